"""The field's protocol: error of the map that gives each target point its source point."""

from __future__ import annotations

import math
import time
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from homolog.core.arguments import check_kind, given_or_default
from homolog.core.cluster import Processes
from homolog.core.errors import ArgumentError, DataError, bad_value
from homolog.core.plugins import blamed_on
from homolog.core.progress import Progress, ignore
from homolog.core.reprs import function_name
from homolog.core.tasks import check_processes, run_tasks
from homolog.datasets import Pair as PairOfNames
from homolog.datasets import ShapeFolder, Truth, drawn_pairs
from homolog.evaluation.exchanges import Exchange, ExchangeFinder
from homolog.evaluation.metrics import Detection, geodesic_diameter, geodesic_errors
from homolog.evaluation.protocol import Protocol
from homolog.evaluation.result import Evaluation, PairErrors
from homolog.geometry import unit_frame
from homolog.matching import Match, Matcher, check_point_map, low_confidence_warnings
from homolog.pairs import SIDES, LandmarkPairs, Pair, PairOptions, PreprocessedShape, Side, WarningSettings
from homolog.shapes import Modality, Shape, add_noise, farthest_points, repair
from homolog.synthesis.degradation import add_floor, add_strays

# Name, side if that matters, whether it is a cloud, and whose scale it takes if not its own.
_Variant = tuple[str, str, bool, str]

MatchShapes = Callable[[Shape, Shape], Any]
"""A method of one's own: takes two shapes and gives a ``Match``, or for each target point its source point (n_target,).

The shapes are as the protocol has them (without faces where they are clouds, with noise where there is any), and
indices are theirs.
"""


@dataclass(frozen=True, eq=False)
class ScoredPair:
    """What a metric of one's own is given.

    Args:
        match: the maps, and both shapes.
        truth: pairs of points that are known to correspond: ``truth.source`` and ``truth.target`` (p,).
        errors: of each of these (p,), as in ``PairErrors``.
    """

    match: Match
    truth: Truth
    errors: Float[np.ndarray, " p"]


# Several processes are given so many pairs of one source at a time, which share its features and searches on it.
_PAIRS_OF_A_PART = 16
# In the report of a match: the maps that are known. A map from the target says nothing of source points, not even that
# they have no counterpart.
_ONE_WAY = ["target_to_source"]

Metric = Callable[[ScoredPair], float]
"""A figure of one pair; its mean over pairs is reported."""


