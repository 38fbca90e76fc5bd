"""Block Lanczos iteration on an inverted operator, with full reorthogonalisation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg
import torch
from jaxtyping import Float
from torch import Tensor

Inverse = Callable[[Tensor], Tensor]


class BlockLanczos:
    """Block Lanczos: an orthonormal Krylov basis, grown block by block, with the operator projected onto it.

    The basis stays orthogonal to ``kernel``, whose eigenpairs are known. Full reorthogonalisation in blocks costs
    2 n m^2 multiplications for m vectors, all in matrix products; single vectors would be bound by memory instead.
    (Golub and Underwood, "The block Lanczos method for computing eigenvalues", 1977.)

    Args:
        inverse: takes rows (b, n) to (S - shift)^-1 applied to each.
        kernel: orthonormal rows (c, n) that the basis stays orthogonal to.
        block: vectors per step; also the highest multiplicity that is found for certain.
        capacity: the most vectors to hold, besides the kernel.
    """

    def __init__(self, inverse: Inverse, kernel: Float[Tensor, "c n"], *, block: int, capacity: int) -> None:
        self._inverse, self._block, self._first = inverse, block, len(kernel)
        # Rows hold the vectors, so that blocks are contiguous: the kernel, what has been multiplied, one block more.
        # NumPy's memory comes in huge pages, PyTorch's does not, and first touching it takes a tenth of the time.
        self._rows = torch.from_numpy(np.empty((len(kernel) + capacity, kernel.shape[1])))
        self._rows[: self._first] = kernel
        self._projected = torch.zeros(len(self._rows), len(self._rows), dtype=torch.float64)
        self._filled = self._first
        start = torch.randn(block, kernel.shape[1], generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        self._take_out(start, 0)
        self._append(start)

    @property
    def size(self) -> int:
        """Vectors in the part of the basis that the operator has been projected onto."""
        return self._filled - self._block - self._first

    def grow(self) -> bool:
        """Apply the operator to the newest block; False, with nothing done, when there is no room for the result."""
        if self._filled + self._block > len(self._rows):
            return False
        image = self._inverse(self._rows[self._filled - self._block : self._filled])
        # The three-term recurrence takes out the large part; a single pass against everything then suffices.
        near = max(0, self._filled - 2 * self._block)
        overlaps = self._projected[self._filled - self._block : self._filled]
        overlaps[:, near : self._filled] = self._take_out(image, near)
        overlaps[:, : self._filled] += self._take_out(image, 0)
        self._append(image)
        return True

    def ritz_pairs(self) -> tuple[Float[Tensor, " m"], Float[Tensor, "m m"], Float[Tensor, " m"]]:
        """Ritz values theta of the inverted operator, their vectors in the basis (columns), and |A v - theta v|."""
        basis = slice(self._first, self._filled - self._block)
        # Block tridiagonal with triangles beside the diagonal: a band, but for rounding. LAPACK's solver for bands is
        # twice as fast as PyTorch's dense one, and has one thread: NumPy's stall where a core has other work.
        projected = self._projected[basis, basis].numpy()
        band = [np.pad(np.diagonal(projected, -below), (0, below)) for below in range(self._block + 1)]
        values, vectors = map(torch.from_numpy, scipy.linalg.eig_banded(band, lower=True))
        return values, vectors, (self._coupling @ vectors[-self._block :]).norm(dim=0)

    def refined(self, values: Float[Tensor, " j"], vectors: Float[Tensor, "m j"]) -> Float[Tensor, "n c+j"]:
        """The kernel, then Ritz vectors in the full space after one more step of the power method, A v / theta.

        It costs no application of the operator, since A v lies in the span of the basis and its newest block.
        """
        weights = torch.eye(self._filled, self._first + len(values), dtype=torch.float64)
        weights[self._first : -self._block, self._first :] = vectors
        weights[-self._block :, self._first :] = self._coupling @ vectors[-self._block :] / values
        return self._rows[: self._filled].T @ weights

    def _take_out(self, image: Float[Tensor, "b n"], first: int) -> Float[Tensor, "b m"]:
        basis = self._rows[first : self._filled]
        overlap = image @ basis.T
        image.addmm_(overlap, basis, alpha=-1)
        return overlap

    def _append(self, image: Float[Tensor, "b n"]) -> None:
        columns, self._coupling = torch.linalg.qr(image.T)  # image = coupling^T @ the new rows
        self._rows[self._filled : self._filled + self._block] = columns.T
        self._filled += self._block
