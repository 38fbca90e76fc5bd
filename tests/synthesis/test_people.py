"""Making bodies and whole sets, with a stand-in for the body model; and, where its data are ready, with anny."""

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from stand_in import Crossing, StandIn, sphere

from homolog.core.errors import ArgumentError, MissingExtraError
from homolog.datasets import ShapeFolder
from homolog.geometry.surface import BarycentricPoints, Surface
from homolog.shapes import read_shape
from homolog.synthesis import (
    BodyModel,
    BodySettings,
    MeshSettings,
    People,
    make_body,
    production,
    remeshing,
    synthesize_people,
)
from homolog.synthesis.bodies import MOST_CROSSING
from homolog.synthesis.remeshing import is_one_closed_surface
from homolog.synthesis.self_intersections import self_intersection_share
from homolog.synthesis.template import boundary_loops, sample_evenly

SMALL = BodySettings(seed=3, mesh=MeshSettings(500))


@pytest.fixture(scope="module")
def points():
    return sample_evenly(StandIn().template.rest, 200)


@pytest.fixture
def workshop(monkeypatch):
    """Sets of stand-ins."""
    monkeypatch.setattr(production, "_body_model", StandIn)
    monkeypatch.setattr(production, "TEMPLATE_POINTS", 200)
    monkeypatch.setattr(remeshing, "_ROUNDS", 4)  # rough meshes do, and soon


def contents(root):
    return {path.relative_to(root): path.read_bytes() for path in sorted(root.rglob("*.*"))}


def test_a_body_depends_on_seed_and_number_alone(points):
    first, again = (make_body(People(StandIn()), points, SMALL, 4) for _ in range(2))
    np.testing.assert_array_equal(first.meshed.mesh.vertices, again.meshed.mesh.vertices)
    np.testing.assert_array_equal(first.meshed.at_points, again.meshed.at_points)
    assert first.character == again.character
    other = make_body(People(StandIn()), points, SMALL, 5)
    assert other.character.build != first.character.build
    assert other.meshed.mesh.faces.shape != first.meshed.mesh.faces.shape


def test_a_pose_that_crosses_is_drawn_back(points):
    settings = BodySettings(seed=0, mesh=MeshSettings(500))
    people = [make_body(People(Crossing()), points, settings, index) for index in (5, 8)]
    assert all(person.meshed.self_intersection <= MOST_CROSSING for person in people)
    assert min(person.character.pose_share for person in people) < 1.0


@pytest.mark.parametrize(
    "settings",
    [
        {"seed": -1},
        {"seed": 1.5},
        {"mesh": MeshSettings(vertices=10)},
        {"mesh": MeshSettings(stretch=0.5)},
        {"mesh": MeshSettings(stretch=float("nan"))},
    ],
)
def test_settings_out_of_range(settings):
    with pytest.raises(ArgumentError, match=r"must be a (whole )?number"):
        BodySettings(**settings)


def test_openings_are_closed():
    vertices, faces = sphere(3)
    cut = faces[(vertices[faces][:, :, 1] < 0.8).all(axis=1)]
    assert len(boundary_loops(cut)) == 1
    from homolog.synthesis.template import Template

    template = Template.of_outer_faces(cut, vertices, np.ones(len(vertices)))
    assert is_one_closed_surface(template.rest)
    assert is_one_closed_surface(template.surface(2.0 * vertices))
    assert len(template.rest.vertices) == len(np.unique(cut)) + 1


def test_a_set_is_a_folder_of_shapes_with_ground_truth(tmp_path, workshop):
    told = []
    synthesize_people(tmp_path / "set", 3, SMALL, progress=lambda *state: told.append(state))
    assert [done for done, _, _ in told] == [0, 0, 1, 2, 3]
    folder = ShapeFolder.open(tmp_path / "set")
    assert folder.names == ("person_00000", "person_00001", "person_00002")
    template = read_shape(tmp_path / "set" / "template" / "template.off")
    rest = Surface(template.points, template.faces)
    at = np.load(tmp_path / "set" / "template" / "points.npz", allow_pickle=False)
    points = BarycentricPoints(at["triangles"], at["weights"]).positions(rest)
    for name in folder.names:
        shape = folder.shape(name)
        assert is_one_closed_surface(Surface(shape.points, shape.faces))
        held = np.load(tmp_path / "set" / "barycentric" / f"{name}.npz", allow_pickle=False)
        places = BarycentricPoints(held["triangles"], held["weights"]).positions(rest)
        assert len(places) == shape.n_points
        # Stand-ins are the template made taller, which places bear out.
        build = json.loads((tmp_path / "set" / "records" / f"{name}.json").read_text())["build"]
        height = (0.5 + 0.5 * build["height"]) / 0.75
        np.testing.assert_allclose(shape.points, places * [1.0, height, 1.0], atol=1e-5)
        found = folder.template_correspondence(name)
        assert np.linalg.norm(places[found] - points, axis=1).max() < 0.12


