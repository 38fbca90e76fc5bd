"""Soft maps between features: Sinkhorn's doubly stochastic matrix, never held whole unless it fits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.arrays import takes_arrays
from homolog.errors import bad_value
from homolog.memory import fits, row_tiles

# The paper's temperature, for raw products as for normalised features.
TEMPERATURE = 0.2
ITERATIONS = 10

# Up to this size of logits, sums of exponentials and products of two scalings stay within float32.
_LARGEST_PLAIN_LOGIT = 25.0


@dataclass(frozen=True)
class SoftMatches:
    """What is kept of a soft map P (n_y, n_x).

    Args:
        y_to_x: argmax of each row (n_y,).
        row_max: that entry (n_y,); between 0 and 1.
        x_to_y: argmax of each column (n_x,).
        column_max: that entry (n_x,).
        column_sum: sum of each column (n_x,), about n_y / n_x where P is balanced; rows sum to one.
    """

    y_to_x: Int[Tensor, " n_y"]
    row_max: Float[Tensor, " n_y"]
    x_to_y: Int[Tensor, " n_x"]
    column_max: Float[Tensor, " n_x"]
    column_sum: Float[Tensor, " n_x"]


def normalised(features: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
    """Features of unit length per point: those of meshes and clouds differ in length by a factor of ten."""
    return torch.nn.functional.normalize(features, dim=-1)


@takes_arrays
def sinkhorn_matches(
    features_y: Float[Tensor, "n_y d"],
    features_x: Float[Tensor, "n_x d"],
    *,
    temperature: float = TEMPERATURE,
    iterations: int = ITERATIONS,
) -> SoftMatches:
    """The matches of P_yx = Sinkhorn(F_y F_x^T / temperature), columns normalised first and rows last.

    With K = exp(F_y F_x^T / temperature), P is diag(u) K diag(v): only the scalings u and v are iterated (Cuturi,
    "Sinkhorn distances", 2013). A sweep over row tiles normalises a tile's rows and at once adds up its columns, so an
    iteration reads K once: 4 n_y n_x operations. K is kept where it fits the working memory; else its tiles are made
    anew in every sweep, for 2 n_y n_x d operations more.

    Raises:
        ArgumentError: if the temperature or the number of iterations is not positive.
    """
    if not temperature > 0:
        raise bad_value("temperature", temperature, "positive")
    if iterations < 1:
        raise bad_value("iterations", iterations, "at least 1")
    kernel = _Kernel.build(features_y / temperature, features_x)
    column_scaling = kernel.column_log_sums().neg()
    for _ in range(iterations - 1):
        column_scaling = kernel.balanced(_centred(column_scaling))
    return kernel.matches(_centred(column_scaling))


def _centred(scaling: Float[Tensor, " n_x"]) -> Float[Tensor, " n_x"]:
    """The same up to a constant, which the rows' normalisation takes out: it grows by log(n_y / n_x) an iteration."""
    return scaling - scaling.mean()


@dataclass(frozen=True)
class _Kernel:
    """K = exp(logits) by row tiles; log scalings g of its columns and f of its rows."""

    left: Float[Tensor, "n_y d"]
    right: Float[Tensor, "d n_x"]
    # All of K, if it fits and cannot overflow; it then takes the place of the logits.
    whole: Float[Tensor, "n_y n_x"] | None
    plain: bool

    @classmethod
    def build(cls, left: Float[Tensor, "n_y d"], features_x: Float[Tensor, "n_x d"]) -> _Kernel:
        bound = float(left.norm(dim=1).max() * features_x.norm(dim=1).max())
        plain = bound <= _LARGEST_PLAIN_LOGIT
        kernel = cls(left, features_x.T, None, plain)
        if not (plain and fits(len(left) * len(features_x) * left.element_size())):
            return kernel
        whole = left.new_empty(len(left), len(features_x))
        for rows in kernel.tiles():
            torch.mm(left[rows], kernel.right, out=whole[rows])
            whole[rows].exp_()
        return cls(left, kernel.right, whole, plain)

    def tiles(self) -> Iterator[slice]:
        # Up to three arrays of a tile's size live at once.
        return row_tiles(len(self.left), bytes_per_row=3 * self.right.shape[1] * self.left.element_size())

    def column_log_sums(self) -> Float[Tensor, " n_x"]:
        """Log sum_i K_ij."""
        total = self.left.new_full((self.right.shape[1],), -torch.inf)
        for rows in self.tiles():
            total = torch.logaddexp(total, self._tile_log_sums(rows))
        return total

    def balanced(self, column_scaling: Float[Tensor, " n_x"]) -> Float[Tensor, " n_x"]:
        """The next column scaling: rows normalised under this one, then columns."""
        if self.plain:
            return self._balanced_plain(column_scaling.exp()).log()
        total = torch.full_like(column_scaling, -torch.inf)
        for rows in self.tiles():
            logits = self._logits(rows)
            row_scaling = -torch.logsumexp(logits + column_scaling, dim=1, keepdim=True)
            total = torch.logaddexp(total, torch.logsumexp(logits + row_scaling, dim=0))
        return -total

    def matches(self, column_scaling: Float[Tensor, " n_x"]) -> SoftMatches:
        """Normalise the rows a last time and read off maxima and sums."""
        n_y, n_x = len(self.left), self.right.shape[1]
        y_to_x = torch.empty(n_y, dtype=torch.int64, device=self.left.device)
        row_max = self.left.new_empty(n_y)
        x_to_y = torch.zeros(n_x, dtype=torch.int64, device=self.left.device)
        column_max, column_sum = self.left.new_full((n_x,), -1.0), self.left.new_zeros(n_x)
        for rows in self.tiles():
            soft = self._soft_rows(rows, column_scaling)
            torch.max(soft, dim=1, out=(row_max[rows], y_to_x[rows]))
            column_sum += soft.sum(dim=0)
            best, where = soft.max(dim=0)
            better = best > column_max
            column_max = torch.where(better, best, column_max)
            x_to_y = torch.where(better, where + rows.start, x_to_y)
        return SoftMatches(y_to_x, row_max, x_to_y, column_max, column_sum)

    def _logits(self, rows: slice) -> Float[Tensor, "t n_x"]:
        return self.left[rows] @ self.right

    def _exponentials(self, rows: slice) -> Float[Tensor, "t n_x"]:
        return self._logits(rows).exp_() if self.whole is None else self.whole[rows]

    def _tile_log_sums(self, rows: slice) -> Float[Tensor, " n_x"]:
        if self.plain:
            return self._exponentials(rows).sum(dim=0).log()
        return torch.logsumexp(self._logits(rows), dim=0)

    def _balanced_plain(self, scaling: Float[Tensor, " n_x"]) -> Float[Tensor, " n_x"]:
        total = torch.zeros_like(scaling)
        for rows in self.tiles():
            tile = self._exponentials(rows)
            total.addmv_(tile.T, (tile @ scaling).reciprocal_())
        return total.reciprocal_()

    def _soft_rows(self, rows: slice, column_scaling: Float[Tensor, " n_x"]) -> Float[Tensor, "t n_x"]:
        if self.plain:
            scaled = self._exponentials(rows) * column_scaling.exp()
            return scaled / scaled.sum(dim=1, keepdim=True)
        return torch.softmax(self._logits(rows) + column_scaling, dim=1)