def evaluate(
    matcher: Matcher | None,
    folder: ShapeFolder,
    protocol: Protocol | None = None,
    *,
    match: MatchShapes | None = None,
    match_pair: Callable[[Pair], Match] | None = None,
    metrics: Mapping[str, Metric] | None = None,
    processes: Processes = 1,
    progress: Progress | None = None,
) -> Evaluation:
    """Match every pair of a folder and measure the maps against its ground truth.

    A point that a map leads to none counts as the diameter of the source, so that abstaining is not rewarded. The
    published protocol has a counterpart for every point; the mean over matched points alone stands beside.

    A shape's scale is that of its repaired mesh, before any noise is added and any face dropped, as the published
    protocol has it. Of a dataset of clouds the errors are Euclidean distances on the source, in the files' unit.

    Args:
        matcher: makes the maps; operators and features of each shape are computed once, those of a partial shape once
            for each full one. Its settings say which matches count as doubtful. None where ``match`` makes the maps.
        folder: shapes with ground truth.
        protocol: which shapes, as what; by default the meshes of the test split.
        match: a method of one's own.
        match_pair: makes the maps of a preprocessed pair; by default ``matcher.find``.
        metrics: figures of one's own by name.
        processes: number of worker processes, or a cluster; for several, what is given must be picklable.
        progress: told how far the work is.

    Raises:
        ArgumentError: if something given is of another kind, more pairs are to be drawn than there are, a map does not
            fit its shapes, a metric gives no finite number, or ``match`` or a metric
            fails.
        DataError: if the ground truth does not fit the shapes, or not one of its points can be matched.

    Examples:
        >>> import homolog
        >>> from homolog.datasets import demo_folder
        >>> from homolog.evaluation import Protocol, evaluate
        >>> protocol = Protocol(split="all", n_pairs=1)
        >>> evaluation = evaluate(homolog.Matcher.from_weights(), demo_folder(), protocol)
        >>> evaluation.to_dict()["mean_geodesic_error"] < 5
        True
    """
    _check_arguments(matcher, folder, match, match_pair, metrics)
    protocol = given_or_default("protocol", protocol, Protocol)
    if protocol.landmarks and match is not None:
        raise ArgumentError("landmarks guide a matcher, but match makes the maps; leave one of them out")
    folder = replace(folder, seed=protocol.seed)
    pairs = folder.pairs(protocol.split, listed=protocol.pairs_file)
    if protocol.n_pairs is not None:
        pairs = drawn_pairs(pairs, protocol.n_pairs, seed=protocol.seed)
    scoring = _Scoring(folder, protocol, matcher, match, match_pair, metrics or {})
    if processes == 1:
        found = scoring(pairs, progress or ignore)
    else:
        found = _in_parts(scoring, pairs, processes, progress or ignore)
    if not any(pair.matched.any() for pair in found.pairs) and not scoring.run(pairs).can_be_matched():
        raise DataError(
            f"{folder.root}: no pair has a common point that could be matched, so there is nothing to score; "
            "ground truth must name points that the faces use"
        )
    return found


@dataclass(frozen=True, eq=False)
class _Scoring:
    """Matches pairs and scores them, in this process or another one."""

    folder: ShapeFolder
    protocol: Protocol
    matcher: Matcher | None
    match: MatchShapes | None
    match_pair: Callable[[Pair], Match] | None
    metrics: Mapping[str, Metric]

    def run(self, pairs: tuple[PairOfNames, ...], progress: Progress = ignore) -> _Run:
        """Read the shapes of some pairs, and their truth."""
        warnings = WarningSettings() if self.matcher is None else self.matcher.settings.warnings
        return _Run(self.folder, self.protocol, pairs, self.metrics, progress, warnings)

    def __call__(self, pairs: tuple[PairOfNames, ...], progress: Progress = ignore) -> Evaluation:
        """The errors of some pairs."""
        run = self.run(pairs, progress)
        return run.evaluation(
            _ByMatcher(run, self.matcher, self.match_pair) if self.match is None else _ByFunction(run, self.match)
        )


def _in_parts(
    scoring: _Scoring, pairs: tuple[PairOfNames, ...], processes: Processes, progress: Progress
) -> Evaluation:
    """The errors of all pairs, found in several processes, and the seconds of all of these together."""
    check_processes(processes)
    by_source: dict[str, list[int]] = defaultdict(list)
    for number, pair in enumerate(pairs):
        by_source[pair[0]].append(number)
    parts = [
        numbers[begin : begin + _PAIRS_OF_A_PART]
        for numbers in by_source.values()
        for begin in range(0, len(numbers), _PAIRS_OF_A_PART)
    ]
    found: list[Evaluation] = []
    tasks = [(pairs[part[0]][0], partial(scoring, tuple(pairs[number] for number in part))) for part in parts]
    root = scoring.folder.root
    run_tasks([tasks], processes=processes, progress=progress, told=found.append, reads=[root])
    scored = {
        number: errors
        for part, one in zip(parts, found, strict=True)
        for number, errors in zip(part, one.pairs, strict=True)
    }
    seconds = {name: sum(one.seconds[name] for one in found) for name in found[0].seconds}
    return replace(found[0], pairs=tuple(scored[number] for number in range(len(pairs))), seconds=seconds)


# What is used of a matcher.
_OF_A_MATCHER = ("preprocess", "paired", "find", "method_of", "settings")


