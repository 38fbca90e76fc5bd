"""Landmarks at the points of two preprocessed shapes, and the features that they make. New here."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from homolog.core.choices import Side
from homolog.core.errors import ArgumentError
from homolog.geometry import Operators, distances_from
from homolog.maps import LandmarkRows
from homolog.pairs.landmarks import LandmarkPairs, Place

if TYPE_CHECKING:
    from homolog.pairs.preprocessing import PreprocessedShape

FAR_AWAY = 0.2
"""A landmark so far from a shape, as a share of sqrt(area), belongs to another shape, or to other coordinates."""
# An uncertain landmark counts half from this uncertainty on, as a share of sqrt(area).
_UNCERTAIN = 0.02
# Distances along a shape are told apart up to this many times the mean distance from a landmark.
_FARTHEST = 2.5
# Landmarks that lie nearer to a line than this, in units of sqrt(area), tell no rotation.
_LEAST_SPREAD = 0.05
# Landmarks count one by one up to this number; more of them share its weight.
_FEW = 5


@dataclass(frozen=True, eq=False)
class Guidance:
    """Landmarks at the points of two repaired shapes x and y.

    Args:
        x: points of x (p,).
        y: of y (p,).
        weights: of each pair, less where it is uncertain (p,).
        uncertainties: in units of sqrt(area) (p,).
        names: of the pairs.
        left_out: names of those that are not used.
    """

    x: Int[Tensor, " p"]
    y: Int[Tensor, " p"]
    weights: Float[Tensor, " p"]
    uncertainties: Float[Tensor, " p"]
    names: tuple[str, ...]
    left_out: tuple[str, ...] = ()

    @classmethod
    def of(cls, pairs: LandmarkPairs, x: PreprocessedShape, y: PreprocessedShape, sides: tuple[Side, Side]) -> Guidance:
        """Landmarks at the nearest points that have operators.

        Args:
            pairs: as they were given.
            x: one shape.
            y: the other.
            sides: which of source and target these are.

        Raises:
            ArgumentError: if an index is that of no point, a position lies far from the shape, or none can be used.
        """
        at_x, at_y = (
            _nearest_points(pairs.on(side, "RAS" if shape.given.space == "RAS" else "LPS"), pairs.names, shape, side)
            for side, shape in zip(sides, (x, y), strict=True)
        )
        found = (at_x >= 0) & (at_y >= 0)
        if not found.any():
            raise ArgumentError("no landmark is at a point that can be matched; give others")
        lost = [name for name, there in zip(pairs.names, found, strict=True) if not there]
        device = x.operators.points.device
        in_files = torch.tensor(pairs.uncertainties, device=device)[torch.from_numpy(found)]
        uncertainties = in_files / (y if sides[1] == "target" else x).operators.scale
        weights = torch.tensor(pairs.weights, device=device)[torch.from_numpy(found)]
        return cls(
            torch.from_numpy(at_x[found]).to(device),
            torch.from_numpy(at_y[found]).to(device),
            weights / (1 + (uncertainties / _UNCERTAIN) ** 2),
            uncertainties,
            tuple(name for name, there in zip(pairs.names, found, strict=True) if there),
            (*pairs.left_out, *lost),
        )

    def __len__(self) -> int:
        return len(self.x)

    def tells_rotation(self, x: Operators, y: Operators) -> bool:
        """Whether there are three landmarks at least, which do not lie on one line on either shape."""
        return all(_spread(operators.points[at]) > _LEAST_SPREAD for operators, at in ((x, self.x), (y, self.y)))

    def rows(self, share: float) -> LandmarkRows:
        """The landmarks as rows of functional maps; see ``zoomout``."""
        return LandmarkRows(self.x, self.y, share * self.weights / len(self))

    def channels(
        self, x: Operators, y: Operators, weight: float, *, partial: bool
    ) -> tuple[Float[Tensor, "n_x c"], Float[Tensor, "n_y c"]]:
        """Features of all points by their distances from the landmarks along the surface, of one length everywhere.

        Each landmark gives an angle, and so two channels: 0 at the landmark, 90 degrees far away. Distances are in
        units of their mean on the shape, so that a long and a short neck compare; a part shares those of its whole.
        """
        far_x, far_y = distances_from(x, self.x), distances_from(y, self.y)
        unit_x = _means(far_x, x)
        unit_y = unit_x if partial else _means(far_y, y)
        sizes = weight * (self.weights / max(len(self), _FEW)).sqrt()
        return _angular(far_x / unit_x, sizes), _angular(far_y / unit_y, sizes)


def _spread(points: Float[Tensor, "p 3"]) -> float:
    """How far points lie from one line: the second singular value of their positions about the mean."""
    values = torch.linalg.svdvals((points - points.mean(dim=0)).double())
    return float(values[1]) if len(points) > 2 else 0.0


def _means(distances: Float[Tensor, "n p"], operators: Operators) -> Float[Tensor, " p"]:
    found: Tensor = (operators.mass @ distances) / operators.mass.sum()
    return found.clamp(min=torch.finfo(found.dtype).tiny)


def _angular(relative: Float[Tensor, "n p"], sizes: Float[Tensor, " p"]) -> Float[Tensor, "n c"]:
    angles = (relative / _FARTHEST).clamp(max=1) * (math.pi / 2)
    return torch.cat([sizes * angles.cos(), sizes * angles.sin()], dim=1)


def _nearest_points(
    places: tuple[Place, ...], names: tuple[str, ...], shape: PreprocessedShape, side: Side
) -> Int[np.ndarray, " p"]:
    """The points of the operators at landmarks; -1 where repair left a point out, or it lies on a small component."""
    main = shape.operators.in_main_component.cpu().numpy()
    kept = shape.repaired.kept[main]
    tree = KDTree(shape.given.points[kept])
    found = np.full(len(places), -1)
    for number, place in enumerate(places):
        if isinstance(place, int):
            if place >= shape.given.n_points:
                raise ArgumentError(
                    f"the landmark {names[number]!r} of the {side}, {shape.name}, is point {place}, but must be one of "
                    f"0 to {shape.given.n_points - 1}"
                )
            clean = shape.repaired.clean_index[place]
            found[number] = clean if clean >= 0 and main[clean] else -1
            continue
        distance, nearest = tree.query(place)
        if distance > FAR_AWAY * shape.operators.scale:
            shown = ", ".join(f"{coordinate:.4g}" for coordinate in place)
            raise ArgumentError(
                f"the landmark {names[number]!r} of the {side} is at ({shown}), {distance:.3g} away from "
                f"{shape.name}; give it in the coordinates and the unit of that file"
            )
        found[number] = np.flatnonzero(main)[nearest]
    return found