def test_a_template_that_was_lost_is_written_again_and_bodies_beyond_those_asked_for_stay(tmp_path, workshop):
    synthesize_people(tmp_path, 3, SMALL)
    before = contents(tmp_path)
    for file in ("template.off", "points.npz"):
        (tmp_path / "template" / file).unlink()
    synthesize_people(tmp_path, 2, SMALL)
    assert contents(tmp_path) == before


def test_the_manifest_tells_everything(tmp_path, workshop):
    synthesize_people(tmp_path / "set", 2, SMALL)
    manifest = json.loads((tmp_path / "set" / "manifest.json").read_text())
    assert {asset["licence"] for asset in manifest["assets"]} == {"Apache-2.0", "CC0-1.0"}
    assert manifest["making"]["seed"] == 3
    assert manifest["making"]["vertices"] == 500
    assert "homolog" in manifest["versions"]
    for body in manifest["bodies"].values():
        assert {"build", "family", "angles", "crossing_share", "sha256"} <= set(body)
        assert body["crossing_share"] <= MOST_CROSSING


def test_the_same_seed_gives_the_same_bytes_and_a_longer_set_extends_a_shorter_one(tmp_path, workshop):
    synthesize_people(tmp_path / "short", 2, SMALL)
    synthesize_people(tmp_path / "long", 3, SMALL)
    short, long = contents(tmp_path / "short"), contents(tmp_path / "long")
    assert {name for name in short if short[name] != long[name]} == {Path("manifest.json")}
    synthesize_people(tmp_path / "short", 3, SMALL)
    assert contents(tmp_path / "short") == long


def test_going_on_makes_only_what_is_missing_or_damaged(tmp_path, workshop, monkeypatch):
    folder = synthesize_people(tmp_path, 4, SMALL)
    before = contents(tmp_path)
    (tmp_path / "records" / "person_00000.json").unlink()
    (tmp_path / "corres" / "person_00001.vts").unlink()
    (tmp_path / "off" / "person_00003.off").write_text("OFF\n")
    made = []
    write = type(folder).write_body
    monkeypatch.setattr(type(folder), "write_body", lambda *given: (made.append(given[1]), write(*given)))
    synthesize_people(tmp_path, 4, SMALL)
    assert made == ["person_00000", "person_00001", "person_00003"]
    assert contents(tmp_path) == before


def test_other_settings_need_another_folder(tmp_path, workshop):
    synthesize_people(tmp_path, 1, SMALL)
    before = contents(tmp_path)
    with pytest.raises(ArgumentError, match="seed 3, not 4"):
        synthesize_people(tmp_path, 1, BodySettings(seed=4, mesh=MeshSettings(500)))
    assert contents(tmp_path) == before


def test_a_folder_with_other_things_is_left_alone(tmp_path, workshop):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ArgumentError, match="holds other things; give another folder"):
        synthesize_people(tmp_path, 1, SMALL)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize("arguments", [{"n": 0}, {"n": 2, "processes": 0}])
def test_counts(tmp_path, workshop, arguments):
    with pytest.raises(ArgumentError, match="at least 1"):
        synthesize_people(tmp_path, **arguments)


def test_without_anny(monkeypatch):
    monkeypatch.setitem(sys.modules, "anny", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'homolog\[synth\]'"):
        BodyModel()


def anny_is_ready():
    """Whether anny has its data prepared, or may take its time to."""
    cache = Path(os.environ.get("ANNY_CACHE_DIR", Path.home() / ".cache" / "anny"))
    return "HOMOLOG_BODIES" in os.environ or any(cache.glob("*/build_model_data_*"))


@pytest.mark.bodies
@pytest.mark.skipif(
    not anny_is_ready(), reason="anny's data are not prepared; HOMOLOG_BODIES=1 does so, in two minutes"
)
def test_real_people(tmp_path):
    pytest.importorskip("anny")
    settings = BodySettings(seed=1, mesh=MeshSettings(2500))
    synthesize_people(tmp_path / "set", 2, settings, processes=2)
    again = synthesize_people(tmp_path / "again", 1, settings)
    for relative, path in again.files("person_00000").items():
        assert path.read_bytes() == (tmp_path / "set" / relative).read_bytes()
    folder = ShapeFolder.open(tmp_path / "set")
    for name in folder.names:
        shape = folder.shape(name)
        surface = Surface(shape.points, shape.faces)
        assert is_one_closed_surface(surface)
        assert self_intersection_share(surface) <= MOST_CROSSING
        assert shape.n_points == pytest.approx(2500, rel=0.08)
        assert shape.points[:, 1].min() == pytest.approx(0.0, abs=5e-3)
        assert 0.5 < np.ptp(shape.points[:, 1]) < 2.7
    shutil.rmtree(tmp_path / "again")
    assert trimesh.load(tmp_path / "set" / "template" / "template.off").is_watertight
