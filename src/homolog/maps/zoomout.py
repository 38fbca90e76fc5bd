"""Spectral refinement of maps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.core.arguments import check_count, check_finite, check_indices
from homolog.core.arrays import takes_arrays
from homolog.maps.nearest import nearest_neighbour

# Points of each shape that take part in the refinement; more change the map little and cost in proportion.
_SAMPLES = 2000

# In so many rounds, the last of them for all points, they look among all: only there is a sample's very counterpart.
_ROUNDS_AMONG_ALL = 3

# What the squared distance of unit features weighs in the first round and in the last, against the mean one of
# eigenfunctions; chosen on pairs of training shapes.
_FIRST_GUIDANCE, _LAST_GUIDANCE = 1.0, 0.1


@takes_arrays
def zoomout(
    y_to_x: Int[Tensor, " n_y"],
    x_to_y: Int[Tensor, " n_x"],
    eigenvectors_x: Float[Tensor, "n_x m_x"],
    eigenvectors_y: Float[Tensor, "n_y m_y"],
    features_x: Float[Tensor, "n_x d"],
    features_y: Float[Tensor, "n_y d"],
    *,
    k_init: int = 20,
    k_step: int = 18,
) -> tuple[Int[Tensor, " n_y"], Int[Tensor, " n_x"]]:
    """Refine the point maps of two complete shapes, both at once, in a growing basis and guided by features.

    ZoomOut (Melzi, Ren, Rodola, Sharma, Wonka and Ovsjanikov, "ZoomOut: spectral upsampling for efficient shape
    correspondence", SIGGRAPH Asia 2019), which alternates between functional map and point map, with two changes. The
    functional maps of a round are fitted to the pairs of both point maps, which makes them agree. And points are near
    each other if their eigenfunctions and their features are: where surfaces touch, or noise hides their detail,
    eigenfunctions alone carry points to the wrong side. Features weigh less as the basis grows and says more by itself.

    Args:
        y_to_x: for each point of y a point of x, as good as it is known.
        x_to_y: likewise the other way.
        eigenvectors_x: of which as many are used as both shapes have.
        eigenvectors_y: likewise.
        features_x: of unit length per point.
        features_y: likewise.
        k_init: size of the first functional map.
        k_step: eigenvectors added per round.

    Returns:
        Both maps, y to x first.

    Raises:
        ArgumentError: if an index is that of no point, a feature is not finite, or a size is no whole number of at
            least 1.
    """
    check_indices("y_to_x", y_to_x, len(eigenvectors_x))
    check_indices("x_to_y", x_to_y, len(eigenvectors_y))
    check_finite("features_x", features_x)
    check_finite("features_y", features_y)
    x, y = _Guided(eigenvectors_x, features_x), _Guided(eigenvectors_y, features_y)
    largest = min(eigenvectors_x.shape[1], eigenvectors_y.shape[1])
    rows_x, rows_y = x.samples, y.samples
    y_to_x, x_to_y = y_to_x[rows_y], x_to_y[rows_x]
    for n_left, size, weight in _rounds(k_init, largest, k_step):
        pairs_x, pairs_y = torch.cat([y_to_x, rows_x]), torch.cat([rows_y, x_to_y])
        among_x, among_y = x.candidates(n_left), y.candidates(n_left)
        rows_x, rows_y = (x.all, y.all) if n_left == 0 else (x.samples, y.samples)
        y_to_x = _counterparts(y, x, (pairs_y, pairs_x), rows_y, among_x, size=size, weight=weight)
        x_to_y = _counterparts(x, y, (pairs_x, pairs_y), rows_x, among_y, size=size, weight=weight)
    return y_to_x, x_to_y


@takes_arrays
def zoomout_partial(
    y_to_x: Int[Tensor, " n_y"],
    eigenvectors_x: Float[Tensor, "n_x m_x"],
    eigenvectors_y: Float[Tensor, "n_y m_y"],
    eigenvalues_x: Float[Tensor, " m_x"],
    eigenvalues_y: Float[Tensor, " m_y"],
    features_x: Float[Tensor, "n_x d"],
    features_y: Float[Tensor, "n_y d"],
    *,
    k_init: int = 20,
    k_step: int = 18,
) -> tuple[Int[Tensor, " n_y"], Int[Tensor, " n_x"]]:
    """Refine the point map of a part y to its complete shape x; see ``zoomout``.

    Only pairs of the part's points can be relied on, so that the map back is read from the same functional map. To so
    many eigenfunctions of x belong those of y that vibrate as slowly (Rodola, Cosmo, Bronstein, Torsello and Cremers,
    "Partial functional correspondence", Computer Graphics Forum 2017): the smaller the part, the fewer.

    Args:
        y_to_x: for each point of the part a point of the complete shape, as good as it is known.
        eigenvectors_x: of the complete shape.
        eigenvectors_y: of the part.
        eigenvalues_x: of the complete shape, ascending, at the same scale as the part's.
        eigenvalues_y: of the part.
        features_x: of unit length per point.
        features_y: likewise.
        k_init: how many eigenvectors of x there are in the first round.
        k_step: eigenvectors of x added per round.

    Returns:
        The map, and the map back, which gives every point of x some point of the part, also where it has none.

    Raises:
        ArgumentError: if an index is that of no point, a feature is not finite, or a size is no whole number of at
            least 1.
    """
    check_indices("y_to_x", y_to_x, len(eigenvectors_x))
    check_finite("features_x", features_x)
    check_finite("features_y", features_y)
    x, y = _Guided(eigenvectors_x, features_x), _Guided(eigenvectors_y, features_y)
    rows = y.samples
    y_to_x = y_to_x[rows]
    for n_left, size, weight in _rounds(k_init, eigenvectors_x.shape[1], k_step):
        as_slow = max(int((eigenvalues_y <= eigenvalues_x[size - 1]).sum()), 1)
        phi_x, phi_y = x.eigenvectors[:, :size], y.eigenvectors[:, :as_slow]
        c_xy = _fitted(phi_x[y_to_x], phi_y[rows])
        among = x.candidates(n_left)
        rows = y.all if n_left == 0 else y.samples
        in_y, in_x = y.guided(rows, phi_y[rows] @ c_xy, weight), x.guided(among, phi_x[among], weight)
        y_to_x = among[nearest_neighbour(in_y, in_x).index]
    in_y, in_x = y.guided(y.reached, phi_y[y.reached] @ c_xy, weight), x.guided(x.all, phi_x, weight)
    return y_to_x, y.reached[nearest_neighbour(in_x, in_y).index]


def _rounds(k_init: int, largest: int, k_step: int) -> Iterator[tuple[int, int, float]]:
    """For each round how many follow, the size of the basis, and how much features weigh."""
    check_count("k_init", k_init)
    check_count("k_step", k_step)
    sizes = [*range(min(k_init, largest), largest, k_step), largest]
    for n_left, size in zip(reversed(range(len(sizes))), sizes, strict=True):
        yield n_left, size, _LAST_GUIDANCE * (_FIRST_GUIDANCE / _LAST_GUIDANCE) ** (n_left / max(len(sizes) - 1, 1))


@dataclass(frozen=True)
class _Guided:
    """A shape's points as the guided refinement sees them."""

    eigenvectors: Float[Tensor, "n m"]
    features: Float[Tensor, "n d"]

    @cached_property
    def all(self) -> Int[Tensor, " n"]:
        """Every point."""
        return torch.arange(len(self.eigenvectors), device=self.eigenvectors.device)

    @cached_property
    def reached(self) -> Int[Tensor, " r"]:
        """Points that some eigenfunction reaches; of debris the embedding says nothing, so nothing is to go there."""
        return self.all[self.eigenvectors.any(dim=1)]

    def candidates(self, n_left: int) -> Int[Tensor, " c"]:
        """The points among which counterparts are looked for, where so many rounds follow."""
        return self.reached if n_left < _ROUNDS_AMONG_ALL else self.samples

    def guided(self, rows: Int[Tensor, " r"], embedding: Float[Tensor, "r k"], weight: float) -> Float[Tensor, "r e"]:
        """An embedding of some points whose squared distances also count those of features, by this weight.

        The weight is relative to the number of eigenfunctions: over unit area the mean square of each is one.
        """
        scale = (weight * embedding.shape[1]) ** 0.5
        return torch.cat([embedding, scale * self.features[rows]], dim=1)

    @cached_property
    def samples(self) -> Int[Tensor, " s"]:
        """Some of the points that are reached."""
        shuffled = torch.randperm(len(self.reached), generator=torch.Generator().manual_seed(0))
        return self.reached[shuffled[:_SAMPLES].sort().values.to(self.reached.device)]


def _counterparts(
    y: _Guided,
    x: _Guided,
    pairs: tuple[Int[Tensor, " p"], Int[Tensor, " p"]],
    rows: Int[Tensor, " r"],
    among: Int[Tensor, " a"],
    *,
    size: int,
    weight: float,
) -> Int[Tensor, " r"]:
    """For some points of y the nearest ones among some of x, once the pairs of points of y and x are laid together."""
    phi_x, phi_y = x.eigenvectors[:, :size], y.eigenvectors[:, :size]
    c_xy = _fitted(phi_x[pairs[1]], phi_y[pairs[0]])
    queries = y.guided(rows, phi_y[rows], weight)
    candidates = x.guided(among, phi_x[among] @ c_xy.T, weight)
    return among[nearest_neighbour(queries, candidates).index]


def _fitted(pulled_back: Float[Tensor, "n k_x"], eigenvectors_y: Float[Tensor, "n k_y"]) -> Float[Tensor, "k_y k_x"]:
    """The least-squares C with Phi_y C = Pi Phi_x on the samples; sampled eigenvectors stay nearly orthogonal."""
    gram, right = (eigenvectors_y.T @ eigenvectors_y).double(), (eigenvectors_y.T @ pulled_back).double()
    # An eigenvector that is zero on all samples must not make the system singular.
    ridge = 1e-6 * gram.diagonal().mean() * torch.eye(len(gram), dtype=gram.dtype, device=gram.device)
    solution: Tensor = torch.linalg.solve(gram + ridge, right).to(pulled_back.dtype)
    return solution
