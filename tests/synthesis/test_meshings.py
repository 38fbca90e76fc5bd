"""Other meshings of shapes: truth stays where it is, sheets come apart, and folders can be gone on with."""

import json

import numpy as np
import pytest
import trimesh

from homolog.core.errors import ArgumentError, DataError, ShapeError
from homolog.datasets import DatasetDescription, ShapeFolder
from homolog.geometry.surface import Surface
from homolog.shapes import Shape, write_shape
from homolog.synthesis import MeshSettings, other_meshing, write_meshings
from homolog.synthesis.remeshing import is_one_closed_surface
from homolog.synthesis.sheets import separated_sheets

SETTINGS = MeshSettings(600, 2.5)


def boxes(*corners, size=1.0):
    """Boxes at these corners, with points that they share merged."""
    box = trimesh.creation.box((size, size, size))
    points = np.concatenate([box.vertices + size / 2 + corner for corner in corners])
    faces = np.concatenate([box.faces + 8 * number for number in range(len(corners))])
    merged, index = np.unique(points.round(9), axis=0, return_inverse=True)
    return Surface(merged, index.ravel()[faces])


def is_closed_manifold(surface):
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    fans = mesh.euler_number == 2 * len(mesh.split(only_watertight=False))
    return mesh.is_watertight and mesh.is_winding_consistent and fans


@pytest.mark.parametrize(("second", "extra"), [((1, 1, 0), 2), ((1, 1, 1), 1), ((3, 0, 0), 0)])
def test_boxes_that_share_an_edge_a_corner_or_nothing(second, extra):
    touching = boxes((0, 0, 0), second)
    apart, copies = separated_sheets(touching)
    assert len(apart.vertices) == len(touching.vertices) + extra == 16
    np.testing.assert_array_equal(apart.vertices, touching.vertices[copies])
    np.testing.assert_array_equal(copies[apart.faces], touching.faces)
    assert is_closed_manifold(apart)
    pieces = trimesh.Trimesh(apart.vertices, apart.faces, process=False).split()
    assert [piece.volume for piece in pieces] == pytest.approx([1.0, 1.0])  # the solids, not what is between them


def test_meshes_that_are_not_closed():
    box = boxes((0, 0, 0))
    for faces in (box.faces[1:], np.concatenate([box.faces[:1, ::-1], box.faces[1:]])):
        with pytest.raises(ShapeError, match="the lid has a boundary, or triangles that are not turned alike"):
            separated_sheets(Surface(box.vertices, faces), "the lid")


@pytest.fixture(scope="module")
def ball(make):
    blob = make.blob(3)
    return Shape(blob.points * 2.0, blob.faces, name="ball")


def test_truth_stays_where_it_is(ball):
    points = np.arange(0, ball.n_points, 3)
    made = other_meshing(ball, points, SETTINGS, seed=2)
    assert made.shape.n_points == pytest.approx(600, rel=0.1)
    assert is_one_closed_surface(Surface(made.shape.points, made.shape.faces))
    unit = np.sqrt(np.linalg.norm(Surface(ball.points, ball.faces).face_vectors, axis=1).sum() / 2)
    places = np.einsum("pck,pc->pk", made.shape.points[made.shape.faces[made.places.faces]], made.places.weights)
    away = np.linalg.norm(places - ball.points[points], axis=1) / unit
    assert away.mean() < 0.003
    assert away.max() < 0.02
    # The vertex is the nearest of all, or about as near: triangles are long.
    each = np.linalg.norm(made.shape.points[None] - ball.points[points][:, None], axis=2) / unit
    np.testing.assert_allclose(made.rounding, each[np.arange(len(points)), made.vertices], rtol=0.02)
    assert (made.rounding < each.min(axis=1) + 0.02).all()
    assert np.unique(made.vertices).size > 0.5 * len(points)


def test_triangles_are_long(ball):
    def elongation(stretch):
        shape = other_meshing(ball, np.arange(3), MeshSettings(600, stretch), seed=2).shape
        sides = (shape.points[shape.faces] - shape.points[np.roll(shape.faces, 1, axis=1)]).reshape(-1, 3)
        squares = np.linalg.eigvalsh(sides.T @ sides)
        return np.sqrt(squares[2] / squares[:2].mean())

    assert elongation(3.0) > 1.3 * elongation(1.0)


@pytest.fixture(scope="module")
def source(tmp_path_factory, make):
    root, blob = tmp_path_factory.mktemp("shapes"), make.blob(2)
    (root / "off").mkdir()
    (root / "corres").mkdir()
    for seed, name in enumerate(("one", "two", "three")):
        order = np.random.default_rng(seed).permutation(blob.n_points)
        write_shape(root / "off" / f"{name}.off", make.relabelled(blob, order))
        lines = [*(np.argsort(order)[:60] + 1).tolist(), -1]
        (root / "corres" / f"{name}.vts").write_text("\n".join(map(str, lines)))
    (root / "test.txt").write_text("one\ntwo\n")
    return root


def contents(place):
    return {str(path.relative_to(place)): path.read_bytes() for path in sorted(place.rglob("*")) if path.is_file()}


def test_a_dataset_of_them(source, tmp_path):
    for name in ("first", "second"):
        write_meshings(source, tmp_path / name, settings=MeshSettings(500, 2.0), seed=4)
    written = contents(tmp_path / "first")
    assert written == contents(tmp_path / "second")
    folder = ShapeFolder.open(tmp_path / "first")
    assert folder.names == ("one", "two")
    assert len(folder.pairs("test")) == 4
    truth = folder.ground_truth().between("one", "two")
    assert len(truth.source) == 60  # without the point that neither has
    ours, theirs = folder.shape("one"), folder.shape("two")
    apart = np.linalg.norm(ours.points[truth.source] - theirs.points[truth.target], axis=1)
    assert apart.mean() < 0.12  # of one blob twice: two roundings
    record = json.loads(written["manifest.json"])["meshes"][0]
    assert (record["name"], record["vertices"]) == ("one", ours.n_points)
    with np.load(tmp_path / "first" / "truth" / "one.npz") as stored:
        assert stored["triangles"].shape == (61,)
        assert (stored["triangles"][-1], stored["weights"][-1].sum()) == (-1, 0.0)
        np.testing.assert_allclose(stored["weights"][:-1].sum(axis=1), 1.0)
    before = (tmp_path / "first" / "off" / "two.off").stat().st_mtime_ns
    (tmp_path / "first" / "off" / "one.off").unlink()
    write_meshings(source, tmp_path / "first", settings=MeshSettings(500, 2.0), seed=4)
    assert contents(tmp_path / "first") == written
    assert (tmp_path / "first" / "off" / "two.off").stat().st_mtime_ns == before


def test_what_cannot_be_meshed(source, tmp_path, make):
    with pytest.raises(ArgumentError, match="made in another way"):
        write_meshings(source, tmp_path / "one", settings=MeshSettings(500, 2.0), seed=4)
        write_meshings(source, tmp_path / "one", settings=MeshSettings(500, 2.0), seed=5)
    with pytest.raises(ArgumentError, match="stretch is 9"):
        write_meshings(source, tmp_path / "two", settings=MeshSettings(500, 9.0))
    with pytest.raises(DataError, match="has no template correspondence"):
        write_meshings(source, tmp_path / "two", description=DatasetDescription(truth="same-numbering"))
    assert not (tmp_path / "two").exists()
    with pytest.raises(ShapeError, match="is a point cloud"):
        other_meshing(make.blob(2).as_cloud(), np.arange(3))
