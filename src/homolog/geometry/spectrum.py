"""Eigenpairs of a Laplacian: shift-and-invert block Lanczos, with a check that none was missed."""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg as sparse_linalg
import torch
from jaxtyping import Float
from torch import Tensor

from homolog.core.errors import ShapeError, bad_value
from homolog.core.reprs import short_repr
from homolog.geometry.lanczos import BlockLanczos, Inverse

_log = logging.getLogger(__name__)

# Dense solves: at most this many points, or more than this share of all eigenpairs. They are faster there, and exact.
_DENSE_POINTS = 500
_DENSE_SHARE = 0.2
# The most points for a dense solve as the last resort: some seconds, and well under a gigabyte.
_DENSE_LIMIT = 6000

# Block Lanczos: sizes of blocks, tried in this order; a block finds eigenvalues of that multiplicity for certain.
_BLOCKS = (8, 32)
# The share of the eigenvalues asked for that lies below the shift. The upper end, where those not asked for begin, must
# be nearer than the lower: it takes a third fewer solves than a shift at zero.
_SHARE_BELOW = 0.62
# Constant functions of at most this many connected components are known beforehand.
_MOST_COMPONENTS = 200
# Up to this many points the factors are solved in one thread: they are small, and threads get in each other's way.
_ONE_THREAD_POINTS = 15_000
# Restarts of ARPACK, which needs a few where it converges at all.
_MOST_RESTARTS = 30

# Largest accepted |S u - lambda u|, as a share of the largest eigenvalue asked for: of block Lanczos, of ARPACK, and of
# dense solves, whose eigenpairs mean nothing beyond that.
_TOLERANCE = 1e-6
_LOOSE_TOLERANCE = 1e-4
_DENSE_TOLERANCE = 1e-2

# What singular factors, numbers that are not finite, and too little memory raise in SciPy and PyTorch.
_FAILURES = (RuntimeError, ValueError, MemoryError)

_Pairs = tuple[Float[Tensor, " k"], Float[Tensor, "n k"]]


@dataclass(frozen=True)
class Spectrum:
    """The lowest eigenpairs, L phi = lambda M phi, in ascending order.

    Args:
        eigenvalues: (k,), float64, not negative.
        eigenvectors: (n, k), float64, with Phi^T M Phi = I; the entry of largest size in each is positive.
        residual: the largest |L phi - lambda M phi|, in the norm of M^-1, as a share of the largest eigenvalue.
        method: how they were found, for reports.

    Examples:
        >>> import trimesh
        >>> from homolog.geometry import lowest_eigenpairs, mesh_laplacian
        >>> mesh = trimesh.creation.icosphere(subdivisions=2)
        >>> lowest_eigenpairs(*mesh_laplacian(mesh.vertices, mesh.faces), 10).method
        'dense'
    """

    eigenvalues: Float[np.ndarray, " k"]
    eigenvectors: Float[np.ndarray, "n k"]
    residual: float
    method: str

    __repr__ = short_repr


def lowest_eigenpairs(laplacian: sparse.spmatrix, mass: Float[np.ndarray, " n"], n_eigenpairs: int) -> Spectrum:
    """The ``n_eigenpairs`` lowest eigenpairs of L phi = lambda M phi, by shift-and-invert block Lanczos.

    The shift lies among the eigenvalues asked for, at 62 % by Weyl's law; functions that are constant on a connected
    component are known beforehand. Sylvester's law of inertia then tells whether any eigenpair was missed. If one was,
    larger blocks are tried, then a dense solve where that is affordable, else ARPACK; ``method`` says which, and
    whether what ARPACK found is incomplete. Small problems are solved densely. The combination is new here.

    Args:
        laplacian: sparse, symmetric, positive semidefinite (n, n).
        mass: lumped, positive (n,).
        n_eigenpairs: at least 1; at most n are found.

    Raises:
        ArgumentError: if ``n_eigenpairs`` is not positive.
        ShapeError: if no method gives eigenpairs with a small residual.

    Examples:
        >>> import trimesh
        >>> from homolog.geometry import lowest_eigenpairs, mesh_laplacian
        >>> mesh = trimesh.creation.icosphere(subdivisions=4)
        >>> spectrum = lowest_eigenpairs(*mesh_laplacian(mesh.vertices, mesh.faces), 4)
        >>> spectrum.eigenvalues.round(1) + 0  # of the sphere: 0, then 2 three times
        array([0., 2., 2., 2.])
    """
    if n_eigenpairs < 1:
        raise bad_value("n_eigenpairs", n_eigenpairs, "at least 1")
    problem = _Problem.build(laplacian, mass)
    k = min(n_eigenpairs, problem.size)
    try:
        return _found(problem, k)
    except _FAILURES as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ShapeError(f"the eigenvalues of the Laplacian were not found ({reason}); remesh the shape") from None


