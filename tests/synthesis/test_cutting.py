"""Cuts and holes: where the plane lies, what the discs take, and that what is left hangs together."""

import heapq

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from homolog.core.errors import ArgumentError, ShapeError
from homolog.shapes import Shape, face_areas
from homolog.synthesis import PartialShape, add_outliers, cut, cut_holes, subsample
from homolog.synthesis.cutting import in_discs


def area(shape):
    return face_areas(shape.points, shape.faces).sum()


def is_whole(part, complete):
    """One connected piece of the complete shape, with its points and nothing else."""
    assert np.array_equal(part.shape.points, complete.points[part.full_index])
    faces = {tuple(face) for face in complete.faces}
    assert all(tuple(face) in faces for face in part.full_index[part.shape.faces])
    assert np.array_equal(np.unique(part.shape.faces), np.arange(part.shape.n_points))
    assert (np.diff(part.full_index) > 0).all()
    assert part.triangles is None and part.weights is None
    return trimesh.Trimesh(part.shape.points, part.shape.faces, process=False).body_count == 1


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), removed=st.floats(0.05, 0.85))
def test_a_cut_leaves_one_side_of_a_plane(make, seed, removed):
    blob = make.blob(3)
    normal = np.random.default_rng(seed).standard_normal(3)
    part = cut(blob, removed=removed, normal=normal, seed=seed)
    assert is_whole(part, blob)
    left = part.shape.points @ normal
    # Every face that is gone reaches below the plane through the lowest point that is left.
    kept = {tuple(face) for face in part.full_index[part.shape.faces]}
    gone = np.array([tuple(face) not in kept for face in blob.faces])
    assert ((blob.points @ normal)[blob.faces[gone]].min(axis=1) < left.min()).all()
    largest_face = face_areas(blob.points, blob.faces).max()
    assert 0 <= area(part.shape) - (1 - removed) * area(blob) <= 2 * largest_face


def test_a_cut_through_two_legs_leaves_the_larger_piece(make):
    """Two legs, the left one longer, joined at the top: both and the bridge are left, or the end of the left one."""
    grid = make.grid(21)
    corners = grid.points[grid.faces].mean(axis=1)
    legs = (np.abs(corners[:, 0] - 0.5) > 0.2) | (corners[:, 1] > 0.8)
    legs &= (corners[:, 0] < 0.5) | (corners[:, 1] > 0.3)
    shape = Shape(grid.points, grid.faces[legs])
    for removed, reaches_right in ((0.4, True), (0.75, False)):
        part = cut(shape, removed=removed, normal=[0, -1, 0], seed=0)
        assert is_whole(part, shape)
        assert (part.shape.points[:, 0].max() > 0.5) == reaches_right
        assert area(part.shape) >= (1 - removed) * area(shape)


def test_nothing_removed_is_the_shape_itself_and_of_two_pieces_the_larger(make):
    blob, small = make.blob(2), make.sphere(1, radius=0.1)
    assert np.array_equal(cut(blob, removed=0.0, seed=1).full_index, np.arange(blob.n_points))
    both = make.joined([small, Shape(blob.points + 9, blob.faces)])
    assert np.array_equal(cut(both, removed=0.0, seed=1).full_index, np.arange(small.n_points, both.n_points))


def brute_distances(shape, start):
    """Shortest ways along the edges, by a heap."""
    around = {}
    for face in shape.faces:
        for a, b in zip(face, np.roll(face, 1), strict=True):
            around.setdefault(int(a), set()).add(int(b))
            around.setdefault(int(b), set()).add(int(a))
    distances, queue = {}, [(0.0, start)]
    while queue:
        distance, point = heapq.heappop(queue)
        if point in distances:
            continue
        distances[point] = distance
        for other in around[point]:
            length = float(np.linalg.norm(shape.points[point] - shape.points[other]))
            heapq.heappush(queue, (distance + length, other))
    return np.array([distances.get(point, np.inf) for point in range(shape.n_points)])


def test_discs_are_geodesic(make):
    blob = make.blob(2)
    centres, radii = np.array([3, 60, 111]), np.array([0.5, 0.9, 0.2])
    expected = np.any([brute_distances(blob, c) < r for c, r in zip(centres, radii, strict=True)], axis=0)
    assert np.array_equal(in_discs(blob, centres, radii), expected)
    assert 0 < expected.sum() < blob.n_points


