"""Coarse maps between samples of two full shapes, and what speaks against them. New here."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Int
from torch import Tensor

from homolog.core.settings import NotNegative, Positive, Settings
from homolog.geometry import Basis
from homolog.maps.handedness import handedness, surface_handedness
from homolog.maps.quality import cycle_error, smooth_dirichlet_energy


@dataclass(frozen=True, kw_only=True)
class CoarseMapSettings(Settings):
    """What speaks against a coarse map of samples of two full shapes; chosen on pairs of training shapes.

    Args:
        cycle: weight of the cycle error.
        handedness: weight of ``homolog.maps.handedness``.
        radius: of the neighbourhoods in which that is told.
        surface_handedness: weight of ``homolog.maps.surface_handedness`` between meshes with an outside.
    """

    cycle: NotNegative = 5.0
    handedness: NotNegative = 0.3
    radius: Positive = 0.15
    surface_handedness: NotNegative = 0.5


@dataclass(frozen=True)
class CoarseFit:
    """How well a coarse map fits.

    Args:
        misfit: how much speaks against it.
        handedness: how far it keeps left and right, 1 if everywhere.
        energy: the mean ``homolog.maps.smooth_dirichlet_energy`` of both ways.
    """

    misfit: float
    handedness: float
    energy: float


def coarse_fit(
    x: Basis,
    y: Basis,
    x_to_y: Int[Tensor, " n_x"],
    y_to_x: Int[Tensor, " n_y"],
    *,
    have_outsides: bool,
    settings: CoarseMapSettings | None = None,
) -> CoarseFit:
    """How well a coarse map between samples of two shapes, which stand alike, fits both ways.

    Its misfit is the mean distance between points and their counterparts, plus ``cycle`` times the mean cycle error,
    minus ``handedness`` times how far it keeps left and right, minus ``surface_handedness`` times how far it keeps the
    surface's orientation.

    Args:
        x: samples of one shape, in normalised coordinates.
        y: of the other.
        x_to_y: for each of those of x one of y (n_x,).
        y_to_x: the way back (n_y,).
        have_outsides: whether both are meshes whose triangles face outward.
        settings: weights.

    Examples:
        >>> import torch, trimesh
        >>> from homolog import Shape, compute_operators
        >>> from homolog.maps import coarse_fit
        >>> mesh = trimesh.creation.box([1.0, 2.0, 3.0]).subdivide_loop(3)
        >>> box = compute_operators(Shape(mesh.vertices, mesh.faces)).basis
        >>> same, other = torch.arange(box.n_points), torch.arange(box.n_points).flip(0)
        >>> right = coarse_fit(box, box, same, same, have_outsides=True)
        >>> right.misfit < coarse_fit(box, box, other, other, have_outsides=True).misfit
        True
    """
    settings = settings or CoarseMapSettings()
    misfit, kept, energy = 0.0, 0.0, 0.0
    for a, b, a_to_b, b_to_a in ((x, y, x_to_y, y_to_x), (y, x, y_to_x, x_to_y)):
        images = b.points[a_to_b]
        misfit += float((a.points - images).norm(dim=1).mean())
        misfit += settings.cycle * float(cycle_error(a.points, a_to_b, b_to_a).mean())
        kept += float(handedness(a.points, images, radius=settings.radius)) / 2
        energy += smooth_dirichlet_energy(a, b, a_to_b) / 2
        if have_outsides and settings.surface_handedness:
            misfit -= settings.surface_handedness * float(surface_handedness(a, b, a_to_b)) / 2
    return CoarseFit(misfit - settings.handedness * kept, kept, energy)
