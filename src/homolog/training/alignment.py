"""Training shapes that do not stand alike: turned to stand as their medoid does, by their form alone."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch

from homolog.core.progress import Progress
from homolog.core.records import record
from homolog.features import Orienter
from homolog.geometry import Operators, some_points
from homolog.maps import joint_rotations
from homolog.shapes import Shape
from homolog.training.data import TrainingSet
from homolog.training.store import unit_mesh

_log = logging.getLogger(__name__)

_SAMPLES = 400
# A shape farther than so many times the median from the shape that it was aligned with may stand another way.
_OUTLIER = 2.0


@record
@dataclass(frozen=True)
class Aligned:
    """How a shape was turned.

    Args:
        rotation: takes its positions p to ``p @ rotation.T``; three rows of three.
        misfit: its rigid distance to the shape that it was aligned with, in units of sqrt(area); 0 of the medoid. Where
            an orienter turned it, the misfit of its orientation.
    """

    rotation: list[list[float]]
    misfit: float


def aligned(shapes: TrainingSet, progress: Progress) -> dict[str, Aligned]:
    """Find how to turn each shape so that all stand as the medoid does; see ``joint_rotations``.

    A warning names the shapes whose misfit is more than twice the median, which may have been turned wrongly.

    Raises:
        ShapeError: if a shape cannot be used.
    """
    positions = (unit_mesh(shapes, name)[0].points for name in shapes.used)
    samples = [torch.from_numpy(each[some_points(len(each), _SAMPLES).numpy()]).float() for each in positions]
    found = joint_rotations(samples, progress=progress)
    turned = {
        name: Aligned(rotation.tolist(), misfit) for name, (rotation, misfit) in zip(shapes.used, found, strict=True)
    }
    _warn_of_outliers({name: how.misfit for name, how in turned.items()})
    return turned


def oriented(
    shapes: TrainingSet, orienter: Orienter, operators: Callable[[Shape], Operators], progress: Progress
) -> dict[str, Aligned]:
    """Turn each shape as the orienter of earlier weights finds it to stand, so that they know it from the start.

    A warning names the shapes whose misfit is more than twice the median, as in ``aligned``.

    Args:
        shapes: to be turned.
        orienter: of the weights that a training starts from.
        operators: of a mesh.
        progress: told of each shape.

    Raises:
        ShapeError: if a shape cannot be used.
    """
    turned: dict[str, Aligned] = {}
    for done, name in enumerate(shapes.used, 1):
        best = orienter(operators(unit_mesh(shapes, name)[0]))[0]
        turned[name] = Aligned(best.rotation.tolist(), best.misfit)
        progress(done, len(shapes.used), f"orienting {name}")
    _warn_of_outliers({name: how.misfit for name, how in turned.items()})
    return turned


def _warn_of_outliers(misfits: Mapping[str, float]) -> None:
    usual = float(np.median([misfit for misfit in misfits.values() if misfit] or [0.0]))
    unlike = [name for name, misfit in misfits.items() if misfit > _OUTLIER * usual]
    if unlike:
        _log.warning(
            "%s: unlike all other shapes (misfit above %.3f), and may have been turned wrongly; look at them, or leave "
            "them out by [data] leave_out.",
            *(", ".join(unlike), _OUTLIER * usual),
        )