def test_one_hole_is_the_disc_around_a_point(make):
    blob = make.blob(2)
    part = cut_holes(blob, holes=1, radius=0.2, seed=8)
    assert is_whole(part, blob)
    gone = np.setdiff1d(np.arange(blob.n_points), part.full_index)
    radius = 0.2 * np.sqrt(area(blob))
    discs = [np.flatnonzero(brute_distances(blob, int(centre)) < radius) for centre in gone]
    assert any(np.array_equal(disc, gone) for disc in discs)


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6))
def test_holes_leave_one_piece(make, seed):
    blob = make.blob(3)
    part = cut_holes(blob, holes=(2, 6), radius=(0.05, 0.3), seed=seed)
    assert is_whole(part, blob)
    assert part.shape.n_points < blob.n_points


@pytest.mark.parametrize("make_part", [cut, cut_holes, subsample, add_outliers])
def test_the_same_seed_gives_the_same_bytes(make, make_part):
    blob = make.blob(3)
    one, again, other = (make_part(blob, seed=seed) for seed in (5, 5, 6))
    assert one.shape.points.tobytes() == again.shape.points.tobytes() != other.shape.points.tobytes()
    assert one.full_index.tobytes() == again.full_index.tobytes()
    if one.shape.faces is not None:
        assert one.shape.faces.tobytes() == again.shape.faces.tobytes()


def test_steps_one_after_the_other_lead_back(make):
    blob = make.blob(3)
    first = cut(blob, seed=1)
    second = first.then(subsample(first.shape, seed=2))
    third = second.then(add_outliers(second.shape, share=0.1, seed=3))
    known = third.full_index >= 0
    assert np.array_equal(third.shape.points[known], blob.points[third.full_index[known]])
    assert (~known).sum() == round(0.1 * second.shape.n_points)


def test_steps_keep_places_on_triangles():
    cloud = PartialShape(Shape(np.eye(4, 3)), np.arange(4), np.array([5, 6, 7, 8]), np.full((4, 3), 1 / 3))
    further = PartialShape(Shape(np.eye(4, 3)), np.array([2, -1, 0, 0]))
    found = cloud.then(further)
    assert found.triangles.tolist() == [7, -1, 5, 5]
    assert found.weights.tolist() == [[1 / 3] * 3, [0] * 3, [1 / 3] * 3, [1 / 3] * 3]


@pytest.mark.parametrize(
    ("make_part", "options", "named"),
    [
        (cut, {"removed": 1.0}, "removed"),
        (cut, {"removed": (0.6, 0.3)}, "removed"),
        (cut, {"removed": "half"}, "removed"),
        (cut, {"normal": [0, 0, 0]}, "normal"),
        (cut, {"normal": [1, 2]}, "normal"),
        (cut_holes, {"holes": 0}, "holes"),
        (cut_holes, {"holes": (4, 2)}, "holes"),
        (cut_holes, {"holes": 10**6}, "holes"),
        (cut_holes, {"holes": 1.5}, "holes"),
        (cut_holes, {"radius": 0.0}, "radius"),
        (subsample, {"least": 1.5}, "least"),
        (subsample, {"direction": [0, np.nan, 1]}, "direction"),
        (add_outliers, {"share": -0.1}, "share"),
        (add_outliers, {"distance": -1.0}, "distance"),
    ],
)
def test_values_that_cannot_be(make, make_part, options, named):
    with pytest.raises(ArgumentError, match=named):
        make_part(make.blob(2), **options, seed=0)


def test_shapes_too_small_or_without_faces(make):
    sphere = make.sphere(1)
    for make_part in (cut, cut_holes):
        with pytest.raises(ShapeError, match="point cloud"):
            make_part(sphere.as_cloud(), seed=0)
    with pytest.raises(ShapeError, match="cut less away"):
        cut(sphere, removed=0.999, seed=0)
    with pytest.raises(ShapeError, match="fewer or smaller holes"):
        cut_holes(sphere, holes=1, radius=3.0, seed=0)
    with pytest.raises(ShapeError, match="raise `least`"):
        subsample(Shape(np.eye(5, 3)), least=0.0, direction=[1, 0, 0], seed=0)
