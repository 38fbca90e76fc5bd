"""Completing a fragment or a partial scan: the posterior of a shape model given the points that are there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float

from homolog.core.arguments import check_kind
from homolog.core.choices import Orient, System
from homolog.core.errors import ArgumentError, HomologError
from homolog.core.files import write_csv, write_json, written_together
from homolog.core.progress import Timings
from homolog.core.versions import versions
from homolog.geometry import some_points
from homolog.geometry.projection import SurfacePoints, SurfaceProjector
from homolog.maps import best_similarity, rigid_motion
from homolog.matching import Match, Matcher
from homolog.pairs import Mask, PairOptions
from homolog.shape_models.model_fit import ModelFit, ModelFitSettings, ModelFitter, PartSamples
from homolog.shape_models.stored_model import StoredModel
from homolog.shapes import Shape, Up, repair, write_shape
from homolog.statistics import Observations, Placement, placed_posterior, principal_modes
from homolog.transfer import read_landmarks, system_of
from homolog.viewing import heat_layer

COMPLETED, POINTS, LANDMARKS, REPORT = "completed.ply", "points.csv", "landmarks.csv", "completion.json"
COMPLETION_FILES = (COMPLETED, POINTS, LANDMARKS, REPORT)
"""What a completion writes into its folder; the landmarks only where the collection has some."""

# Of so many points of the fragment the samples are taken.
_MOST_POINTS = 20000
# Another place that fits nearly as well makes a completion ambiguous: within this factor, or this difference.
_NEARLY_AS_WELL = (1.25, 0.05)
# A fragment with a larger misfit, in squared standard deviations of an independent point, may have its faces the other
# way round, or lie in a wrong place: heads in the right one have 0.2 to 0.9, in wrong ones 1.4 and more.
_DOUBTFUL = 1.5
# Shapes of the collection that tell how far off completions are, spread over their list.
_LEFT_OUT = 12
# A model that was made of two shapes does not say what it cannot show; this share of its size is assumed.
_ASSUMED = 0.02


@dataclass(frozen=True, eq=False)
class Completion:
    """The whole shape that a fragment is likely to be of, in the fragment's coordinates.

    Args:
        fragment: as it was given.
        shape: the likeliest whole shape, with the points and faces of the collection's template.
        deviations: for each point of it, the root mean square distance at which the true point is to be expected, in
            the fragment's unit (n,).
        observed: which of its points lie on the fragment (n,).
        fit: of the model to the fragment.
        misfit_elsewhere: of the best fit in another place; None if there is none.
        deviation: standard deviation of each coordinate that was assumed of what the model cannot show.
        calibration: what the model's own statement was multiplied by, see ``complete``.
        landmarks: positions of landmarks by name, those that were given and all others of the collection (3,).
        landmark_deviations: of each, likewise; 0 for those that were given.
        match: of the fragment with the model's mean; None where that failed, or was not wanted.
        warnings: a line each.
    """

    fragment: Shape
    shape: Shape
    deviations: Float[np.ndarray, " n"]
    observed: Bool[np.ndarray, " n"]
    fit: ModelFit
    misfit_elsewhere: float | None
    deviation: float
    calibration: float
    landmarks: dict[str, Float[np.ndarray, " 3"]]
    landmark_deviations: dict[str, float]
    match: Match | None
    warnings: tuple[str, ...] = ()

    def figures(self) -> dict[str, Any]:
        """For JSON; lengths are in the fragment's unit."""
        placement, missing = self.fit.posterior.placement, self.deviations[~self.observed]
        return {
            "placement": {
                "rotation": placement.rotation.tolist(),
                "scale": placement.scale,
                "shift": placement.shift.tolist(),
            },
            "coefficients": self.fit.posterior.coefficients.tolist(),
            "points": self.shape.n_points,
            "observed_points": int(self.observed.sum()),
            "distance": float(np.median(self.fit.distances)),
            "deviation": float(np.sqrt((self.deviations**2).mean())),
            "missing_deviation": float(np.sqrt((missing**2).mean())) if len(missing) else None,
            "model_deviation": self.deviation,
            "calibration": self.calibration,
            "misfit": self.fit.misfit,
            "misfit_elsewhere": self.misfit_elsewhere,
        }


