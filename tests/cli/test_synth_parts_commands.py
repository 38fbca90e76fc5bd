"""``homolog synth views``, ``homolog synth meshings`` and ``homolog synth part``."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from homolog.shapes import Shape, read_shape, write_shape
from homolog.synthesis import ViewSettings


@pytest.fixture
def bodies(tmp_path, make):
    (tmp_path / "bodies").mkdir()
    for seed in range(3):
        write_shape(
            tmp_path / "bodies" / f"body{seed}.off", Shape(make.blob(2).points * (1 + seed), make.blob(2).faces)
        )
    return tmp_path / "bodies"


@pytest.mark.slow
def test_views(homolog, bodies, tmp_path):
    options = ["-n", 5, "--seed", 2, "--pixels", 30, 40, "--distance", 2, 2.5, "--elevation", 0, 10, "--noise", 0.01]
    for name in ("one", "two"):
        ended = homolog("synth", "views", bodies, "-o", tmp_path / name, *options)
        assert (ended.code, ended.out.strip(), ended.err) == (0, str(tmp_path / name), "")
    manifest = json.loads((tmp_path / "one" / "manifest.json").read_text())
    expected = {"seed": 2, "distance": [2, 2.5], "elevation": [0, 10], "pixels": [30, 40], "noise": 0.01}
    assert expected.items() <= manifest["making"].items() and len(manifest["views"]) == 5
    files = [path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*") if path.is_file()]
    assert len(files) == 4 + 5 * 4 + len({view[key] for view in manifest["views"] for key in ("viewed", "full")})
    assert all((tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes() for file in files)


def test_views_have_the_defaults_of_the_library(homolog, bodies, tmp_path):
    assert homolog("synth", "views", bodies, "-o", tmp_path / "views", "-n", 5, "--quiet").out == ""
    making = json.loads((tmp_path / "views" / "manifest.json").read_text())["making"]
    for key, value in asdict(ViewSettings()).items():
        assert making[key] == (list(value) if isinstance(value, tuple) else value)


@pytest.mark.parametrize("options", [["-n", 4], ["--distance", 3, 2], ["--elevation", 0, 90], ["--pixels", 0, 9]])
def test_views_that_cannot_be(homolog, bodies, tmp_path, options):
    ended = homolog("synth", "views", bodies, "-o", tmp_path / "views", *options)
    assert ended.is_one_line_of_complaint()
    assert not (tmp_path / "views").exists()


def test_views_of_nothing(homolog, tmp_path):
    assert homolog("synth", "views", tmp_path / "nowhere", "-o", tmp_path / "views").is_one_line_of_complaint()


@pytest.mark.parametrize("kind", ["cut", "holes", "view"])
def test_a_part_leads_back_to_the_points_of_the_file(homolog, files, tmp_path, make, kind):
    """Also where the file needs repair: a stray point comes before all others."""
    blob = make.blob(3)
    given = Shape(np.concatenate([[[9, 9, 9]], blob.points]), blob.faces + 1)
    write_shape(tmp_path / "given.ply", given)
    ended = homolog("synth", "part", tmp_path / "given.ply", "--kind", kind, "--seed", 3, "-o", tmp_path / "out")
    assert (ended.code, ended.out.strip(), ended.err) == (0, str(tmp_path / "out"), "")
    expected = {"part.ply", "part.npz"} | ({"cloud.ply", "cloud.npz"} if kind == "view" else set())
    assert {path.name for path in (tmp_path / "out").iterdir()} == expected
    part = read_shape(tmp_path / "out" / "part.ply")
    with np.load(tmp_path / "out" / "part.npz") as stored:
        assert np.array_equal(part.points, given.points[stored["full_index"]])
    assert 0 < part.n_faces < given.n_faces
    if kind == "view":
        cloud = read_shape(tmp_path / "out" / "cloud.ply")
        with np.load(tmp_path / "out" / "cloud.npz") as stored:
            places = np.einsum("nk,nkd->nd", stored["weights"], given.points[stored["corners"]])
            assert cloud.points == pytest.approx(places, abs=1e-12)
            assert (stored["full_index"][:, None] == stored["corners"]).any(axis=1).all()


def test_a_folder_holds_one_part(homolog, files, tmp_path):
    place = tmp_path / "out"
    for kind, names in (
        ("view", {"part.ply", "part.npz", "cloud.ply", "cloud.npz"}),
        ("cut", {"part.ply", "part.npz"}),
    ):
        assert homolog("synth", "part", files.mesh, "--kind", kind, "-o", place).code == 0
        assert {path.name for path in place.iterdir()} == names
    (place / "notes.txt").touch()
    ended = homolog("synth", "part", files.mesh, "--kind", "view", "-o", place)
    assert ended.is_one_line_of_complaint() and "holds other things" in ended.err
    assert {path.name for path in place.iterdir()} == {"part.ply", "part.npz", "notes.txt"}


def test_parts_that_cannot_be(homolog, files, tmp_path):
    for file in (files.cloud, files.rubbish, tmp_path / "nowhere.ply"):
        ended = homolog("synth", "part", file, "--kind", "cut", "-o", tmp_path / "out")
        assert ended.is_one_line_of_complaint()
    assert not (tmp_path / "out").exists()
    ended = homolog("synth", "part", files.mesh, "--kind", "cut", "-o", files.mesh)
    assert ended.is_one_line_of_complaint()
    assert homolog("synth", "part", files.mesh, "--kind", "slice").is_one_line_of_complaint()


@pytest.mark.slow
def test_a_set_of_views_is_scored_as_it_is(homolog, make, tmp_path):
    """Of two views of copies of one blob the axiomatic way finds something; each target is scored where it is seen."""
    blob = make.blob(3)
    (tmp_path / "bodies" / "off").mkdir(parents=True)
    (tmp_path / "bodies" / "corres").mkdir()
    for name in ("a", "b"):
        write_shape(tmp_path / "bodies" / "off" / f"{name}.off", blob)
        lines = "\n".join(map(str, range(1, blob.n_points + 1)))
        (tmp_path / "bodies" / "corres" / f"{name}.vts").write_text(lines)
    homolog("synth", "views", tmp_path / "bodies", "-o", tmp_path / "views", "-n", 10)
    ended = homolog(
        "evaluate", tmp_path / "views", "--partial", "--method", "axiomatic", "--json", tmp_path / "score.json"
    )
    assert (ended.code, ended.err) == (0, "") and "partial" in ended.out
    found = json.loads((tmp_path / "score.json").read_text())
    assert found["protocol"]["partial"]
    views = {entry["name"]: entry for entry in json.loads((tmp_path / "views" / "manifest.json").read_text())["views"]}
    assert len(found["pairs"]) == 2
    for pair in found["pairs"]:
        assert pair["points"] == views[pair["target"]]["mesh_points"]
        assert pair["source"] == views[pair["target"]]["full"]
    # A point at random is some 60 away.
    assert found["mean_geodesic_error"] < 40


def test_meshings(homolog, tmp_path, make):
    blob = make.blob(2)
    for folder in ("off", "corres"):
        (tmp_path / "set" / folder).mkdir(parents=True)
    for name in ("one", "two"):
        write_shape(tmp_path / "set" / "off" / f"{name}.off", blob)
        (tmp_path / "set" / "corres" / f"{name}.vts").write_text("1\n2\n3")
    options = ["--vertices", 500, "--split", "all", "--processes", 1]
    ended = homolog("synth", "meshings", tmp_path / "set", "-o", tmp_path / "out", *options)
    assert (ended.code, ended.out.strip(), ended.err) == (0, str(tmp_path / "out"), "")
    making = json.loads((tmp_path / "out" / "manifest.json").read_text())["making"]
    assert {"vertices": 500, "stretch": 3.0, "seed": 0}.items() <= making.items()
    assert read_shape(tmp_path / "out" / "off" / "one.off").n_points == pytest.approx(500, rel=0.1)
