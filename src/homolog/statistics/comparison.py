"""Two groups of shapes compared point by point: Hotelling's T squared and permutation tests, corrected for all points.

H. Hotelling, "The generalization of Student's ratio", 1931; permutations of the labels with the largest statistic of
all points in place of each point's own (P. H. Westfall and S. S. Young, "Resampling-based multiple testing", 1993;
T. E. Nichols and A. P. Holmes, "Nonparametric permutation tests for functional neuroimaging", Human Brain Mapping 15,
2002); false discovery rates by Y. Benjamini and Y. Hochberg, JRSS B 57, 1995.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, islice
from math import comb

import numpy as np
from jaxtyping import Bool, Float

from homolog.core.arguments import check_count
from homolog.core.errors import ArgumentError
from homolog.core.progress import Progress, ignore

PERMUTATIONS = 10_000
"""As many relabellings by default; all of them where there are no more."""
# A point's statistic counts as reached by a permutation within this share: sums in another order differ by rounding.
_TIE = 1e-9
# Directions in which a point varies by less than this share of the largest are rounding errors.
_RANK = 1e-12
_BATCH = 256


@dataclass(frozen=True, eq=False)
class GroupComparison:
    """Two groups of shapes, compared point by point.

    Args:
        difference: mean of the second group less that of the first (n, 3).
        t_squared: Hotelling's statistic of each point; 0 where nothing varies (n,).
        p: the share of relabellings whose statistic at the same point is as large (n,).
        p_corrected: the share whose largest statistic of all points is as large: the chance of a single false point
            below a threshold is at most that threshold, over the whole surface (n,).
        q: the false discovery rate at which each point would just be discovered (n,).
        permutations: relabellings that were looked at, the given one included.
        is_exact: whether these are all there are.
    """

    difference: Float[np.ndarray, "n 3"]
    t_squared: Float[np.ndarray, " n"]
    p: Float[np.ndarray, " n"]
    p_corrected: Float[np.ndarray, " n"]
    q: Float[np.ndarray, " n"]
    permutations: int
    is_exact: bool

    @property
    def p_overall(self) -> float:
        """The corrected p of the most different point: whether the groups differ anywhere."""
        return float(np.nanmin(self.p_corrected))


def compare_groups(
    points: Float[np.ndarray, "s n 3"],
    second: Bool[np.ndarray, " s"],
    *,
    permutations: int = PERMUTATIONS,
    seed: int = 0,
    progress: Progress = ignore,
) -> GroupComparison:
    """Whether two groups of aligned shapes differ, and where.

    The statistic of a point follows from the difference of the means and the covariance of all shapes alone, and the
    latter no relabelling changes. So each point is whitened once, and a relabelling is a matrix product.

    Args:
        points: aligned shapes in correspondence (s, n, 3).
        second: which of them are of the second group (s,).
        permutations: relabellings; of more, so many are drawn, with the given one among them.
        seed: of what is drawn.
        progress: called with relabellings that are done, their total and what is done.

    Raises:
        ArgumentError: if a group has fewer than two shapes, both fewer than six, or an array has another shape.

    Examples:
        >>> shapes = np.random.default_rng(0).standard_normal((12, 5, 3))
        >>> shapes[6:, 2] += 10  # the second group differs at point 2
        >>> found = compare_groups(shapes, np.arange(12) >= 6)
        >>> found.is_exact, found.permutations, (found.p_corrected < 0.05).tolist()
        (True, 924, [False, False, True, False, False])
    """
    second = np.asarray(second)
    _check(points, second)
    check_count("permutations", permutations, least=2)
    count, n_points, n_second = len(points), points.shape[1], int(second.sum())
    whitened = _whitened(points)
    every = comb(count, n_second)
    is_exact = every <= permutations
    total = every if is_exact else permutations
    own = _shares(whitened, second[None], n_points)[0]
    bound = own * (1 - _TIE)
    reached, beyond, done = np.zeros(n_points), np.zeros(n_points), 0
    if not is_exact:  # the given labels are one of the relabellings (Phipson and Smyth, 2010)
        reached, beyond, done = reached + 1, beyond + 1, 1
    for labels in _relabellings(second, total - done, seed, is_exact=is_exact):
        shares = _shares(whitened, labels, n_points)
        reached += (shares >= bound).sum(axis=0)
        beyond += len(shares) - np.searchsorted(np.sort(shares.max(axis=1)), bound, side="left")
        done += len(labels)
        progress(done, total, "permutations")
    p = reached / done
    own = np.minimum(own, 1 - np.finfo(float).eps)
    difference = points[second].mean(axis=0) - points[~second].mean(axis=0)
    t_squared = (count - 2) * own / (1 - own)
    return GroupComparison(difference, t_squared, p, beyond / done, false_discovery_rates(p), done, is_exact)


def false_discovery_rates(p: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The smallest false discovery rate at which each hypothesis is rejected (Benjamini and Hochberg, 1995).

    Examples:
        >>> false_discovery_rates(np.array([0.01, 0.04, 0.03, 0.5])).round(4).tolist()
        [0.04, 0.0533, 0.0533, 0.5]
    """
    order = np.argsort(p)
    raised = p[order] * len(p) / np.arange(1, len(p) + 1)
    found = np.empty(len(p))
    found[order] = np.minimum(np.minimum.accumulate(raised[::-1])[::-1], 1.0)
    return found


