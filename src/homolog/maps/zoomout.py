"""ZoomOut: spectral upsampling of point maps, guided by features, for full and for partial shapes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.core.arguments import check_finite, check_indices, given_or_default
from homolog.core.arrays import takes_arrays
from homolog.core.settings import Count, Positive, Settings
from homolog.maps.nearest import nearest_neighbour

# Of the largest weight of a pair: functional maps need pairs from everywhere, or they tear where there are none.
_LEAST_WEIGHT = 0.05


@dataclass(frozen=True, kw_only=True)
class RefinementSettings(Settings):
    """Settings of the refinement by ``zoomout`` and ``zoomout_partial``.

    The weights of features were chosen on pairs of training shapes.

    Args:
        k_init: eigenfunctions in the first round, at least 1; 6 to 30 are sensible. An initial map that is only roughly
            right wants few.
        k_step: eigenfunctions added per round, at least 1; 1 to 40 are sensible. Time grows with the number of rounds.
        n_samples: points of each shape that take part in all rounds but the last, at least 1; 1,000 to 5,000 are
            sensible. More change the map little, and cost in proportion.
        rounds_among_all: in this many of the last rounds, samples look for their counterparts among all points of the
            other shape, and not among its samples alone; at least 1. Only among all points is a sample's exact
            counterpart.
        guidance_start: weight of the squared distance of unit features in the first round, relative to the mean
            squared difference of eigenfunctions; above 0, 0.1 to 10 are sensible.
        guidance_end: the same in the last round, above 0. The weight falls geometrically from one to the other. 1e-9
            for both leaves features out, as the published method does.

    Examples:
        >>> from homolog.maps import RefinementSettings
        >>> [size for _, size, _ in RefinementSettings(k_init=30, k_step=40).rounds(128)]
        [30, 70, 110, 128]
    """

    k_init: Count = 20
    k_step: Count = 18
    n_samples: Count = 2000
    rounds_among_all: Count = 3
    guidance_start: Positive = 1.0
    guidance_end: Positive = 0.1

    def rounds(self, largest: int) -> Iterator[tuple[int, int, float]]:
        """For each round: how many others follow, the number of eigenfunctions up to ``largest``, features' weight."""
        sizes = [*range(min(self.k_init, largest), largest, self.k_step), largest]
        fall = self.guidance_start / self.guidance_end
        for n_left, size in zip(reversed(range(len(sizes))), sizes, strict=True):
            yield n_left, size, self.guidance_end * fall ** (n_left / max(len(sizes) - 1, 1))


