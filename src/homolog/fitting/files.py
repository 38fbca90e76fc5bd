"""A fitted body model on disk: its parameters, the registered mesh, and how far the scan is from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from typing_extensions import TypedDict

from homolog.core.errors import DataError
from homolog.core.files import expanded, write_json, write_npy, written_together
from homolog.core.messages import shorten
from homolog.core.records import read_record, record
from homolog.core.versions import versions
from homolog.fitting.articulated import ArticulatedModel, Fit
from homolog.fitting.registration import BodyFit
from homolog.matching import given_files
from homolog.shapes import write_shape

PARAMETERS, REGISTERED, DISTANCES = "parameters.json", "registered.ply", "distances.npy"
FIT_FILES = (PARAMETERS, REGISTERED, DISTANCES)
"""What a fit writes into its folder."""

_PERCENTILES = {"median": 50, "percentile_95": 95, "largest": 100}


@record
class _Record(TypedDict):
    """What is read back of ``parameters.json``."""

    model: str
    parameters: dict[str, float]
    bones: dict[str, list[float]]
    shift: list[float]
    scale: float
    unit: str
    units_per_metre: float


def write_fit(folder: str | Path, found: BodyFit) -> list[Path]:
    """Write a fit into a folder, whole or not at all.

    ``parameters.json`` has the shape parameters from 0 to 1, the rotation of each bone as a rotation vector in radians,
    about the axes of the model at rest and relative to the bone above, and the place of the whole: a point is
    ``units_per_metre * (scale * model + shift)``. ``registered.ply`` is the model's surface in the scan's coordinates,
    ``distances.npy`` the distance of each of its points from the scan's surface.

    Returns:
        The files that were written.

    Raises:
        ArgumentError: if the folder cannot be written to, or a file in it is an input.
    """
    of_seen = found.distances[found.seen]
    shares = {name: float(np.percentile(of_seen, share)) for name, share in _PERCENTILES.items()}
    content = {
        "model": found.model,
        "parameters": found.parameters,
        "bones": {bone: Rotation.from_matrix(turn).as_rotvec().tolist() for bone, turn in found.bones.items()},
        "shift": found.fit.shift.tolist(),
        "scale": found.fit.scale,
        "unit": found.unit,
        "units_per_metre": found.units_per_metre,
        "distance": {"mean": float(of_seen.mean()), **shares},
        "points_seen": int(found.seen.sum()),
        "warnings": list(found.warnings),
        "versions": versions(),
        "match": dict(found.match.report),
    }
    with written_together(folder, FIT_FILES, given_files(found.match)) as paths:
        write_json(paths[0], content)
        write_shape(paths[1], found.registered)
        write_npy(paths[2], found.distances)
    return paths


def read_fit(folder: str | Path, model: ArticulatedModel) -> tuple[Fit, float]:
    """Read the parameters that ``write_fit`` wrote.

    Args:
        folder: that folder.
        model: that was fitted.

    Returns:
        The fit, whose points are in metres, and how many of the scan's units a metre is.

    Raises:
        DataError: if the file is missing, damaged, or that of another model.

    Examples:
        >>> fit, per_metre = read_fit("fit", model)  # doctest: +SKIP
        >>> per_metre * fit.points(model)  # doctest: +SKIP
    """
    path = expanded(folder) / PARAMETERS
    told = read_record(path, _Record, instead="run homolog fit again")
    unknown = (set(told["parameters"]) ^ set(model.parameters)) | (set(told["bones"]) - set(model.bones))
    turns, shift = np.array(list(told["bones"].values())), np.array(told["shift"])
    if unknown:
        raise DataError(f"{path} is of another model ({shorten(', '.join(sorted(unknown)))}); give the model it is of")
    if turns.shape != (len(told["bones"]), 3) or shift.shape != (3,):
        raise DataError(f"{path} is damaged: rotations and shift must have three numbers; run homolog fit again")
    fit = Fit.at_rest(model)
    rotations = fit.rotations.copy()
    rotations[[model.bones.index(bone) for bone in told["bones"]]] = Rotation.from_rotvec(turns).as_matrix()
    build = np.array([told["parameters"][name] for name in model.parameters])
    return replace(fit, build=build, rotations=rotations, shift=shift, scale=told["scale"]), told["units_per_metre"]
