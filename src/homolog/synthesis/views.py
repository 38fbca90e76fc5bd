"""What a camera sees of a mesh: the visible triangles, and a cloud such as a depth camera would take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from homolog.core.arguments import is_count, is_real
from homolog.core.errors import ShapeError, bad_value
from homolog.shapes import FEWEST_POINTS, Shape, face_areas
from homolog.synthesis.drawing import Range, check_number, check_range, drawn
from homolog.synthesis.part import Part, mesh_faces, part_of_faces
from homolog.synthesis.rays import first_hits, visible

Vector = tuple[float, float, float]

# What tells the numbers apart that are drawn with one seed.
_CAMERA, _NOISE = 0, 1

_ADVICE = "move the camera, or take a finer mesh"


@dataclass(frozen=True)
class Camera:
    """A pinhole camera that holds its image upright: +y of the shape points up in it.

    Args:
        position: of the pinhole, in the shape's units.
        target: the place in the middle of the image.
        opening: half the extent of the image's shorter side at depth 1.
        pixels: width and height of the image.
    """

    position: Vector
    target: Vector
    opening: float
    pixels: tuple[int, int] = (240, 180)

    def __post_init__(self) -> None:
        if np.linalg.norm(np.cross(self._sight, (0, 1, 0))) <= 1e-9 * np.linalg.norm(self._sight):
            raise bad_value("target", self.target, "in a direction from the position that is not straight up or down")
        if not (is_real(self.opening) and self.opening > 0):
            raise bad_value("opening", self.opening, "a positive number")
        _check_pixels(self.pixels)

    @property
    def _sight(self) -> Float[np.ndarray, " 3"]:
        return np.subtract(self.target, self.position)

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Unit vectors to the right, downwards, and forwards, as rows."""
        forwards = self._sight / np.linalg.norm(self._sight)
        right = np.cross(forwards, (0, 1, 0))
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(forwards, right), forwards])

    @property
    def edges(self) -> Float[np.ndarray, " 2"]:
        """Half the extents of the image at depth 1, its width first."""
        extents: np.ndarray = self.opening * np.array(self.pixels) / min(self.pixels)
        return extents

    def seen_from(self, points: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
        """Points in the camera's coordinates: right, down, depth."""
        coordinates: np.ndarray = (points - np.array(self.position)) @ self.axes.T
        return coordinates

    def rays(self) -> Float[np.ndarray, "r 2"]:
        """Where the rays through the middles of the pixels meet the image at depth 1, row by row from the top."""
        u, v = ((2 * np.arange(n) + 1 - n) / n * edge for n, edge in zip(self.pixels, self.edges, strict=True))
        return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)

    def frames(self, coordinates: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which points, in the camera's coordinates, lie within the image, whatever hides them."""
        within: np.ndarray = (np.abs(coordinates[:, :2]) <= self.edges * coordinates[:, 2:]).all(axis=1)
        return within


@dataclass(frozen=True)
class ViewSettings:
    """From where a shape is looked at, and how finely. The image just holds the sphere around the shape.

    Args:
        distance: from the middle of the shape to the camera, in radii of the sphere around it, or the range from which
            it is drawn.
        elevation: how high the camera stands above the middle, in degrees, or the range from which it is drawn, so
            that equal areas of the sphere of directions are as likely. Azimuths are as likely all around.
        pixels: width and height of the image that the cloud is taken with.
        noise: standard deviation of the cloud's depths, along the rays, in units of sqrt(area) of the complete shape.
    """

    distance: Range = (2.0, 4.0)
    elevation: Range = (-15.0, 45.0)
    pixels: tuple[int, int] = (240, 180)
    noise: float = 0.0

    def __post_init__(self) -> None:
        check_range("distance", self.distance, lambda radii: radii > 1, "a number above 1, in radii of the shape")
        check_range("elevation", self.elevation, lambda angle: -89 <= angle <= 89, "a number of degrees from -89 to 89")
        check_number("noise", self.noise, 0)
        _check_pixels(self.pixels)


@dataclass(frozen=True, eq=False)
class View:
    """What a camera sees of a complete shape.

    Args:
        mesh: the faces whose corners and middle are all visible, in as many pieces as occlusion leaves.
        cloud: the first places that the rays through the pixels meet, from the top left on.
        camera: from where.
        visible_share: of the complete shape's area.
    """

    mesh: Part
    cloud: Part
    camera: Camera
    visible_share: float


def view(shape: Shape, settings: ViewSettings | None = None, *, seed: int) -> View:
    """Look at a mesh from a random place around it.

    Args:
        shape: a clean mesh, +y up; not changed.
        settings: where the camera may be, its pixels and its noise.
        seed: of the camera and of the noise.

    Raises:
        ShapeError: if the shape is a cloud or needs repair, or next to nothing of it is seen.
    """
    settings = settings or ViewSettings()
    camera = drawn_camera(shape, settings, seed=seed)
    return view_from(shape, camera, noise=settings.noise, seed=seed)


def drawn_camera(shape: Shape, settings: ViewSettings, *, seed: int) -> Camera:
    """A camera somewhere around a mesh; see ``ViewSettings``.

    Raises:
        ShapeError: if the shape is a cloud or needs repair.
    """
    used = shape.points[mesh_faces(shape)].reshape(-1, 3)
    middle = (used.min(axis=0) + used.max(axis=0)) / 2
    radius = np.linalg.norm(used - middle, axis=1).max()
    random = np.random.default_rng([seed, _CAMERA])
    distance = drawn(settings.distance, random)
    position = middle + radius * distance * _drawn_place(settings.elevation, random)
    # The cone that touches the sphere around the shape.
    opening = 1 / np.sqrt(distance**2 - 1)
    return Camera(_vector(position), _vector(middle), float(opening), settings.pixels)


def view_from(shape: Shape, camera: Camera, *, noise: float = 0.0, seed: int = 0) -> View:
    """Look at a mesh with a camera.

    A face counts as visible if its corners and its middle are, from either side; what lies outside the image is not.
    Visibility is exact and knows nothing of pixels, but a face that something hides only in between counts as visible.

    Args:
        shape: a clean mesh; not changed.
        camera: from where; the whole shape must lie before it.
        noise: standard deviation of the cloud's depths, along the rays, in units of the square root of the area.
        seed: of the noise.

    Raises:
        ShapeError: if the shape is a cloud or needs repair, lies behind the camera, or next to nothing of it is seen.
    """
    check_number("noise", noise, 0)
    faces = mesh_faces(shape)
    points = camera.seen_from(shape.points)
    corners = points[faces]
    if not (corners[:, :, 2] > 0).all():
        raise ShapeError(f"{shape.name} lies partly behind the camera at {camera.position}; move the camera away")
    seen = _visible_faces(camera, points, faces)
    areas = face_areas(shape.points, faces)
    return View(
        mesh=part_of_faces(shape, seen, advice=_ADVICE),
        cloud=_cloud(shape, camera, corners, noise * np.sqrt(areas.sum()), seed),
        camera=camera,
        visible_share=float(areas[seen].sum() / areas.sum()),
    )


def _drawn_place(elevation: Range, random: np.random.Generator) -> Float[np.ndarray, " 3"]:
    """A unit vector; bands of equal height on a sphere have equal areas."""
    ends = np.sin(np.radians(elevation))
    height = drawn(tuple(ends) if isinstance(elevation, tuple) else float(ends), random)
    azimuth = random.uniform(0, 2 * np.pi)
    across = np.sqrt(1 - height**2)
    return np.array([across * np.sin(azimuth), height, across * np.cos(azimuth)])


def _visible_faces(
    camera: Camera, points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Bool[np.ndarray, " m"]:
    corners = points[faces]
    # Points that no face uses may lie anywhere, behind the camera even.
    used = np.unique(faces)
    asked = np.concatenate([points[used], corners.mean(axis=1)])
    seen = visible(corners, asked) & camera.frames(asked)
    point_seen = np.zeros(len(points), dtype=bool)
    point_seen[used] = seen[: len(used)]
    both: np.ndarray = point_seen[faces].all(axis=1) & seen[len(used) :]
    return both


def _cloud(shape: Shape, camera: Camera, corners: Float[np.ndarray, "m 3 3"], sigma: float, seed: int) -> Part:
    rays = camera.rays()
    hits = first_hits(corners, rays)
    (met,) = np.nonzero(hits.triangles >= 0)
    if len(met) < FEWEST_POINTS:
        raise ShapeError(f"{shape.name}: {len(met)} rays meet it, but a cloud needs {FEWEST_POINTS}; take more pixels")
    triangles, weights = hits.triangles[met], hits.weights[met]
    faces = mesh_faces(shape)[triangles]
    nearest = np.take_along_axis(faces, weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    points = np.einsum("rk,rkd->rd", weights, shape.points[faces])
    noise = sigma * np.random.default_rng([seed, _NOISE]).standard_normal(len(met))
    points += noise[:, None] * _directions(camera, rays[met])
    return Part(Shape(points, name=shape.name), nearest, triangles, weights)


def _directions(camera: Camera, rays: Float[np.ndarray, "r 2"]) -> Float[np.ndarray, "r 3"]:
    """Unit vectors along rays, in the shape's own coordinates."""
    along = np.column_stack([rays, np.ones(len(rays))]) @ camera.axes
    unit: np.ndarray = along / np.linalg.norm(along, axis=1, keepdims=True)
    return unit


def _vector(values: Float[np.ndarray, " 3"]) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


def _check_pixels(pixels: Any) -> None:
    if not (isinstance(pixels, tuple) and len(pixels) == 2 and all(map(is_count, pixels))):
        raise bad_value("pixels", pixels, "two positive whole numbers, width and height")
