"""Building a shape model in one call: all files of one folder, resumed, and inputs that stay as they are."""

import json

import numpy as np
import pytest
from without_weights import axiomatic

from homolog.core.errors import ArgumentError
from homolog.shape_models import ModelSettings, ShapeModelSettings, build
from homolog.shapes import read_shape

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
