"""From a shape to its symmetry: it is matched with its own mirror image. New here."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, get_args

import numpy as np
from jaxtyping import Float, Int

from homolog.core.arguments import check_choice, check_kind
from homolog.core.choices import Up
from homolog.core.errors import ArgumentError, ShapeError
from homolog.geometry.projection import SurfaceProjector
from homolog.matching import Match, match, orientation_warnings
from homolog.pairs import SIDES, mask_of
from homolog.shapes import Shape, mirrored
from homolog.statistics import FEWEST_PAIRS, MirrorPlane, best_mirror_plane
from homolog.symmetries.measuring import local_stretch
from homolog.transfer import surface_map

BENT = 0.03
"""A shape is bent to one side if its mean asymmetry is a larger share of its size."""
_AMBIGUOUS = (
    "the shape has more than one mirror plane: another one fits nearly as well; turn the file so that left and right "
    "differ in x, and trust it by orient='given'"
)
_OF_TWO = (
    *("partial", "partial_scale", "pre_aligned", "mirror", "landmarks"),
    *(f"{side}_{name}" for side in SIDES for name in ("up", "mask")),
)
_PERCENTILES = {"median": 50, "percentile_95": 95}


@dataclass(frozen=True, eq=False, repr=False)
class Symmetry:
    """The bilateral symmetry of a shape, in the indices and coordinates of its file.

    Args:
        shape: as it was given.
        partner: for each point the index of its mirror partner; -1 where it has none (n,).
        confidence: trust in each partner, from 0 to 1 (n,).
        positions: where the partner of each point lies on the surface, between the shape's points; NaN where it has
            none (n, 3).
        plane: whose reflection takes points to their partners best, in the sense of least squares.
        stretch: by what factor lengths around the partner are those around the point (n,): 1.1 where the other side is
            ten per cent longer. It does not change where a body bends. NaN without a partner. See ``local_stretch``.
        match: of the shape with its mirror image, whose points have the same numbers.

    Examples:
        >>> import homolog
        >>> found = homolog.symmetry(homolog.demo_shapes()[0], weights="people")
        >>> (abs(found.plane.normal).round(1) + 0).tolist()  # left and right differ in x
        [1.0, 0.0, 0.0]
        >>> found.mirrored.n_points == found.shape.n_points
        True
    """

    shape: Shape
    partner: Int[np.ndarray, " n"]
    confidence: Float[np.ndarray, " n"]
    positions: Float[np.ndarray, "n 3"]
    plane: MirrorPlane
    stretch: Float[np.ndarray, " n"]
    match: Match

    @classmethod
    def of(cls, found: Match) -> Symmetry:
        """The symmetry that a match of a shape with its own mirror image tells.

        Args:
            found: what ``homolog.match(shape, shape, mirror="target")`` or a ``Matcher`` gives.

        Raises:
            ArgumentError: if it is a match of two shapes, or of a shape that is not reflected.
            ShapeError: if too few points have a partner.
        """
        check_kind("found", found, Match)
        shape = found.source
        options = found.report.get("options", {})
        is_own = np.array_equal(shape.points, found.target.points, equal_nan=True)
        if not is_own or options.get("mirror") not in ("source", "target"):
            raise ArgumentError(
                "found is no match of a shape with its mirror image; give homolog.match(shape, shape, mirror='target')"
            )
        partner, confidence = _partners(found)
        if (partner >= 0).sum() < FEWEST_PAIRS:
            raise ShapeError(
                f"{shape.name} has no mirror plane: fewer than {FEWEST_PAIRS} of its points have a partner"
            )
        projector = SurfaceProjector(shape)
        positions = _positions(projector, found)
        (known,) = np.nonzero(np.isfinite(positions).all(axis=1))
        stretch = local_stretch(projector.shape, positions[projector.repaired.kept])
        plane = best_mirror_plane(shape.points[known], positions[known], _areas(projector)[known])
        lifted = projector.repaired.to_original(stretch)
        return cls(shape, partner, confidence, positions, plane, np.where(partner < 0, np.nan, lifted), found)

    @cached_property
    def asymmetry(self) -> Float[np.ndarray, " n"]:
        """How far each point lies from its partner's mirror image across the plane, in the file's unit (n,).

        It is 0 for a shape that the plane divides into mirror images, and grows where a body bends to one side. NaN
        without a partner.
        """
        return np.asarray(np.linalg.norm(self.plane.reflected(self.positions) - self.shape.points, axis=1))

    @cached_property
    def mirrored(self) -> Shape:
        """The shape reflected in the plane with points numbered as in its own file: a left hand keeps its numbers.

        Each point lies at the mirror image of its partner. Points without a partner are reflected themselves.
        """
        sources = np.where(np.isfinite(self.positions), self.positions, self.shape.points)
        return replace(self.shape, points=self.plane.reflected(sources), name=f"mirrored {self.shape.name}")

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know, a line each: that of the match, and whether there is another plane."""
        rounds = orientation_warnings(self.match)
        told = tuple(warning for warning in self.match.warnings if warning not in rounds)
        return (*told, _AMBIGUOUS) if rounds else told

    def figures(self) -> dict[str, Any]:
        """The plane and figures of the asymmetry, for JSON; lengths are in the file's unit."""
        unit = SurfaceProjector(self.shape).unit
        return {
            "plane": {"normal": self.plane.normal.tolist(), "offset": self.plane.offset},
            "points": len(self.partner),
            "points_without_partner": int((self.partner < 0).sum()),
            "mean_confidence": float(self.confidence.mean()),
            "size": unit,
            "asymmetry": _summary(self.asymmetry),
            "asymmetry_of_size": float(np.nanmean(self.asymmetry)) / unit,
            "stretch": _summary(np.exp(np.abs(np.log(self.stretch)))),
            "returning": _summary(_returning(self.shape.points, self.partner)),
        }

    def __repr__(self) -> str:
        normal = ", ".join(f"{value:.3f}" for value in self.plane.normal)
        return (
            f"Symmetry({self.shape.name!r}: plane ({normal}) at {self.plane.offset:.4g}, "
            f"mean asymmetry {np.nanmean(self.asymmetry):.4g})"
        )


