"""Finding which way round two full shapes are: the right map among the possible ones. New here.

A shape that is turned, or looked at from behind, is matched left for right or head for tail by features that follow
the pose. So several rotations are tried. Each leads to a coarse map of samples, the map tells how well it fits, and the
best is taken. Rotations come from the features' orienter, which looks at one shape alone, or from the two shapes as
rigid bodies.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import product

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.features import FeatureExtractor, Orientation, computed_features
from homolog.geometry import Basis, some_points
from homolog.maps import (
    CoarseMapSettings,
    best_rotation,
    closest_point_rotations,
    coarse_fit,
    cube_rotations,
    most_similar,
    normalised,
    principal_rotations,
    rotation_angle,
    zoomout,
)
from homolog.pairs import OrientationSettings, Pair, PairOrientation, PreprocessedShape, Side

# Hypotheses that differ by less lead to the same map.
_SAME_MAP_DEGREES = 45.0
# Between these, in degrees, are the turns of a cube by a quarter about an axis.
_LEAST_TURN, _MOST_TURN = 45.0, 105.0
# Of closest points, after principal axes have been brought together.
_AXES_STEPS = 10
# The second best of these tells whether the best is ambiguous.
_BY_AXES = 2
# How often the best of rigid bodies is turned further, as its own map tells.
_FURTHER_TURNS = 2


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A way to turn both shapes.

    Args:
        source: rotation of the source from the upright shape (3, 3).
        target: of the target.
        misfit: how much speaks against it.
        handedness: how far its coarse map keeps left and right; 1 without a map.
        energy: the Dirichlet energy of its coarse map, that of an isometry being 1; 0 without a map.
        turn: of the source onto the target, as its coarse map tells it (3, 3); none without a map.
    """

    source: Float[Tensor, "3 3"]
    target: Float[Tensor, "3 3"]
    misfit: float = 0.0
    handedness: float = 1.0
    energy: float = 0.0
    turn: Float[Tensor, "3 3"] = field(default_factory=lambda: torch.eye(3))

    @property
    def is_as_given(self) -> bool:
        """Whether it turns neither shape."""
        return all(torch.equal(rotation, torch.eye(3)) for rotation in (self.source, self.target))

    def is_like(self, other: Hypothesis) -> bool:
        """Whether both turn the shapes against each other alike, so that they lead to the same map."""
        turns = self.target.T @ self.source, other.target.T @ other.source
        return bool(rotation_angle(turns[0] @ turns[1].T) < _SAME_MAP_DEGREES)


@torch.no_grad()
def orient(pair: Pair) -> Pair:
    """The pair with its shapes turned so that they are the same way round; see ``orientations``."""
    return orientations(pair, 1)[0]


@torch.no_grad()
def orientations(pair: Pair, count: int) -> list[Pair]:
    """The pair in up to so many ways round that lead to different maps, the likeliest first.

    As it is where that was done before, a shape is partial, features do not follow the pose, or the options trust the
    files. Upright weights without an orienter are trusted to have got upright shapes: other rotations mislead their
    features.
    """
    if count > 1 and pair.before_search is not None:
        pair = replace(pair.before_search, choice=pair.choice, adaptation=pair.adaptation)
    is_trusted = pair.orientation is not None or pair.options.orient == "given"
    if is_trusted or pair.options.partial is not None or not pair.follows_pose:
        return [pair]
    if pair.extractor is not None and pair.extractor.info.upright and not _has_orientations(pair):
        return [pair]
    found = _distinct(_ranked(pair, unlikely_too=count > 1))
    return [_turned(pair, found, number) for number in range(len(found[:count]))]


def _turned(pair: Pair, found: list[Hypothesis], number: int) -> Pair:
    settings = pair.settings.orientation
    # Closest points of rigid bodies tell less than features.
    margin = settings.given_margin if pair.extractor is None else settings.margin
    return replace(
        pair,
        source=pair.source.turned(found[number].source, pair.extractor),
        target=pair.target.turned(found[number].target, pair.extractor),
        orientation=_certainty(found, number, margin),
    )