def _found(problem: _Problem, k: int) -> Spectrum:
    if problem.size <= _DENSE_POINTS or k > _DENSE_SHARE * problem.size:
        return _checked(problem.spectrum(_dense(problem, k), "dense"), _DENSE_TOLERANCE)
    for block in _BLOCKS:
        pairs = _shift_and_invert(problem, k, block)
        found = problem.spectrum(pairs, f"block Lanczos, blocks of {block}") if pairs is not None else None
        if found is not None and found.residual < _TOLERANCE:
            return found
        _log.info("block Lanczos with blocks of %d did not find every eigenpair", block)
    return _last_resort(problem, k)


def _checked(found: Spectrum, tolerance: float = _LOOSE_TOLERANCE) -> Spectrum:
    if found.residual <= tolerance:  # which it is not if it is no number
        return found
    raise RuntimeError(f"a residual of {found.residual:.1g}")


@dataclass(frozen=True)
class _Problem:
    """The symmetric problem S u = lambda u with S = M^-1/2 L M^-1/2, where phi = M^-1/2 u."""

    matrix: sparse.csc_matrix
    root_mass: Float[np.ndarray, " n"]
    # Orthonormal rows, the known eigenvectors for lambda = 0: constant on one connected component each.
    kernel: Float[Tensor, "c n"]

    @classmethod
    def build(cls, laplacian: sparse.spmatrix, mass: Float[np.ndarray, " n"]) -> _Problem:
        root_mass = np.sqrt(mass)
        scaling = sparse.diags(1 / root_mass)
        matrix = scaling @ laplacian @ scaling
        count, component = sparse.csgraph.connected_components(laplacian, directed=False)
        # Of more components than that, the largest are kept: the others hardly matter.
        kept = np.argsort(-np.bincount(component, mass), kind="stable")[: min(count, _MOST_COMPONENTS)]
        kernel = np.where(component[None, :] == kept[:, None], root_mass[None, :], 0.0)
        kernel /= np.linalg.norm(kernel, axis=1, keepdims=True)
        # robust-laplacian gives a point without faces a one on the diagonal: a constant there is not in the kernel.
        size = np.linalg.norm(kernel * matrix.diagonal(), axis=1)
        kernel = kernel[np.linalg.norm(matrix @ kernel.T, axis=0) <= 1e-9 * size]
        return cls(((matrix + matrix.T) / 2).tocsc(), root_mass, torch.from_numpy(kernel))

    @property
    def size(self) -> int:
        return len(self.root_mass)

    def factorise(self, shift: float) -> sparse_linalg.SuperLU:
        """A sparse L D L^T of S - shift, in the form of an LU with symmetric ordering and diagonal pivots."""
        shifted = (self.matrix - shift * sparse.identity(self.size, format="csc")).tocsc()
        return sparse_linalg.splu(
            shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )

    def expected_eigenvalue(self, k: int) -> float:
        """About where the k-th eigenvalue of a surface lies, by Weyl's law: 4 pi k / area."""
        return 4 * np.pi * k / float(self.root_mass @ self.root_mass)

    def count_below(self, value: float) -> int | None:
        """How many eigenvalues lie below ``value``; None if it is an eigenvalue itself, so that no factors tell."""
        try:
            return _negative_pivots(self.factorise(value))
        except RuntimeError:
            return None

    def with_kernel(self, pairs: _Pairs, wanted: int) -> _Pairs:
        """The lowest ``wanted`` eigenpairs, from those outside the kernel in ascending order."""
        zeros = torch.zeros(len(self.kernel), dtype=torch.float64)
        values, vectors = torch.cat([zeros, pairs[0]]), torch.cat([self.kernel.T, pairs[1]], dim=1)
        return values[:wanted], vectors[:, :wanted]

    def residual(self, pairs: _Pairs) -> float:
        values, vectors = pairs
        errors = torch.from_numpy(self.matrix @ vectors.numpy()).addcmul_(vectors, values, value=-1).norm(dim=0)
        return float(errors.max()) / self.scale(values)

    def scale(self, values: Float[Tensor, " k"]) -> float:
        """The size of the largest eigenvalue: where there are more components than pairs asked for, all are zero."""
        return max(float(values.max()), 1e-3 * self.expected_eigenvalue(len(values)))

    def spectrum(self, pairs: _Pairs, method: str) -> Spectrum:
        values, vectors = pairs[0].numpy(), pairs[1].numpy() / self.root_mass[:, None]
        vectors *= np.where(vectors.max(axis=0) < -vectors.min(axis=0), -1.0, 1.0)
        return Spectrum(np.maximum(values, 0.0), vectors, self.residual(pairs), method)


