"""Partial views: the triangles that a camera sees of a mesh, and the cloud that a depth camera would record."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from homolog.core.arguments import is_count, is_real
from homolog.core.errors import ShapeError, bad_value
from homolog.shapes import FEWEST_POINTS, Shape, face_areas
from homolog.synthesis.partial_shape import PartialShape, keep_faces, mesh_faces
from homolog.synthesis.rays import first_hits, visible
from homolog.synthesis.sampling import Range, check_number, check_range, sample

Vector = tuple[float, float, float]

# Streams of random numbers with one seed.
_CAMERA, _NOISE, _APART = 0, 1, 2

_ROUNDING = 1e-9

_ADVICE = "move the camera, or take a finer mesh"


@dataclass(frozen=True)
class Camera:
    """An upright pinhole camera: the shape's +y points up in the image.

    Args:
        position: of the centre of projection, in the shape's units.
        target: the point in the middle of the image.
        opening: half the shorter side of the image at depth 1 (the tangent of half the field of view).
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
        """The camera's axes as rows: right, down, forward."""
        forwards = self._sight / np.linalg.norm(self._sight)
        right = np.cross(forwards, (0, 1, 0))
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(forwards, right), forwards])

    @property
    def edges(self) -> Float[np.ndarray, " 2"]:
        """Half the width and half the height of the image at depth 1."""
        extents: np.ndarray = self.opening * np.array(self.pixels) / min(self.pixels)
        return extents

    def to_camera(self, points: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
        """Camera coordinates of points: right, down, depth."""
        coordinates: np.ndarray = (points - np.array(self.position)) @ self.axes.T
        return coordinates

    def rays(self) -> Float[np.ndarray, "r 2"]:
        """Image coordinates at depth 1 of the rays through the pixels' centres, row by row from the top."""
        u, v = ((2 * np.arange(n) + 1 - n) / n * edge for n, edge in zip(self.pixels, self.edges, strict=True))
        return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)

    def frames(self, coordinates: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which points, in camera coordinates, lie within the image, occluded or not."""
        within: np.ndarray = (np.abs(coordinates[:, :2]) <= self.edges * coordinates[:, 2:]).all(axis=1)
        return within


@dataclass(frozen=True)
class ViewSettings:
    """The distribution of cameras, and the image's resolution. The image just contains the shape's bounding sphere.

    Args:
        distance: from the shape's centre to the camera, in radii of the bounding sphere, or the range from which it is
            sampled uniformly.
        elevation: of the camera above the shape's centre, in degrees, or the range from which it is sampled, uniformly
            by area on the sphere. Azimuths are uniform.
        pixels: width and height of the depth image.
        noise: standard deviation of the cloud's depths along the rays, in units of sqrt(area) of the full shape.
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
    """A partial view of a full shape.

    Args:
        mesh: the faces whose corners and centroid are visible; occlusion may split it into several components.
        cloud: the first hits of the rays through the pixels, row by row from the top left.
        camera: that it was seen with.
        visible_share: share of the full shape's area that is visible.
    """

    mesh: PartialShape
    cloud: PartialShape
    camera: Camera
    visible_share: float


def view(shape: Shape, settings: ViewSettings | None = None, *, seed: int, apart: float = 0.0) -> View:
    """View a mesh from a random position around it.

    Args:
        shape: a clean mesh, +y up; not changed.
        settings: distribution of cameras, resolution and noise.
        seed: of the camera and the noise.
        apart: by how many degrees the direction of sight differs from that of the camera without it; see
            ``camera_apart``.

    Raises:
        ArgumentError: if no camera is so far apart within the range of elevations.
        ShapeError: if the shape is a cloud or needs repair, or next to nothing of it is visible.

    Examples:
        >>> seen = view(shape, ViewSettings(distance=3.0), seed=0)  # doctest: +SKIP
        >>> seen.mesh.shape.n_points, seen.visible_share  # doctest: +SKIP
    """
    settings = settings or ViewSettings()
    camera = sample_camera(shape, settings, seed=seed)
    if apart:
        camera = camera_apart(camera, settings, degrees=apart, seed=seed)
    return view_from(shape, camera, noise=settings.noise, seed=seed)


def sample_camera(shape: Shape, settings: ViewSettings, *, seed: int) -> Camera:
    """Sample a camera around a mesh; see ``ViewSettings``.

    Raises:
        ShapeError: if the shape is a cloud or needs repair.
    """
    used = shape.points[mesh_faces(shape)].reshape(-1, 3)
    middle = (used.min(axis=0) + used.max(axis=0)) / 2
    radius = np.linalg.norm(used - middle, axis=1).max()
    random = np.random.default_rng([seed, _CAMERA])
    distance = sample(settings.distance, random)
    position = middle + radius * distance * _sample_direction(settings.elevation, random)
    return Camera(_vector(position), _vector(middle), _opening(distance), settings.pixels)


def camera_apart(camera: Camera, settings: ViewSettings, *, degrees: float, seed: int) -> Camera:
    """A camera that looks at the same place in a direction so many degrees from another camera's.

    Its distance is drawn anew, and so are the side to which it lies and its elevation, within the settings' range.

    Args:
        camera: the other, as ``sample_camera`` gives it.
        settings: distribution of distances and elevations.
        degrees: between the directions of sight, above 0 and at most 180.
        seed: of the random choices.

    Raises:
        ArgumentError: if there is none within the range of elevations.

    Examples:
        >>> from homolog.synthesis import Camera, ViewSettings, camera_apart
        >>> front = Camera((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), 0.5)
        >>> side = camera_apart(front, ViewSettings(elevation=0.0), degrees=90, seed=0)
        >>> abs(side.position[0]) > 1.9, abs(side.position[2]) < 1e-9
        (True, True)
    """
    if not (is_real(degrees) and 0 < degrees <= 180):
        raise bad_value("apart", degrees, "a number of degrees above 0 and up to 180")
    away = np.subtract(camera.position, camera.target)
    direction = away / np.linalg.norm(away)
    upward = np.array([0.0, 1.0, 0.0]) - direction[1] * direction  # as seen from there
    level, reach = np.cos(np.radians(degrees)) * direction[1], np.sin(np.radians(degrees)) * np.linalg.norm(upward)
    ends = np.sin(np.radians(np.broadcast_to(settings.elevation, 2)))
    lowest, highest = max(ends[0], level - reach), min(ends[1], level + reach)
    if lowest > highest + _ROUNDING:
        raise bad_value("apart", degrees, f"an angle between two cameras at elevations of {settings.elevation} degrees")
    random = np.random.default_rng([seed, _APART])
    distance = sample(settings.distance, random)
    # Uniform by area on the sphere, as elevations are: zones of equal height have equal areas.
    rise = np.clip((random.uniform(lowest, max(lowest, highest)) - level) / max(reach, _ROUNDING), -1, 1)
    across = rise * upward / np.linalg.norm(upward) + random.choice([-1, 1]) * np.sqrt(1 - rise**2) * camera.axes[0]
    turned = np.cos(np.radians(degrees)) * direction + np.sin(np.radians(degrees)) * across
    # The image just contains the bounding sphere: that gives its radius.
    radius = np.linalg.norm(away) / np.sqrt(1 + camera.opening**-2)
    position = np.array(camera.target) + radius * distance * turned
    return replace(camera, position=_vector(position), opening=_opening(distance))


def _opening(distance: float) -> float:
    """That of the cone that touches the bounding sphere, so many radii away."""
    return float(1 / np.sqrt(distance**2 - 1))


def view_from(shape: Shape, camera: Camera, *, noise: float = 0.0, seed: int = 0) -> View:
    """View a mesh with a given camera.

    A face is visible if its corners and its centroid are, from either side, and lie within the image. Visibility is
    computed exactly, not from pixels, but a face that is occluded only between these four points counts as visible.

    Args:
        shape: a clean mesh; not changed.
        camera: the whole shape must lie in front of it.
        noise: standard deviation of the cloud's depths, along the rays, in units of the square root of the area.
        seed: of the noise.

    Raises:
        ShapeError: if the shape is a cloud, needs repair, lies behind the camera, or is hardly visible.
    """
    check_number("noise", noise, 0)
    faces = mesh_faces(shape)
    points = camera.to_camera(shape.points)
    corners = points[faces]
    if not (corners[:, :, 2] > 0).all():
        raise ShapeError(f"{shape.name} lies partly behind the camera at {camera.position}; move the camera away")
    visible_faces = _visible_faces(camera, points, faces)
    areas = face_areas(shape.points, faces)
    return View(
        mesh=keep_faces(shape, visible_faces, advice=_ADVICE),
        cloud=_cloud(shape, camera, corners, noise * np.sqrt(areas.sum()), seed),
        camera=camera,
        visible_share=float(areas[visible_faces].sum() / areas.sum()),
    )


def _sample_direction(elevation: Range, random: np.random.Generator) -> Float[np.ndarray, " 3"]:
    """A unit vector, uniform by area: zones of equal height on a sphere have equal areas (Archimedes)."""
    ends = np.sin(np.radians(elevation))
    height = sample(tuple(ends) if isinstance(elevation, tuple) else float(ends), random)
    azimuth = random.uniform(0, 2 * np.pi)
    across = np.sqrt(1 - height**2)
    return np.array([across * np.sin(azimuth), height, across * np.cos(azimuth)])


def _visible_faces(
    camera: Camera, points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Bool[np.ndarray, " m"]:
    corners = points[faces]
    # Points that no face uses may lie anywhere, behind the camera even.
    used = np.unique(faces)
    queried = np.concatenate([points[used], corners.mean(axis=1)])
    seen = visible(corners, queried) & camera.frames(queried)
    point_seen = np.zeros(len(points), dtype=bool)
    point_seen[used] = seen[: len(used)]
    both: np.ndarray = point_seen[faces].all(axis=1) & seen[len(used) :]
    return both


def _cloud(shape: Shape, camera: Camera, corners: Float[np.ndarray, "m 3 3"], sigma: float, seed: int) -> PartialShape:
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
    along = np.column_stack([rays[met], np.ones(len(met))]) @ camera.axes
    points += noise[:, None] * (along / np.linalg.norm(along, axis=1, keepdims=True))
    return PartialShape(Shape(points, name=shape.name), nearest, triangles, weights)


def _vector(values: Float[np.ndarray, " 3"]) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


def _check_pixels(pixels: Any) -> None:
    if not (isinstance(pixels, tuple) and len(pixels) == 2 and all(map(is_count, pixels))):
        raise bad_value("pixels", pixels, "two positive whole numbers, width and height")
