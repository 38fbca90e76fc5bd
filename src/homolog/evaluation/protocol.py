"""The field's protocol: error of the map that gives each target point its source point."""

from __future__ import annotations

import time
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, get_args

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import spearmanr

from homolog.core.choices import Modalities, Side, Split
from homolog.core.errors import ArgumentError, DataError, bad_choice, bad_value
from homolog.core.progress import Progress, no_progress
from homolog.datasets import Counterparts, Pair, ShapeFolder, Truth, drawn_pairs
from homolog.evaluation.metrics import PCK_THRESHOLD, Detection, area_under_pck, least_confident_share, pck_curve
from homolog.geometry import edge_graph, pair_distances, surface_area, unit_frame
from homolog.matching import MEASURES, Correspondence, MapQuality, Matcher, Prepared
from homolog.shapes import Modality, Shape, add_noise, repair

_ROLES: tuple[Side, Side] = ("source", "target")
# Of fewer pairs, rank correlations mean little.
_PAIRS_TO_RANK = 10
# Name, role if that matters, whether it is a cloud, and whose scale it takes if not its own.
_Variant = tuple[str, str, bool, str]

MatchPair = Callable[[Prepared, Prepared], Correspondence]
"""Gives the maps of two prepared shapes."""


@dataclass(frozen=True)
class Protocol:
    """What to evaluate.

    Args:
        modality: of source and target.
        split: which shapes.
        pairs_file: a list of pairs to use instead of the split's.
        n_pairs: how many of the pairs to draw at random, none of a shape with itself; by default all are used.
        partial: whether each target is a part of a shape like its source, in the same units; it takes its scale then.
        pre_aligned: whether such parts lie in the coordinates of their sources, about where they belong.
        noise: standard deviation of isotropic noise on the points of every cloud, in units of sqrt(area); independent
            on source and target.
        seed: of the noise, of the pairs drawn, and of the order of points in sets that are shuffled.
    """

    modality: Modalities = "mesh"
    split: Split = "test"
    pairs_file: str | None = None
    n_pairs: int | None = None
    partial: bool = False
    pre_aligned: bool = False
    noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.modality not in get_args(Modalities):
            raise bad_choice("modality", self.modality, get_args(Modalities))
        if not (np.isfinite(self.noise) and self.noise >= 0):
            raise bad_value("noise", self.noise, "a number of at least 0, in units of sqrt(area)")
        if self.pre_aligned and not self.partial:
            raise ArgumentError("pre_aligned is for parts, but partial is False; set it, or leave pre_aligned out")
        if self.noise and self.modality == "mesh":
            raise ArgumentError("noise is for clouds, but modality is 'mesh'; use 'cloud', or leave noise at 0")

    def is_cloud(self, role: Side) -> bool:
        """Whether the shapes in this role lose their faces."""
        source, _, target = self.modality.partition("-to-")
        return (source if role == "source" else target or source) == "cloud"


