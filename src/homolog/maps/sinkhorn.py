"""Sinkhorn's doubly stochastic map as two scalings of one kernel, and the derivative of what it carries over.

With the logits L = F_y F_x^T, the soft map is P_ij = exp(L_ij + f_i + g_j). Only the logarithms of the scalings, f and
g, are iterated: the columns g = -log sum_i exp(L_ij + f_i) first and the rows f likewise last (Sinkhorn 1967; Cuturi,
"Sinkhorn distances", 2013). At most one n_y x n_x array is held, and none where it does not fit the working memory.
The readable reference is ``homolog.maps.reference.soft_map``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.core.arguments import check_count, is_real
from homolog.core.errors import bad_value
from homolog.core.memory import fits, row_tiles

# The paper's temperature, for raw products as for normalised features.
TEMPERATURE = 0.2
ITERATIONS = 10

# Up to this size of logits, sums of exponentials and products of two scalings stay within float32.
_LARGEST_PLAIN_LOGIT = 25.0
# And up to this size of scalings: between shapes of different size f grows, and g falls, by log(n_y / n_x) each time.
_LARGEST_PLAIN_SCALING = 50.0
# How far scalings may move from those absorbed into a kernel before what has underflowed there could matter.
_LARGEST_SHIFT = 20.0

_Scalings = tuple[Float[Tensor, " n_y"], Float[Tensor, " n_x"]]


@dataclass(frozen=True, eq=False)
class Kernel:
    """K = exp(L + a + b) by row tiles, with scalings a of the rows and b of the columns absorbed.

    Args:
        left: F_y, divided by the temperature.
        right: F_x^T.
        absorbed: a and b; None if the logits are small enough to need none.
        dense: all of K, if it fits the working memory; the logits are then not needed.
    """

    left: Float[Tensor, "n_y d"]
    right: Float[Tensor, "d n_x"]
    absorbed: _Scalings | None = None
    dense: Float[Tensor, "n_y n_x"] | None = None

    @classmethod
    def of(cls, left: Float[Tensor, "n_y d"], right: Float[Tensor, "d n_x"], near: _Scalings | None = None) -> Kernel:
        """The kernel of features, with scalings absorbed only where its logits are too large to go without.

        Args:
            left: F_y, divided by the temperature.
            right: F_x^T.
            near: the scalings that it will be used with; by default the first ones, which make its columns sum to one.
        """
        logits = cls(left, right)
        small = float(left.norm(dim=1).max() * right.norm(dim=0).max()) <= _LARGEST_PLAIN_LOGIT
        if small and (near is None or logits.covers(*near)):
            return logits._kept_dense()
        nothing = left.new_zeros(len(left))
        return logits.with_absorbed(*(near or (nothing, logits.exact_columns(nothing))))

    def with_absorbed(self, f: Float[Tensor, " n_y"], g: Float[Tensor, " n_x"]) -> Kernel:
        """The kernel of the same features with these scalings absorbed, in the memory of this one: use it no more."""
        return Kernel(self.left, self.right, (f, g))._kept_dense(self.dense)

    def tiles(self) -> Iterator[tuple[slice, Float[Tensor, "t n_x"]]]:
        """Row tiles of K; each is to be used before the next is asked for."""
        if self.dense is not None:
            yield from ((rows, self.dense[rows]) for rows in self._slices())
            return
        for rows, logits in self.logits():
            yield rows, self._exponentials(rows, logits)

    def sweep(self) -> Iterator[tuple[slice, Float[Tensor, "t n_x"]]]:
        """The same for what makes nothing of a tile's size: in one piece where all of K is kept."""
        return self.tiles() if self.dense is None else iter([(slice(len(self.left)), self.dense)])

    def relative(self, f: Float[Tensor, " n_y"], g: Float[Tensor, " n_x"]) -> _Scalings:
        """Scalings u and v with exp(L + f + g) = diag(u) K diag(v)."""
        f, g = self._shifts(f, g)
        return f.exp(), g.exp()

    def covers(self, f: Float[Tensor, " n_y"], g: Float[Tensor, " n_x"]) -> bool:
        """Whether nothing that matters for these scalings has underflowed in K."""
        largest = _LARGEST_SHIFT if self.absorbed else _LARGEST_PLAIN_SCALING
        return all(bool(shift.abs().amax() <= largest) for shift in self._shifts(f, g))

    def iterate(self, g: Float[Tensor, " n_x"]) -> _Scalings:
        """The row scalings under the columns' g, and the columns' next: one sweep over K."""
        a, b = self.absorbed or (0.0, 0.0)
        v = (g - b).exp()
        row_sums, column_sums = torch.empty_like(self.left[:, 0]), torch.zeros_like(g)
        for rows, tile in self.sweep():
            torch.mv(tile, v, out=row_sums[rows])
            column_sums.addmv_(tile.T, row_sums[rows].reciprocal())
        # K holds exp(a + b) already: the sums are those of the logits under f - a and g - b.
        return a - row_sums.log(), b - column_sums.log()

    def logits(self) -> Iterator[tuple[slice, Float[Tensor, "t n_x"]]]:
        """Row tiles of L; each is to be used before the next is asked for, and may be written to."""
        tiles = list(self._slices())
        # One buffer for all tiles: fresh memory costs as much as the products themselves.
        scratch = self.left.new_empty(tiles[0].stop if tiles else 0, self.right.shape[1])
        for rows in tiles:
            yield rows, torch.mm(self.left[rows], self.right, out=scratch[: rows.stop - rows.start])

    def exact_iteration(self, g: Float[Tensor, " n_x"]) -> _Scalings:
        """``iterate`` in the logarithm, from the logits: slow, and right wherever the scalings may lie."""
        f = torch.empty_like(self.left[:, 0])
        for rows, logits in self.logits():
            f[rows] = -torch.logsumexp(logits + g, dim=1)
        return f, self.exact_columns(f)

    def exact_columns(self, f: Float[Tensor, " n_y"]) -> Float[Tensor, " n_x"]:
        """The columns' scaling under the rows' f, in the logarithm."""
        total = torch.full_like(self.right[0], -torch.inf)
        for rows, logits in self.logits():
            total = torch.logaddexp(total, torch.logsumexp(logits + f[rows, None], dim=0))
        return -total

    def _shifts(self, f: Float[Tensor, " n_y"], g: Float[Tensor, " n_x"]) -> _Scalings:
        """How far scalings lie from those absorbed."""
        return (f, g) if self.absorbed is None else (f - self.absorbed[0], g - self.absorbed[1])

    def _slices(self) -> Iterator[slice]:
        # Up to three arrays of a tile's size live at once.
        return row_tiles(len(self.left), bytes_per_row=3 * self.right.shape[1] * self.left.element_size())

    def _exponentials(self, rows: slice, logits: Float[Tensor, "t n_x"]) -> Float[Tensor, "t n_x"]:
        if self.absorbed is not None:
            logits.add_(self.absorbed[0][rows, None]).add_(self.absorbed[1])
        return logits.exp_()

    def _kept_dense(self, memory: Float[Tensor, "n_y n_x"] | None = None) -> Kernel:
        n_y, n_x = len(self.left), self.right.shape[1]
        if not fits(n_y * n_x * self.left.element_size()):
            return self
        dense = self.left.new_empty(n_y, n_x) if memory is None else memory
        for rows in self._slices():
            self._exponentials(rows, torch.mm(self.left[rows], self.right, out=dense[rows]))
        return Kernel(self.left, self.right, self.absorbed, dense)