@dataclass(frozen=True, eq=False)
class LandmarkRows:
    """Pairs of points that are known to correspond, as rows of the functional maps of ``zoomout``.

    Args:
        x: points of x (p,).
        y: of y (p,).
        shares: of each pair, relative to the number of all other rows (p,).
    """

    x: Int[Tensor, " p"]
    y: Int[Tensor, " p"]
    shares: Float[Tensor, " p"]

    def times(self, n_rows: int) -> Int[Tensor, " r"]:
        """Which pairs to append to so many rows, each as often as its share says."""
        counts = (self.shares * n_rows).round().long()
        return torch.repeat_interleave(torch.arange(len(counts), device=counts.device), counts)

    def appended(
        self, points_x: Int[Tensor, " n"], points_y: Int[Tensor, " n"]
    ) -> tuple[Int[Tensor, " m"], Int[Tensor, " m"]]:
        """Pairs of points with these behind them."""
        which = self.times(len(points_x))
        return torch.cat([points_x, self.x[which]]), torch.cat([points_y, self.y[which]])


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
    landmarks: LandmarkRows | None = None,
    weights_x: Float[Tensor, " n_x"] | None = None,
    weights_y: Float[Tensor, " n_y"] | None = None,
) -> tuple[Int[Tensor, " n_y"], Int[Tensor, " n_x"]]:
    """ZoomOut: spectral upsampling of the point maps of two full shapes, both directions at once, guided by features.

    Melzi, Ren, Rodolà, Sharma, Wonka and Ovsjanikov, "ZoomOut: spectral upsampling for efficient shape
    correspondence", SIGGRAPH Asia 2019, which alternates between functional map and point map while the basis grows.
    New here are two changes. The functional maps of a round are fitted to the pairs of both point maps, so that the
    maps agree. And nearest neighbours are taken of eigenfunctions and features together: where surfaces touch, or noise
    hides detail, eigenfunctions alone carry points to the wrong side. Features weigh less as the basis grows.

    Args:
        y_to_x: initial map, for each point of y a point of x (n_y,).
        x_to_y: initial map the other way (n_x,).
        eigenvectors_x: of the Laplacian of x (n_x, m_x); as many are used as both shapes have.
        eigenvectors_y: likewise (n_y, m_y).
        features_x: of unit length per point, see ``normalised`` (n_x, d).
        features_y: likewise (n_y, d).
        settings: sizes of the basis, samples, and how much features weigh.
        landmarks: pairs of points that are known to correspond.
        weights_x: how much each point of x counts where functional maps are fitted (n_x,); by default all alike. A pair
            counts by the geometric mean of the weights of its points, and at least a twentieth of the largest.
        weights_y: likewise (n_y,).

    Returns:
        Both refined maps, y to x first.

    Raises:
        ArgumentError: if an index is that of no point, or a feature is not finite.

    Examples:
        >>> import torch, trimesh
        >>> from homolog import Shape, compute_operators
        >>> from homolog.maps import RefinementSettings, normalised, zoomout
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = compute_operators(Shape(mesh.vertices, mesh.faces))
        >>> true = torch.arange(sphere.n_points)
        >>> third = torch.where(true % 3 == 0, 0, true)  # a third of the points goes to the first one
        >>> phi, features = sphere.eigenvectors, normalised(sphere.points)
        >>> y_to_x, x_to_y = zoomout(third, third, phi, phi, features, features)
        >>> torch.equal(y_to_x, true)
        True

    See Also:
        ``zoomout_partial`` for a partial shape and a full one.
    """
    check_indices("y_to_x", y_to_x, len(eigenvectors_x))
    check_indices("x_to_y", x_to_y, len(eigenvectors_y))
    check_finite("features_x", features_x)
    check_finite("features_y", features_y)
    settings = given_or_default("settings", settings, RefinementSettings)
    x = _Guided(eigenvectors_x, features_x, settings, weights_x)
    y = _Guided(eigenvectors_y, features_y, settings, weights_y)
    largest = min(eigenvectors_x.shape[1], eigenvectors_y.shape[1])
    rows_x, rows_y = x.samples, y.samples
    y_to_x, x_to_y = y_to_x[rows_y], x_to_y[rows_x]
    for n_left, size, weight in settings.rounds(largest):
        pairs_x, pairs_y = torch.cat([y_to_x, rows_x]), torch.cat([rows_y, x_to_y])
        if landmarks is not None:
            pairs_x, pairs_y = landmarks.appended(pairs_x, pairs_y)
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
    landmarks: LandmarkRows | None = None,
    weights_x: Float[Tensor, " n_x"] | None = None,
    weights_y: Float[Tensor, " n_y"] | None = None,
) -> tuple[Int[Tensor, " n_y"], Int[Tensor, " n_x"]]:
    """ZoomOut for a partial shape y and a full one x: spectral upsampling with a slanted functional map.

    Only pairs of the partial shape's points can be relied on, so the map back is read from the same functional map. To
    k eigenfunctions of x belong those of y with eigenvalues no larger than the k-th of x: the smaller the partial
    shape, the fewer (Rodolà, Cosmo, Bronstein, Torsello and Cremers, "Partial functional correspondence", Computer
    Graphics Forum 2017). Features guide it as in ``zoomout``; that combination is new here.

    Args:
        y_to_x: initial map, for each point of the partial shape a point of the full one (n_y,).
        eigenvectors_x: of the full shape (n_x, m_x).
        eigenvectors_y: of the partial shape (n_y, m_y).
        eigenvalues_x: of the full shape, ascending, at the same scale as the partial shape's (m_x,).
        eigenvalues_y: of the partial shape (m_y,).
        features_x: of unit length per point (n_x, d).
        features_y: likewise (n_y, d).
        settings: sizes of the basis, which are numbers of eigenvectors of x, samples, and how much features weigh.
        landmarks: pairs of points that are known to correspond.
        weights_x: as in ``zoomout`` (n_x,).
        weights_y: likewise (n_y,).

    Returns:
        The refined map, and the map back, which gives every point of x some point of y, even outside the overlap.

    Raises:
        ArgumentError: if an index is that of no point, or a feature is not finite.

    Examples:
        >>> import torch, trimesh
        >>> from homolog import Shape, compute_operators
        >>> from homolog.maps import normalised, zoomout_partial
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> full = compute_operators(Shape(mesh.vertices, mesh.faces))
        >>> upper = mesh.faces[(mesh.vertices[mesh.faces][:, :, 2] > -0.2).all(axis=1)]
        >>> kept = torch.from_numpy(upper).unique()
        >>> index = torch.zeros(full.n_points, dtype=torch.int64).index_put_((kept,), torch.arange(len(kept)))
        >>> partial = compute_operators(Shape(mesh.vertices[kept], index[upper].numpy()), scale=full.scale)
        >>> y_to_x, x_to_y = zoomout_partial(
        ...     kept, full.eigenvectors, partial.eigenvectors, full.eigenvalues, partial.eigenvalues,
        ...     normalised(full.points), normalised(full.points[kept]))
        >>> bool((full.points[y_to_x] - full.points[kept]).norm(dim=1).mean() < 0.1)
        True

    See Also:
        ``overlap`` for the points of x that have a counterpart.
    """
    check_indices("y_to_x", y_to_x, len(eigenvectors_x))
    check_finite("features_x", features_x)
    check_finite("features_y", features_y)
    settings = given_or_default("settings", settings, RefinementSettings)
    x = _Guided(eigenvectors_x, features_x, settings, weights_x)
    y = _Guided(eigenvectors_y, features_y, settings, weights_y)
    rows = y.samples
    y_to_x = y_to_x[rows]
    for n_left, size, weight in settings.rounds(eigenvectors_x.shape[1]):
        k_y = max(int((eigenvalues_y <= eigenvalues_x[size - 1]).sum()), 1)
        phi_x, phi_y = x.eigenvectors[:, :size], y.eigenvectors[:, :k_y]
        pairs_x, pairs_y = (y_to_x, rows) if landmarks is None else landmarks.appended(y_to_x, rows)
        c_xy = _fitted(phi_x[pairs_x], phi_y[pairs_y], _weights(x, pairs_x, y, pairs_y))
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
    weights: Float[Tensor, " n"] | None = None

    @cached_property
    def all(self) -> Int[Tensor, " n"]:
        """Every point."""
        return torch.arange(len(self.eigenvectors), device=self.eigenvectors.device)

    @cached_property
    def main(self) -> Int[Tensor, " r"]:
        """Points where not every eigenfunction is zero, as it is on small components: no point is mapped to those."""
        return self.all[self.eigenvectors.any(dim=1)]

    def candidates(self, n_left: int) -> Int[Tensor, " c"]:
        """The points among which counterparts are looked for in a round that this many others follow."""
        return self.main if n_left < self.settings.rounds_among_all else self.samples

    def guided(self, rows: Int[Tensor, " r"], embedding: Float[Tensor, "r k"], weight: float) -> Float[Tensor, "r e"]:
        """An embedding of points whose squared distances also count those of features, by this weight.

        The weight is relative to the number of eigenfunctions: over unit area the mean square of each is one.
        """
        scale = (weight * embedding.shape[1]) ** 0.5
        return torch.cat([embedding, scale * self.features[rows]], dim=1)

    @cached_property
    def samples(self) -> Int[Tensor, " s"]:
        """A random subset of the points in the main component; the same in every run."""
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
    """For some points of y the nearest ones among some of x, with the functional map fitted to pairs of both."""
    phi_x, phi_y = x.eigenvectors[:, :size], y.eigenvectors[:, :size]
    c_xy = _fitted(phi_x[pairs[1]], phi_y[pairs[0]], _weights(x, pairs[1], y, pairs[0]))
    queries = y.guided(rows, phi_y[rows], weight)
    candidates = x.guided(among, phi_x[among] @ c_xy.T, weight)
    return among[nearest_neighbour(queries, candidates).index]