@dataclass(frozen=True, eq=False)
class PairErrors:
    """Errors of one pair.

    Args:
        pair: names of source and target.
        errors: of each point with a known counterpart that is matched (p,): geodesic, in units of sqrt(area), or
            straight ones in the files' unit where the set is of clouds.
        confidences: of the map there (p,).
        missing: how well points of the source that a part lacks are found; None where that is not known.
        quality: what the maps tell of themselves, without the truth; None if whoever made them does not say.
    """

    pair: Pair
    errors: Float[np.ndarray, " p"]
    confidences: Float[np.ndarray, " p"]
    missing: Detection | None = None
    quality: MapQuality | None = None


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The errors of all pairs, and where the time went.

    Args:
        pairs: in the order of the folder.
        route: by which shapes of these modalities are matched.
        unmatched_points: points with a known counterpart that are left out, as they have no match.
        seconds: per part of the work.
        straight_unit: of straight errors, where the set is of clouds; None for geodesic ones.
    """

    pairs: tuple[PairErrors, ...]
    route: str
    unmatched_points: int
    seconds: dict[str, float]
    euclidean_unit: str | None = None

    @property
    def errors(self) -> Float[np.ndarray, " p"]:
        """Errors of all points of all pairs together."""
        return np.concatenate([pair.errors for pair in self.pairs])

    @property
    def missing(self) -> Detection | None:
        """How well points of complete shapes that parts lack are found, in all pairs together; None if not known."""
        known = [pair.missing for pair in self.pairs if pair.missing is not None]
        return sum(known[1:], known[0]) if known else None

    @property
    def rank_correlations(self) -> dict[str, float | None]:
        """Spearman's rank correlation, over pairs, of each figure of ``Quality`` with the mean error; {} of few pairs.

        None for figures that are not known of all pairs, or the same for all.
        """
        known = [pair for pair in self.pairs if pair.quality is not None and len(pair.errors)]
        if len(known) < _PAIRS_TO_RANK:
            return {}
        errors = [float(pair.errors.mean()) for pair in known]
        figures = [pair.quality.mean for pair in known if pair.quality is not None]
        return {name: _rank_correlation([getattr(each, name) for each in figures], errors) for name in MEASURES}

    @property
    def error_kind(self) -> str:
        """Whether errors are ``"geodesic"`` or ``"straight"``."""
        return "geodesic" if self.euclidean_unit is None else "straight"

    def to_dict(self) -> dict[str, Any]:
        """Figures for JSON; geodesic errors are multiplied by 100, as tables in the field show them."""
        confidences = np.concatenate([pair.confidences for pair in self.pairs])
        share = least_confident_share(self.errors, confidences)
        missing = self.missing
        return {
            f"mean_{self.error_kind}_error": self._shown(self.errors.mean()),
            f"median_{self.error_kind}_error": self._shown(np.median(self.errors)),
            "unit": "sqrt(area) / 100" if self.euclidean_unit is None else self.euclidean_unit,
            **(self._curve() if self.euclidean_unit is None else {}),
            # JSON has no NaN, which stands for no error at all.
            "least_confident_fifth_error_share": share if np.isfinite(share) else None,
            **({} if missing is None else {"without_counterpart": missing.to_dict()}),
            **({"quality_rank_correlations": self.rank_correlations} if self.rank_correlations else {}),
            "route": self.route,
            "unmatched_points": self.unmatched_points,
            "pairs": [self._pair(pair) for pair in self.pairs],
            "seconds": self.seconds,
        }

    def _shown(self, error: float) -> float:
        return float(error) * (100 if self.euclidean_unit is None else 1)

    def _curve(self) -> dict[str, Any]:
        thresholds, shares = pck_curve(self.errors)
        return {
            "pck_auc": area_under_pck(self.errors),
            "pck_threshold": PCK_THRESHOLD,
            "pck": {"thresholds": thresholds.tolist(), "shares": shares.tolist()},
        }

    def _pair(self, pair: PairErrors) -> dict[str, Any]:
        return {
            "source": pair.pair[0],
            "target": pair.pair[1],
            "points": len(pair.errors),
            f"mean_{self.error_kind}_error": self._shown(pair.errors.mean()) if len(pair.errors) else None,
            **({} if pair.missing is None else {"without_counterpart": pair.missing.to_dict()}),
            **({} if pair.quality is None else {"quality": pair.quality.to_dict()}),
        }


def _rank_correlation(figures: list[float | None], errors: list[float]) -> float | None:
    known = [figure for figure in figures if figure is not None]
    if len(known) < len(errors) or len(set(known)) < 2 or len(set(errors)) < 2:
        return None
    return float(spearmanr(known, errors).statistic)


def evaluate(
    matcher: Matcher,
    folder: ShapeFolder,
    protocol: Protocol,
    *,
    match: MatchPair | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Match every pair of a folder and measure the maps against its ground truth.

    Each shape's operators and features are computed once, those of a part once for each complete shape. ``match`` makes
    the maps of a prepared pair; by default ``matcher.match_prepared``. A shape's scale is that of its repaired mesh,
    before any noise is added and any face dropped, as the published protocol has it. Of a set of clouds the errors are
    straight distances on the source, in the files' unit.

    Raises:
        ArgumentError: if more pairs are to be drawn than there are.
        DataError: if the ground truth does not fit the shapes, or not one of its points is matched.
    """
    folder = replace(folder, seed=protocol.seed)
    pairs = folder.pairs(protocol.split, listed=protocol.pairs_file)
    if protocol.n_pairs is not None:
        pairs = drawn_pairs(pairs, protocol.n_pairs, seed=protocol.seed)
    match = match or (partial(matcher.match_prepared, partial="target") if protocol.partial else matcher.match_prepared)
    run = _Run(matcher, folder, protocol, pairs, match, progress or no_progress)
    return run.evaluation()