@dataclass(frozen=True, eq=False)
class _Known:
    """Landmarks of the collection, and where they were given on the fragment."""

    names: tuple[str, ...]
    places: SurfacePoints
    given: dict[str, Float[np.ndarray, " 3"]]

    @property
    def indices(self) -> list[int]:
        """Which of the collection's landmarks were given."""
        return [number for number, name in enumerate(self.names) if name in self.given]

    def observations(self, deviation: float) -> Observations | None:
        """The given ones as points that were seen."""
        chosen = self.indices
        if not chosen:
            return None
        places = SurfacePoints(self.places.corners[chosen], self.places.weights[chosen])
        positions = np.array([self.given[self.names[number]] for number in chosen])
        return Observations(places, positions, np.tile(np.eye(3) / deviation**2, (len(chosen), 1, 1)))


def complete(
    fragment: Shape,
    stored: StoredModel,
    matcher: Matcher | None = None,
    *,
    settings: ModelFitSettings | None = None,
    uncertainty: float | None = None,
    up: Up = "y",
    orient: Orient = "auto",
    landmarks: str | Path | None = None,
    axes: System | None = None,
    timings: Timings | None = None,
) -> Completion:
    """The whole shape that a fragment is likely to be of, by the shape model of a collection.

    The fragment is matched with the model's mean as a partial shape, and compared with it as a rigid body in all
    rotations. From each of these starts the model is fitted: its shape and its place on the fragment together. The fit
    that contradicts the fragment least is taken; it is exact in the sense of Albrecht et al. 2013 for the
    correspondence that it ends with.

    What a model of few shapes cannot show is alike at neighbouring points, so that its own statement of the variance is
    too small. So each shape of the collection in turn is completed from the same places by a model of the others; the
    deviations are multiplied by the ratio of the errors to those stated, if that is above 1.

    Args:
        fragment: a mesh or a cloud in any state, in the unit of the collection's shapes.
        stored: the model.
        matcher: that matches the fragment with the mean; None to look for its place as a rigid body alone.
        settings: of the fit.
        uncertainty: standard deviation of each coordinate of the fragment around what the model can show, in its unit;
            by default what the collection says of shapes that it was not made of.
        up: the axis of the fragment that points up.
        orient: ``"given"`` if the fragment lies as the model's mean does, so that nothing else is tried.
        landmarks: a file of landmarks on the fragment, with names that the collection's landmarks have.
        axes: the fragment's anatomical axes, for landmark files that state theirs.
        timings: collects the time of each step.

    Raises:
        ArgumentError: if landmarks are given that the collection has not.
        ShapeError: if the fragment cannot be used.
        DataError: if a file of the collection is damaged.

    Examples:
        >>> from homolog.shape_models import StoredModel, complete
        >>> stored = StoredModel.read("bones")  # doctest: +SKIP
        >>> found = complete(homolog.read_shape("fragment.ply"), stored)  # doctest: +SKIP
        >>> found.shape.points, found.deviations  # doctest: +SKIP
    """
    check_kind("fragment", fragment, Shape)
    timings, settings = timings or Timings(), settings or ModelFitSettings()
    known = _known_landmarks(fragment, stored, landmarks, axes)
    size = float(np.sqrt(((stored.mean.points - stored.mean.points.mean(axis=0)) ** 2).sum(axis=1).mean()))
    deviation = uncertainty or stored.deviation or _ASSUMED * size
    fitter = ModelFitter(stored.model, stored.mean.faces, deviation, settings)
    match, warnings, starts = None, list[str](), list[Placement]()
    if orient == "given":
        starts = [Placement(np.eye(3), np.zeros(3))]
    elif matcher is not None:
        try:
            match = _matched(fragment, stored, matcher, known, up, timings)
            starts = [_placement(match, scale=settings.scale)]
        except HomologError as error:
            warnings.append(f"the fragment could not be matched with the mean ({error}), so its place alone was tried")
    part = replace(_part(fragment, match, settings.samples), known=known.observations(deviation))
    with timings.measure("fit"):
        fits = fitter.fits(part, starts, search=orient != "given")
        if part.normals is not None and fits[0].misfit > _DOUBTFUL:  # its faces may look inward, or either way
            for normals in (-part.normals, None):
                others = fitter.fits(replace(part, normals=normals), starts, search=orient != "given")
                fits = min(fits, others, key=lambda each: each[0].misfit)
    with timings.measure("calibrate"):
        factor = _calibration(stored, fits[0], deviation)
    return _completion(fragment, stored, fits, deviation, factor, known, match, warnings)


