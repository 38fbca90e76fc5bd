"""A shape through time: trajectories and drift of frames whose truth is known; the command as well."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from without_weights import axiomatic

from homolog.core.errors import ArgumentError
from homolog.matching import Match
from homolog.shape_models import Template, sequence, track, write_track
from homolog.shapes import Shape, read_shape, write_shape
from homolog.shapes.formats.ply import read_ply_property


@pytest.fixture(scope="module")
def motion(make, tmp_path_factory):
    """Four frames of a blob that grows longer and moves, each with points in an order of its own; the truth."""
    root, blob = tmp_path_factory.mktemp("motion"), make.blob(2)
    files, true = [], []
    for number in range(4):
        points = blob.points * [1, 1 + 0.04 * number, 1] + [0, 0, 0.5 * number]
        order = np.random.default_rng(number).permutation(len(points)) if number else np.arange(len(points))
        files.append(root / f"frame{number}.ply")
        write_shape(files[-1], make.relabelled(Shape(points, blob.faces), order))
        true.append(points)
    return files, np.stack(true)


@pytest.fixture(scope="module")
def found(motion):
    return track(motion[0], axiomatic())


def test_trajectories_are_those_of_the_points(motion, found):
    _, true = motion
    assert found.points.shape == true.shape
    away = np.linalg.norm(found.points - true, axis=2)
    assert away[0].max() == 0 and away.mean() < 0.03  # of a blob that is 2.8 long
    assert all(np.isnan(frame.drift).all() for frame in found.frames[:2])
    for frame in found.frames[2:]:
        assert np.isfinite(frame.drift).all() and frame.figures()["drift_of_size"] < 0.02
    assert found.matched_by.startswith("axiomatic") and found.mean_drift.shape == (162,)


def test_points_by_the_maps_from_frame_to_frame(motion, found):
    files, true = motion
    told = []
    chained = track(files[:3], axiomatic(), follow="previous", listener=told.append)
    assert [frame.subject.name for frame in told] == ["frame1", "frame2"]
    np.testing.assert_array_equal(chained.points[1], found.points[1])
    assert np.linalg.norm(chained.points - true[:3], axis=2).mean() < 0.03
    apart = np.linalg.norm(chained.points[2] - found.points[2], axis=1)
    np.testing.assert_allclose(chained.frames[2].drift, apart)


def test_a_wrong_map_is_drift(motion, monkeypatch):
    """The map from frame 1 to frame 2 is shuffled: that from the first frame stays right."""

    class Shuffled(type(axiomatic())):
        def match(self, source, target, **words):
            points = np.random.default_rng(0).permutation(source.n_points)
            return Match(source, target, points, np.argsort(points))

    monkeypatch.setattr(sequence, "untangled", lambda smooth: smooth)
    files, true = motion
    matcher = Shuffled(settings=axiomatic().settings)
    found = track(files[:3], matcher)
    assert found.frames[2].figures()["drift_of_size"] > 0.1
    assert "lost its way" in found.frames[2].warnings[-1]
    assert np.linalg.norm(found.points[2] - true[2], axis=1).mean() < 0.03


def test_a_frame_that_cannot_be_matched_is_passed_over(motion, tmp_path):
    files, _ = motion
    (tmp_path / "empty.ply").write_bytes(b"")
    found = track([files[0], tmp_path / "empty.ply", files[1]], axiomatic())
    assert "empty.ply" in found.frames[1].error and np.isnan(found.points[1]).all()
    assert not found.frames[2].error and np.isnan(found.frames[2].drift).all()
    write_track(tmp_path / "out", found)
    assert sorted(path.name for path in (tmp_path / "out" / "frames").iterdir()) == ["frame0.ply", "frame1.ply"]
    report = json.loads((tmp_path / "out" / "track.json").read_text())
    assert list(report["not_matched"]) == ["empty"]


def test_what_is_written_reads_back(found, tmp_path):
    paths = write_track(tmp_path / "out", found)
    assert [path.name for path in paths] == ["frames", "points.npy", "drift.csv", "drift.ply", "track.json"]
    np.testing.assert_array_equal(np.load(paths[1]), found.points)
    mesh = read_shape(paths[0] / "frame3.ply")
    np.testing.assert_array_equal(mesh.points, found.points[3])
    np.testing.assert_array_equal(mesh.faces, found.first.faces)
    with paths[2].open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == [f"frame{number}" for number in range(4)]
    assert rows[1]["drift"] == "" and float(rows[3]["drift"]) == pytest.approx(found.frames[3].drift.mean())
    np.testing.assert_allclose(read_ply_property(paths[3], "drift"), found.mean_drift)
    with pytest.raises(ArgumentError, match="replaced"):
        write_track(tmp_path / "out", found, files=[paths[0] / "frame3.ply"])


@pytest.fixture
def registered(monkeypatch):
    """The frames that the first one is registered to."""
    names, registered_to = [], Template.registered_to

    def counted(self, shape, **words):
        names.append(shape.name)
        return registered_to(self, shape, **words)

    monkeypatch.setattr(Template, "registered_to", counted)
    return names


def contents(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_track_that_is_stopped_goes_on_and_ends_as_without(motion, registered, tmp_path):
    files = motion[0][:3]

    def run(name, **words):
        found = track(files, axiomatic(), output=tmp_path / name, **words)
        write_track(tmp_path / name, found)
        return found

    def stop(frame):
        raise KeyboardInterrupt

    whole = run("whole")
    with pytest.raises(KeyboardInterrupt):
        run("stopped", listener=stop)
    resumed = run("stopped")
    assert registered == [f"frame{number}.ply" for number in (1, 2, 1, 2)]
    assert contents(tmp_path / "stopped") == contents(tmp_path / "whole")
    np.testing.assert_array_equal(resumed.points, whole.points)
    other = run("stopped", follow="previous")  # both ways are kept
    assert len(registered) == 4 and other.follow == "previous" and not np.array_equal(other.points, whole.points)
    with pytest.raises(ArgumentError, match="a track made in another way \\(matching\\)"):
        run("stopped", orient="given")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("")
    with pytest.raises(ArgumentError, match="holds other things"):
        run("mine")


def test_a_frame_that_changed_is_done_anew_with_those_after_it(motion, registered, tmp_path):
    files = [tmp_path / file.name for file in motion[0]]
    for file, given in zip(files, motion[0], strict=True):
        file.write_bytes(given.read_bytes())
    out = tmp_path / "out"
    write_track(out, track(files[:3], axiomatic(), output=out))
    track(files, axiomatic(), output=out)
    assert registered == [f"frame{number}.ply" for number in (1, 2, 3)]
    (tmp_path / "frame2.ply").write_bytes(b"ply")
    found = track(files, axiomatic(), output=out)
    assert registered[3:] == ["frame3.ply"]  # it is matched to frame 1 then
    np.testing.assert_array_equal(found.points[3], track([files[0], files[1], files[3]], axiomatic()).points[2])
    write_track(out, found)
    assert sorted(path.name for path in (out / "frames").iterdir()) == ["frame0.ply", "frame1.ply", "frame3.ply"]


def test_mistakes_are_named(motion, found):
    with pytest.raises(ArgumentError, match="there is one frame"):
        track(motion[0][:1], axiomatic())
    with pytest.raises(ArgumentError, match="follow is 'last'"):
        track(motion[0], axiomatic(), follow="last")
    assert replace(found, frames=found.frames[:2]).mean_drift.max() == 0