def _negative_pivots(factors: sparse_linalg.SuperLU) -> int:
    """As many as there are eigenvalues below the shift (Sylvester's law of inertia)."""
    return int((factors.U.diagonal() < 0).sum())


def _shift_and_invert(problem: _Problem, k: int, block: int) -> _Pairs | None:
    """Eigenpairs by block Lanczos on (S - shift)^-1, or None if it does not converge or misses any."""
    try:
        return _iterate(problem, *_shifted(problem, k), k, block)
    except _FAILURES:  # the shift hit an eigenvalue, or nearly
        return None


def _iterate(problem: _Problem, shift: float, factors: sparse_linalg.SuperLU, k: int, block: int) -> _Pairs | None:
    # SuperLU solves in one thread, and lets others run meanwhile.
    threads = min(torch.get_num_threads(), block) if problem.size > _ONE_THREAD_POINTS else 1
    with ThreadPoolExecutor(threads) as pool:

        def inverse(rows: Tensor) -> Tensor:
            parts = [part.numpy().T for part in rows.chunk(threads)]
            return torch.cat([torch.from_numpy(solved.T) for solved in pool.map(factors.solve, parts)])

        return _grown(problem, inverse, shift, k, block)


def _grown(problem: _Problem, inverse: Inverse, shift: float, k: int, block: int) -> _Pairs | None:
    wanted = k + 1  # one more, to know where the next eigenvalue begins
    capacity = min(4 * wanted + 12 * block, problem.size - len(problem.kernel))
    krylov = BlockLanczos(inverse, problem.kernel, block=block, capacity=capacity)
    # Bodies, spheres and boxes need this many vectors, for 30 to 200 eigenpairs.
    check_at = min(1.6 * wanted + 9 * block, capacity - 3 * block)
    while krylov.grow():
        if krylov.size >= check_at:
            check_at = krylov.size + 2 * block
            pairs = _converged(problem, krylov, shift, wanted)
            if pairs is not None:
                return _complete(problem, pairs, k)
    return None


def _shifted(problem: _Problem, k: int) -> tuple[float, sparse_linalg.SuperLU]:
    """A shift below which about the best share of the wanted eigenvalues lies, and the factors of S - shift."""
    shift = _SHARE_BELOW * problem.expected_eigenvalue(k)
    factors = problem.factorise(shift)
    share = _negative_pivots(factors) / k
    if abs(share - _SHARE_BELOW) > 0.1 and share > 0:  # Weyl's law is off, as it is for shapes with long boundaries
        shift *= _SHARE_BELOW / share
        factors = problem.factorise(shift)
    return shift, factors


