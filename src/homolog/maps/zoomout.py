"""ZoomOut: spectral upsampling of point maps, guided by features, for full and for partial shapes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.core.arguments import check_count, check_finite, check_indices, check_number
from homolog.core.arrays import takes_arrays
from homolog.maps.nearest import nearest_neighbour


@dataclass(frozen=True, kw_only=True)
class RefinementSettings:
    """Settings of the refinement by ``zoomout`` and ``zoomout_partial``.

    The weights of features were chosen on pairs of training shapes. All defaults were then fixed for every benchmark.

    Args:
        k_init: eigenfunctions in the first round, at least 1; 6 to 30 are sensible. A map that is known but roughly
            wants few.
        k_step: eigenfunctions added per round, at least 1; 1 to 40 are sensible. Time grows with the number of rounds.
        n_samples: points of each shape that take part in all rounds but the last, at least 1; 1,000 to 5,000 are
            sensible. More change the map little, and cost in proportion.
        rounds_among_all: in so many of the last rounds, samples look for their counterparts among all points of the
            other shape, and not among its samples alone; 1 or more. Only among all is a sample's very counterpart.
        guidance_start: weight of the squared distance of unit features in the first round, against the mean squared
            difference of eigenfunctions; above 0, 0.1 to 10 are sensible.
        guidance_end: the same in the last round, above 0. The weight falls geometrically between the two. 1e-9 for
            both leaves features out, as the published method does.
    """

    k_init: int = 20
    k_step: int = 18
    n_samples: int = 2000
    rounds_among_all: int = 3
    guidance_start: float = 1.0
    guidance_end: float = 0.1

    def __post_init__(self) -> None:
        for name in ("k_init", "k_step", "n_samples", "rounds_among_all"):
            check_count(name, getattr(self, name))
        for name in ("guidance_start", "guidance_end"):
            check_number(name, getattr(self, name), above=0)

    def rounds(self, largest: int) -> Iterator[tuple[int, int, float]]:
        """For each round how many follow it, its number of eigenfunctions up to the largest, and features' weight."""
        sizes = [*range(min(self.k_init, largest), largest, self.k_step), largest]
        fall = self.guidance_start / self.guidance_end
        for n_left, size in zip(reversed(range(len(sizes))), sizes, strict=True):
            yield n_left, size, self.guidance_end * fall ** (n_left / max(len(sizes) - 1, 1))


@takes_arrays
def zoomout(
    y_to_x: Int[Tensor, " n_y"],
    x_to_y: Int[Tensor, " n_x"],
    eigenvectors_x: Float[Tensor, "n_x m_x"],
    eigenvectors_y: Float[Tensor, "n_y m_y"],
    features_x: Float[Tensor, "n_x d"],
    features_y: Float[Tensor, "n_y d"],
    *,
    settings: RefinementSettings | None = None,
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
        settings: sizes of the basis, samples, and how much features weigh.

    Returns:
        Both maps, y to x first.

    Raises:
        ArgumentError: if an index is that of no point, or a feature is not finite.
    """
    check_indices("y_to_x", y_to_x, len(eigenvectors_x))
    check_indices("x_to_y", x_to_y, len(eigenvectors_y))
    check_finite("features_x", features_x)
    check_finite("features_y", features_y)
    settings = settings or RefinementSettings()
    x, y = _Guided(eigenvectors_x, features_x, settings), _Guided(eigenvectors_y, features_y, settings)
    largest = min(eigenvectors_x.shape[1], eigenvectors_y.shape[1])
    rows_x, rows_y = x.samples, y.samples
    y_to_x, x_to_y = y_to_x[rows_y], x_to_y[rows_x]
    for n_left, size, weight in settings.rounds(largest):
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
    settings: RefinementSettings | None = None,
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
        settings: sizes of the basis, which are numbers of eigenvectors of x, samples, and how much features weigh.

    Returns:
        The map, and the map back, which gives every point of x some point of the part, also where it has none.

    Raises:
        ArgumentError: if an index is that of no point, or a feature is not finite.
    """
    check_indices("y_to_x", y_to_x, len(eigenvectors_x))
    check_finite("features_x", features_x)
    check_finite("features_y", features_y)
    settings = settings or RefinementSettings()
    x, y = _Guided(eigenvectors_x, features_x, settings), _Guided(eigenvectors_y, features_y, settings)
    rows = y.samples
    y_to_x = y_to_x[rows]
    for n_left, size, weight in settings.rounds(eigenvectors_x.shape[1]):
        as_slow = max(int((eigenvalues_y <= eigenvalues_x[size - 1]).sum()), 1)
        phi_x, phi_y = x.eigenvectors[:, :size], y.eigenvectors[:, :as_slow]
        c_xy = _fitted(phi_x[y_to_x], phi_y[rows])
        among = x.candidates(n_left)
        rows = y.all if n_left == 0 else y.samples
        in_y, in_x = y.guided(rows, phi_y[rows] @ c_xy, weight), x.guided(among, phi_x[among], weight)
        y_to_x = among[nearest_neighbour(in_y, in_x).index]
    in_y, in_x = y.guided(y.main, phi_y[y.main] @ c_xy, weight), x.guided(x.all, phi_x, weight)
    return y_to_x, y.main[nearest_neighbour(in_x, in_y).index]


@dataclass(frozen=True)
class _Guided:
    """A shape's points as the guided refinement sees them."""

    eigenvectors: Float[Tensor, "n m"]
    features: Float[Tensor, "n d"]
    settings: RefinementSettings

    @cached_property
    def all(self) -> Int[Tensor, " n"]:
        """Every point."""
        return torch.arange(len(self.eigenvectors), device=self.eigenvectors.device)

    @cached_property
    def main(self) -> Int[Tensor, " r"]:
        """Points where not every eigenfunction is zero, as it is on small components: nothing is mapped to those."""
        return self.all[self.eigenvectors.any(dim=1)]

    def candidates(self, n_left: int) -> Int[Tensor, " c"]:
        """The points among which counterparts are looked for, where so many rounds follow."""
        return self.main if n_left < self.settings.rounds_among_all else self.samples

    def guided(self, rows: Int[Tensor, " r"], embedding: Float[Tensor, "r k"], weight: float) -> Float[Tensor, "r e"]:
        """An embedding of some points whose squared distances also count those of features, by this weight.

        The weight is relative to the number of eigenfunctions: over unit area the mean square of each is one.
        """
        scale = (weight * embedding.shape[1]) ** 0.5
        return torch.cat([embedding, scale * self.features[rows]], dim=1)

    @cached_property
    def samples(self) -> Int[Tensor, " s"]:
        """Some of the points that are reached."""
        shuffled = torch.randperm(len(self.main), generator=torch.Generator().manual_seed(0))
        return self.main[shuffled[: self.settings.n_samples].sort().values.to(self.main.device)]


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