@dataclass(frozen=True, eq=False)
class Balanced:
    """The scalings of all iterations, f_t and g_t for t = 1 ... T, and a kernel that covers the last."""

    kernel: Kernel
    rows: list[Float[Tensor, " n_y"]]
    columns: list[Float[Tensor, " n_x"]]


def balance(
    features_y: Float[Tensor, "n_y d"], features_x: Float[Tensor, "n_x d"], *, temperature: float, iterations: int
) -> Balanced:
    """Run Sinkhorn's iterations on the kernel of two sets of features.

    A sweep normalises the rows and adds up the columns, 4 n_y n_x operations. Where K does not fit, its tiles are made
    anew in every sweep, for 2 n_y n_x d more.

    Raises:
        ArgumentError: if the temperature or the number of iterations is not positive.
    """
    if not (is_real(temperature) and temperature > 0):
        raise bad_value("temperature", temperature, "a positive finite number")
    check_count("iterations", iterations)
    kernel = Kernel.of(features_y / temperature, features_x.T)
    g = _first_columns(kernel)
    rows, columns = [], []
    for _ in range(iterations):
        columns.append(g)
        f, g = kernel.iterate(g)
        if not kernel.covers(f, columns[-1]):  # infinite ones are not covered, either
            f, g = kernel.exact_iteration(columns[-1])
            kernel = kernel.with_absorbed(f, columns[-1])
        rows.append(f)
    return Balanced(kernel, rows, columns)


def _first_columns(kernel: Kernel) -> Float[Tensor, " n_x"]:
    if kernel.absorbed is not None:
        return kernel.absorbed[1]
    total = torch.zeros_like(kernel.right[0])
    for _, tile in kernel.tiles():
        total += tile.sum(dim=0)
    return -total.log()


