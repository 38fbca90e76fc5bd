"""``homolog symmetry``: mirror partners, the plane, heat maps and a mirrored copy."""

import csv
import json

import numpy as np
import pytest
import trimesh

from homolog.shapes import Shape, read_shape, write_shape


@pytest.fixture
def egg(tmp_path):
    """A shape that only z = 3 divides into mirror images, and the partner of each of its points."""
    sphere = trimesh.creation.icosphere(subdivisions=3)
    x, y, _ = sphere.vertices.T
    points = sphere.vertices * (1 + 0.3 * y + 0.2 * x * y + 0.3 * np.exp(-((x - 0.8) ** 2 + y**2) / 0.1))[:, None]
    write_shape(tmp_path / "egg.ply", Shape(points * [2, 3, 1] + [0, 0, 3], sphere.faces))
    partner = np.linalg.norm(points[:, None] * [1, 1, -1] - points, axis=2).argmin(axis=1)
    return tmp_path / "egg.ply", partner


@pytest.mark.slow
def test_partners_plane_and_mirrored_copy_are_written(homolog, egg, tmp_path):
    file, partner = egg
    page, picture = tmp_path / "egg.html", tmp_path / "egg.png"
    ended = homolog(
        "symmetry", file, "-o", tmp_path / "out", "--method", "registration", "--html", page, "--picture", picture
    )
    assert ended.code == 0, ended.err
    assert ended.out.split() == [
        *(str(tmp_path / "out" / name) for name in ("points.csv", "asymmetry.ply", "stretch.ply", "mirrored.ply")),
        *(str(each) for each in (tmp_path / "out" / "symmetry.json", page, picture)),
    ]
    assert "normal (0.0000, 0.0000, 1.0000), offset 3," in ended.err
    with (tmp_path / "out" / "points.csv").open() as table:
        assert [int(row["partner"]) for row in csv.DictReader(table)] == partner.tolist()
    report = json.loads((tmp_path / "out" / "symmetry.json").read_text())
    assert report["plane"]["offset"] == pytest.approx(3, abs=1e-6)
    assert report["asymmetry"]["largest"] < 1e-6
    assert report["match"]["inputs"]["source"]["file"] == str(file)
    given, mirrored = read_shape(file), read_shape(tmp_path / "out" / "mirrored.ply")
    assert mirrored.points == pytest.approx(given.points, abs=1e-6)
    assert "Asymmetry" in page.read_text() and picture.read_bytes().startswith(b"\x89PNG")


def test_an_ambiguous_plane_is_said(homolog, tmp_path):
    sphere = trimesh.creation.icosphere(subdivisions=2)
    write_shape(tmp_path / "ellipsoid.off", Shape(sphere.vertices * [3, 2, 1], sphere.faces))
    ended = homolog("symmetry", tmp_path / "ellipsoid.off", "-o", tmp_path / "out", "--method", "registration")
    assert ended.code == 0
    assert "more than one mirror plane" in ended.err and "--orient given" in ended.err
    assert "--alternatives" not in ended.err


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["missing.ply"], "missing.ply"),
        (["egg.ply", "--picture", "a.jpg"], "a.jpg"),
        (["egg.ply", "--lines", "3"], "--picture FILE.png"),
        (["egg.ply", "-o", "egg.ply"], "egg.ply"),
        (["egg.ply", "--partial", "source"], "No such option: --partial"),
    ],
)
def test_mistakes_are_one_line(homolog, egg, monkeypatch, tmp_path, more, said):
    monkeypatch.chdir(tmp_path)
    ended = homolog("symmetry", *more)
    assert ended.is_one_line_of_complaint() and said in ended.err
    assert [path.name for path in tmp_path.iterdir()] == ["egg.ply"]


def test_a_scan_that_would_be_replaced_is_refused(homolog, egg, tmp_path):
    file, _ = egg
    scan = file.rename(tmp_path / "asymmetry.ply")
    before = scan.read_bytes()
    ended = homolog("symmetry", scan, "-o", tmp_path)
    assert ended.is_one_line_of_complaint() and scan.read_bytes() == before
