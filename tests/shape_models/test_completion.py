"""Completing fragments by a shape model: synthetic families whose truth is known, and what is written."""

import csv
import json

import numpy as np
import pytest

from homolog.core.errors import ArgumentError, DataError
from homolog.matching import Match
from homolog.shape_models import (
    Figures,
    ModelFitSettings,
    Outcome,
    Registered,
    ShapeModelFolder,
    StoredModel,
    Subject,
    TemplateLandmarks,
    complete,
    write_completion,
    write_outputs,
)
from homolog.shape_models.completion import _placement
from homolog.shapes import Shape, read_shape, write_shape
from homolog.shapes.formats.ply import read_ply_property

pytest.importorskip("h5py")
pytest.importorskip("matplotlib")
FIGURES = Figures(0.9, 1.0, 0.01, 1.1, 0.02, 0.9, 1.1)
TOP = [0.1, 1.2, 0.1]
LANDMARKS = {"top": 0, "side": 40, "other": 100}


def member(blob, amounts):
    """A shape of the family, which has three ways to vary."""
    _, y, z = blob.points.T
    length, bend, bulge = amounts
    offsets = np.stack([0.15 * bend * y**2, 0.25 * length * y, 0.2 * bulge * z * (1 + y)], axis=1)
    return blob.points + offsets


@pytest.fixture(scope="module")
def collection(make, tmp_path_factory):
    """A collection of ten shapes of the family, with three landmarks."""
    root, blob, random = tmp_path_factory.mktemp("family"), make.blob(2), np.random.default_rng(0)
    rows = [f"{name},{','.join(map(str, blob.points[index]))}" for name, index in LANDMARKS.items()]
    (root / "marks.csv").write_text("\n".join(["label,x,y,z", *rows]) + "\n")
    folder, outcomes = ShapeModelFolder.prepare(root / "out", {"template": {"sha256": ""}}), []
    for number in range(10):
        points = member(blob, random.standard_normal(3)) + 0.003 * random.standard_normal(blob.points.shape)
        file = root / f"shape{number}.ply"
        write_shape(file, Shape(points, blob.faces))
        outcome = Outcome(Subject(f"shape{number}", file), FIGURES)
        folder.write(outcome, Registered(points, FIGURES, ()), blob, "")
        outcomes.append(outcome)
    write_outputs(folder, blob, outcomes, landmarks=TemplateLandmarks(root / "marks.csv", blob))
    return root / "out"


@pytest.fixture(scope="module")
def stored(collection):
    return StoredModel.read(collection)


@pytest.fixture(scope="module")
def case(make):
    """A shape of the family that the model was not made of, turned and moved; and the lower part of it."""
    blob = make.blob(2)
    whole = member(blob, [0.8, -0.6, 0.9]) @ make.rotation(5).T + [3.0, -2.0, 1.0]
    kept = blob.points[:, 1] < 0.35
    faces = blob.faces[kept[blob.faces].all(axis=1)]
    used = np.unique(faces)
    place = np.full(len(whole), -1)
    place[used] = np.arange(len(used))
    return whole, used, Shape(whole[used], place[faces], name="fragment")


@pytest.fixture(scope="module")
def upright(stored, case):
    """The same part of another shape, where the model's mean lies."""
    return Shape(stored.model.shapes(np.array([[0.5, -0.3, 0.2]]))[0][case[1]], case[2].faces, name="fragment")