def _weights(
    x: _Guided, points_x: Int[Tensor, " p"], y: _Guided, points_y: Int[Tensor, " p"]
) -> Float[Tensor, " p"] | None:
    """How much each pair of points counts; None where all count alike."""
    known = [one.weights[at] for one, at in ((x, points_x), (y, points_y)) if one.weights is not None]
    if not known:
        return None
    found = torch.stack(known).log().mean(dim=0).exp()
    return found.clamp(min=_LEAST_WEIGHT * float(found.max()))


def _fitted(
    pulled_back: Float[Tensor, "n k_x"],
    eigenvectors_y: Float[Tensor, "n k_y"],
    weights: Float[Tensor, " n"] | None = None,
) -> Float[Tensor, "k_y k_x"]:
    """The least-squares C with Phi_y C = Pi Phi_x on the samples; sampled eigenvectors stay nearly orthogonal."""
    if weights is not None:
        pulled_back, eigenvectors_y = (rows * weights.sqrt()[:, None] for rows in (pulled_back, eigenvectors_y))
    gram, right = (eigenvectors_y.T @ eigenvectors_y).double(), (eigenvectors_y.T @ pulled_back).double()
    # Eigenvectors that are zero on all samples, be it all of them, must not make the system singular.
    ridge = (1e-6 * gram.diagonal().mean()).clamp(min=torch.finfo(gram.dtype).tiny) * torch.eye(
        len(gram), dtype=gram.dtype, device=gram.device
    )
    solution: Tensor = torch.linalg.solve(gram + ridge, right).to(pulled_back.dtype)
    return solution