def _ranked(pair: Pair, *, unlikely_too: bool) -> list[Hypothesis]:
    """What may be right, the least misfit first; on demand, behind it, also what the orienter finds unlikely."""
    settings = pair.settings.orientation
    if not _has_orientations(pair):
        samples = Samples.of(pair)
        ranked = samples.ranked([*_of_rigid_bodies(samples, settings), *_of_landmarks(pair)])
        given = next(found for found in ranked if found.is_as_given)
        if samples.refined and samples.extractor is not None and not given.is_like(ranked[0]):
            return _given_first(_turned_further(samples, ranked), settings.turned_margin)
        ranked = _first(ranked, (found for found in ranked if found.is_like(given)), settings.given_margin)
        ranked = _small_turn_left(samples, ranked) if pair.method.supports.small_turns else ranked
        return _given_first(ranked, settings.margin)
    both = pair.source.orientations, pair.target.orientations
    # What landmarks say of a way round is worth more than what the orienter does.
    likely = _of_orienter(*both, settings, settings.orienter_margin if pair.guidance is None else math.inf)
    all_of_them = _of_orienter(*both, settings, math.inf) if unlikely_too else likely
    others = [found for found in all_of_them if not any(found.is_like(other) for other in likely)]
    samples = Samples.of(pair)
    ranked = _given_first(samples.ranked(likely), settings.margin)
    alike = _alike(*both, settings)
    if max(orientations[0].misfit for orientations in both) > settings.unsure and not alike.is_like(ranked[0]):
        alike = samples.judged(alike)
        ranked = _first([*ranked, alike], [alike], settings.alike_margin)
    less_known: Side = "source" if pair.source.orientations[0].misfit > pair.target.orientations[0].misfit else "target"
    return [*_handed_first(samples, ranked, less_known), *samples.ranked(others)]


def _handed_first(samples: Samples, ranked: list[Hypothesis], side: Side) -> list[Hypothesis]:
    """With another pose of one shape in the first place, where the best map mixes left and right and its map does not.

    The orienter may be right where features are not: they know no one who bends backwards, but may know him tilted.
    Counterparts are then far from each other at the right map as well, so that handedness decides. The other map must
    be smoother, too: one that takes a front for a back keeps left and right, but not all distances on the surface.
    Where both stand as they are given, though, file and orienter agree, and a coarse map does not overrule them.
    """
    settings, best = samples.settings, ranked[0]
    if best.is_as_given or best.handedness >= settings.doubtful_handedness:
        return ranked
    quarters = (turn for turn in cube_rotations() if _LEAST_TURN < rotation_angle(turn) < _MOST_TURN)
    poses = [replace(best, misfit=0.0, **{side: turn @ getattr(best, side)}) for turn in quarters]
    others = (found for found in samples.ranked(poses) if found.handedness >= settings.sure_handedness)
    return [*[found for found in others if found.energy < best.energy - settings.pose_margin][:1], *ranked]


def _has_orientations(pair: Pair) -> bool:
    return bool(pair.source.orientations and pair.target.orientations)


def _of_orienter(
    source: tuple[Orientation, ...], target: tuple[Orientation, ...], settings: OrientationSettings, margin: float
) -> list[Hypothesis]:
    """The likely orientations of both, each with each, as long as they lead to different maps."""
    likely = (
        [found for found in orientations if found.misfit <= orientations[0].misfit + margin]
        for orientations in (source, target)
    )
    pairs = sorted(product(*likely), key=lambda both: both[0].misfit + both[1].misfit)
    weight = settings.orienter
    found = [Hypothesis(one.rotation, other.rotation, weight * (one.misfit + other.misfit)) for one, other in pairs]
    return _distinct(found)[: settings.hypotheses]


def _alike(
    source: tuple[Orientation, ...], target: tuple[Orientation, ...], settings: OrientationSettings
) -> Hypothesis:
    """Both turned as the orienter turns the shape that it knows better: files often hold shapes that stand alike."""
    best = source[0], target[0]
    rotation = min(best, key=lambda found: found.misfit).rotation
    return Hypothesis(rotation, rotation, settings.orienter * sum(found.misfit for found in best))


