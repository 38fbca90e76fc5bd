"""A block Lanczos iteration on an inverted operator, with full reorthogonalisation."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

Inverse = Callable[[Tensor], Tensor]


class BlockLanczos:
    """An orthonormal Krylov basis, grown block by block, with the operator projected onto it.

    The basis stays orthogonal to ``kernel``, whose eigenpairs are known. Full reorthogonalisation in whole blocks costs
    2 n m^2 multiplications for m vectors, all in matrix products; single vectors would be bound by memory instead.

    Args:
        inverse: takes rows (b, n) to (S - shift)^-1 applied to each.
        kernel: orthonormal rows (c, n) to stay away from.
        block: vectors per step; also the highest multiplicity that is found for certain.
        capacity: the most vectors to hold.
    """

    def __init__(self, inverse: Inverse, kernel: Float[Tensor, "c n"], *, block: int, capacity: int) -> None:
        self._inverse, self._kernel, self._block = inverse, kernel, block
        # Rows hold the vectors, so that blocks are contiguous. There is always one block more than was multiplied.
        self._rows = torch.empty(capacity, kernel.shape[1], dtype=torch.float64)
        self._projected = torch.zeros(capacity, capacity, dtype=torch.float64)
        start = torch.randn(block, kernel.shape[1], generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        self._rows[:block], self._coupling = _orthonormal_rows(self._away_from_kernel(start))
        self._filled = block

    @property
    def size(self) -> int:
        """Vectors in the part of the basis that the operator has been projected onto."""
        return self._filled - self._block

    def grow(self) -> bool:
        """Apply the operator to the newest block; False, with nothing done, when there is no room for the result."""
        block, filled = self._block, self._filled
        if filled + block > len(self._rows):
            return False
        image = self._away_from_kernel(self._inverse(self._rows[filled - block : filled]))
        # The three-term recurrence takes out the large part; a single pass against everything then suffices.
        self._take_out(image, max(0, filled - 2 * block))
        self._take_out(image, 0)
        self._rows[filled : filled + block], self._coupling = _orthonormal_rows(image)
        self._filled = filled + block
        return True

    def ritz_pairs(self) -> tuple[Float[Tensor, " m"], Float[Tensor, "m m"], Float[Tensor, " m"]]:
        """Ritz values theta of the inverted operator, their vectors in the basis (columns), and |A v - theta v|."""
        upper = torch.triu(self._projected[: self.size, : self.size])
        values, vectors = torch.linalg.eigh(upper + torch.triu(upper, 1).T)
        return values, vectors, (self._coupling @ vectors[-self._block :]).norm(dim=0)

    def lift(self, vectors: Float[Tensor, "m j"]) -> Float[Tensor, "n j"]:
        """Vectors in the basis as vectors in the whole space."""
        return self._rows[: self.size].T @ vectors

    def _take_out(self, image: Float[Tensor, "b n"], first: int) -> None:
        basis = self._rows[first : self._filled]
        overlap = basis @ image.T
        image -= overlap.T @ basis
        self._projected[first : self._filled, self._filled - self._block : self._filled] += overlap

    def _away_from_kernel(self, rows: Float[Tensor, "b n"]) -> Float[Tensor, "b n"]:
        return rows - (rows @ self._kernel.T) @ self._kernel


def _orthonormal_rows(rows: Float[Tensor, "b n"]) -> tuple[Float[Tensor, "b n"], Float[Tensor, "b b"]]:
    """Q and R with ``rows = R^T Q``, Q of orthonormal rows."""
    columns, triangle = torch.linalg.qr(rows.T)
    return columns.T, triangle
