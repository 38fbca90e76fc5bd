"""One shape through time: the first frame's points on every frame, and how far two ways to find them drift apart.

Each frame is matched to the first one, and to the one before it. The maps from frame to frame, one after the other,
lead to the same points if all of them are right; where they do not, either way has drifted. New here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float

from homolog.core.arguments import check_choice
from homolog.core.choices import Orient, Up
from homolog.core.errors import ArgumentError, HomologError
from homolog.core.files import expanded, sha256, write_csv, write_json, write_npy, written_together
from homolog.core.progress import Progress, ignore
from homolog.core.versions import versions
from homolog.geometry.projection import SurfaceProjector
from homolog.matching import Match, Matcher
from homolog.shape_models.choice import choice_for_all
from homolog.shape_models.registration import Registered, Template, check_template
from homolog.shape_models.settings import ShapeModelSettings
from homolog.shape_models.subjects import Subject, subjects_of
from homolog.shape_models.track_folder import FRAMES, Step, TrackFolder, linked
from homolog.shapes import Shape, drawable, files_of_shape, read_hashed_shape, read_shape, write_shape
from homolog.transfer import surface_map, untangled
from homolog.viewing import heat_layer

Follow = Literal["first", "previous"]
"""Which maps give the points: those from the first frame to each, or those from frame to frame."""
TRAJECTORIES, DRIFT, MEAN_DRIFT, REPORT = "points.npy", "drift.csv", "drift.ply", "track.json"
TRACK_FILES = (TRAJECTORIES, DRIFT, MEAN_DRIFT, REPORT)
"""What a track writes into its folder, beside ``frames/NAME.ply``."""
# Drift above this share of sqrt(area) is told: good maps of people have mean errors of 2 to 4 %.
_FAR = 0.05


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """A frame of a sequence.

    Args:
        subject: its name and file.
        points: the first frame's points on it, in its coordinates; NaN if it could not be matched (n, 3).
        drift: how far the two ways to find each of these lead apart, in the frame's unit; NaN where there is one
            alone, as on the first two frames (n,).
        size: the square root of its area; NaN if it could not be matched.
        confidence: mean of the map from the first frame.
        warnings: a line each.
        error: why it could not be matched; empty if it was.
    """

    subject: Subject
    points: Float[np.ndarray, "n 3"]
    drift: Float[np.ndarray, " n"]
    size: float = np.nan
    confidence: float = np.nan
    warnings: tuple[str, ...] = ()
    error: str = ""

    def figures(self) -> dict[str, float | None]:
        """Of the drift: mean and 95th percentile, in the frame's unit, and the mean as a share of sqrt(area)."""
        known = self.drift[np.isfinite(self.drift)]
        if not len(known):
            return {"drift": None, "drift_95": None, "drift_of_size": None}
        mean = float(known.mean())
        return {"drift": mean, "drift_95": float(np.percentile(known, 95)), "drift_of_size": mean / self.size}


@dataclass(frozen=True, eq=False)
class Track:
    """The points of a sequence's first frame through time.

    Args:
        first: the first frame.
        frames: all of them, the first included.
        follow: which maps gave the points.
        matched_by: what found the maps.
    """

    first: Shape
    frames: tuple[TrackedFrame, ...]
    follow: Follow
    matched_by: str = ""

    @property
    def points(self) -> Float[np.ndarray, "t n 3"]:
        """The trajectories: each of the first frame's points on each frame; NaN on frames that failed."""
        return np.stack([frame.points for frame in self.frames])

    @property
    def mean_drift(self) -> Float[np.ndarray, " n"]:
        """Of each point over all frames that have two ways to it; 0 if none has."""
        drifts = [frame.drift for frame in self.frames if np.isfinite(frame.drift).any()]
        return np.asarray(np.nanmean(drifts, axis=0)) if drifts else np.zeros(self.first.n_points)