def _converged(problem: _Problem, krylov: BlockLanczos, shift: float, wanted: int) -> _Pairs | None:
    """The lowest ``wanted`` eigenpairs, those of the kernel included, if their residuals are small enough."""
    inverse_values, vectors, errors = krylov.ritz_pairs()
    values = shift + 1 / inverse_values
    # Negative ones are near-zero values of the inverse: the far end of the spectrum, of either sign by rounding.
    values = torch.where(values < -1e-3 * shift, torch.inf, values)
    order = torch.argsort(values)[: max(wanted - len(problem.kernel), 0)]
    values = torch.cat([torch.zeros(len(problem.kernel), dtype=torch.float64), values[order]])[:wanted]
    # What |S u - lambda u| will be for the refined vectors.
    residuals = errors[order] / inverse_values[order].square()
    if (residuals > 0.1 * _TOLERANCE * problem.scale(values)).any():
        return None
    return values, krylov.refined(inverse_values[order], vectors[:, order])[:, :wanted]


def _complete(problem: _Problem, pairs: _Pairs, k: int) -> _Pairs | None:
    """The first ``k`` eigenpairs, or None if the law of inertia says that some were missed."""
    values, vectors = pairs
    # Inside a cluster of equal eigenvalues there is nowhere to count from. Where the k-th lies in one, the count is
    # taken below the cluster: it does not matter which of its members were found.
    least_gap = (1e-4 * values[1:]).clamp(min=1e-8 * problem.expected_eigenvalue(k))
    (gaps,) = torch.nonzero(values[1:] - values[:-1] > least_gap, as_tuple=True)
    if len(gaps):
        below = int(gaps[-1]) + 1
        if problem.count_below(float(values[below - 1] + values[below]) / 2) != below:
            return None
    return values[:k], vectors[:, :k]


def _dense(problem: _Problem, k: int) -> _Pairs:
    matrix = torch.from_numpy(problem.matrix.toarray())
    # The known zero modes are moved above all others, where they cannot mix with those that are nearly zero.
    matrix.addmm_(problem.kernel.T, problem.kernel, alpha=2 * float(matrix.abs().sum(dim=1).max()))
    rest = problem.size - len(problem.kernel)
    values, vectors = torch.linalg.eigh(matrix)
    return problem.with_kernel((values[:rest], vectors[:, :rest]), k)


def _arpack(problem: _Problem, wanted: int) -> _Pairs:
    shift = -1e-2 / float(problem.root_mass @ problem.root_mass)
    factors, kernel = problem.factorise(shift), problem.kernel.numpy()

    def outside(vector: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        rest: np.ndarray = vector - kernel.T @ (kernel @ vector)
        return rest

    inverse = sparse_linalg.LinearOperator(
        (problem.size, problem.size), matvec=lambda vector: outside(factors.solve(outside(vector.ravel()))), dtype=float
    )
    values, vectors = sparse_linalg.eigsh(
        problem.matrix,
        max(wanted - len(kernel), 1),
        sigma=shift,
        OPinv=inverse,
        v0=outside(np.random.default_rng(0).standard_normal(problem.size)),
        maxiter=_MOST_RESTARTS,
    )
    order = np.argsort(values)
    return problem.with_kernel((torch.from_numpy(values[order]), torch.from_numpy(vectors[:, order])), wanted)


def _last_resort(problem: _Problem, k: int) -> Spectrum:
    if problem.size <= _DENSE_LIMIT:
        return _checked(problem.spectrum(_dense(problem, k), "dense, after block Lanczos failed"), _DENSE_TOLERANCE)
    pairs = _arpack(problem, k + 1)
    complete = _complete(problem, pairs, k)
    if complete is not None:
        return _checked(problem.spectrum(complete, "ARPACK, after block Lanczos failed"))
    _log.warning("some of the lowest eigenpairs of the Laplacian were missed; remesh the shape")
    pairs = (pairs[0][:k], pairs[1][:, :k])
    return _checked(problem.spectrum(pairs, "ARPACK, incomplete, after block Lanczos failed"))