def carried_over(
    features_y: Float[Tensor, "n_y d"],
    features_x: Float[Tensor, "n_x d"],
    functions_x: Float[Tensor, "n_x k"],
    *,
    temperature: float = TEMPERATURE,
    iterations: int = ITERATIONS,
) -> Float[Tensor, "n_y k"]:
    """Transfer of functions by a soft map: P_yx times functions on x, with P_yx = Sinkhorn(F_y F_x^T / temperature).

    Differentiable in the features. The derivative is taken iteration by iteration, with the scalings as the only thing
    kept, and the kernel made anew: one array of n_y x n_x at most, where unrolled iterations hold twenty. New here.
    ``torch.func.grad`` and ``vmap`` work, the latter member by member; second derivatives and forward mode are for
    ``homolog.maps.reference.soft_map``.

    Args:
        features_y: of unit length per point (n_y, d).
        features_x: likewise (n_x, d).
        functions_x: what is transferred, not differentiated (n_x, k).
        temperature: above 0.
        iterations: of both normalisations.

    Returns:
        The functions on y (n_y, k).

    Raises:
        ArgumentError: if the temperature or the number of iterations is not positive.

    Examples:
        >>> import torch
        >>> from homolog.maps.sinkhorn import carried_over
        >>> carried_over(torch.eye(3), torch.eye(3), torch.ones(3, 1)).round(decimals=4).flatten()
        tensor([1., 1., 1.])
    """
    return _CarriedOver.apply(features_y, features_x, functions_x, temperature, iterations)[0]  # type: ignore[no-untyped-call,no-any-return]


class _CarriedOver(torch.autograd.Function):
    """The functions carried over, and the scalings of all iterations, rows first: all that the derivative needs."""

    @staticmethod
    def forward(
        features_y: Tensor, features_x: Tensor, functions_x: Tensor, temperature: float, iterations: int
    ) -> tuple[Tensor, ...]:
        balanced = balance(features_y, features_x, temperature=temperature, iterations=iterations)
        u, v = balanced.kernel.relative(balanced.rows[-1], balanced.columns[-1])
        carried, weighted = functions_x.new_empty(len(u), functions_x.shape[1]), v[:, None] * functions_x
        for rows, tile in balanced.kernel.tiles():
            torch.mm(tile, weighted, out=carried[rows])
        return carried.mul_(u[:, None]), *balanced.rows, *balanced.columns

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
        *tensors, ctx.temperature, _ = inputs
        ctx.mark_non_differentiable(*output[1:])
        ctx.save_for_backward(*tensors, *output[1:])

    @staticmethod
    def backward(ctx: Any, grad: Tensor, *_: Tensor) -> tuple[Tensor | None, ...]:
        left, right = _PulledBack.apply(grad, ctx.temperature, *ctx.saved_tensors)  # type: ignore[no-untyped-call]
        return left, right, None, None, None

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *inputs: Any) -> tuple[tuple[Tensor, ...], tuple[int, ...]]:
        """See ``_one_by_one``."""
        return _one_by_one(_CarriedOver, info.batch_size, in_dims, inputs)


class _PulledBack(torch.autograd.Function):
    """The gradients of both features from that of the functions carried over."""

    @staticmethod
    def forward(
        grad: Tensor,
        temperature: float,
        features_y: Tensor,
        features_x: Tensor,
        functions_x: Tensor,
        *scalings: Tensor,
    ) -> tuple[Tensor, Tensor]:
        rows, columns = scalings[: len(scalings) // 2], scalings[len(scalings) // 2 :]
        left, right = features_y / temperature, features_x.T
        kernel = Kernel.of(left, right, near=(rows[-1], columns[-1]))
        derivative = _Derivative(kernel, [torch.zeros_like(rows[0]), *rows], columns)
        derivative.run(grad, functions_x)
        return derivative.left / temperature, derivative.right

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        """Keep nothing: there is no second derivative."""

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> None:
        raise NotImplementedError(
            "what a soft map carries over is derived once; for second derivatives use homolog.maps.reference.soft_map"
        )

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *inputs: Any) -> tuple[tuple[Tensor, ...], tuple[int, ...]]:
        """See ``_one_by_one``."""
        return _one_by_one(_PulledBack, info.batch_size, in_dims, inputs)


def _one_by_one(
    function: type[torch.autograd.Function], batch_size: int, in_dims: tuple[int | None, ...], inputs: tuple[Any, ...]
) -> tuple[tuple[Tensor, ...], tuple[int, ...]]:
    """Members of a ``vmap`` one after another: all of them together would not keep to the working memory."""
    results = []
    for i in range(batch_size):
        member = [value if at is None else value.select(at, i) for value, at in zip(inputs, in_dims, strict=True)]
        results.append(function.apply(*member))  # type: ignore[no-untyped-call]
    outputs = tuple(map(torch.stack, zip(*results, strict=True)))
    return outputs, (0,) * len(outputs)