def _check_arguments(matcher: Any, folder: Any, match: Any, match_pair: Any, metrics: Any) -> None:
    """Refuse, before anything is read, what cannot make maps or score them."""
    has_its_methods = all(hasattr(matcher, name) for name in _OF_A_MATCHER)
    if callable(matcher) and not has_its_methods:
        raise ArgumentError(
            f"matcher is the function {function_name(matcher)}, but must be a Matcher; give None, and the function by "
            "match="
        )
    if matcher is not None and not has_its_methods:
        check_kind("matcher", matcher, Matcher)
    check_kind("folder", folder, ShapeFolder)
    for name, function in (("match", match), ("match_pair", match_pair)):
        if function is not None and not callable(function):
            raise bad_value(name, function, "a function")
    if matcher is None and match is None:
        raise ArgumentError("matcher is None, but maps must come from a matcher or from match; give one of them")
    if match is not None and match_pair is not None:
        raise ArgumentError("match and match_pair are both given, but only one can make the maps; leave one out")
    if not isinstance(metrics, Mapping | None):
        raise bad_value("metrics", metrics, "a table of functions by name, such as {'mine': function}")
    for name, metric in (metrics or {}).items():
        if not (isinstance(name, str) and callable(metric)):
            raise bad_value(f"metrics[{name!r}]", metric, "a function of a ScoredPair, under a name")


