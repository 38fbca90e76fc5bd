"""``homolog export``: a match in the forms of other programs."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from homolog.core.errors import ArgumentError
from homolog.matching import Match, read_point_map
from homolog.shapes import Shape
from homolog.shapes.formats.ply import read_ply_property
from homolog.transfer import field_of_match, point_distances


@pytest.fixture(scope="module")
def shapes(make):
    """A blob, and the same a tenth longer and shifted."""
    blob = make.blob(2)
    return blob, Shape(blob.points * [1, 1.1, 1] + [0, 0, 5], blob.faces)


@pytest.fixture
def match(shapes):
    same = np.arange(shapes[0].n_points)
    return Match(*shapes, same, same)


@pytest.fixture
def result(match, tmp_path):
    match.save(tmp_path / "result")
    return tmp_path / "result"


def test_the_field_takes_the_target_to_the_source(match, shapes):
    field, errors = field_of_match(match, spacing=0.1)
    truth = shapes[0].points - shapes[1].points
    away = np.linalg.norm(field.at(shapes[1].points) - truth, axis=1)
    assert away.max() < 0.05 and errors[1] < 0.03  # the smooth map slides a little along the surface
    back, _ = field_of_match(match.inverse(), spacing=0.1)
    assert np.linalg.norm(back.at(shapes[0].points) + truth, axis=1).max() < 0.05
    turned, _ = field_of_match(match, spacing=0.1, axes="RAS")
    flipped = [-1, -1, 1]
    np.testing.assert_allclose(turned.at(shapes[1].points * flipped), field.at(shapes[1].points) * flipped, atol=0.02)


def test_distances_before_and_after_alignment(match, shapes):
    found = point_distances(match)
    truth = np.linalg.norm(shapes[1].points - shapes[0].points, axis=1)
    np.testing.assert_allclose(found.distances, truth, atol=0.02)
    aligned = point_distances(match, align="rigid")
    assert aligned.distances.max() < 0.25 and aligned.distances.mean() < 0.1
    sphere_like = point_distances(match, align="similarity")
    assert sphere_like.distances.mean() < found.distances.mean()
    grown = Shape(1.05 * shapes[0].points, shapes[0].faces)
    same = np.arange(grown.n_points)
    assert (point_distances(Match(shapes[0], grown, same, same)).along_normals > 0).mean() > 0.95


def test_everything_is_written(homolog, result, match, tmp_path):
    pytest.importorskip("SimpleITK")
    ended = homolog(
        "export", result, "--field", tmp_path / "f.nrrd", "--spacing", 0.2, "--distances", tmp_path / "d.ply",
        "--table", tmp_path / "d.csv", "--map", tmp_path / "p2p.vts", "--particles", tmp_path / "p",
    )  # fmt: skip
    assert ended.code == 0, ended.err
    names = ("f.nrrd", "d.ply", "d.csv", "p2p.vts", "p/source.particles", "p/target.particles")
    assert ended.out.split() == [str(tmp_path / name) for name in names]
    assert "nodes 0.2 apart" in ended.err
    distances = read_ply_property(tmp_path / "d.ply", "distance")
    np.testing.assert_allclose(distances, point_distances(match).distances)
    with (tmp_path / "d.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["distance"]) for row in rows] == pytest.approx(distances)
    np.testing.assert_array_equal(read_point_map(tmp_path / "p2p.vts"), match.target_to_source)
    source, target = (np.loadtxt(tmp_path / "p" / f"{side}.particles") for side in ("source", "target"))
    np.testing.assert_array_equal(source, match.source.points)
    np.testing.assert_allclose(np.linalg.norm(target - source, axis=1), distances)


def test_the_other_way_round(homolog, result, match, tmp_path):
    ended = homolog("export", result, "--map", tmp_path / "m.mat", "--map-name", "p2p", "--reverse", "-q")
    assert (ended.code, ended.out) == (0, "")
    np.testing.assert_array_equal(read_point_map(tmp_path / "m.mat"), match.source_to_target)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ([], "nothing is to be written"),
        (["--field", "f.png"], "must be one of .nrrd"),
        (["--distances", "d.obj"], "must end with .ply"),
        (["--map", "m.dat"], "must end with one of .npz"),
        (["--map-name", "p2p", "--table", "t.csv"], "add --map FILE"),
        (["--table", "result/t.csv", "--spacing", "x"], "--spacing"),
        (["--distances", "result/source.ply"], "replaced by the result"),
        (["--field", "f.nrrd", "--spacing", "0.0001"], "give 0.0"),
    ],
)
def test_mistakes_are_one_line(homolog, result, monkeypatch, tmp_path, more, said):
    pytest.importorskip("SimpleITK")
    monkeypatch.chdir(tmp_path)
    ended = homolog("export", "result", *more)
    assert ended.is_one_line_of_complaint() and said in ended.err
    assert [path.name for path in tmp_path.iterdir()] == ["result"] and len(list(result.iterdir())) == 4


def test_a_ras_file_beside_an_lps_one(match):
    mixed = replace(match, source=replace(match.source, space="RAS"))
    with pytest.raises(ArgumentError, match="different anatomical axes"):
        field_of_match(mixed)