class _Derivative:
    """Pulls the gradient of P times functions back to the features, through all iterations.

    Let R = exp(L + f_t + g_t), whose rows sum to one, and Q = exp(L + f_{t-1} + g_t), whose columns do. Differentiated,
    the iterations read df_t = -R (dL + dg_t) row by row, and dg_t = -Q^T (dL + df_{t-1}) column by column. Each adds to
    the gradient of L a matrix of rank one times K; all together they are K times a single matrix product.

    Args:
        kernel: of the features; covers the last scalings.
        rows: f_0 = 0 to f_T.
        columns: g_1 to g_T.
    """

    def __init__(self, kernel: Kernel, rows: Sequence[Tensor], columns: Sequence[Tensor]) -> None:
        self.kernel, self.rows, self.columns = kernel, rows, columns
        self.left, self.right = torch.zeros_like(kernel.left), torch.zeros_like(kernel.right.T)
        self._factors: list[tuple[Tensor, Tensor]] = []

    def run(self, grad: Float[Tensor, "n_y k"], functions: Float[Tensor, "n_x k"]) -> None:
        """Find the gradients: ``left`` of F_y divided by the temperature, ``right`` of F_x."""
        column_grad = self._through_product(grad, functions)
        for t in range(len(self.columns), 0, -1):
            column_grad = self._through_iteration(t, column_grad)
        a, b = (torch.cat(factors, dim=1) for factors in zip(*self._factors, strict=True))
        for rows, tile in self.kernel.tiles():
            self._pull_back(rows, (a[rows] @ b.T).mul_(tile))

    def _through_product(
        self, grad: Float[Tensor, "n_y k"], functions: Float[Tensor, "n_x k"]
    ) -> Float[Tensor, " n_x"]:
        """From the product to the last scalings; what is asked for of g_T."""
        u, v = self.kernel.relative(self.rows[-1], self.columns[-1])
        grad, functions = u[:, None] * grad, v[:, None] * functions
        row_grad, column_grad, back = torch.empty_like(u), torch.zeros_like(v), torch.zeros_like(v)
        for rows, tile in self.kernel.tiles():
            weighted = (grad[rows] @ functions.T).mul_(tile)
            row_grad[rows] = weighted.sum(dim=1)
            column_grad += weighted.sum(dim=0)
            back.addmv_(tile.T, u[rows] * row_grad[rows])
        self._factors += [(grad, functions), (-(row_grad * u)[:, None], v[:, None])]
        return column_grad - v * back

    def _through_iteration(self, t: int, column_grad: Float[Tensor, " n_x"]) -> Float[Tensor, " n_x"]:
        """From g_t by f_{t-1} to g_{t-1}."""
        f, g, g_before = self.rows[t - 1], self.columns[t - 1], self.columns[max(t - 2, 0)]
        if not (self.kernel.covers(f, g) and self.kernel.covers(f, g_before)):
            return self._through_iteration_exactly(f, g, g_before if t > 1 else None, column_grad)
        (u, v), (_, v_before) = self.kernel.relative(f, g), self.kernel.relative(f, g_before)
        column_grad = v * column_grad
        self._factors.append((-u[:, None], column_grad[:, None]))
        if t == 1:
            return column_grad
        row_grad, back = torch.empty_like(u), torch.zeros_like(v)
        for rows, tile in self.kernel.sweep():
            row_grad[rows] = -u[rows] * (tile @ column_grad)
            back.addmv_(tile.T, u[rows] * row_grad[rows])
        self._factors.append((-(row_grad * u)[:, None], v_before[:, None]))
        return -v_before * back

    def _through_iteration_exactly(
        self,
        f: Float[Tensor, " n_y"],
        g: Float[Tensor, " n_x"],
        g_before: Float[Tensor, " n_x"] | None,
        column_grad: Float[Tensor, " n_x"],
    ) -> Float[Tensor, " n_x"]:
        """The same from the logits, where the scalings lie too far from those that the kernel has absorbed."""
        back = torch.zeros_like(g)
        for rows, logits in self.kernel.logits():
            normal_columns = (logits + f[rows, None] + g).exp_().mul_(column_grad)
            if g_before is not None:
                row_grad = -normal_columns.sum(dim=1, keepdim=True)
                normal_rows = (logits + f[rows, None] + g_before).exp_().mul_(row_grad)
                back -= normal_rows.sum(dim=0)
                normal_columns += normal_rows
            self._pull_back(rows, normal_columns.neg_())
        return back

    def _pull_back(self, rows: slice, logits_grad: Float[Tensor, "t n_x"]) -> None:
        """From the logits of a row tile to the features."""
        self.left[rows].addmm_(logits_grad, self.kernel.right.T)
        self.right.addmm_(logits_grad.T, self.kernel.left[rows])