class _Run:
    """One evaluation: shapes, truth, and the bookkeeping of time."""

    def __init__(
        self,
        folder: ShapeFolder,
        protocol: Protocol,
        pairs: tuple[PairOfNames, ...],
        metrics: Mapping[str, Metric],
        progress: Progress,
        warnings: WarningSettings,
    ) -> None:
        self.folder, self.protocol, self.pairs, self.metrics, self.progress = folder, protocol, pairs, metrics, progress
        self.warnings = warnings
        names = dict.fromkeys(name for pair in pairs for name in pair)
        self.shapes = {name: folder.shape(name) for name in names}
        self.shape_of = cache(lambda name: self.shapes[name] if name in self.shapes else folder.shape(name))
        self.frame = cache(lambda name: unit_frame(repair(self.shapes[name]).shape))  # many parts may share one
        self.ground_truth = folder.ground_truth(self.shape_of)
        own_clouds = protocol.is_cloud("target")  # full shapes, which lead the pairs, have none
        self.clouds = {name: folder.cloud(name) for name in names if own_clouds and folder.has_cloud(name)}
        whole = [self._truth(pair) for pair in pairs]  # a fault of any is said before anything is computed
        self.known = dict(zip(pairs, [self._landmarks(*each) for each in zip(pairs, whole, strict=True)], strict=True))
        self.truths = [truth.without(self.known[pair]) for pair, truth in zip(pairs, whole, strict=True)]
        self.euclidean = folder.description.holds == "clouds"  # without a surface that distances could run along
        self.exchanges = self._exchange_finder()
        self.total = self.done = 0
        self.seconds = {"preprocess": 0.0, "match": 0.0, "measure": 0.0}

    def evaluation(self, source: _ByFunction | _ByMatcher) -> Evaluation:
        self.total += len(self.pairs)
        matches = [source.match(pair) for pair in self.pairs]
        with self.timed("measure"):
            scored = list(self._scored(matches))
        seconds = {**self.seconds, "total": sum(self.seconds.values())}
        unit = (self.folder.description.unit or "units of the files") if self.euclidean else None
        return Evaluation(tuple(scored), source.method, seconds, unit)

    def can_be_matched(self) -> bool:
        """Whether repair keeps a point of any pair that is known to correspond."""
        kept = cache(lambda name: repair(self.shapes[name]).clean_index >= 0)
        return any(
            (kept(source)[truth.source] & (pair_cloud is not None or kept(target)[truth.target])).any()
            for (source, target), truth in zip(self.pairs, self.truths, strict=True)
            for pair_cloud in [self.clouds.get(target)]
        )

    def _exchange_finder(self) -> ExchangeFinder | None:
        """What tells what maps exchange; None where parts, or shapes without a template, are matched."""
        has_template = self.folder.description.truth == "template-correspondence"
        if self.protocol.partial or self.clouds or not has_template:
            return None
        return ExchangeFinder(self.folder, self.ground_truth, self.shape_of)

    def _truth(self, pair: PairOfNames) -> Truth:
        """Points of source and target that are known to correspond."""
        cloud = self.clouds.get(pair[1])
        return self.ground_truth.between(*pair) if cloud is None else self.ground_truth.of_cloud(*pair, cloud)

    def _landmarks(self, pair: PairOfNames, truth: Truth) -> Int[np.ndarray, " p"]:
        """Which of the points that are known to correspond guide the match."""
        count, points = self.protocol.landmarks, self.shapes[pair[0]].points[truth.source]
        if not count:
            return np.empty(0, dtype=int)
        if count >= len(points):
            raise ArgumentError(
                f"landmarks is {count}, but {' - '.join(pair)} has {len(points)} points that are known to correspond, "
                "and others are scored; take fewer"
            )
        return farthest_points(points, count, seed=self.protocol.seed)

    def landmark_pairs(self, pair: PairOfNames) -> LandmarkPairs | None:
        """The landmarks that guide the match of a pair."""
        if not len(self.known[pair]):
            return None
        truth = self._truth(pair)
        return LandmarkPairs(truth.source[self.known[pair]], truth.target[self.known[pair]])

    def given(self, pair: PairOfNames, side: Side) -> Shape:
        """A shape as the protocol has it, turned, with its noise and with its faces."""
        shape, factor = self._cluttered(self._noisy(pair, side), pair, side), self.part_units(side)
        if self.protocol.turn == "none" and factor == 1:
            return shape
        turned = factor * shape.points @ self.protocol.rotation(pair[SIDES.index(side)]).T
        return Shape(turned, shape.faces, name=shape.name)

    def part_units(self, side: Side) -> float:
        """What the lengths of the shapes of a side are multiplied by."""
        return self.protocol.part_units if side == "target" else 1.0

    def _noisy(self, pair: PairOfNames, side: Side) -> Shape:
        name = pair[SIDES.index(side)]
        shape = self.clouds.get(name, self.shapes[name]) if side == "target" else self.shapes[name]
        if not self.is_noisy(side):
            return shape
        scale = self.frame(self.scaled_by(pair, side)).scale
        return add_noise(shape, self.protocol.noise * scale, seed=self._seed(name, side))

    def _cluttered(self, shape: Shape, pair: PairOfNames, side: Side) -> Shape:
        """A cloud with outliers and a floor after its own points, where the protocol has them."""
        if not self.is_cluttered(side):
            return shape
        protocol, scale = self.protocol, self.frame(self.scaled_by(pair, side)).scale
        seed = self._seed(pair[SIDES.index(side)], f"{side} clutter")
        strays = add_strays(shape, protocol.outliers, kind=protocol.outlier_kind, unit=scale, seed=seed)
        if protocol.background == "none":
            return strays
        floor = add_floor(shape, shape.n_points, seed=seed + 1).points[shape.n_points :]
        return Shape(np.concatenate([strays.points, floor]), name=shape.name)

    def _seed(self, name: str, use: str) -> int:
        return zlib.crc32(f"{self.protocol.seed} {name} {use}".encode(errors="surrogateescape"))

    def is_noisy(self, side: Side) -> bool:
        """Whether the shapes of a side have noise."""
        return bool(self.protocol.is_cloud(side) and self.protocol.noise)

    def is_cluttered(self, side: Side) -> bool:
        """Whether the shapes of a side have points that do not belong to them."""
        return self.protocol.is_cloud(side) and self.protocol.is_cluttered

    def n_own_points(self, pair: PairOfNames, side: Side) -> int:
        """How many points a shape has of its own: the first ones."""
        name = pair[SIDES.index(side)]
        return (self.clouds.get(name, self.shapes[name]) if side == "target" else self.shapes[name]).n_points

    def found_clutter(self, pair: PairOfNames, match: Match) -> Detection | None:
        """How well the added points were found: those that have no counterpart. Of full shapes, parts lack others."""
        lacking = {False: (), True: ("source",), "both": SIDES}[self.protocol.partial]  # the other shape is a part
        told: tuple[Side, ...] = ("target",) if _is_one_way(match) else SIDES
        sides = [side for side in told if self.is_cluttered(side) and side not in lacking]
        if not sides:
            return None
        maps = {"source": match.source_to_target, "target": match.target_to_source}
        each = [
            Detection.of(maps[side] < 0, np.arange(len(maps[side])) >= self.n_own_points(pair, side)) for side in sides
        ]
        return sum(each[1:], each[0])

    def scaled_by(self, pair: PairOfNames, side: Side) -> str:
        """Whose scale a shape takes: its own, but a partial one that of the full one."""
        return pair[0] if self.protocol.partial else pair[SIDES.index(side)]

    def tick(self, what: str) -> None:
        """Say what is done next."""
        self.progress(self.done, self.total, what)
        self.done += 1

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """Count a block's seconds for a part of the work."""
        began = time.perf_counter()
        yield
        self.seconds[part] += time.perf_counter() - began

    def _scored(self, matches: list[Match]) -> Iterator[PairErrors]:
        """Errors of all pairs, those of one source measured at once: a search from a point serves all its pairs."""
        by_source: dict[str, list[int]] = defaultdict(list)
        for number, pair in enumerate(self.pairs):
            by_source[pair[0]].append(number)
        mapped = [self._mapped(*each) for each in zip(self.pairs, matches, self.truths, strict=True)]
        errors: dict[int, Float[np.ndarray, " p"]] = {}
        for source, numbers in by_source.items():
            starts, ends = (
                np.concatenate([found[n] for n in numbers]) for found in ([t.source for t in self.truths], mapped)
            )
            cuts = np.cumsum([len(mapped[number]) for number in numbers])[:-1]
            errors |= dict(zip(numbers, np.split(self._errors(self.shapes[source], starts, ends), cuts), strict=True))
        for number, pair in enumerate(self.pairs):
            yield self._pair(pair, matches[number], self.truths[number], mapped[number], errors[number])

    def _mapped(self, pair: PairOfNames, match: Match, truth: Truth) -> Int[np.ndarray, " p"]:
        """Where points with a known counterpart are mapped to; for an added point the nearest of the source's own."""
        mapped: Int[np.ndarray, " p"] = match.target_to_source[truth.target]
        n_own = self.n_own_points(pair, "source")
        is_added = mapped >= n_own
        if not is_added.any():
            return mapped
        points = match.source.points
        own = mapped.copy()
        own[is_added] = KDTree(points[:n_own]).query(points[mapped[is_added]])[1]
        return own

    def _pair(
        self,
        pair: PairOfNames,
        match: Match,
        truth: Truth,
        mapped: Int[np.ndarray, " p"],
        errors: Float[np.ndarray, " p"],
    ) -> PairErrors:
        tells_missing = self.protocol.partial is True and not _is_one_way(match)
        known = self.ground_truth.counterparts(*pair) if tells_missing else None
        scored = ScoredPair(match, truth, errors)
        return PairErrors(
            pair=pair,
            errors=errors,
            matched=mapped >= 0,
            confidences=match.target_confidence[truth.target],
            missing=None if known is None else Detection.of(match.source_to_target[known.points] < 0, ~known.present),
            overlap=self._found_overlap(pair, match),
            clutter=self.found_clutter(pair, match),
            quality=match.quality,
            doubtful=None if match.quality is None else bool(low_confidence_warnings(match, self.warnings)),
            metrics={name: _figure(name, metric, scored, pair) for name, metric in self.metrics.items()},
            exchanged=self._exchanged(pair, match),
            chosen=next((candidate["name"] for candidate in match.report.get("choice", ())), None),
            adaptation=match.report.get("adaptation"),
        )

    def _found_overlap(self, pair: PairOfNames, match: Match) -> Detection | None:
        """How well the points of two parts are found that have a counterpart, of both together.

        Of the source alone, where the target is a cloud with points of its own.
        """
        if self.protocol.partial != "both" or _is_one_way(match):
            return None
        known = [(match.source_to_target, self.ground_truth.counterparts(*pair))]
        if pair[1] not in self.clouds:
            known.append((match.target_to_source, self.ground_truth.counterparts(*pair[::-1])))
        each = [Detection.of(there[one.points] >= 0, one.present) for there, one in known if one is not None]
        return sum(each[1:], each[0]) if len(each) == len(known) else None

    def _exchanged(self, pair: PairOfNames, match: Match) -> Exchange | None:
        if self.exchanges is None:
            return None
        mapped = self._mapped(pair, match, self._truth(pair))  # of all points, landmarks as well
        return self.exchanges.exchange(pair, mapped, scale=self.frame(pair[0]).scale)

    def _errors(
        self, shape: Shape, truth: Int[np.ndarray, " p"], mapped: Int[np.ndarray, " p"]
    ) -> Float[np.ndarray, " p"]:
        """Distances on a shape from true points to where they are mapped; its diameter where that is nowhere."""
        nowhere = mapped < 0
        reached = np.where(nowhere, truth, mapped)
        if self.euclidean:
            errors: np.ndarray = np.linalg.norm(shape.points[truth] - shape.points[reached], axis=1)
        else:
            errors = geodesic_errors(shape, truth, reached)
        if nowhere.any():
            diagonal = np.linalg.norm(np.ptp(shape.points, axis=0))
            errors[nowhere] = diagonal if self.euclidean else geodesic_diameter(shape)
        return errors