def track(
    files: Sequence[str | Path],
    matcher: Matcher,
    *,
    follow: Follow = "first",
    up: Up = "y",
    as_cloud: bool = False,
    orient: Orient = "auto",
    output: str | Path | None = None,
    progress: Progress = ignore,
    listener: Callable[[TrackedFrame], None] = ignore,
) -> Track:
    """Follow the points of the first frame through a sequence of shapes.

    Where the matcher has a choice of features, it is made once for all frames. A frame that cannot be matched does not
    stop the others; the next is then matched to the last that could be.

    Args:
        files: the frames in order, two or more.
        matcher: that finds the maps.
        follow: ``"first"`` takes the points from the maps of the first frame to each, whose errors do not add up;
            ``"previous"`` from the maps of frame to frame, which are more alike.
        up: the axis that points up in all files.
        as_cloud: match without faces.
        orient: ``"auto"`` finds which way round frames are, ``"given"`` trusts their coordinates.
        output: a folder that keeps what is found of each frame, for ``write_track`` as well; the same call then goes on
            where it was stopped, and does again what depends on frames that changed. By default nothing is kept.
        progress: called with frames that are done, their total, and the current one's name.
        listener: called with each frame.

    Raises:
        ArgumentError: if there are fewer than two frames, two have one name, ``follow`` is another word, or
            ``output`` holds other files, or a track with other settings.
        ShapeError: if the first frame cannot be used.

    Examples:
        >>> from homolog.shape_models import track
        >>> found = track(["scan1.ply", "scan2.ply", "scan3.ply"], homolog.Matcher.from_weights())  # doctest: +SKIP
        >>> found.points.shape  # frames, points, 3  # doctest: +SKIP
    """
    check_choice("follow", follow, get_args(Follow))
    subjects = subjects_of(files)
    if len(subjects) < 2:
        raise ArgumentError("there is one frame; give two or more, in their order")
    first, digest = read_hashed_shape(subjects[0].file)
    check_template(first)
    words: dict[str, Any] = {"up": up, "as_cloud": as_cloud, "orient": orient}
    settings = ShapeModelSettings(
        template_up=up, shapes_up=up, template_as_cloud=as_cloud, shapes_as_cloud=as_cloud, orient=orient
    )
    made = {name: value for name, value in matcher.describe().items() if name != "device"}
    making = {"first": {"sha256": digest}, "matching": words, **made}
    with nullcontext() if output is None else TrackFolder.opened(output, making) as folder:
        choice = None if folder is None else folder.choice()
        if choice is None:
            choice = choice_for_all(first, subjects[1:], matcher, settings, progress=progress)
            if folder is not None:
                folder.keep_choice(choice)
        chosen = matcher.limited_to(choice[0].name) if choice else matcher
        tracker = _Tracker(first, digest, chosen, words, folder)
        none = np.full(first.n_points, np.nan)
        frames = [TrackedFrame(subjects[0], first.points, none, SurfaceProjector(first).unit, 1.0)]
        for number, subject in enumerate(subjects[1:], 1):
            progress(number, len(subjects), subject.name)
            try:
                frames.append(tracker.next(subject, follow))
            except HomologError as error:
                frames.append(TrackedFrame(subject, np.full(first.points.shape, np.nan), none, error=str(error)))
            listener(frames[-1])
    return Track(first, tuple(frames), follow, tracker.matched_by)