def symmetry(shape: Any, **words: Any) -> Symmetry:
    """The mirror partner of each point of a shape, its mirror plane, and how asymmetric it is.

    The shape is matched with its own mirror image. So a bent body has partners as well, of its intrinsic reflection.

    Args:
        shape: a path, a shape, or whatever ``as_shape`` takes.
        **words: those of ``homolog.match`` for one shape: ``weights``, ``features`` (a function), ``method``,
            ``settings``, ``device``, ``orient``, ``clutter``, ``strict``; and of the shape ``up``, ``as_cloud`` and
            ``mask``.

    Raises:
        ArgumentError: if a word is not allowed.
        ShapeError: if the shape cannot be read or used.

    Examples:
        >>> import homolog
        >>> found = homolog.symmetry(homolog.demo_shapes()[0], method="registration")
        >>> found.partner.shape, found.asymmetry.shape
        ((4918,), (4918,))
    """
    return Symmetry.of(match(shape, shape, **mirror_words(**words)))


def mirror_words(*, up: str = "y", as_cloud: bool = False, mask: Any = None, **words: Any) -> dict[str, Any]:
    """The words of ``homolog.match`` that match a shape with its mirror image.

    Raises:
        ArgumentError: if a word is about two different shapes.
    """
    for name in _OF_TWO:
        if name in words:
            raise ArgumentError(f"{name} is given, but a symmetry is of one shape; leave it out")
    check_choice("up", up, get_args(Up))
    known = mask_of(mask, "mask")
    both = {"source_up": up, "target_up": up, "source_mask": known, "target_mask": known}
    return {"mirror": "target", "as_cloud": "both" if as_cloud else None, **both, **words}


def _partners(found: Match) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """For each point its partner and the trust in it, by the one of both maps that comes back nearer to the point.

    Points of the mirror image have the same numbers, so that the maps there and back both tell the same reflection.
    """
    maps = (found.source_to_target, found.target_to_source)
    there, back = (_returning(found.source.points, indices) for indices in maps)
    first = there <= back
    trusts = found.source_confidence, found.target_confidence
    return np.where(first, *maps), np.where(first, *trusts)


def _returning(points: Float[np.ndarray, "n 3"], partner: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """How far from each point its partner's partner lies; infinite where there is none (n,)."""
    again = np.where(partner >= 0, partner[partner], -1)
    away = np.linalg.norm(points[again] - points, axis=1)
    return np.asarray(np.where(again >= 0, away, np.inf))


def _positions(projector: SurfaceProjector, found: Match) -> Float[np.ndarray, "n 3"]:
    """Where the partner of each point lies on the surface: along a smooth map to the mirror image, reflected back."""
    image = mirrored(projector.given)
    return mirrored(replace(image, points=surface_map(projector, image, found).positions)).points


def _areas(projector: SurfaceProjector) -> Float[np.ndarray, " n"]:
    """The area around each point as given, 0 where repair left it out; alike on a cloud."""
    surface, count = projector.surface, projector.shape.n_points
    if surface is None:
        return projector.repaired.to_original(np.ones(count), fill=0.0)
    areas = np.repeat(np.linalg.norm(surface.face_vectors, axis=1) / 6, 3)
    return projector.repaired.to_original(np.bincount(surface.faces.ravel(), areas, count), fill=0.0)


def _summary(values: Float[np.ndarray, " n"]) -> dict[str, float]:
    known = values[np.isfinite(values)]
    shares = {name: float(np.percentile(known, share)) for name, share in _PERCENTILES.items()}
    return {"mean": float(known.mean()), **shares, "largest": float(known.max())}
