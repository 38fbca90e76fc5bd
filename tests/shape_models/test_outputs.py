"""What a collection comes to: arrays, tables and models agree with the shapes, and exports read back."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from homolog.core.errors import ArgumentError, DataError
from homolog.shape_models import (
    Figures,
    ModelSettings,
    Outcome,
    Registered,
    ShapeModelFolder,
    ShapeModelSettings,
    Subject,
    write_outputs,
)
from homolog.shape_models import model_files as model_files_module
from homolog.shape_models import overview as overview_module
from homolog.shape_models.registered_shapes import worst_first
from homolog.shapes import Shape, read_shape, write_shape
from homolog.statistics import generalisation, generalised_procrustes, principal_modes

h5py = pytest.importorskip("h5py")
pytest.importorskip("matplotlib")
image = pytest.importorskip("PIL.Image")

FIGURES = Figures(0.9, 1.0, 0.01, 1.1, 0.02, 0.9, 1.1)


@pytest.fixture
def template(make):
    return make.blob(1)


@pytest.fixture
def placed(template, tmp_path, make):
    """``placed(count)`` is a folder with so many moved and bent copies of the template, and what became of them."""

    def build(count, *, faces=True, doubtful=()):
        rng = np.random.default_rng(0)
        base = template if faces else template.as_cloud()
        folder, outcomes = ShapeModelFolder.prepare(tmp_path / "out", {"template": {"sha256": ""}}), []
        for number in range(count):
            points = base.points * rng.uniform(0.8, 1.2, 3) @ make.rotation(number).T + number
            file = tmp_path / f"shape{number}.ply"
            write_shape(file, Shape(points))
            warnings = ("the match has low confidence: because",) if number in doubtful else ()
            outcome = Outcome(Subject(f"shape{number}", file), FIGURES, warnings, seconds=1.0)
            folder.write(outcome, Registered(points, FIGURES, warnings), base, "")
            outcomes.append(outcome)
        return folder, base, outcomes

    return build


def table(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_the_array_and_the_table(placed, tmp_path):
    folder, template, outcomes = placed(4, doubtful=[2])
    failed = Outcome(Subject("none", tmp_path / "none, really.ply"), None, error="none.ply is empty")
    write_outputs(folder, template, [outcomes[0], failed, *outcomes[1:]])
    points = np.load(folder.root / "points.npy", allow_pickle=False)
    assert points.shape == (4, template.n_points, 3) and points.dtype == np.float64
    rows = table(folder.root / "quality.csv")
    assert [row["name"] for row in rows] == ["shape0", "none", "shape1", "shape2", "shape3"]
    assert [row["row"] for row in rows] == ["0", "", "1", "2", "3"]
    for row in rows:
        if row["row"]:
            np.testing.assert_array_equal(points[int(row["row"])], read_shape(folder.shape_file(row["name"])).points)
            assert float(row["flipped_triangles"]) == 0.02 and float(row["distance_from_mean"]) > 0
            assert row["ambiguous_orientation"] == "False"
    assert rows[1]["warnings"] == "not registered: none.ply is empty" and rows[1]["confidence"] == ""
    assert rows[1]["file"].endswith("none, really.ply")
    assert rows[3]["warnings"].startswith("the match has low confidence") and rows[2]["warnings"] == ""
    report = json.loads((folder.root / "report.json").read_text())
    assert report["not_registered"] == {"none": "none.ply is empty"} and list(report["warnings"]) == ["shape2"]
    assert all((folder.root / name).is_file() for name in report["files"])


def test_the_model_is_that_of_the_aligned_points(placed):
    folder, template, outcomes = placed(5)
    write_outputs(folder, template, outcomes, ModelSettings(scale=True, seed=3))
    points = np.load(folder.root / "points.npy")
    aligned = generalised_procrustes(points, scale=True, start=template.points)
    model, place = principal_modes(aligned.points), folder.root / "model"
    np.testing.assert_allclose(read_shape(place / "mean.ply").points, model.mean)
    np.testing.assert_array_equal(read_shape(place / "mean.ply").faces, template.faces)
    modes, rows = np.load(place / "modes.npy"), table(place / "curves.csv")
    np.testing.assert_allclose(modes, model.modes)
    assert [float(row["variance"]) for row in rows] == pytest.approx(model.variances)
    assert float(rows[-1]["compactness"]) == pytest.approx(1)
    left = generalisation(aligned.points).mean
    assert [float(row["generalisation"]) for row in rows[: len(left)]] == pytest.approx(left)
    assert rows[-1]["generalisation"] == ""
    read = table(place / "coefficients.csv")
    coefficients = np.array([[float(row[f"mode_{k + 1}"]) for k in range(len(modes))] for row in read])
    deviations = np.sqrt([float(row["variance"]) for row in rows])
    again = model.mean + np.tensordot(coefficients * deviations, modes, axes=1)
    np.testing.assert_allclose(again, aligned.points, atol=1e-4)
    with image.open(place / "curves.png") as curves:
        assert curves.width > 3 * curves.height


@pytest.mark.parametrize("faces", [True, False])
def test_shapeworks_reads_back(placed, faces):
    """As its readers do: numbers split by blanks, a matrix row by row, files beside the project."""
    folder, template, outcomes = placed(3, faces=faces)
    write_outputs(folder, template, outcomes, ModelSettings(scale=True))
    place, points = folder.root / "shapeworks", np.load(folder.root / "points.npy")
    project = json.loads((place / "collection.swproj").read_text())
    assert [entry["name"] for entry in project["data"]] == ["shape0", "shape1", "shape2"]
    worlds = []
    for entry, own in zip(project["data"], points, strict=True):
        assert all(isinstance(value, str) for value in entry.values())
        local, world = (read_particles(place / entry[f"{kind}_particles_1"]) for kind in ("local", "world"))
        np.testing.assert_array_equal(local, own)
        alignment, procrustes = (
            np.array(entry[key].split(), dtype=float).reshape(4, 4) for key in ("alignment_1", "procrustes_1")
        )
        np.testing.assert_array_equal(alignment, np.eye(4))
        np.testing.assert_allclose((np.c_[local, np.ones(len(local))] @ procrustes.T)[:, :3], world, atol=1e-9)
        if faces:
            mesh = read_shape(place / entry["groomed_1"])
            np.testing.assert_array_equal(mesh.points, own)
        else:
            assert not {"shape_1", "groomed_1"} & entry.keys()
        worlds.append(world)
    np.testing.assert_allclose(
        np.mean(worlds, axis=0), read_shape(folder.root / "model" / "mean.ply").points, atol=1e-9
    )


def read_particles(path):
    text = path.read_text()
    assert text.endswith("\n")
    return np.array(text.split(), dtype=float).reshape(-1, 3)


@pytest.mark.parametrize("faces", [True, False])
def test_scalismo_reads_back(placed, faces):
    """As its reader does: vectors point by point, points and cells as rows of x, y and z, all in single precision."""
    folder, template, outcomes = placed(4, faces=faces)
    write_outputs(folder, template, outcomes)
    model = np.load(folder.root / "model" / "modes.npy"), read_shape(folder.root / "model" / "mean.ply").points
    with h5py.File(folder.root / "scalismo" / "model.h5") as file:
        assert (file["version/majorVersion"][()], file["version/minorVersion"][()]) == (0, 9)
        kind = file["representer"].attrs["datasetType"]
        assert kind == (b"POLYGON_MESH" if faces else b"POINT_SET")
        assert file["representer"].attrs["name"] == b"itkStandardMeshRepresenter"
        reference, mean = file["representer/points"][()], file["model/mean"][()]
        basis, variances = file["model/pcaBasis"][()], file["model/pcaVariance"][()]
        assert {array.dtype for array in (reference, mean, basis, variances)} == {np.dtype(np.float32)}
        np.testing.assert_allclose(reference.T, model[1], atol=1e-6)
        np.testing.assert_allclose(mean.reshape(-1, 3), model[1], atol=1e-6)
        np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-5)
        np.testing.assert_allclose(basis.T.reshape(model[0].shape), model[0], atol=1e-6)
        if faces:
            cells = file["representer/cells"][()]
            assert cells.dtype == np.int32
            np.testing.assert_array_equal(cells.T, template.faces)
        else:
            assert "cells" not in file["representer"]
    aligned = generalised_procrustes(np.load(folder.root / "points.npy"), start=template.points).points
    np.testing.assert_allclose(variances.sum(), 3 * aligned.var(axis=0, ddof=1).mean() * template.n_points, rtol=1e-4)


def test_the_contact_sheet_has_the_worst_first(placed, tmp_path, monkeypatch):
    folder, template, outcomes = placed(4, doubtful=[1])
    worse = Outcome(outcomes[3].subject, replace(FIGURES, confidence=0.3), seconds=1.0)
    failed = Outcome(Subject("none", tmp_path / "none.ply"), None, error="none.ply is empty")
    seen = []
    drawn = overview_module.contact_sheet
    monkeypatch.setattr(overview_module, "contact_sheet", lambda tiles: seen.extend(tiles) or drawn(tiles))
    write_outputs(folder, template, [*outcomes[:3], worse, failed])
    assert [tile.title for tile in seen] == ["template", "1. none", "2. shape1", "3. shape3", "4. shape0", "5. shape2"]
    sheet = {row["name"]: row["sheet"] for row in table(folder.root / "quality.csv")}
    assert sheet == {"none": "1", "shape1": "2", "shape3": "3", "shape0": "4", "shape2": "5"}
    assert [tile.alarming for tile in seen] == [False, True, True, False, False, False]
    assert seen[1].points is None and seen[2].lines[-1] == "see warnings"
    with image.open(folder.root / "contact_sheet.png") as sheet:
        pixels = np.asarray(sheet.convert("RGB")).astype(int)
    assert (np.ptp(pixels, axis=2) > 40).mean() > 0.02  # coloured shapes on white


@pytest.mark.parametrize("count", [1, 2])
def test_few_shapes(placed, count):
    """One has no modes; two have one, of which nothing can be left out."""
    folder, template, outcomes = placed(count)
    files = write_outputs(folder, template, outcomes)
    assert (folder.root / "points.npy").is_file()
    assert (folder.root / "model" in files) == (folder.root / "model" / "modes.html").is_file() == (count == 2)
    if count == 2:
        assert [row["generalisation"] for row in table(folder.root / "model" / "curves.csv")] == [""]


def test_what_no_longer_holds_is_taken_away(placed):
    folder, template, outcomes = placed(3)
    write_outputs(folder, template, outcomes)
    own = folder.root / "shapeworks" / "mine.txt"
    own.write_text("kept")
    write_outputs(folder, template, outcomes[:2])
    particles = sorted(path.name for path in (folder.root / "shapeworks" / "particles").iterdir())
    assert particles == [f"shape{number}_{kind}.particles" for number in (0, 1) for kind in ("local", "world")]
    assert np.load(folder.root / "points.npy").shape[0] == 2
    assert folder.others([outcome.subject for outcome in outcomes[:2]]) == ["shape2"]
    write_outputs(folder, template, outcomes[:1])
    assert own.read_text() == "kept"
    own.unlink()
    write_outputs(folder, template, outcomes[:1])
    assert not any((folder.root / name).exists() for name in ("model", "shapeworks", "scalismo"))


@pytest.mark.slow
def test_a_report_from_elsewhere_takes_nothing_away_that_is_not_ours(placed, tmp_path):
    folder, template, outcomes = placed(3)
    write_outputs(folder, template, outcomes)
    mine = tmp_path / "mine.txt"
    mine.write_text("kept")
    for files in (["../mine.txt", str(mine), "shapes/shape0.ply", 7], 7):
        report = json.loads((folder.root / "report.json").read_text())
        (folder.root / "report.json").write_text(json.dumps({**report, "files": files}))
        write_outputs(folder, template, outcomes)
        assert mine.read_text() == "kept" and (folder.root / "shapes" / "shape0.ply").is_file()


def test_the_same_shapes_give_the_same_bytes(placed):
    folder, template, outcomes = placed(3)

    def contents():
        write_outputs(folder, template, outcomes)
        return {path: path.read_bytes() for path in folder.root.rglob("*") if path.is_file() and path.suffix != ".h5"}

    assert contents() == contents()


def test_nothing_is_left_half_written(placed, monkeypatch):
    folder, template, outcomes = placed(3)
    write_outputs(folder, template, outcomes)
    before = {path: path.read_bytes() for path in folder.root.rglob("*") if path.is_file()}

    def fail(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(model_files_module, "write_scalismo", fail)
    with pytest.raises(OSError, match="No space"):
        write_outputs(folder, template, outcomes[:2])
    assert {path: path.read_bytes() for path in folder.root.rglob("*") if path.is_file()} == before


def test_a_delivery_that_fails_leaves_no_empty_folder(placed, monkeypatch):
    folder, template, outcomes = placed(3)
    before = sorted(folder.root.rglob("*"))
    monkeypatch.setattr(model_files_module, "write_scalismo", lambda *args: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_outputs(folder, template, outcomes)
    assert sorted(folder.root.rglob("*")) == before


def test_where_all_fail_the_files_are_those_of_this_time(placed):
    folder, template, outcomes = placed(3)
    write_outputs(folder, template, outcomes)
    failed = [Outcome(outcome.subject, None, error=f"{outcome.subject.name} is empty") for outcome in outcomes]
    with pytest.raises(DataError, match="none of the 3 shapes could be registered"):
        write_outputs(folder, template, failed)
    rows = table(folder.root / "quality.csv")
    assert [row["warnings"] for row in rows] == [f"not registered: shape{number} is empty" for number in range(3)]
    assert list(json.loads((folder.root / "report.json").read_text())["not_registered"]) == [
        "shape0",
        "shape1",
        "shape2",
    ]
    assert not (folder.root / "points.npy").exists() and not (folder.root / "model").exists()


def test_the_worst_first(tmp_path):
    """Of shapes that are alike in all but one figure, and of one that is worst in one and best in two."""

    def placed(name, *warnings, **figures):
        return Outcome(Subject(name, tmp_path / name), replace(FIGURES, **figures), warnings)

    good = placed("good")
    for worse in ({"confidence": 0.8}, {"dirichlet_energy": 1.2}, {"edges_5": 0.8}, {"edges_95": 1.2}):
        bad = placed("bad", **worse)
        assert worst_first([good, bad]) == worst_first([bad, good]) == [bad, good]
    flipped = placed("flipped", flipped_triangles=0.5)
    assert worst_first([good, flipped]) == [good, flipped]
    failed = Outcome(Subject("failed", tmp_path / "failed"), None, error="empty")
    doubtful = placed("see warnings", "because", confidence=1.0)
    mixed = placed("mixed", confidence=0.7, dirichlet_energy=1.0, edges_95=1.05)
    bad = placed("bad", dirichlet_energy=3.0, edges_95=2.0)
    assert worst_first([good, mixed, bad, doubtful, failed]) == [failed, doubtful, bad, good, mixed]
    assert worst_first([failed]) == [failed]


def test_names_that_look_like_formulas_stay_names(placed, tmp_path):
    folder, template, outcomes = placed(2)
    failed = Outcome(Subject("=1+1", Path("=1+1.ply")), None, error="=1+1.ply is empty")
    write_outputs(folder, template, [*outcomes, failed])
    row = table(folder.root / "quality.csv")[2]
    assert (row["name"], row["file"]) == ("'=1+1", "'=1+1.ply")


def test_refused(placed, tmp_path, make):
    folder, template, outcomes = placed(2)
    failed = Outcome(Subject("none", tmp_path / "none.ply"), None, error="none.ply is empty")
    with pytest.raises(DataError, match="none of the 1 shapes could be registered"):
        write_outputs(folder, template, [failed])
    with pytest.raises(DataError, match="has 42 points, but the template has 162"):
        write_outputs(folder, make.blob(2), outcomes)


@pytest.mark.parametrize(
    ("kind", "values", "said"),
    [
        (ModelSettings, {"seed": -1}, "seed is -1, but must be a whole number of at least 0"),
        (ModelSettings, {"shapes_up": "w"}, "shapes_up is 'w', but must be one of x, y, z"),
        (ShapeModelSettings, {"strict": "no"}, "strict is 'no', but must be true or false"),
    ],
)
def test_settings_that_cannot_be_are_refused(kind, values, said):
    with pytest.raises(ArgumentError, match=said):
        kind(**values)


def test_many_shapes_have_the_first_modes_alone_and_all_the_variance(placed, monkeypatch):
    folder, template, outcomes = placed(6)
    write_outputs(folder, template, outcomes)
    every, told = np.load(folder.root / "model" / "modes.npy"), json.loads((folder.root / "report.json").read_text())
    points = (folder.root / "points.npy").read_bytes()
    monkeypatch.setattr("homolog.shape_models.registered_shapes._FEW", 5)
    monkeypatch.setattr("homolog.shape_models.registered_shapes.MOST_MODES", 2)
    write_outputs(folder, template, outcomes)
    some, now = np.load(folder.root / "model" / "modes.npy"), json.loads((folder.root / "report.json").read_text())
    assert (some == every[:2]).all() and len(every) == told["modes"] > 2 == now["modes"]
    assert now["variance"] == pytest.approx(told["variance"])
    assert (folder.root / "points.npy").read_bytes() == points
    with (folder.root / "model" / "curves.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 and float(rows[1]["compactness"]) < 1