def _calibration(stored: StoredModel, fit: ModelFit, deviation: float) -> float:
    """The ratio of errors to stated deviations where the collection's shapes are completed by models of the others."""
    if stored.deviation is None:
        return 1.0
    shapes, kept = stored.aligned(), stored.kept
    asked = np.unique(np.linspace(0, len(shapes) - 1, _LEFT_OUT).astype(int))
    turn, scale = fit.posterior.placement.rotation, fit.posterior.placement.scale
    precisions = scale**2 * turn.T @ fit.seen.precisions @ turn  # in the model's coordinates
    here, ratios = Placement(np.eye(3), np.zeros(3)), list[float]()
    for number in asked:
        others = principal_modes(np.delete(shapes, number, axis=0), kept=stored.model.kept)
        seen = Observations(fit.seen.places, fit.seen.places.interpolate(shapes[number]), precisions)
        found = placed_posterior(others, seen, here, scale=len(fit.posterior.covariance) > 6 + len(stored.model.modes))
        errors = ((found.points - shapes[number]) ** 2).sum(axis=1)[kept]
        ratios.append(float(errors.mean() / (found.variances[kept] + 3 * deviation**2).mean()))
    return max(1.0, float(np.sqrt(np.mean(ratios))))


def _completion(
    fragment: Shape,
    stored: StoredModel,
    fits: Sequence[ModelFit],
    deviation: float,
    factor: float,
    known: _Known,
    match: Match | None,
    warnings: Sequence[str],
) -> Completion:
    """What a fit says of every point and landmark."""
    best, elsewhere = fits[0], fits[1].misfit if len(fits) > 1 else None
    posterior, own = best.posterior, 3 * deviation**2
    shape = Shape(posterior.points, stored.mean.faces, name=f"completed {fragment.name}")
    surface = SurfaceProjector(fragment)
    near = surface.positions(surface.project(shape.points))
    observed = np.linalg.norm(near - shape.points, axis=1) <= SurfaceProjector(shape).spacing
    positions = known.places.interpolate(shape.points)
    spread = factor * np.sqrt(posterior.variances_at(known.places) + own)
    found = dict(zip(known.names, positions, strict=True)) | known.given
    told = {name: 0.0 if name in known.given else float(one) for name, one in zip(known.names, spread, strict=True)}
    return Completion(
        fragment=fragment,
        shape=shape,
        deviations=factor * np.sqrt(posterior.variances + own),
        observed=observed,
        fit=best,
        misfit_elsewhere=elsewhere,
        deviation=deviation,
        calibration=factor,
        landmarks=found,
        landmark_deviations=told,
        match=match,
        warnings=(*warnings, *_fit_warnings(best, elsewhere)),
    )


def _fit_warnings(best: ModelFit, elsewhere: float | None) -> list[str]:
    told = []
    factor, difference = _NEARLY_AS_WELL
    if elsewhere is not None and elsewhere < max(factor * best.misfit, best.misfit + difference):
        told.append(
            "where the fragment belongs is ambiguous: it fits nearly as well in another place; look at the result, or "
            "give landmarks"
        )
    if best.misfit > _DOUBTFUL:
        told.append(
            f"the fragment does not look like a part of the collection's shapes (misfit {best.misfit:.3g}, usually "
            f"below {_DOUBTFUL:g}), or lies in a wrong place; look at the result, at the units, or give landmarks"
        )
    return told