def _figure(name: str, metric: Metric, scored: ScoredPair, pair: PairOfNames) -> float:
    """What a metric of one's own gives for a pair, as a number."""
    with blamed_on(f"the metric {name!r}", " -> ".join(pair)):
        found: Any = metric(scored)
    try:
        # To Python, True is a number; here it is mostly a comparison whose mean was forgotten.
        figure = math.nan if np.asarray(found).dtype == bool else float(found)
    except (TypeError, ValueError, RuntimeError):
        figure = math.nan
    if not math.isfinite(figure):
        raise bad_value(f"the metric {name!r} of {' - '.join(pair)}", found, "a finite number")
    return figure


def _is_one_way(match: Match) -> bool:
    return match.report.get("directions") == _ONE_WAY


class _ByFunction:
    """Maps by a method of one's own, which is given the shapes that are scored."""

    def __init__(self, run: _Run, match: MatchShapes) -> None:
        self.run, self.function = run, match
        self.method = function_name(match)

    def match(self, pair: PairOfNames) -> Match:
        run = self.run
        run.tick(" - ".join(pair))
        source, target = (
            shape.as_cloud() if run.protocol.is_cloud(side) else shape
            for side, shape in ((side, run.given(pair, side)) for side in SIDES)
        )
        with run.timed("match"), blamed_on(f"match {self.method!r}", " -> ".join(pair)):
            found = self.function(source, target)
        if isinstance(found, Match):
            sizes = {"source": source.n_points, "target": target.n_points}
            for side, points in (("source", found.source_to_target), ("target", found.target_to_source)):
                if len(points) != sizes[side]:
                    raise ArgumentError(
                        f"{' - '.join(pair)}: the match has {len(points)} {side} points, but must have {sizes[side]}, "
                        "those of the shape that was given"
                    )
            return found
        if isinstance(found, tuple) and len(found) == 2:
            raise ArgumentError(
                f"{' - '.join(pair)}: match {self.method!r} gave two values, but must give a Match, or one map: "
                f"target_to_source, for each target point its source point, ({target.n_points},)"
            )
        name = f"{' - '.join(pair)}: target_to_source"
        back = check_point_map(name, found, n_points=target.n_points, n_others=source.n_points)
        nowhere = np.full(source.n_points, -1)
        return Match(source, target, nowhere, back, method=self.method, report={"directions": _ONE_WAY})


