"""Exchanges of left and right, and of ends, on boxes whose mirror maps are known from the grid they are made of."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from homolog.core.errors import DataError
from homolog.datasets import ShapeFolder
from homolog.evaluation import Protocol, evaluate, exchange_of, mean_shape, mirror_plane, partners
from homolog.shapes import Shape, write_shape

NAMES = ("a", "b", "c")


@pytest.fixture(scope="module")
def box():
    """Points of a box that has other ends along y and z, its faces, and for each axis the map that mirrors its grid."""
    mesh = trimesh.creation.box((1.0, 4.0, 2.0))
    for _ in range(3):
        mesh = mesh.subdivide()
    x, y, z = mesh.vertices.T
    points = np.stack([x * (1 + 0.15 * y), y + 0.1 * y**2, z * (1 + 0.2 * z) + 0.1 * y], axis=1)
    tree = KDTree(mesh.vertices)
    mirrors = [tree.query(mesh.vertices * signs)[1] for signs in ([-1, 1, 1], [1, -1, 1], [1, 1, -1])]
    return SimpleNamespace(points=points, faces=mesh.faces, mirrors=np.stack(mirrors), count=len(points))


@pytest.fixture
def boxes(box, tmp_path):
    """A folder of boxes that are turned, stretched along and numbered each in its own way; who has which number."""
    (tmp_path / "off").mkdir()
    (tmp_path / "corres").mkdir()
    orders = {}
    for seed, name in enumerate(NAMES):
        orders[name] = order = np.random.default_rng(seed).permutation(box.count)
        points = (
            (box.points * [1 + 0.1 * seed, 1, 1])[order] @ Rotation.random(random_state=seed).as_matrix() * 10**seed
        )
        write_shape(tmp_path / "off" / f"{name}.off", Shape(points, np.argsort(order)[box.faces]))
        write_lines(tmp_path / "corres" / f"{name}.vts", np.argsort(order) + 1)
    (tmp_path / "pairs.txt").write_text("a,b\nb,c\nc,c\n")
    return SimpleNamespace(root=tmp_path, orders=orders)


def write_lines(path, numbers):
    path.write_text("".join(f"{number}\n" for number in numbers))


def found_by(boxes, mapped, protocol=None, **options):
    """The evaluation of a map between boxes: for each point of the grid the one that it is taken to."""

    def match(source, target):
        source, target = (boxes.orders[shape.name.removesuffix(".off")] for shape in (source, target))
        on_grid = mapped[target]
        return np.where(on_grid < 0, -1, np.argsort(source)[on_grid])

    return evaluate(None, ShapeFolder.open(boxes.root, **options), protocol or Protocol(), match=match)


def exchanges(evaluation):
    return [pair.exchanged for pair in evaluation.pairs]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_mirror_plane_of_a_turned_box(box, seed):
    turn = Rotation.random(random_state=seed).as_matrix()
    assert abs(mirror_plane(box.points @ turn.T + seed) @ turn[:, 0]) == pytest.approx(1, abs=1e-6)


def test_partners_are_the_mirrored_points_of_the_grid(box):
    found = partners(box.points @ Rotation.random(random_state=3).as_matrix().T)
    np.testing.assert_array_equal(found.left_right, box.mirrors[0])
    for ours, true in zip(found.turned_over, box.mirrors[1:], strict=True):  # the ends differ, but not by much
        assert np.linalg.norm(box.points[ours] - box.points[true], axis=1).mean() < 0.5


def test_points_that_are_not_known_have_no_partners(box):
    points = box.points.copy()
    lacking = box.points[:, 0] > 0.45
    points[lacking] = np.nan
    found = partners(points, box.mirrors[0])
    assert (found.turned_over[:, lacking] == -1).all()
    assert (found.turned_over[:, ~lacking] >= 0).all() and not lacking[found.turned_over[:, ~lacking]].any()


def test_maps_that_exchange_nothing(boxes, box):
    found = found_by(boxes, np.arange(box.count))
    assert exchanges(found) == ["none"] * 3
    assert found.exchanges == {"none": 3, "left-right": 0, "turned over": 0}


@pytest.mark.parametrize("turn", ["none", "any"])
@pytest.mark.parametrize(("axis", "expected"), [(0, "left-right"), (1, "turned over"), (2, "turned over")])
def test_maps_that_mirror(boxes, box, axis, expected, turn):
    found = found_by(boxes, box.mirrors[axis], Protocol(turn=turn))
    assert exchanges(found) == [expected] * 3
    figures = found.to_dict()
    assert figures["exchanged_pairs"] == {"none": 0, "left-right": 0, "turned over": 0, expected: 3}
    assert [pair["exchanged"] for pair in figures["pairs"]] == [expected] * 3
    header, *rows = found.rows()
    assert [row[header.index("exchanged")] for row in rows] == [expected] * 3


@pytest.mark.parametrize("axis", [1, 2])
def test_half_a_turn_is_what_moves_points_more(boxes, box, axis):
    """Both mirrors one after the other: of a box that is 1 thick, the long way is told."""
    found = found_by(boxes, box.mirrors[axis][box.mirrors[0]])
    assert exchanges(found) == ["turned over"] * 3


@pytest.mark.parametrize(("share", "expected"), [(0.4, "none"), (0.6, "left-right")])
def test_more_than_half_of_the_matched_points_decide(boxes, box, share, expected):
    order = np.random.default_rng(0).permutation(box.count)
    mapped = np.where(order < share * box.count, box.mirrors[0], np.arange(box.count))
    assert exchanges(found_by(boxes, mapped)) == [expected] * 3
    # Points without a match do not count: of the others, most are mirrored, or all are right.
    unmatched = np.where(order < 0.35 * box.count, -1, mapped)
    assert exchanges(found_by(boxes, unmatched)) == ["none"] * 3


def test_template_points_that_a_shape_lacks(boxes, box):
    for name in NAMES:
        file = boxes.root / "corres" / f"{name}.vts"
        lines = np.loadtxt(file, int)
        lines[ord(name) :: 7] = -1
        write_lines(file, lines)
    for axis, expected in ((0, "left-right"), (1, "turned over")):
        assert exchanges(found_by(boxes, box.mirrors[axis])) == [expected] * 3
    assert exchanges(found_by(boxes, np.arange(box.count))) == ["none"] * 3


def test_partners_that_the_folder_tells(boxes, box):
    """A file that calls the other end each point's partner is believed."""
    vertices = np.argsort(boxes.orders["b"])[box.mirrors[1]] + 1
    write_lines(boxes.root / "corres" / "b.sym.vts", vertices)
    assert exchanges(found_by(boxes, box.mirrors[1])) == ["left-right"] * 3
    assert exchanges(found_by(boxes, box.mirrors[0])) == ["turned over"] * 3
    write_lines(boxes.root / "corres" / "b.sym.vts", vertices[1:])
    with pytest.raises(DataError, match=r"b\.sym\.vts has .* lines up to .*, but must have"):
        found_by(boxes, box.mirrors[0])


