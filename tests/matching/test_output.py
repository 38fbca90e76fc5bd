"""What a match leaves on disk."""

import json

import numpy as np
import pytest

from homolog.errors import ArgumentError
from homolog.matching import Correspondence, matched_colours, output, position_colours, write_result
from homolog.matching import correspondence as correspondence_module
from homolog.shapes import Shape, read_shape

NAMES = ["correspondence.npz", "source.ply", "target.ply", "report.json"]
GREY = [160, 160, 160]


@pytest.fixture
def shapes(make):
    """A sphere of 162 points and a cloud of 42, one of whose points is nowhere."""
    points = make.sphere(1).points * [3, 1, 2] + 0.1
    points[7] = np.nan
    return make.sphere(2), Shape(points, name="cloud")


@pytest.fixture
def found(shapes):
    rng = np.random.default_rng(0)
    n, m = (shape.n_points for shape in shapes)
    forth, back = rng.integers(0, m, n), rng.integers(0, n, m)
    forth[[3, 100]], back[7] = -1, -1
    return Correspondence(
        forth, back, np.where(forth < 0, 0, rng.random(n)), np.where(back < 0, 0, rng.random(m)), "features", ("look!",)
    )


def colours_in(path):
    """Vertex colours of a binary PLY, read by hand."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode().splitlines()
    n = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    vertex = lines[lines.index(f"element vertex {n}") + 1 :]
    assert [line.split()[2] for line in vertex[:6]] == ["x", "y", "z", "red", "green", "blue"]
    rows = np.frombuffer(body, np.dtype([("xyz", "<f8", 3), ("rgb", "u1", 3)]), count=n)
    return rows["rgb"].astype(int)


def test_saved_arrays(found, tmp_path):
    found.save(tmp_path / "maps.npz")
    with np.load(tmp_path / "maps.npz", allow_pickle=False) as stored:
        assert sorted(stored.files) == [
            "source_confidence",
            "source_to_target",
            "target_confidence",
            "target_to_source",
        ]
        for name in stored.files:
            np.testing.assert_array_equal(stored[name], getattr(found, name))
        assert stored["source_to_target"].dtype == stored["target_to_source"].dtype == np.int64
        assert stored["source_confidence"].dtype.kind == stored["target_confidence"].dtype.kind == "f"
    assert [path.name for path in tmp_path.iterdir()] == ["maps.npz"]


def test_a_real_match_saves_its_own_arrays(build, blobs, tmp_path):
    found = build("features").match(*blobs.of("mc"))
    found.save(tmp_path / "maps.npz")
    with np.load(tmp_path / "maps.npz") as stored:
        np.testing.assert_array_equal(stored["source_to_target"], found.source_to_target)
        assert stored["target_to_source"].shape == (blobs.target.n_points,)


def test_the_four_files(shapes, found, tmp_path):
    folder = tmp_path / "new" / "result"
    paths = write_result(folder, *shapes, found, {"answer": 42})
    assert paths == [folder / name for name in NAMES]
    assert sorted(path.name for path in folder.iterdir()) == sorted(NAMES)
    for path, given in zip(paths[1:3], shapes, strict=True):
        written = read_shape(path)
        np.testing.assert_array_equal(written.points, given.points)
        assert written.modality == given.modality
        if given.faces is not None:
            np.testing.assert_array_equal(written.faces, given.faces)
    assert json.loads(paths[3].read_text()) == {"answer": 42}


def test_same_colour_same_point(shapes, found, tmp_path):
    paths = write_result(tmp_path, *shapes, found, {})
    source, target = colours_in(paths[1]), colours_in(paths[2])
    asked, matched = found.target_to_source, found.target_to_source >= 0
    # A source point without a counterpart is grey itself, yet lends its colour to target points mapped to it.
    with_match = found.source_to_target >= 0
    both = matched & with_match[asked]
    assert both.sum() > 30
    np.testing.assert_array_equal(target[both], source[asked[both]])
    assert np.all(target[~matched] == GREY)
    assert np.all(source[~with_match] == GREY)
    assert len(np.unique(source, axis=0)) > 100


def test_colours_follow_the_position():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, -4], [np.inf, 0, 0], [0.5, 1, -2]])
    colours = position_colours(points)
    assert colours.dtype == np.uint8
    assert colours[:5].tolist() == [[40, 40, 255], [255, 40, 255], [40, 255, 255], [40, 40, 40], GREY]
    assert np.all(np.abs(colours[5].astype(int) - 147.5) <= 1)
    assert position_colours(points[:3])[:, 2].tolist() == [40, 40, 40]


def test_matched_colours_have_one_row_per_point(shapes, found):
    source, target = matched_colours(shapes[0], found)
    assert source.shape == (162, 3)
    assert target.shape == (42, 3)
    assert source.dtype == target.dtype == np.uint8


def test_other_files_in_the_folder_stay(shapes, found, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "report.json").write_text("old")
    write_result(tmp_path, *shapes, found, {})
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert (tmp_path / "report.json").read_text() == "{}\n"


def test_out_is_a_file(shapes, found, tmp_path):
    (tmp_path / "out").write_text("precious")
    for folder in (tmp_path / "out", tmp_path / "out" / "below"):
        with pytest.raises(ArgumentError, match="cannot be made a folder") as caught:
            write_result(folder, *shapes, found, {})
        assert "\n" not in str(caught.value)
    assert (tmp_path / "out").read_text() == "precious"


class Stopped(BaseException):
    """Stands for Ctrl-C."""


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), Stopped()])
@pytest.mark.parametrize("broken", [0, 1, 3])
@pytest.mark.parametrize("before", [None, b"old"])
def test_nothing_is_half_written(shapes, found, tmp_path, monkeypatch, error, broken, before):
    """Writing stops amid one file: that one is as it was before, and no other trace is left."""
    folder = tmp_path / "result"
    folder.mkdir()
    if before is not None:
        for name in NAMES:
            (folder / name).write_bytes(before)

    def half(path, *args, **kwargs):
        path.write_bytes(b"half")
        raise error

    if broken == 0:
        monkeypatch.setattr(correspondence_module.np, "savez_compressed", half)
    elif broken == 1:
        monkeypatch.setattr("homolog.shapes.writing._write_ply", half)
    else:

        def dumps(*args, **kwargs):
            (temporary,) = [path for path in folder.iterdir() if path.name.startswith(".")] or [None]
            assert temporary is None
            raise error

        monkeypatch.setattr(output.json, "dumps", dumps)
    with pytest.raises(ArgumentError if isinstance(error, OSError) else Stopped):
        write_result(folder, *shapes, found, {})
    left = sorted(path.name for path in folder.iterdir())
    assert left == (sorted(NAMES) if before else sorted(NAMES[:broken]))
    for name in NAMES[broken:]:
        assert before is None or (folder / name).read_bytes() == before
    for name in NAMES[:broken]:
        assert (folder / name).read_bytes() not in (b"half", b"old")


def test_a_report_that_json_cannot_hold_leaves_no_report(shapes, found, tmp_path):
    with pytest.raises(TypeError):
        write_result(tmp_path, *shapes, found, {"bad": object()})
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(NAMES[:3])