@dataclass(frozen=True, eq=False)
class _Queries:
    """Distances to measure on one source shape: from each true point to where the map puts it."""

    pair: Pair
    truth: Int[np.ndarray, " p"]
    mapped: Int[np.ndarray, " p"]
    confidences: Float[np.ndarray, " p"]
    missing: Detection | None
    quality: MapQuality | None


class _Run:
    def __init__(
        self,
        matcher: Matcher,
        folder: ShapeFolder,
        protocol: Protocol,
        pairs: tuple[Pair, ...],
        match: MatchPair,
        progress: Progress,
    ) -> None:
        self.matcher, self.folder, self.protocol, self.pairs = matcher, folder, protocol, pairs
        self.match, self.progress = match, progress
        names = dict.fromkeys(name for pair in pairs for name in pair)
        self.shapes = {name: folder.shape(name) for name in names}
        self.frame = cache(lambda name: unit_frame(repair(self.shapes[name]).shape))  # many parts may share one
        self.truth = folder.ground_truth(self.shapes.__getitem__)
        self.clouds = {name: folder.cloud(name) for name in names if self._has_cloud(name)}
        for pair in pairs:
            self._truth(pair)  # what is wrong with any is said before anything is computed
        self.uses = Counter(self._variant(pair, role) for pair in pairs for role in _ROLES)
        self.prepared: dict[_Variant, Prepared] = {}
        self.total = len(self.uses) + len(pairs)
        self.done = 0
        self.seconds = {"prepare": 0.0, "match": 0.0, "measure": 0.0}

    def evaluation(self) -> Evaluation:
        queries = [self._match(pair) for pair in self.pairs]
        with self._timed("measure"):
            errors = self._errors(queries)
        if not any(len(pair.errors) for pair in errors):
            raise DataError(
                f"{self.folder.root}: no common point of any pair is matched, so there is nothing to score; "
                "ground truth must name points that the faces use"
            )
        seconds = {**self.seconds, "total": sum(self.seconds.values())}
        route = self.matcher.route(*(self._modality(self.pairs[0], role) for role in _ROLES))
        unmatched = sum(len(query.mapped) - len(pair.errors) for query, pair in zip(queries, errors, strict=True))
        unit = (self.folder.description.unit or "units of the files") if self._euclidean else None
        return Evaluation(tuple(errors), route, unmatched, seconds, unit)

    @property
    def _euclidean(self) -> bool:
        """Whether distances are straight ones: there is no surface that they could run along."""
        return self.folder.description.holds == "clouds"

    def _has_cloud(self, name: str) -> bool:
        """Whether a shape is used as a cloud with points of its own; complete shapes, which lead the pairs, are not."""
        return self.protocol.is_cloud("target") and self.folder.has_cloud(name)

    def _truth(self, pair: Pair) -> Truth:
        cloud = self.clouds.get(pair[1])
        return self.truth.between(*pair) if cloud is None else self.truth.of_cloud(*pair, cloud)

    def _modality(self, pair: Pair, role: Side) -> Modality:
        faces = None if self.protocol.is_cloud(role) else self.shapes[_in_role(pair, role)].faces
        return "cloud" if faces is None else "mesh"

    def _variant(self, pair: Pair, role: Side) -> _Variant:
        """What tells preparations apart: noise makes source and target of one name two clouds, scale a part several."""
        cloud, partner = self.protocol.is_cloud(role), self._scaled_by(pair, role)
        name = _in_role(pair, role)
        own = cloud and (self.protocol.noise or name in self.clouds)
        return name, role if own else "", cloud, "" if partner == name else partner

    def _scaled_by(self, pair: Pair, role: Side) -> str:
        """Whose scale a shape takes: its own, but a part its complete partner's."""
        return pair[0] if self.protocol.partial else _in_role(pair, role)

    def _take(self, pair: Pair, role: Side) -> Prepared:
        """A shape made ready, when it is first needed; it is let go of when it is needed no more."""
        variant = self._variant(pair, role)
        if variant not in self.prepared:
            with self._timed("prepare"):
                self.prepared[variant] = self._prepare(pair, role)
        self.uses[variant] -= 1
        return self.prepared[variant] if self.uses[variant] else self.prepared.pop(variant)

    def _prepare(self, pair: Pair, role: Side) -> Prepared:
        name, scaled_by, cloud = _in_role(pair, role), self._scaled_by(pair, role), self.protocol.is_cloud(role)
        self._tick(name)
        shape = self.clouds.get(name, self.shapes[name]) if role == "target" else self.shapes[name]
        if scaled_by == name and not (cloud and self.protocol.noise):
            return self.matcher.prepare(shape, as_cloud=cloud)
        frame = self.frame(scaled_by)
        centre = frame.centre if self.protocol.pre_aligned else None
        if cloud and self.protocol.noise:
            seed = zlib.crc32(f"{self.protocol.seed} {name} {role}".encode())
            shape = add_noise(shape, self.protocol.noise * frame.scale, seed=seed)
        return self.matcher.prepare(shape, as_cloud=cloud, scale=frame.scale, centre=centre)

    def _match(self, pair: Pair) -> _Queries:
        source, target = self._take(pair, "source"), self._take(pair, "target")
        self._tick(" - ".join(pair))
        with self._timed("match"):
            found = self.match(source, target)
        truth = self._truth(pair)
        known = self.truth.counterparts(*pair) if self.protocol.partial else None
        missing = None if known is None else _missing(found, known)
        at = truth.target
        return _Queries(
            pair, truth.source, found.target_to_source[at], found.target_confidence[at], missing, found.quality
        )

    def _errors(self, queries: list[_Queries]) -> list[PairErrors]:
        """Errors, each source shape's distances searched for all its pairs at once."""
        by_source: dict[str, list[int]] = defaultdict(list)
        for number, query in enumerate(queries):
            by_source[query.pair[0]].append(number)
        errors: dict[int, PairErrors] = {}
        for source, numbers in by_source.items():
            truth = np.concatenate([queries[number].truth for number in numbers])
            mapped = np.concatenate([queries[number].mapped for number in numbers])
            distances = self._distances(self.shapes[source], truth, np.where(mapped < 0, truth, mapped))
            cuts = np.cumsum([len(queries[number].truth) for number in numbers])[:-1]
            for number, part in zip(numbers, np.split(distances, cuts), strict=True):
                query = queries[number]
                kept = query.mapped >= 0
                errors[number] = PairErrors(
                    query.pair, part[kept], query.confidences[kept], query.missing, query.quality
                )
        return [errors[number] for number in range(len(queries))]

    def _distances(
        self, shape: Shape, truth: Int[np.ndarray, " q"], mapped: Int[np.ndarray, " q"]
    ) -> Float[np.ndarray, " q"]:
        if not self._euclidean:
            return geodesic_errors(shape, truth, mapped)
        distances: np.ndarray = np.linalg.norm(shape.points[truth] - shape.points[mapped], axis=1)
        return distances

    @contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        began = time.perf_counter()
        yield
        self.seconds[part] += time.perf_counter() - began

    def _tick(self, what: str) -> None:
        self.progress(self.done, self.total, what)
        self.done += 1


