"""Profiles of heads and trunks of several species, from the control grids of infinigen's animals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline, PchipInterpolator

from homolog.synthesis.animal_parameters import Form
from homolog.synthesis.quadruped import Quadruped

STATIONS = np.linspace(0.04, 0.96, 12)
"""Where profiles are measured, as shares of the length from the back."""

_REACH = 0.035


@dataclass(frozen=True)
class Profile:
    """The outline of a head or a trunk along its length.

    Args:
        length: of the whole.
        width: at each station.
        top: the height of the upper outline at each station.
        bottom: that of the lower one.
    """

    length: float
    width: Float[np.ndarray, " s"]
    top: Float[np.ndarray, " s"]
    bottom: Float[np.ndarray, " s"]

    @property
    def height(self) -> Float[np.ndarray, " s"]:
        """From the lower outline to the upper one."""
        return np.asarray(self.top - self.bottom)

    @property
    def middle(self) -> Float[np.ndarray, " s"]:
        """The height half way between both outlines."""
        return np.asarray((self.top + self.bottom) / 2)


@cache
def profile(name: str) -> Profile:
    """The profile of a control grid of the quadruped's file."""
    points = _surface(Quadruped.load().grids[name]).reshape(-1, 3)
    at = points[:, 0] - points[:, 0].min()
    near = [points[np.abs(at / at.max() - station) < _REACH] for station in STATIONS]
    highest = np.array([part.max(axis=0) for part in near])
    lowest = np.array([part.min(axis=0) for part in near])
    return Profile(float(at.max()), 2 * highest[:, 1], highest[:, 2], lowest[:, 2])


def _surface(grid: Float[np.ndarray, "u v 3"]) -> Float[np.ndarray, "a b 3"]:
    """Points of a cubic B-spline surface, which is open along the animal and closed around it."""
    n_along, n_around, _ = grid.shape
    knots = np.concatenate([np.zeros(3), np.linspace(0, 1, n_along - 2), np.ones(3)])
    along = BSpline(knots, grid, 3)(np.linspace(0, 1, 160))
    wrapped = np.concatenate([along, along[:, :3]], axis=1)
    around = BSpline(np.arange(-3.0, n_around + 4), wrapped, 3, axis=1)
    return np.asarray(around(np.linspace(0, n_around, 64, endpoint=False)))


def mixed_profile(form: Form, names: tuple[str, ...], own: Profile) -> Profile:
    """The mean of profiles with the shares of a form; what these leave is that of ``own``."""
    shares = [max(form[name], 0.0) for name in names]
    weights = np.array([max(1.0 - sum(shares), 0.0), *shares])
    weights /= weights.sum()
    parts = [own, *(profile(name) for name in names)]
    length, width, top, bottom = (
        np.einsum("p,p...->...", weights, np.array([getattr(part, of) for part in parts]))
        for of in ("length", "width", "top", "bottom")
    )
    return Profile(float(length), width, top, bottom)


def along(values: Float[np.ndarray, " s"], at: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Values of stations, interpolated without overshooting."""
    interpolate: Callable[..., np.ndarray] = PchipInterpolator(STATIONS, values)
    return np.asarray(interpolate(at.clip(STATIONS[0], STATIONS[-1])))
