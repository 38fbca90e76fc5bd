"""What a camera sees, against shapes of which it is known what can be seen."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from homolog.core.errors import ArgumentError, ShapeError
from homolog.shapes import Shape, face_areas
from homolog.synthesis import Camera, ViewSettings, camera_apart, sample_camera, view, view_from


def looking(position, target=(0.0, 0.0, 0.0), *, opening=1.0, pixels=(60, 40)):
    return Camera(tuple(map(float, position)), tuple(map(float, target)), opening, pixels)


def same(one, other):
    """Whether two parts have the same bytes."""
    arrays = [
        (part.shape.points, part.shape.faces, part.full_index, part.triangles, part.weights) for part in (one, other)
    ]
    return all(
        (a is None and b is None) or (a.dtype == b.dtype and a.tobytes() == b.tobytes())
        for a, b in zip(*arrays, strict=True)
    )


@pytest.mark.parametrize("position", [(0, 0.3, 3), (2, 1, -1.5), (-1.1, 0.2, 0.1), (30, 40, 50)])
def test_a_sphere_shows_the_faces_that_look_at_the_camera(make, position):
    sphere = make.sphere(3)
    found = view_from(sphere, looking(position, opening=3 if np.linalg.norm(position) < 9 else 0.05))
    corners = sphere.points[sphere.faces]
    outwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = np.array(position) - corners.mean(axis=1)
    facing = np.einsum("md,md->m", outwards, towards) > 0
    expected = {tuple(sorted(face)) for face in sphere.faces[facing]}
    assert {tuple(sorted(face)) for face in found.mesh.full_index[found.mesh.shape.faces]} == expected
    areas = face_areas(sphere.points, sphere.faces)
    assert found.visible_share == pytest.approx(areas[facing].sum() / areas.sum(), rel=1e-12)
    # On the sphere itself the cap of n.(c - p) > 0 is seen. Flat faces show up to an edge more at its rim.
    normals = sphere.points
    cap = np.einsum("nd,nd->n", normals, np.array(position) - sphere.points)
    seen = np.zeros(sphere.n_points, dtype=bool)
    seen[found.mesh.full_index] = True
    edge = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1).max()
    assert seen[cap > edge * np.linalg.norm(position)].all()
    assert not seen[cap < -edge * np.linalg.norm(position)].any()


def test_the_cloud_of_a_sphere_lies_where_the_formula_says(make):
    """The first of the two places where each ray meets the sphere, but for the flatness of its faces."""
    sphere, camera = make.sphere(5), looking((0, 0.5, 3), opening=0.5)
    cloud = view_from(sphere, camera).cloud
    along = np.column_stack([camera.rays(), np.ones(len(camera.rays()))]) @ camera.axes
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    origin = np.array(camera.position)
    half = along @ origin
    under_root = half**2 - (origin @ origin - 1)
    clear = under_root > 0.02
    places = origin + (-half - np.sqrt(np.maximum(under_root, 0)))[:, None] * along
    distances = np.linalg.norm(places[clear][:, None] - cloud.shape.points, axis=2).min(axis=1)
    assert distances.max() < 0.01
    assert clear.sum() <= cloud.shape.n_points <= (under_root > -0.02).sum()


def test_a_wall_hides_what_is_behind_it(make):
    """A small square before a large one: what its shadow covers is not seen, and the large one falls into no pieces."""
    back = make.grid(41, width=4.0)
    front = make.grid(11, width=1.0)
    back, front = Shape(back.points - [2, 2, 0], back.faces), Shape(front.points - [0.5, 0.5, -1], front.faces)
    scene = make.joined([front, back])
    found = view_from(scene, looking((0, 0, 3)))
    # From 3 away, the square at 1 with half a side of 0.5 casts a shadow of half a side 0.75.
    x, y, _ = back.points.T
    shadow = np.maximum(np.abs(x), np.abs(y)) < 0.75 - 1e-9
    expected = np.flatnonzero(np.concatenate([np.ones(front.n_points, dtype=bool), ~shadow]))
    assert found.mesh.full_index.tolist() == expected.tolist()
    assert (found.cloud.full_index < front.n_points).any()
    behind = found.cloud.shape.points[found.cloud.full_index >= front.n_points]
    assert (np.abs(behind[:, :2]).max(axis=1) > 0.75).all()


def test_a_surface_is_seen_from_its_back_as_well(make):
    grid = make.grid(9)
    for z in (2, -2):
        assert view_from(grid, looking((0.5, 0.5, z), (0.5, 0.5, 0))).visible_share == 1


def test_what_lies_outside_the_image_is_not_seen(make):
    grid = make.grid(21)
    found = view_from(grid, looking((0.5, 0.5, 1), (0.5, 0.5, 0), opening=0.25, pixels=(20, 10)))
    across, up = np.abs(grid.points[found.mesh.full_index, :2] - 0.5).max(axis=0)
    assert (across, up) == pytest.approx((0.5, 0.25))


@settings(max_examples=10)
@given(seed=st.integers(0, 10**6))
def test_indices_and_weights_lead_back(demo, seed):
    body = demo.amber
    found = view(body, ViewSettings(pixels=(60, 60)), seed=seed)
    mesh, cloud = found.mesh, found.cloud
    assert np.array_equal(mesh.shape.points, body.points[mesh.full_index])
    faces = {tuple(face) for face in body.faces}
    assert all(tuple(face) in faces for face in mesh.full_index[mesh.shape.faces])
    assert np.array_equal(np.unique(mesh.shape.faces), np.arange(mesh.shape.n_points))
    corners = body.faces[cloud.triangles]
    assert cloud.shape.points == pytest.approx(np.einsum("nk,nkd->nd", cloud.weights, body.points[corners]), abs=1e-12)
    assert (cloud.weights >= 0).all() and cloud.weights.sum(axis=1) == pytest.approx(1)
    largest = np.take_along_axis(corners, cloud.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    assert np.array_equal(cloud.full_index, largest)
    assert 0.1 < found.visible_share < 0.6
    # Every cloud point projects to the middle of a pixel, each to one of its own.
    coordinates = found.camera.to_camera(cloud.shape.points)
    pixel = (coordinates[:, :2] / coordinates[:, 2:] / found.camera.edges + 1) * 30 - 0.5
    assert pixel == pytest.approx(np.round(pixel), abs=1e-6)
    assert len(np.unique(np.round(pixel) @ [1, 100])) == len(pixel)


def test_noise_moves_cloud_points_along_their_rays(make):
    sphere, camera = make.sphere(3), looking((0, 0, 4), opening=0.3, pixels=(80, 80))
    clean, noisy = (view_from(sphere, camera, noise=noise, seed=4) for noise in (0.0, 0.01))
    assert same(clean.mesh, noisy.mesh)
    assert np.array_equal(clean.cloud.weights, noisy.cloud.weights)
    shift = noisy.cloud.shape.points - clean.cloud.shape.points
    along = clean.cloud.shape.points - camera.position
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    assert np.cross(shift, along) == pytest.approx(0, abs=1e-12)
    sigma = 0.01 * np.sqrt(face_areas(sphere.points, sphere.faces).sum())
    depths = np.einsum("nd,nd->n", shift, along)
    assert depths.std() == pytest.approx(sigma, rel=0.05) and abs(depths.mean()) < 0.1 * sigma


def test_the_same_seed_gives_the_same_bytes(make):
    blob, options = make.blob(2), ViewSettings(pixels=(40, 30), noise=0.01)
    one, again, other = (view(blob, options, seed=seed) for seed in (5, 5, 6))
    assert same(one.mesh, again.mesh) and same(one.cloud, again.cloud) and one.camera == again.camera
    assert one.camera != other.camera and not same(one.cloud, other.cloud)


def test_cameras_stand_where_the_settings_say(make):
    blob = make.blob(2)
    middle = (blob.points.min(axis=0) + blob.points.max(axis=0)) / 2
    radius = np.linalg.norm(blob.points - middle, axis=1).max()
    options = ViewSettings(distance=(1.5, 2.5), elevation=(-10, 60))
    cameras = [sample_camera(blob, options, seed=seed) for seed in range(400)]
    away = (np.array([camera.position for camera in cameras]) - middle) / radius
    distances = np.linalg.norm(away, axis=1)
    height = away[:, 1] / distances
    assert 1.5 <= distances.min() < 1.55 and 2.45 < distances.max() <= 2.5
    # Evenly in height, as Archimedes has it.
    low, high = np.sin(np.radians([-10, 60]))
    assert low <= height.min() and height.max() <= high
    assert np.histogram(height, bins=4, range=(low, high))[0] == pytest.approx(100, abs=30)
    assert np.histogram(np.arctan2(away[:, 0], away[:, 2]), bins=4, range=(-np.pi, np.pi))[0] == pytest.approx(
        100, abs=30
    )
    for camera in cameras:
        assert camera.frames(camera.to_camera(blob.points)).all()
    given_values = sample_camera(blob, ViewSettings(distance=3.0, elevation=30.0), seed=0)
    place = (np.array(given_values.position) - middle) / radius
    assert (np.linalg.norm(place), place[1]) == pytest.approx((3, 1.5))


def test_the_image_is_upright_and_not_mirrored():
    camera = looking((0, 0, 5))
    assert camera.to_camera(np.array([1.0, 2.0, 3.0])) == pytest.approx([1, -2, 2])
    rays = camera.rays().reshape(40, 60, 2)
    assert rays[0, 0] == pytest.approx([-1.5 * 59 / 60, -39 / 40])
    assert rays[-1, -1] == pytest.approx([1.5 * 59 / 60, 39 / 40])


def test_the_pieces_that_occlusion_leaves_stay(make):
    """Of a ball behind a bar its upper and its lower half are seen, joined by nothing."""
    sphere = make.sphere(4)
    bar = Shape(make.grid(2).points * [6, 0.3, 1] + [-3, -0.15, 1.5], make.grid(2).faces)
    found = view_from(make.joined([bar, sphere]), looking((0, 0, 4)))
    mesh = found.mesh.shape
    pieces = trimesh.Trimesh(mesh.points, mesh.faces, process=False).body_count
    assert pieces == 3


def test_points_without_a_face_do_not_matter(make):
    sphere = make.sphere(2)
    with_stray = Shape(np.concatenate([[[0, 0, 50.0]], sphere.points]), sphere.faces + 1)
    camera = looking((0, 0, 3), opening=0.5)
    assert np.array_equal(view_from(with_stray, camera).mesh.full_index, view_from(sphere, camera).mesh.full_index + 1)
    assert sample_camera(with_stray, ViewSettings(), seed=0) == sample_camera(sphere, ViewSettings(), seed=0)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"distance": 1.0}, "distance"),
        ({"distance": (3.0, 2.0)}, "distance"),
        ({"elevation": 90.0}, "elevation"),
        ({"pixels": (0, 5)}, "pixels"),
        ({"pixels": 50}, "pixels"),
        ({"noise": -1.0}, "noise"),
        ({"noise": float("nan")}, "noise"),
    ],
)
def test_settings_that_cannot_be(wrong, named):
    with pytest.raises(ArgumentError, match=named):
        ViewSettings(**wrong)


def test_cameras_that_cannot_be():
    for bad in ({"position": (0, 5, 0)}, {"position": (0, 0, 0)}, {"opening": 0.0}):
        with pytest.raises(ArgumentError, match=r"target|opening"):
            looking(**{"position": (0, 0, 3), **bad})


def test_shapes_that_have_no_view(make):
    sphere = make.sphere(2)
    with pytest.raises(ShapeError, match="point cloud"):
        view(sphere.as_cloud(), seed=0)
    with pytest.raises(ShapeError, match="behind the camera"):
        view_from(sphere, looking((0, 0, 0.5), (0, 0, 1)))
    with pytest.raises(ShapeError, match="0 points are left"):
        view_from(sphere, looking((0, 0, 5), (9, 0, -4), opening=0.1))
    with pytest.raises(ShapeError, match="take more pixels"):
        view(sphere, ViewSettings(pixels=(1, 1)), seed=0)
    with pytest.raises(ShapeError, match="repair"):
        view(Shape(np.where(sphere.points > 0.99, np.nan, sphere.points), sphere.faces), seed=0)


def elevations_of_circle(direction, degrees):
    """The elevations of many directions at one angle from a given one."""
    direction = direction / np.linalg.norm(direction)
    across = trimesh.transformations.rotation_matrix(np.radians(degrees), np.cross(direction, (0, 1, 0)))[:3, :3]
    turns = (
        trimesh.transformations.rotation_matrix(turn, direction)[:3, :3] for turn in np.linspace(0, 2 * np.pi, 720)
    )
    return np.degrees(np.arcsin([(turn @ across @ direction)[1] for turn in turns]))


@given(
    degrees=st.floats(1, 180),
    seed=st.integers(0, 1000),
    elevation=st.tuples(st.floats(-80, 0), st.floats(0, 80)),
    distance=st.floats(1.5, 6),
)
@settings(max_examples=60, deadline=None)
def test_cameras_apart(degrees, seed, elevation, distance):
    """The angle between both directions of sight, the elevation, and an image that just holds the same sphere."""
    one = looking((0.0, 0.3, 2.0), (0.1, 0.2, -0.3), opening=0.5)
    chosen = ViewSettings(distance=distance, elevation=elevation)
    try:
        other = camera_apart(one, chosen, degrees=degrees, seed=seed)
    except ArgumentError:
        heights = elevations_of_circle(np.subtract(one.position, one.target), degrees)
        assert not ((heights > elevation[0] + 0.2) & (heights < elevation[1] - 0.2)).any()
        return
    assert other.target == one.target
    first, second = (np.subtract(camera.position, camera.target) for camera in (one, other))
    cosine = first @ second / np.linalg.norm(first) / np.linalg.norm(second)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))) == pytest.approx(degrees, abs=1e-4)
    height = np.degrees(np.arcsin(second[1] / np.linalg.norm(second)))
    assert elevation[0] - 1e-6 <= height <= elevation[1] + 1e-6
    radii = [np.linalg.norm(c) / np.sqrt(1 + camera.opening**-2) for c, camera in ((first, one), (second, other))]
    assert radii[1] == pytest.approx(radii[0])
    assert np.linalg.norm(second) == pytest.approx(distance * radii[0])


def test_views_apart(make):
    blob = make.blob(3)
    one, other = view(blob, seed=5), view(blob, seed=5, apart=70.0)
    first, second = (np.subtract(seen.camera.position, seen.camera.target) for seen in (one, other))
    cosine = first @ second / np.linalg.norm(first) / np.linalg.norm(second)
    assert np.degrees(np.arccos(cosine)) == pytest.approx(70)
    assert same(view(blob, seed=5, apart=70.0).mesh, other.mesh)


@pytest.mark.parametrize("degrees", [0, -30, 181, float("nan"), "60"])
def test_angles_that_cannot_be(degrees):
    with pytest.raises(ArgumentError, match=r"apart is .*, but must be a number of degrees above 0 and up to 180"):
        camera_apart(looking((0, 0, 3)), ViewSettings(), degrees=degrees, seed=0)


def test_no_camera_is_opposite_one_that_looks_down():
    with pytest.raises(ArgumentError, match="apart is 180, but must be an angle between two cameras at elevations"):
        camera_apart(looking((0, 2, 3)), ViewSettings(), degrees=180, seed=0)
