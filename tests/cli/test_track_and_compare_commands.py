"""``homolog track`` and ``homolog compare``: frames and groups in, files out."""

import numpy as np
import pytest

from homolog.shape_models import Figures, Outcome, Registered, ShapeModelFolder, Subject, write_outputs
from homolog.shapes import Shape, write_shape

FIGURES = Figures(0.9, 1.0, 0.01, 1.1, 0.02, 0.9, 1.1)


@pytest.fixture
def frames(make, tmp_path):
    """A folder with three frames whose names are in another order than their numbers."""
    blob = make.blob(2)
    (tmp_path / "scans").mkdir()
    for number in (1, 2, 10):
        points = blob.points * [1, 1 + 0.005 * number, 1]
        write_shape(tmp_path / "scans" / f"scan{number}.ply", Shape(points, blob.faces))
    return tmp_path / "scans"


def test_a_folder_of_frames_is_followed(homolog, frames, tmp_path):
    out = tmp_path / "out"
    ended = homolog("track", frames, "-o", out, "--method", "registration", "--orient", "given")
    assert ended.code == 0, ended.err
    names = ("frames", "points.npy", "drift.csv", "drift.ply", "track.json")
    assert ended.out.split() == [str(out / name) for name in names]
    assert "Followed 162 points through 3 of 3 frames. Drift: " in ended.err
    rows = (out / "drift.csv").read_text().splitlines()
    assert [row.split(",")[1] for row in rows[1:]] == ["scan1", "scan2", "scan10"]
    (frames / "scan2.ply").write_bytes(b"ply")
    ended = homolog("track", frames, "-o", out, "--method", "registration", "--orient", "given", "-q")
    assert ended.code == 2 and "scan2.ply" in ended.err and np.isnan(np.load(out / "points.npy")[1]).all()


@pytest.fixture
def collection(make, tmp_path):
    """A collection of eight shapes, of which the last four are longer, and the table of both groups."""
    pytest.importorskip("h5py")
    pytest.importorskip("matplotlib")
    blob, outcomes, random = make.blob(1), [], np.random.default_rng(0)
    folder = ShapeModelFolder.prepare(tmp_path / "model", {"template": {"sha256": ""}})
    rows = ["name,group"]
    for number in range(8):
        points = blob.points * [1, 1 + 0.2 * (number > 3), 1] + 0.02 * random.standard_normal(blob.points.shape)
        file = tmp_path / f"shape{number}.ply"
        write_shape(file, Shape(points, blob.faces))
        outcomes.append(Outcome(Subject(f"shape{number}", file), FIGURES))
        folder.write(outcomes[-1], Registered(points, FIGURES, ()), blob, "")
        rows.append(f"shape{number},{'long' if number > 3 else 'short'}")
    write_outputs(folder, blob, outcomes)
    (tmp_path / "groups.csv").write_text("\n".join(rows) + "\n")
    return tmp_path / "model"


def test_two_groups_are_compared(homolog, collection, tmp_path):
    out = tmp_path / "out"
    ended = homolog("compare", collection, "--groups", tmp_path / "groups.csv", "-o", out)
    assert ended.code == 0, ended.err
    names = ("comparison.ply", "points.csv", "mean-short.ply", "mean-long.ply", "comparison.json")
    assert ended.out.split() == [str(out / name) for name in names]
    assert "long (4) less short (4): p = 0.0286 (70 all relabellings)" in ended.err
    ended = homolog("compare", collection, "--groups", tmp_path / "groups.csv", "--between", "long", "tall")
    assert ended.is_one_line_of_complaint() and "must be one of short, long" in ended.err


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["track", "scans/scan1.ply"], "there is one frame"),
        (["track", "none.ply", "scans/scan1.ply"], "none.ply"),
        (["track", "empty"], "holds 0 shapes"),
        (["track", "scans", "--follow", "last"], "--follow"),
        (["compare", "scans", "--groups", "groups.csv"], "is no collection"),
        (["compare", "scans"], "Missing option '--groups'"),
    ],
)
def test_mistakes_are_one_line(homolog, frames, monkeypatch, tmp_path, more, said):
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path)
    ended = homolog(*more)
    assert ended.is_one_line_of_complaint() and said in ended.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", frames.name]