def _in_role(pair: Pair, role: Side) -> str:
    return pair[_ROLES.index(role)]


def _missing(found: Correspondence, known: Counterparts) -> Detection:
    """How well a match tells which of these points of the complete shape the part lacks."""
    return Detection.of(found.source_to_target[known.points] < 0, ~known.present)


def geodesic_errors(
    shape: Shape, truth: Int[np.ndarray, " q"], mapped: Int[np.ndarray, " q"]
) -> Float[np.ndarray, " q"]:
    """Distance along a mesh's edges from each true point to the one it was mapped to, in units of sqrt(area).

    The mesh is the repaired one. Between separate pieces, and from points that no face uses, where there is no way
    along the surface, it is the straight one: the least it can be.

    Raises:
        DataError: if the shape has no faces.
        ShapeError: if it cannot be repaired.
    """
    repaired = repair(shape)
    clean = repaired.shape
    if clean.faces is None:
        raise DataError(f"{shape.name} has no faces, but geodesic errors are measured along a surface")
    unit = np.sqrt(surface_area(clean))
    graph = edge_graph(clean.points / unit, clean.faces)
    starts, ends = repaired.clean_index[truth], repaired.clean_index[mapped]
    on_it = (starts >= 0) & (ends >= 0)
    distances = np.full(len(truth), np.inf)
    distances[on_it] = pair_distances(graph, starts[on_it], ends[on_it])
    apart = np.isinf(distances)
    distances[apart] = np.linalg.norm(shape.points[truth[apart]] - shape.points[mapped[apart]], axis=1) / unit
    return distances