class _ByMatcher:
    """Maps by a matcher; a shape is preprocessed when it is first needed, and let go of when it is needed no more."""

    def __init__(self, run: _Run, matcher: Matcher | None, match_pair: Callable[[Pair], Match] | None) -> None:
        assert matcher is not None
        self.run, self.matcher, self.find = run, matcher, match_pair or matcher.find
        self.uses = Counter(self._variant(pair, side) for pair in run.pairs for side in SIDES)
        self.preprocessed: dict[_Variant, PreprocessedShape] = {}
        self.options = PairOptions(
            partial={False: None, True: "target", "both": "both"}[run.protocol.partial],
            pre_aligned=run.protocol.pre_aligned,
            orient=run.protocol.orient,
            clutter=run.protocol.clutter,
            proxy=run.protocol.proxy,
        )
        modalities: list[Modality] = [
            "cloud" if run.protocol.is_cloud(side) else run.shapes[name].modality
            for side, name in zip(SIDES, run.pairs[0], strict=True)
        ]
        both = run.protocol.partial == "both"
        method_of = partial(matcher.method_of, parts=True) if both else matcher.method_of
        self.method = method_of(*modalities).name
        run.total += len(self.uses)

    def match(self, pair: PairOfNames) -> Match:
        source, target = self._take(pair, "source"), self._take(pair, "target")
        self.run.tick(" - ".join(pair))
        with self.run.timed("match"):
            options = replace(self.options, landmarks=self.run.landmark_pairs(pair))
            found = self.find(self.matcher.paired(source, target, options))
        check_kind("what match_pair gave", found, Match)
        return found

    def _variant(self, pair: PairOfNames, side: Side) -> _Variant:
        """What tells preparations apart: noise makes source and target of one name two clouds, scale a part several."""
        name, partner, cloud = pair[SIDES.index(side)], self.run.scaled_by(pair, side), self.run.protocol.is_cloud(side)
        own = cloud and (self.run.protocol.noise or self.run.protocol.is_cluttered or name in self.run.clouds)
        return name, side if own else "", cloud, "" if partner == name else partner

    def _take(self, pair: PairOfNames, side: Side) -> PreprocessedShape:
        variant = self._variant(pair, side)
        if variant not in self.preprocessed:
            self.run.tick(pair[SIDES.index(side)])
            with self.run.timed("preprocess"):
                self.preprocessed[variant] = self._preprocess(pair, side)
        self.uses[variant] -= 1
        return self.preprocessed[variant] if self.uses[variant] else self.preprocessed.pop(variant)

    def _preprocess(self, pair: PairOfNames, side: Side) -> PreprocessedShape:
        run = self.run
        preprocess = partial(
            self.matcher.preprocess,
            run.given(pair, side),
            as_cloud=run.protocol.is_cloud(side),
            orient="given" if run.protocol.pre_aligned else run.protocol.orient,
            partial=self.options.is_partial(side),
            clutter=run.protocol.clutter,
            proxy=run.protocol.proxy,
        )
        scaled_by = run.scaled_by(pair, side)
        if scaled_by == pair[SIDES.index(side)] and not (run.is_noisy(side) or run.is_cluttered(side)):
            return preprocess()
        frame = run.frame(scaled_by)
        return preprocess(scale=frame.scale, centre=frame.centre if run.protocol.pre_aligned else None)
