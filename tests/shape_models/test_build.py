"""Building a shape model in one call: all files of one folder, resumed, and inputs that stay as they are."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from test_template_registration import on_triangles
from without_weights import axiomatic

from homolog.core.errors import ArgumentError, DataError
from homolog.shape_models import (
    ModelSettings,
    ShapeModelFolder,
    ShapeModelSettings,
    TemplateLandmarks,
    build,
    listed_files,
)
from homolog.shapes import read_shape
from homolog.transfer import read_landmarks

pytest.importorskip("h5py")
pytest.importorskip("matplotlib")
pytest.importorskip("PIL.Image")


def test_one_call_registers_and_models(family, tmp_path):
    template, files, true = family
    new = []
    options = {"listener": lambda outcome: new.append(outcome.subject.name), "report": {"mine": 1}}
    built = build(template, files[:2], tmp_path / "out", axiomatic(), model=ModelSettings(scale=True), **options)
    assert new == ["copy0", "copy1"] and [outcome.error for outcome in built.outcomes] == ["", ""]
    points = np.load(built.folder.root / "points.npy")
    np.testing.assert_array_equal(points[1], read_shape(built.folder.shape_file("copy1")).points)
    assert np.linalg.norm(points - true[:2], axis=2).mean() < 0.1
    report = json.loads((built.folder.root / "report.json").read_text())
    assert report["mine"] == 1 and report["inputs"]["template"] == str(template) and report["statistics"]["scale"]
    assert all(path.exists() for path in built.files)
    again = build(template, files, tmp_path / "out", axiomatic, **options)
    assert new == ["copy0", "copy1", "copy2"] and len(again.outcomes) == 3
    with pytest.raises(ArgumentError, match=r"made in another way \(matching\)"):
        build(template, files, tmp_path / "out", axiomatic(), settings=ShapeModelSettings(strict=True))


def test_inputs_are_never_replaced(family, tmp_path):
    template, files, _ = family
    inside = tmp_path / "out" / "scan.ply"
    inside.parent.mkdir()
    inside.write_bytes(files[0].read_bytes())
    with pytest.raises(ArgumentError, match=r"lies in .*out, where the result is written"):
        build(template, [inside], tmp_path / "out", axiomatic())
    (tmp_path / "linked" / "shapes").mkdir(parents=True)
    (tmp_path / "linked" / "shapes" / "copy0.ply").hardlink_to(files[0])
    with pytest.raises(ArgumentError, match="is an input and would be replaced"):
        build(template, files[:1], tmp_path / "linked", axiomatic())


def test_several_processes_need_a_function(family, tmp_path):
    template, files, _ = family
    with pytest.raises(ArgumentError, match="need a function that makes the matcher"):
        build(template, files, tmp_path / "out", axiomatic(), processes=2)
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def registered(family, tmp_path_factory):
    """A folder of which all shapes are registered."""
    template, files, _ = family
    root = tmp_path_factory.mktemp("registered") / "out"
    build(template, files, root, axiomatic())
    return root


@pytest.mark.parametrize("suffix", [".json", ".mrk.json", ".fcsv", ".csv"])
def test_landmarks_are_carried_to_all_shapes(family, registered, tmp_path, suffix):
    """Corners and middles of the template's triangles come where the true copies have them."""
    template, files, true = family
    shape = read_shape(template)
    corners, middles = shape.points[[3, 50]], shape.points[shape.faces[[7, 90]]].mean(axis=1)
    given, names = np.concatenate([corners, middles]), ["A", "B", "C", "D"]
    rows = list(zip(names, given.tolist(), strict=True))
    texts = {
        ".json": json.dumps([{"id": name, "coordinates": at} for name, at in rows]),
        ".mrk.json": json.dumps(
            {"markups": [{"controlPoints": [{"label": name, "position": at} for name, at in rows]}]}
        ),
        ".fcsv": "# CoordinateSystem = LPS\n" + "".join(f"{name},{x},{y},{z}\n" for name, (x, y, z) in rows),
        ".csv": "".join(f"{name},{x},{y},{z}\n" for name, (x, y, z) in rows),
    }
    marks = tmp_path / f"marks{suffix}"
    marks.write_text(texts[suffix])
    root = tmp_path / "out"
    shutil.copytree(registered, root)
    built = build(template, files, root, axiomatic(), landmarks=marks)
    assert built.warnings == () and marks.read_text() == texts[suffix]
    table = list(csv.DictReader((root / "landmarks.csv").read_text().splitlines()))
    assert [(row["shape"], row["landmark"]) for row in table] == [(f.stem, name) for f in files for name in names]
    in_table = np.array([[float(row[axis]) for axis in "xyz"] for row in table]).reshape(3, 4, 3)
    for number, file in enumerate(files):
        found = read_landmarks(root / "landmarks" / f"{file.stem}{suffix}")
        there = np.concatenate([true[number][[3, 50]], true[number][shape.faces[[7, 90]]].mean(axis=1)])
        assert found.names == tuple(names)
        assert np.linalg.norm(found.points - there, axis=1).max() < 0.2
        np.testing.assert_allclose(in_table[number], found.points)
        subject = read_shape(file)
        assert on_triangles(found.points, subject.points[subject.faces]).all()
    report = json.loads((root / "report.json").read_text())["landmarks"]
    assert report["names"] == names and report["largest_distance_from_template"] < 1e-6
    build(template, files, root, axiomatic())
    assert not (root / "landmarks").exists() and not (root / "landmarks.csv").exists()