def _known_landmarks(fragment: Shape, stored: StoredModel, file: str | Path | None, axes: System | None) -> _Known:
    names, places = stored.landmarks()
    if file is None:
        return _Known(names, places, {})
    read = read_landmarks(file)
    positions = read.points_in(system_of(fragment.space, axes))
    given = {name: at for name, at in zip(read.names, positions, strict=True) if np.isfinite(at).all()}
    shared = {name: at for name, at in given.items() if name in names}
    if not shared:
        have = ", ".join(names) or "none; run homolog collection with --landmarks"
        raise ArgumentError(f"{file} has no landmark with a name of the collection's landmarks, which are {have}")
    return _Known(names, places, shared)


def _matched(fragment: Shape, stored: StoredModel, matcher: Matcher, known: _Known, up: Up, timings: Timings) -> Match:
    pairs: Any = None
    if chosen := known.indices:
        on_mean = known.places.interpolate(stored.mean.points)[chosen]
        pairs = (np.array([known.given[known.names[number]] for number in chosen]), on_mean)
    options = PairOptions(
        partial="source",
        source_up=up,
        target_up=stored.settings.template_up,
        target_mask=None if stored.weights is None else Mask(stored.weights),
        landmarks=pairs,
    )
    return matcher.match(fragment, replace(stored.mean, name="the mean"), options, timings=timings)


def _placement(match: Match, *, scale: bool) -> Placement:
    """Where a match puts the model's mean."""
    (seen,) = np.nonzero(match.source_to_target >= 0)
    mean, there = match.target.points[match.source_to_target[seen]], match.source.points[seen]
    if scale:
        found = best_similarity(torch.from_numpy(mean), torch.from_numpy(there))
        return Placement(found.rotation.numpy(), found.shift.numpy(), found.scale)
    turn, shift = rigid_motion(mean, there)
    return Placement(turn, shift)


def _part(fragment: Shape, match: Match | None, count: int) -> PartSamples:
    """Points of the fragment that are spread evenly, without those that were set apart, with normals of a mesh."""
    kept = repair(fragment).kept if match is None else np.flatnonzero(match.source_to_target >= 0)
    kept = kept[some_points(len(kept), _MOST_POINTS).numpy()]
    projector, normals = SurfaceProjector(fragment), None
    if projector.surface is not None:
        normals = projector.repaired.to_original(projector.surface.vertex_normals, fill=0.0)[kept]
    return PartSamples(fragment.points[kept], normals).sampled(count)


def write_completion(folder: str | Path, found: Completion, *, files: Sequence[str | Path] = ()) -> list[Path]:
    """Write a completion into a folder, whole or not at all.

    ``completed.ply`` is the whole shape in a heat map of the deviations, with the numbers ``deviation`` and
    ``observed`` at each point. ``points.csv`` has the same as a table, ``landmarks.csv`` the collection's landmarks.

    Args:
        folder: where to.
        found: what to write.
        files: inputs, which are not to be replaced.

    Returns:
        The files that were written.

    Raises:
        ArgumentError: if the folder cannot be written to, or a file in it is an input.
    """
    names = [name for name in COMPLETION_FILES if name != LANDMARKS or found.landmarks]
    numbers = {"deviation": found.deviations, "observed": found.observed.astype(float)}
    heat = heat_layer("Deviation", "", {"source": found.deviations}, "")
    with written_together(folder, names, files) as paths:
        write_shape(paths[0], found.shape, colours=heat.colours["source"], numbers=numbers)
        columns = np.column_stack([found.shape.points, found.deviations]).tolist()
        rows = [
            (number, *row, int(seen)) for number, (row, seen) in enumerate(zip(columns, found.observed, strict=True))
        ]
        write_csv(paths[1], [("point", "x", "y", "z", "deviation", "observed"), *rows])
        if found.landmarks:
            told = [(name, *at.tolist(), found.landmark_deviations[name]) for name, at in found.landmarks.items()]
            write_csv(paths[2], [("landmark", "x", "y", "z", "deviation"), *told])
        report = {"warnings": list(found.warnings), **found.figures(), "versions": versions()}
        write_json(paths[-1], {**report, "match": None if found.match is None else dict(found.match.report)})
    return paths