def test_parts_and_other_truths_are_not_asked(boxes, box):
    mapped = np.arange(box.count)
    found = found_by(boxes, mapped, Protocol(partial=True))
    assert found.exchanges is None and exchanges(found) == [None] * 3
    assert "exchanged_pairs" not in found.to_dict() and "exchanged" not in found.to_dict()["pairs"][0]
    header, *rows = found.rows()
    assert {row[header.index("exchanged")] for row in rows} == {None}


def test_few_template_points_tell_nothing(boxes, box):
    for name in NAMES:
        write_lines(boxes.root / "corres" / f"{name}.vts", (np.argsort(boxes.orders[name]) + 1)[:9])
    assert exchanges(found_by(boxes, np.arange(box.count))) == [None] * 3


def test_points_near_their_partners_tell_nothing():
    own = np.random.default_rng(0).normal(size=(50, 3)) * [0.01, 1, 1]
    over = np.stack([own, own])
    assert exchange_of(own, own * [-1, 1, 1], own * [-1, 1, 1], over) == "none"
    assert exchange_of(own, own * [-1, 1, 1], own * [-1, 1, 1], over, scale=0.01) == "left-right"


def test_the_mean_of_no_shapes():
    assert mean_shape([]) is None
    assert mean_shape([np.full((20, 3), np.nan)]) is None