def _distinct(hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """The best of those that lead to the same map."""
    kept: list[Hypothesis] = []
    for hypothesis in hypotheses:
        if not any(hypothesis.is_like(other) for other in kept):
            kept.append(hypothesis)
    return kept


def _of_rigid_bodies(samples: Samples, settings: OrientationSettings) -> list[Hypothesis]:
    """The source as it is given, and turned to lie near the target as a rigid body."""
    points = samples.x.points, samples.y.points
    found = closest_point_rotations(*points)[: settings.hypotheses]
    by_axes = closest_point_rotations(*points, starts=principal_rotations(*points), steps=0, last_steps=_AXES_STEPS)
    others = (Hypothesis(rotation.cpu(), torch.eye(3)) for rotation, _ in (*found, *by_axes[:_BY_AXES]))
    return [Hypothesis(torch.eye(3), torch.eye(3)), *others]


def _turned_further(samples: Samples, ranked: list[Hypothesis]) -> list[Hypothesis]:
    """With the best in the first place, as long as it gets better, turned as its own map tells.

    Rigid bodies in two poses fit best where a limb lies on another; counterparts tell how the bodies are turned.
    """
    for _ in range(_FURTHER_TURNS):
        further = samples.judged(Hypothesis(ranked[0].turn, torch.eye(3)))
        if further.misfit >= ranked[0].misfit:
            break
        ranked = [further, *ranked]
    return ranked


def _of_landmarks(pair: Pair) -> Iterator[Hypothesis]:
    """The source turned to bring its landmarks nearest to the target's, where there are enough to tell."""
    if pair.guidance is None or not pair.guidance.tells_rotation(pair.x.operators, pair.y.operators):
        return
    source, target = pair.x.points_as_given[pair.guidance.x], pair.y.points_as_given[pair.guidance.y]
    yield Hypothesis(best_rotation(source, target, pair.guidance.weights).cpu().float(), torch.eye(3))


def _small_turn_left(samples: Samples, ranked: list[Hypothesis]) -> list[Hypothesis]:
    """With the shapes as they are given in place of the best, where that is nearly so: the method does the rest.

    Unless the best brings them as near as two samples of one surface: no method is as exact then.
    """
    given, best = next(found for found in ranked if found.is_as_given), ranked[0]
    if not given.is_like(best) or samples.distance(best) < samples.settings.small_turn * samples.distance_of_copies:
        return ranked
    return [replace(given, misfit=best.misfit), *ranked]


def _given_first(ranked: list[Hypothesis], margin: float) -> list[Hypothesis]:
    """With the shapes as they are given in the first place, where nothing is clearly better."""
    return _first(ranked, (found for found in ranked if found.is_as_given), margin)


def _first(ranked: list[Hypothesis], preferred: Iterable[Hypothesis], margin: float) -> list[Hypothesis]:
    """With the best of some in the first place, where nothing is better by a margin."""
    best = min(preferred, key=lambda found: found.misfit, default=ranked[0])
    if best.misfit >= ranked[0].misfit + margin:
        return ranked
    return [best, *(found for found in ranked if found is not best)]


def _certainty(distinct: list[Hypothesis], number: int, least: float) -> PairOrientation:
    """How sure one of several hypotheses is, against the best of the others, which it must differ from by a margin."""
    misfit, others = distinct[number].misfit, [each.misfit for each in distinct if each is not distinct[number]]
    if not others:
        return PairOrientation(misfit)
    margin = min(others) - misfit
    return PairOrientation(misfit, min(others), margin, ambiguous=abs(margin) < least)


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of the source x and the target y of a pair, on which hypotheses are judged.

    Args:
        x: basis there, of the source as it was given.
        y: of the target.
        extractor: of features; None to compare positions.
        refined: whether coarse maps are refined by ZoomOut.
        have_outsides: whether both are meshes whose triangles face outward.
        settings: of the search.
        misfit: what speaks against a coarse map.
        landmarks: how many of the last samples of both are each other's counterparts.
        guidance: weight of the distance by which a coarse map misses these.
    """

    x: Basis
    y: Basis
    extractor: FeatureExtractor | None
    refined: bool
    have_outsides: bool
    settings: OrientationSettings
    misfit: CoarseMapSettings
    landmarks: int = 0
    guidance: float = 0.0

    @classmethod
    def of(cls, pair: Pair) -> Samples:
        """The samples of a pair."""
        settings = pair.settings.orientation
        # Each has samples of its own, or shapes of one numbering would have exact counterparts at one way round alone.
        draw = _sampled if pair.extractor is not None else _drawn_by_area
        known = [None, None] if pair.guidance is None else [pair.guidance.x, pair.guidance.y]
        shapes = zip((pair.source, pair.target), known, strict=True)
        x, y = (draw(shape, settings.samples, seed, at) for seed, (shape, at) in enumerate(shapes))
        refined = pair.near_isometric and pair.method.supports.refinement
        without = settings.turned if refined and pair.extractor is not None else settings.rigid
        misfit = settings.upright if _has_orientations(pair) else without
        n_landmarks = 0 if pair.guidance is None else len(pair.guidance)
        guidance = pair.settings.guidance.orientation
        return cls(x, y, pair.extractor, refined, pair.have_outsides, settings, misfit, n_landmarks, guidance)

    def ranked(self, hypotheses: list[Hypothesis]) -> list[Hypothesis]:
        """Hypotheses with what their coarse maps tell, the least misfit first."""
        return sorted(map(self.judged, hypotheses), key=lambda found: found.misfit)

    def judged(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis with what its coarse map adds to its misfit."""
        x, y = self.x.turned(hypothesis.source.to(self.x.points)), self.y.turned(hypothesis.target.to(self.y.points))
        x_to_y, y_to_x = maps = self._coarse_maps(x, y)
        fit = coarse_fit(x, y, *maps, have_outsides=self.have_outsides, settings=self.misfit)
        misfit = hypothesis.misfit + fit.misfit + self._missed(x.points, y.points, *maps)
        starts = torch.cat([self.x.points, self.x.points[y_to_x]])
        ends = torch.cat([self.y.points[x_to_y], self.y.points])
        turn = best_rotation(starts, ends).cpu().float()
        return replace(hypothesis, misfit=misfit, handedness=fit.handedness, energy=fit.energy, turn=turn)

    def distance(self, hypothesis: Hypothesis) -> float:
        """The mean squared distance of closest points, of each shape's points to the other's."""
        start = (hypothesis.target.T @ hypothesis.source).to(self.x.points)
        found = closest_point_rotations(self.x.points, self.y.points, starts=start[None], steps=0, last_steps=0)
        return found[0][1]

    @property
    def distance_of_copies(self) -> float:
        """What is to be expected of it between random samples of one surface of unit area."""
        return sum(1 / (math.pi * len(basis.points)) for basis in (self.x, self.y))

    def _coarse_maps(self, x: Basis, y: Basis) -> tuple[Int[Tensor, " n"], Int[Tensor, " m"]]:
        of_x, of_y = (self._features(basis) for basis in (x, y))
        x_to_y, y_to_x = most_similar(of_x, of_y).index, most_similar(of_y, of_x).index
        if self.refined:
            k = self.settings.map_eigenpairs
            vectors = x.eigenvectors[:, :k].contiguous(), y.eigenvectors[:, :k].contiguous()
            y_to_x, x_to_y = zoomout(y_to_x, x_to_y, *vectors, of_x, of_y, settings=self.settings.refinement)
        return x_to_y, y_to_x

    def _features(self, basis: Basis) -> Float[Tensor, "n d"]:
        if self.extractor is not None:
            return normalised(computed_features(self.extractor, basis))
        # With a constant beside small positions, unit vectors are as similar as positions are near.
        return normalised(torch.nn.functional.pad(basis.points / 10, (0, 1), value=1.0))

    def _missed(
        self, x: Float[Tensor, "n 3"], y: Float[Tensor, "m 3"], x_to_y: Int[Tensor, " n"], y_to_x: Int[Tensor, " m"]
    ) -> float:
        """What it counts that a coarse map misses the landmarks."""
        if not self.landmarks:
            return 0.0
        at_x, at_y = slice(len(x) - self.landmarks, None), slice(len(y) - self.landmarks, None)
        there, back = (y[x_to_y[at_x]] - y[at_y]).norm(dim=1), (x[y_to_x[at_y]] - x[at_x]).norm(dim=1)
        return self.guidance * float(there.mean() + back.mean())


def _sampled(shape: PreprocessedShape, count: int, seed: int, landmarks: Int[Tensor, " p"] | None) -> Basis:
    """The basis of a shape as it was given, at some of its points, and at the landmarks behind them."""
    kept = some_points(shape.operators.n_points, count, seed=seed).to(shape.operators.points.device)
    basis = shape.operators.basis.sampled(_with(kept, landmarks))
    return basis.turned(shape.rotation.T.to(basis.points))


def _drawn_by_area(shape: PreprocessedShape, count: int, seed: int, landmarks: Int[Tensor, " p"] | None) -> Basis:
    """The same about its centre, at points drawn by their area: positions alone are compared, of unlike sampling."""
    mass = shape.operators.mass.cpu().double()
    drawn = torch.multinomial(mass, min(count, len(mass)), generator=torch.Generator().manual_seed(seed))
    basis = shape.operators.basis.sampled(_with(drawn.to(shape.operators.points.device), landmarks))
    return replace(basis, points=basis.points - basis.points.mean(dim=0)).turned(shape.rotation.T.to(basis.points))


def _with(kept: Int[Tensor, " n"], landmarks: Int[Tensor, " p"] | None) -> Int[Tensor, " m"]:
    return kept if landmarks is None else torch.cat([kept, landmarks])