def test_landmarks_in_other_axes(family, tmp_path):
    template, files, true = family
    point = read_shape(template).points[20]
    (tmp_path / "ras.fcsv").write_text(f"# CoordinateSystem = RAS\nA,{-point[0]},{-point[1]},{point[2]}\n")
    build(template, files[:1], tmp_path / "out", axiomatic(), landmarks=tmp_path / "ras.fcsv")
    found = read_landmarks(tmp_path / "out" / "landmarks" / "copy0.fcsv")
    assert found.system == "RAS" and np.linalg.norm(found.points_in("LPS")[0] - true[0][20]) < 0.2
    build(template, files[:1], tmp_path / "out", axiomatic(), landmarks=tmp_path / "ras.fcsv", axes="RAS")
    there = read_landmarks(tmp_path / "out" / "landmarks" / "copy0.fcsv").points[0]
    turned = np.argmin(np.linalg.norm(read_shape(template).points - point * [-1, -1, 1], axis=1))
    assert np.linalg.norm(there - true[0][turned]) < 0.4
    inside = tmp_path / "out" / "mine.csv"
    inside.write_text("A,1,2,3\n")
    with pytest.raises(ArgumentError, match=r"mine.csv lies in .*out"):
        build(template, files[:1], tmp_path / "out", axiomatic(), landmarks=inside)


def test_the_match_of_each_shape_is_kept(family, tmp_path):
    template, files, _ = family
    built = build(template, files[:2], tmp_path / "out", axiomatic())
    folder = ShapeModelFolder.existing(tmp_path / "out")
    assert folder.names == ["copy0", "copy1"]
    kept, alone = folder.match("copy1"), axiomatic().match(read_shape(template), read_shape(files[1]))
    np.testing.assert_array_equal(kept.source_to_target, alone.source_to_target)
    np.testing.assert_array_equal(kept.target_to_source, alone.target_to_source)
    np.testing.assert_array_equal(kept.target.points, read_shape(files[1]).points)
    assert kept.report["inputs"]["target"]["file"] == str(files[1])
    with pytest.raises(ArgumentError, match="copy9"):
        folder.match("copy9")
    with pytest.raises(DataError, match="is no collection"):
        ShapeModelFolder.existing(tmp_path)
    built.folder.forget(built.outcomes[1].subject)
    assert not built.folder.match_folder("copy1").exists() and folder.names == ["copy0"]


@pytest.mark.parametrize(("names", "repeated"), [("AB", ""), ("AA", "A")])
def test_names_of_landmarks_that_repeat_are_a_warning(family, tmp_path, names, repeated):
    shape = read_shape(family[0])
    rows = zip(names, shape.points[[3, 50]].tolist(), strict=True)
    (tmp_path / "marks.csv").write_text("".join(f"{name},{x},{y},{z}\n" for name, (x, y, z) in rows))
    told = TemplateLandmarks(tmp_path / "marks.csv", shape).warnings
    assert [f"have the same name, {repeated};" in line for line in told] == ([True] if repeated else [])


def test_landmarks_far_from_the_template_are_refused(family, tmp_path):
    """In metres beside millimetres, say; a matter of axes is not farther than the shape is wide."""
    shape = read_shape(family[0])
    x, y, z = (1000 * shape.points[3]).tolist()
    (tmp_path / "marks.csv").write_text(f"A,{x},{y},{z}\n")
    with pytest.raises(DataError, match=r"a landmark of marks\.csv is .* away from the template's surface; give"):
        TemplateLandmarks(tmp_path / "marks.csv", shape)


def test_a_list_names_shapes_from_its_own_folder_on(tmp_path):
    (tmp_path / "list.txt").write_text("anna.ply\n\nscans/ben.ply\r\n/far/carl.ply\n")
    expected = [tmp_path / "anna.ply", tmp_path / "scans" / "ben.ply", Path("/far/carl.ply")]
    assert listed_files(tmp_path / "list.txt") == expected and listed_files(None) == []
    (tmp_path / "empty.txt").write_text("\n")
    with pytest.raises(ArgumentError, match=r"empty\.txt lists no shapes"):
        listed_files(tmp_path / "empty.txt")
    with pytest.raises(ArgumentError, match=r"none\.txt cannot be read: No such file"):
        listed_files(tmp_path / "none.txt")