@dataclass
class _Tracker:
    """The state of a track: the last frame that was matched, and where the maps from frame to frame have led."""

    first: Shape
    chain: str
    matcher: Matcher
    words: dict[str, Any]
    folder: TrackFolder | None = None
    matched_by: str = ""
    last: Shape | Subject | None = None  # a subject that was matched by an earlier run is read on demand

    def __post_init__(self) -> None:
        self.chained = self.first.points

    @cached_property
    def template(self) -> Template:
        """The first frame, prepared."""
        return Template(self.first, self.matcher, **self.words)

    def next(self, subject: Subject, follow: Follow) -> TrackedFrame:
        """The first frame's points on the next one."""
        chain = linked(self.chain, sha256(*files_of_shape(subject.file)))
        step = None if self.folder is None else self.folder.step(subject.name, chain)
        now: Shape | Subject = subject
        if step is None:
            now = read_shape(subject.file)
            step = self._made(now)
            if self.folder is not None:
                self.folder.keep(subject.name, chain, step)
        drift = np.full(self.first.n_points, np.nan)
        if self.last is not None:
            drift = np.linalg.norm(step.chained - step.direct, axis=1)
        self.last, self.chained, self.chain, self.matched_by = now, step.chained, chain, step.matched_by
        points = step.direct if follow == "first" else step.chained
        return TrackedFrame(subject, points, drift, step.size, step.confidence, _warnings(step, drift))

    def _made(self, shape: Shape) -> Step:
        words = {name: value for name, value in self.words.items() if name != "orient"}
        found = self.template.registered_to(shape, **words)
        chained, size = self._chained(shape, found), SurfaceProjector(shape).unit
        return Step(found.points, chained, size, found.figures.confidence, found.warnings, found.matched_by)

    def _chained(self, shape: Shape, direct: Registered) -> Float[np.ndarray, "n 3"]:
        """Where the map from the last frame takes the points that were found there."""
        if self.last is None:
            return direct.points
        before = self.last if isinstance(self.last, Shape) else read_shape(self.last.file)
        up, cloud = self.words["up"], "both" if self.words["as_cloud"] else None
        match: Match = self.matcher.match(
            before, shape, source_up=up, target_up=up, as_cloud=cloud, orient=self.words["orient"]
        )
        last = SurfaceProjector(before)
        step = untangled(surface_map(last, shape, match))
        return step.target.positions(step.apply(last.project(self.chained)))


def _warnings(step: Step, drift: Float[np.ndarray, " n"]) -> tuple[str, ...]:
    known = drift[np.isfinite(drift)]
    if not len(known) or known.mean() <= _FAR * step.size:
        return step.warnings
    told = (
        f"the map from the first frame and those from frame to frame lead {100 * known.mean() / step.size:.1f} % of "
        "sqrt(area) apart: one of them has lost its way; look at both (--follow)"
    )
    return (*step.warnings, told)


def write_track(folder: str | Path, found: Track, *, files: Sequence[str | Path] = ()) -> list[Path]:
    """Write a track into a folder, whole or not at all.

    ``frames/NAME.ply`` is the first frame's mesh on each frame that was matched, ``points.npy`` all of these
    (frames, points, 3), ``drift.csv`` a row per frame, and ``drift.ply`` the first frame in a heat map of its points'
    mean drift, with the number ``drift``.

    Args:
        folder: where to.
        found: what to write.
        files: inputs, which are not to be replaced.

    Returns:
        The files that were written.

    Raises:
        ArgumentError: if the folder cannot be written to, or a file in it is an input.
    """
    matched = [frame for frame in found.frames if not frame.error]
    names = (*TRACK_FILES, *(f"{FRAMES}/{frame.subject.name}.ply" for frame in matched))
    faces, drift = drawable(found.first).faces, found.mean_drift
    with written_together(folder, names, files) as paths:
        for path, frame in zip(paths[len(TRACK_FILES) :], matched, strict=True):
            write_shape(path, Shape(frame.points, faces))
        write_npy(paths[0], found.points)
        write_csv(paths[1], _rows(found))
        heat = heat_layer("Drift", "", {"source": drift}, "")
        write_shape(
            paths[2], Shape(found.first.points, faces), colours=heat.colours["source"], numbers={"drift": drift}
        )
        report = {
            "follow": found.follow,
            "matched_by": found.matched_by,
            "frames": [frame.subject.name for frame in found.frames],
            "not_matched": {frame.subject.name: frame.error for frame in found.frames if frame.error},
            "warnings": {frame.subject.name: list(frame.warnings) for frame in found.frames if frame.warnings},
            "versions": versions(),
        }
        write_json(paths[3], report)
    TrackFolder(expanded(folder)).forget_frames(frame.subject.name for frame in matched)
    return [expanded(folder) / FRAMES, *paths[: len(TRACK_FILES)]]


def _rows(found: Track) -> list[list[Any]]:
    rows: list[list[Any]] = [["frame", "name", "drift", "drift_95", "drift_of_size", "confidence", "warnings", "file"]]
    for number, frame in enumerate(found.frames):
        trust = frame.confidence if np.isfinite(frame.confidence) else None
        told = f"not matched: {frame.error}" if frame.error else "; ".join(frame.warnings)
        rows.append([number, frame.subject.name, *frame.figures().values(), trust, told, frame.subject.file])
    return rows