def _check(points: Float[np.ndarray, "s n 3"], second: Bool[np.ndarray, " s"]) -> None:
    if points.ndim != 3 or points.shape[2] != 3 or second.shape != points.shape[:1] or second.dtype != bool:
        raise ArgumentError(
            f"points and second have shapes {points.shape} and {second.shape}, but must have shapes (s, n, 3) and (s,) "
            "of truth values"
        )
    if not np.isfinite(points).all():
        raise ArgumentError("points holds NaN or infinite numbers, but must be finite")
    sizes = int((~second).sum()), int(second.sum())
    if min(sizes) < 2 or sum(sizes) < 6:
        raise ArgumentError(
            f"the groups have {sizes[0]} and {sizes[1]} shapes, but need two or more each, and six together"
        )


def _whitened(points: Float[np.ndarray, "s n 3"]) -> Float[np.ndarray, "s 3n"]:
    """Shapes about their mean, each point in coordinates where the scatter of all shapes is the identity."""
    centred = points - points.mean(axis=0)
    scatter = np.einsum("snk,snl->nkl", centred, centred)
    sizes, axes = np.linalg.eigh(scatter)
    smallest = np.maximum(_RANK * sizes[:, -1:], np.finfo(float).tiny)
    scale = np.where(sizes > smallest, 1 / np.sqrt(np.maximum(sizes, smallest)), 0.0)
    return np.asarray(np.einsum("snk,nkl->snl", centred, axes * scale[:, None, :]).reshape(len(points), -1))


def _shares(
    whitened: Float[np.ndarray, "s 3n"], labels: Bool[np.ndarray, "r s"], n_points: int
) -> Float[np.ndarray, "r n"]:
    """The share h of a point's scatter that each labelling explains.

    T squared is (s - 2) h / (1 - h), which grows with h, by the formula of Sherman and Morrison for the scatter within.
    """
    second = labels.sum(axis=1, keepdims=True)
    first = labels.shape[1] - second
    contrast = labels / second - ~labels / first
    differences = (contrast @ whitened).reshape(len(labels), n_points, 3)
    return np.asarray((differences**2).sum(axis=2) * (first * second / labels.shape[1]))


def _relabellings(
    second: Bool[np.ndarray, " s"], total: int, seed: int, *, is_exact: bool
) -> Iterator[Bool[np.ndarray, "r s"]]:
    """Labels of all shapes, in batches: all ways to choose the second group, or so many that are drawn."""
    count, n_second = len(second), int(second.sum())
    if is_exact:
        chosen = combinations(range(count), n_second)
        while batch := list(islice(chosen, _BATCH)):
            labels = np.zeros((len(batch), count), dtype=bool)
            labels[np.arange(len(batch))[:, None], batch] = True
            yield labels
        return
    random = np.random.default_rng(seed)
    for start in range(0, total, _BATCH):
        order = random.random((min(_BATCH, total - start), count)).argsort(axis=1)
        yield second[order]
