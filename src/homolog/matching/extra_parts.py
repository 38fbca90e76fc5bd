"""Parts that only one of two full shapes has, such as a held object or a hat. New here.

Each shape is deformed onto the other, coarsely, along both point maps. What it does not reach, in one piece, may be
such a part; so may what a wrong map misses, and a limb. Therefore the shapes are matched again without the piece. It is
a part that only one shape has if the map then contradicts itself less, and the rest still covers all of the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from homolog.core.choices import Side
from homolog.core.errors import ShapeError
from homolog.features.extractor import GivenFeatures
from homolog.geometry import EXTRA_PART
from homolog.geometry.deformation import WeightedPairs
from homolog.geometry.patches import PatchedShape
from homolog.geometry.proxy import Proxy
from homolog.maps import confidence
from homolog.matching.misfit import map_misfit
from homolog.matching.refinement import method_maps, refine
from homolog.matching.result import Match
from homolog.pairs import SIDES, ExtraPartSettings, Pair, PointMaps, PreprocessedShape, Preprocessor
from homolog.shapes import Finding

# Shapes of fewer points are too coarse to tell.
_FEWEST = 1000
# Distances are medians over so many neighbours.
_NEIGHBOURS = 12
# A point is off by its distance to the deformed other shape, by at most so many times its own distance once deformed.
_OWN = 2.0
# Rounds in which a piece grows before it is left out, and rings of points around it that may belong to it.
_GROWING, _RINGS = 2, 3
# So many maps are made without a piece, each of which says anew what belongs to it, two at least. All but the last may
# leave so many times as much of the other shape uncovered, and from the third on such a share of the one before.
_FEWEST_MAPS, _MOST_MAPS, _LOOSELY, _LESS = 2, 4, 4.0, 0.8
_TINY = 1e-9
# So many parts are looked for, and none that holds more of its shape.
_MOST_PARTS, _LARGEST = 3, 0.5


def without_extra_parts(pair: Pair, maps: PointMaps, preprocessor: Preprocessor) -> tuple[Pair, PointMaps]:
    """Two shapes and their maps, without the parts that only one of them has.

    Looked for in full shapes with features of near-isometric kind, where the map contradicts itself; not with
    landmarks, features or a proxy in a shape's place, and not where clutter is kept.

    Args:
        pair: as it was matched.
        maps: between its repaired shapes, refined.
        preprocessor: of its shapes.
    """
    matched, settings = _Matched(pair, maps), pair.settings.extra_parts
    if settings is None or not _may_be_told(pair):
        return pair, maps
    again = replace(preprocessor, extractor=pair.extractor)
    for _ in range(_MOST_PARTS):
        found = next(_Search(matched, again, settings).found(), None)
        if found is None:
            break
        matched = found
    return matched.pair, matched.maps


def extra_part_warnings(match: Match) -> tuple[str, ...]:
    """Say which shape has a part that the other lacks."""
    return tuple(
        f"the {side} seems to have a part that the other shape lacks: {finding['count']} points get no counterpart; "
        "look at it, and give clutter='keep' if it has one"
        for side in SIDES
        for finding in match.report.get("inputs", {}).get(side, {}).get("findings", [])
        if finding["rule"] == EXTRA_PART
    )


def _may_be_told(pair: Pair) -> bool:
    shapes = pair.source, pair.target
    return (
        pair.options.partial is None
        and pair.options.clutter == "remove"
        and pair.guidance is None
        and pair.extractor is not None
        and not isinstance(pair.extractor, GivenFeatures)
        and pair.near_isometric
        and pair.method.supports.refinement
        and not any(isinstance(shape.repaired, Proxy) for shape in shapes)
        and all(shape.operators.n_points >= _FEWEST for shape in shapes)
    )


@dataclass(frozen=True, eq=False)
class _Half:
    """One shape of a pair in patches, with its map."""

    shape: PreprocessedShape
    patched: PatchedShape
    to_other: Int[np.ndarray, " n"]
    trust: Float[np.ndarray, " n"]
    edges: csr_array
    near: Int[np.ndarray, "n k"]

    @classmethod
    def of(
        cls, shape: PreprocessedShape, count: int, to_other: Int[np.ndarray, " n"], trust: Float[np.ndarray, " n"]
    ) -> _Half:
        points = shape.operators.points.cpu().numpy()
        near = KDTree(points).query(points, k=_NEIGHBOURS)[1]
        edges = shape.operators.sparse_laplacian() != 0
        return cls(shape, PatchedShape(shape.operators, count), to_other, trust, csr_array(edges.astype(float)), near)

    def onto(self, other: _Half, out: Bool[np.ndarray, " m"] | None = None) -> Float[np.ndarray, "n 3"]:
        """Its points where it is deformed onto the other, of which some are left out."""
        target = other.patched.points
        allowed = np.ones(len(target), dtype=bool) if out is None else ~out
        pairs = WeightedPairs(
            np.concatenate([np.arange(len(self.to_other)), other.to_other]),
            np.concatenate([target[self.to_other], target]),
            np.concatenate(
                [
                    self.trust * self.patched.masses * allowed[self.to_other],
                    other.trust * other.patched.masses * allowed,
                ]
            ),
        )
        return self.patched.registered(target, pairs, allowed)

    def smoothed(self, distances: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        found: np.ndarray = np.median(distances[self.near], axis=1)
        return found

    def away(self, positions: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, " n"]:
        """How far its points are from the other shape, deformed onto it."""
        return self.smoothed(KDTree(positions).query(self.patched.points)[0])

    def share(self, points: Bool[np.ndarray, " n"]) -> float:
        """Of the shape's area."""
        return float(self.patched.masses[points].sum())

    def taken_to(self, points: Bool[np.ndarray, " m"]) -> float:
        """The share of its area that its map takes to some points of the other."""
        return self.share(points[self.to_other])

    def wider(self, points: Bool[np.ndarray, " n"], rings: int) -> Bool[np.ndarray, " n"]:
        for _ in range(rings):
            points = points | (self.edges @ points > 0)
        return points

    def pieces(self, points: Bool[np.ndarray, " n"]) -> list[Bool[np.ndarray, " n"]]:
        """The connected pieces of some points, the largest first."""
        (kept,) = np.nonzero(points)
        count, piece = connected_components(self.edges[kept][:, kept], directed=False) if len(kept) else (0, kept)
        of_all = np.full(len(points), -1)
        of_all[kept] = piece
        return sorted((of_all == number for number in range(count)), key=self.share, reverse=True)

    def joined(self, points: Bool[np.ndarray, " n"], seed: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """The pieces that hold points of a seed."""
        held = [piece for piece in self.pieces(points) if (piece & seed).any()]
        joined: np.ndarray = np.any([np.zeros_like(seed), *held], axis=0)
        return joined


@dataclass(frozen=True, eq=False)
class _Matched:
    """A pair with its maps and its match."""

    pair: Pair
    maps: PointMaps

    @cached_property
    def match(self) -> Match:
        return Match.of(self.pair, self.maps)


def _other(side: Side) -> Side:
    return "target" if side == "source" else "source"


def _halves(matched: _Matched, count: int) -> dict[Side, _Half]:
    """Both shapes, with what they are mapped to."""
    pair, maps = matched.pair, matched.maps
    x, y, settings = pair.x.operators.points, pair.y.operators.points, pair.settings.confidence
    trust_x = confidence(x, y, maps.x_to_y, maps.y_to_x, settings=settings).double().cpu().numpy()
    trust_y = confidence(y, x, maps.y_to_x, maps.x_to_y, settings=settings).double().cpu().numpy()
    source = _Half.of(pair.x, count, maps.x_to_y.cpu().numpy(), trust_x)
    return {"source": source, "target": _Half.of(pair.y, count, maps.y_to_x.cpu().numpy(), trust_y)}


@dataclass(frozen=True, eq=False)
class _Search:
    """A pair of full shapes, of which one may have a part that the other lacks."""

    matched: _Matched
    preprocessor: Preprocessor
    settings: ExtraPartSettings

    @property
    def sure(self) -> float:
        """The misfit up to which a map is sure."""
        return self.settings.sure_mesh if self.matched.pair.are_meshes else self.settings.sure_cloud

    def found(self) -> Iterator[_Matched]:
        """The pair without such a part, and its match; nothing is looked for where the map is sure."""
        if self._misfit(self.matched) <= self.sure:
            return
        halves = _halves(self.matched, self.settings.patches)
        positions: dict[Side, Float[np.ndarray, "n 3"]] = {
            side: halves[side].onto(halves[_other(side)]) for side in SIDES
        }
        for side, piece in self._pieces(halves, positions):
            out = self._grown(halves, side, piece)
            is_likely = halves[_other(side)].taken_to(out) <= self.settings.taken * halves[side].share(out)
            missed = halves[_other(side)].away(positions[side]) > self.settings.far
            without = self._without(halves, side, out, missed) if is_likely else None
            if without is not None:
                yield without

    def _pieces(
        self, halves: dict[Side, _Half], positions: dict[Side, Float[np.ndarray, "n 3"]]
    ) -> list[tuple[Side, Bool[np.ndarray, " n"]]]:
        """The largest piece of each shape that the other does not reach, if it is large enough; the larger first."""
        found = []
        for side in SIDES:
            half, opposite = halves[side], _other(side)
            away = half.away(positions[opposite])
            own = half.smoothed(KDTree(halves[opposite].patched.points).query(positions[side])[0])
            off = np.minimum(away, _OWN * own)
            found += [(half.share(piece), side, piece) for piece in half.pieces(off > self.settings.far)[:1]]
        large = [size for size in found if size[0] >= self.settings.least]
        return [(side, piece) for _, side, piece in sorted(large, key=lambda size: size[0], reverse=True)]

    def _grown(self, halves: dict[Side, _Half], side: Side, piece: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """The piece with what is not reached either once nothing is drawn to it."""
        half, other = halves[side], halves[_other(side)]
        out = half.wider(piece, _GROWING)
        for _ in range(_GROWING):
            beyond = half.away(other.onto(half, out)) > self.settings.near
            out = half.wider(half.joined(beyond | out, piece) & beyond, 1) | piece
        return out

    def _without(
        self, halves: dict[Side, _Half], side: Side, out: Bool[np.ndarray, " n"], missed: Bool[np.ndarray, " m"]
    ) -> _Matched | None:
        """The pair without some points of a shape, and its match, if that shows that the other lacks them.

        Where the map is sure without them, what was missed of the other shape with them does not count as uncovered.
        """
        half, opposite, settings = halves[side], _other(side), self.settings
        first, least = self._misfit(self.matched), _LOOSELY
        for number in range(1, _MOST_MAPS + 1):
            tried = self._tried(half, side, out)
            if tried is None or self._misfit(tried) > first:
                return None
            new = _halves(tried, settings.patches)
            is_sure = self._misfit(tried) <= self.sure
            uncovered = self._uncovered(halves, new, side, out, missed & is_sure)
            if number >= _FEWEST_MAPS and uncovered <= 1:
                is_better = self._misfit(tried) <= min(first - settings.gain, settings.most_misfit)
                return tried if is_better else None
            if uncovered > least:
                return None
            least = _LESS * uncovered if number >= _FEWEST_MAPS else _LOOSELY
            everything = _in_frame_of(half.shape, new[side].shape)
            away = half.smoothed(KDTree(new[opposite].onto(new[side])).query(everything)[0])
            out = (away > settings.near) & half.wider(out, _RINGS)
        return None

    def _misfit(self, matched: _Matched) -> float:
        return map_misfit(matched.match, self.matched.pair.settings.choice)

    def _tried(self, half: _Half, side: Side, out: Bool[np.ndarray, " n"]) -> _Matched | None:
        """The shapes matched without some points of one of them; None where too little is left."""
        if half.share(out) > _LARGEST or not out.any() or (~out).sum() < _FEWEST:
            return None
        share = f"{100 * out.mean():.2g} % of the points"
        action = f"set apart, {share}: the other shape has nothing like them; clutter='keep' keeps them"
        finding = Finding(EXTRA_PART, int(out.sum()), "repaired", action)
        try:
            left = self.preprocessor.without(half.shape, ~out, finding)
        except ShapeError:
            return None
        pair = self.matched.pair
        pair = replace(pair, source=left, maps=None) if side == "source" else replace(pair, target=left, maps=None)
        return _Matched(pair, refine(pair, method_maps(pair)))

    def _uncovered(
        self,
        before: dict[Side, _Half],
        after: dict[Side, _Half],
        side: Side,
        out: Bool[np.ndarray, " n"],
        missed: Bool[np.ndarray, " m"],
    ) -> float:
        """How much of the other shape the rest leaves uncovered, or of what was mapped to the part; 1 is allowed."""
        opposite, settings = _other(side), self.settings
        other = after[opposite]
        away = other.away(after[side].onto(other)) > settings.far
        there = out[before[opposite].to_other]
        everywhere = other.share(away & ~missed) / (settings.uncovered * before[side].share(out))
        return max(everywhere, other.share(away & there) / max(settings.uncovered_there * other.share(there), _TINY))


def _in_frame_of(shape: PreprocessedShape, other: PreprocessedShape) -> Float[np.ndarray, "n 3"]:
    """The points of a shape in the normalised coordinates of the same one with fewer points."""
    own, new = shape.operators, other.operators
    shift = shape.rotation.double() @ (own.centre - new.centre).double().cpu()
    found: np.ndarray = ((own.points.double().cpu() * own.scale + shift) / new.scale).numpy()
    return found