def table(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_stored_model_is_the_one_that_was_written(collection, stored):
    assert stored.names[:2] == ("shape0", "shape1") and stored.points().shape == (10, 162, 3)
    assert stored.deviation == pytest.approx(0.003, rel=0.6)  # the noise, which no mode holds
    names, places = stored.landmarks()
    assert names == tuple(LANDMARKS)
    at = places.interpolate(stored.mean.points)
    np.testing.assert_allclose(at, stored.mean.points[list(LANDMARKS.values())], atol=0.01)


def test_a_fragment_in_any_place_is_completed(stored, case):
    """Without a match: its place is found as that of a rigid body, and what is missing follows from the model."""
    whole, used, fragment = case
    found = complete(fragment, stored, settings=ModelFitSettings(samples=150))
    away = np.linalg.norm(found.shape.points - whole, axis=1)
    missing = np.setdiff1d(np.arange(len(whole)), used)
    assert away[missing].mean() < 0.03 and away.max() < 0.1  # of a shape that is 2.8 long
    assert found.observed[used].mean() > 0.95 and found.observed[missing].mean() < 0.25
    assert found.deviations[missing].mean() > 1.3 * found.deviations[used].mean()
    assert (away <= 3 * found.deviations).mean() > 0.9
    assert set(found.landmarks) == set(LANDMARKS) and found.match is None
    for name, index in LANDMARKS.items():
        assert np.linalg.norm(found.landmarks[name] - whole[index]) < 0.06
        assert found.landmark_deviations[name] == pytest.approx(found.deviations[index], rel=0.2)


def test_another_size(stored, case):
    whole, _, fragment = case
    larger = Shape(1.15 * fragment.points, fragment.faces)
    found = complete(larger, stored, settings=ModelFitSettings(samples=150, scale=True))
    assert found.fit.posterior.placement.scale == pytest.approx(1.15, rel=0.03)
    np.testing.assert_allclose(found.shape.points, 1.15 * whole, atol=0.15)


def test_as_given(stored, upright):
    given = complete(upright, stored, settings=ModelFitSettings(samples=150), orient="given")
    near = np.linalg.norm(given.shape.points[:, None] - upright.points, axis=2).min(axis=0)
    assert near.max() < 0.1 and given.misfit_elsewhere is None
    assert given.fit.misfit < 2 and given.warnings == ()


@pytest.mark.parametrize("scale", [False, True])
def test_a_match_gives_a_start(case, make, scale):
    """Where the mean is the whole shape, its points lie there exactly."""
    whole, used, fragment = case
    before = Shape((whole - 2) @ make.rotation(8), make.blob(2).faces)
    there = np.full(len(whole), -1)
    there[used] = np.arange(len(used))
    start = _placement(Match(fragment, before, used, there), scale=scale)
    np.testing.assert_allclose(start(before.points), whole, atol=1e-6)


def test_what_is_written_reads_back(stored, upright, tmp_path):
    (tmp_path / "known.csv").write_text(f"label,x,y,z\ntop,{','.join(map(str, TOP))}\nunknown,0,0,0\n")
    settings = ModelFitSettings(samples=100)
    found = complete(upright, stored, settings=settings, landmarks=tmp_path / "known.csv", orient="given")
    paths = write_completion(tmp_path / "out", found)
    assert [path.name for path in paths] == ["completed.ply", "points.csv", "landmarks.csv", "completion.json"]
    shape = read_shape(paths[0])
    np.testing.assert_array_equal(shape.points, found.shape.points)
    np.testing.assert_array_equal(read_ply_property(paths[0], "deviation"), found.deviations)
    np.testing.assert_array_equal(read_ply_property(paths[0], "observed"), found.observed)
    rows = table(paths[1])
    assert [float(row["deviation"]) for row in rows] == found.deviations.tolist()
    marks = {row["landmark"]: row for row in table(paths[2])}
    assert float(marks["top"]["deviation"]) == 0 and float(marks["side"]["deviation"]) > 0
    assert float(marks["top"]["x"]) == pytest.approx(TOP[0])
    report = json.loads(paths[3].read_text())
    assert report["points"] == found.shape.n_points and report["misfit"] < 9


def test_mistakes_are_named(stored, case, tmp_path, collection):
    (tmp_path / "known.csv").write_text("label,x,y,z\nnose,0,0,0\n")
    with pytest.raises(ArgumentError, match="which are top, side, other"):
        complete(case[2], stored, landmarks=tmp_path / "known.csv")
    with pytest.raises(DataError, match="is no collection"):
        StoredModel.read(tmp_path)
