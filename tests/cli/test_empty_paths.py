"""An empty path, as an unset variable of a shell leaves it, is one clear line wherever a path is taken."""

import numpy as np
import pytest

import homolog as library
from homolog.core.errors import ArgumentError
from homolog.core.files import PATH_NEEDED
from homolog.shapes import Shape

EMPTY = {
    "match {} b.ply": "SOURCE",
    "match a.ply {}": "TARGET",
    "match a.ply b.ply -o {}": "--output",
    "match a.ply b.ply --html {}": "--html",
    "match a.ply b.ply --picture {}": "--picture",
    "match a.ply b.ply --weights {}": "--weights",
    "match a.ply b.ply --settings {}": "--settings",
    "info {}": "SHAPES",
    "info a.ply {}": "SHAPES",
    "view {}": "RESULT",
    "view result --truth a.vts {}": "--truth",
    "evaluate {}": "DATA",
    "evaluate data --json {}": "--json",
    "evaluate data --csv {}": "--csv",
    "evaluate data --plot {}": "--plot",
    "evaluate data --maps {}": "--maps",
    "evaluate data --dataset {}": "--dataset",
    "data check faust {}": "DATA",
    "train data -o {}": "--output",
    "collection a.ply {}": "SHAPES",
    "transfer result -o {}": "--output",
    "transfer result --labels {}": "--labels",
    "demo -o {}": "--output",
    "volume surface mask.nii -o {}": "--output",
    "reconstruct a.xyz -o {}": "--output",
    "synth people -o {}": "--output",
}


@pytest.mark.parametrize(("words", "called"), EMPTY.items(), ids=EMPTY)
def test_empty_paths_of_commands(homolog, tmp_path, monkeypatch, words, called):
    monkeypatch.chdir(tmp_path)
    ended = homolog(*("" if word == "{}" else word for word in words.split()))
    assert ended.is_one_line_of_complaint(), ended
    assert ended.err == f"Error: {called} is '', but must be {PATH_NEEDED}\n"
    assert not list(tmp_path.iterdir())


def test_the_form_with_an_equals_sign(homolog, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "--output is ''" in homolog("match", "a.ply", "b.ply", "--output=").err


BODY = Shape(np.eye(4)[:, :3], name="body")
MATCH = library.Match(BODY, BODY, np.arange(4), np.arange(4))
CALLS = {
    "read_shape": lambda: library.read_shape(""),
    "write_shape": lambda: library.write_shape("", BODY),
    "as_shape": lambda: library.as_shape(""),
    "match": lambda: library.match("", BODY),
    "save": lambda: MATCH.save(""),
    "load": lambda: library.Match.load(""),
    "read_point_map": lambda: library.matching.read_point_map(""),
    "MapsFolder": lambda: library.evaluation.MapsFolder(""),
    "read_truth": lambda: library.datasets.read_truth(("", ""), (BODY, BODY)),
    "ShapeFolder": lambda: library.datasets.ShapeFolder.open(""),
    "subjects_of": lambda: library.shape_models.subjects_of([""]),
    "write_page": lambda: library.viewing.write_page("", library.viewing.scene_of(MATCH)),
}


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
def test_empty_paths_in_python(call):
    with pytest.raises(ArgumentError) as caught:
        call()
    assert str(caught.value) == f"path is '', but must be {PATH_NEEDED}"


@pytest.mark.parametrize("name", ["page.txt", "page", "page.html.gz", "report.json"])
def test_a_page_has_the_suffix_of_pages(homolog, files, tmp_path, name):
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path / "out", "--html", tmp_path / name)
    assert ended.is_one_line_of_complaint() and f"{name} must end in .html or .htm" in ended.err
    assert not list(tmp_path.iterdir())
    with pytest.raises(ArgumentError, match=r"must end in \.html or \.htm"):
        library.viewing.write_page(tmp_path / name, library.viewing.scene_of(MATCH))
