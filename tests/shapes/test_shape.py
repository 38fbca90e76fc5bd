"""What a shape may be made of."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from homolog.core.errors import ShapeError
from homolog.shapes import Shape, check, demo_shapes, repair, stand_upright

POINTS = np.eye(4, 3)
FACES = [[0, 1, 2], [1, 2, 3]]


@pytest.mark.parametrize("kind", ["i1", "u8", ">i4", "f4", "f8", object])
def test_faces_of_any_kind_that_are_whole_numbers(kind):
    shape = Shape(POINTS, np.array(FACES).astype(kind))
    assert shape.faces.dtype == np.int64
    np.testing.assert_array_equal(shape.faces, FACES)


@pytest.mark.parametrize("kind", ["i1", "u8", ">f4", "f2", "?", object])
def test_points_of_any_real_kind(kind):
    shape = Shape(np.array(POINTS).astype(kind), FACES)
    assert shape.points.dtype == np.float64
    np.testing.assert_array_equal(shape.points, POINTS)
    np.testing.assert_array_equal(Shape([[Fraction(1, 2), 0, 1]] * 4).points, [[0.5, 0, 1]] * 4)


@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_are_copies_that_nobody_changes(order):
    points, faces = np.array(POINTS, order=order), np.array(FACES, np.int64, order=order)
    shape = Shape(points, faces)
    points[:], faces[:] = 7, 7
    np.testing.assert_array_equal(shape.points, POINTS)
    np.testing.assert_array_equal(shape.faces, FACES)
    for array in (shape.points, shape.faces):
        assert array.flags.c_contiguous
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


@pytest.mark.parametrize(
    ("points", "faces", "said"),
    [
        (POINTS, [[0, 1, 1.7]], "faces hold 1.7, but must be whole numbers"),
        (POINTS, [[0, 1, np.nan]], "faces hold nan, but must be whole numbers"),
        (POINTS, [[0, 1, np.inf]], "faces hold inf, but must be whole numbers"),
        (POINTS, [[0, 1, 1e30]], "faces hold 1e+30, but must be whole numbers"),
        (POINTS, np.array([[0, 1, 1.7]], object), "faces hold 1.7, but must be whole numbers"),
        (POINTS, [[0, 1, 10**30]], "faces hold 1e+30, but must be whole numbers"),
        (POINTS, np.array(FACES) + 0j, "faces are of type complex128, but must be real"),
        (POINTS, [["0", "1", "2"]], "faces are of type <U1, but must be real"),
        (POINTS + 1j, None, "points are of type complex128, but must be real"),
        (np.array(POINTS, "M8[s]"), None, "points are of type datetime64"),
        ([["a", "b", "c"]], None, "points are of type <U1, but must be real"),
        ([[None, 0, 0]] * 4, FACES, None),
        ([[object(), 0, 0]], None, "points must be an array of numbers"),
        ([[1, 2, 3], [1, 2]], None, "points must be an array of numbers"),
        (POINTS[:, :2], None, r"points have shape (4, 2), but must have shape (n, 3)"),
        (POINTS, [0, 1, 2], r"faces have shape (3,), but must have shape (n, 3)"),
    ],
)
def test_what_is_refused(points, faces, said):
    if said is None:  # nothing at all, which numpy takes for NaN
        assert np.isnan(Shape(points, faces).points[0, 0])
        return
    with pytest.raises(ShapeError) as caught:
        Shape(points, faces, name="thing")
    assert str(caught.value).startswith(f"thing: {said}")
    assert "\n" not in str(caught.value)


def test_faces_that_do_not_fit_are_refused():
    points = np.random.default_rng(0).random((5, 3))
    with pytest.raises(
        ShapeError, match="body: faces seem to count from 1, as they hold 1 to 5 but not 0; give faces - 1"
    ):
        Shape(points, [[1, 2, 3], [3, 4, 5]], name="body")
    for bad, index in (([0, 1, 5], 5), ([0, 1, -1], -1), ([2, 3, 99], 99)):
        with pytest.raises(
            ShapeError, match=f"body: faces hold the index {index}, but must hold .* from 0 to 4"
        ) as caught:
            Shape(points, [[1, 2, 3], [1, 3, 0], bad], name="body")
        assert "\n" not in str(caught.value)
        broken = Shape(points, [[1, 2, 3], [1, 3, 0], bad], allow_broken=True)
        # What is made of it stays allowed, and what is repaired needs no leave any more.
        assert replace(broken, points=2 * points).n_faces == 3
        assert not repair(broken).shape.allow_broken and repair(broken).shape.n_faces == 2
    assert Shape(points, np.zeros((0, 3), int)).n_faces == 0


def test_what_is_printed_is_short():
    shape = Shape(np.random.default_rng(0).random((500, 3)), name="cloud.ply")
    assert repr(shape) == "Shape('cloud.ply': cloud, 500 points)"
    assert repr(repair(shape)) == "Repaired(Shape('cloud.ply': cloud, 500 points), 500 of 500 points kept)"
    assert repr(check(shape)) == "Report('cloud.ply': cloud, 500 points, 0 faces, 0 findings)"


def test_turning_a_shape_leaves_its_anatomical_axes():
    shape = Shape(np.eye(4, 3), space="RAS")
    assert stand_upright(shape, "y").space == "RAS" and stand_upright(shape, "z").space is None


def test_demo_bodies():
    for shape in demo_shapes():
        assert check(shape).is_clean and shape.modality == "mesh"
