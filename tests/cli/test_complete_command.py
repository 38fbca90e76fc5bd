"""``homolog complete``: a fragment and a collection in, a whole shape out."""

import json

import numpy as np
import pytest

from homolog.shapes import Shape, read_shape, write_shape

pytest.importorskip("h5py")
pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def family(make, tmp_path_factory):
    """A template, three shapes in correspondence with it, and the lower part of another one."""
    root, blob = tmp_path_factory.mktemp("family"), make.blob(2)
    write_shape(root / "template.ply", blob)
    for number, (length, bend) in enumerate([(0.9, 0.1), (1.1, -0.1), (1.0, 0.2)]):
        write_shape(root / f"shape{number}.ply", Shape(_stretched(blob, length, bend), blob.faces))
    points = _stretched(blob, 1.05, 0.05)
    kept = points[:, 1] < 0.4
    faces = blob.faces[kept[blob.faces].all(axis=1)]
    used, corners = np.unique(faces, return_inverse=True)
    write_shape(root / "fragment.ply", Shape(points[used], corners.reshape(-1, 3)))
    return root


def _stretched(blob, length, bend):
    y = blob.points[:, 1]
    return blob.points * [1, length, 1] + np.stack([bend * y**2, 0 * y, 0 * y], axis=1)


@pytest.mark.slow
def test_a_fragment_is_completed(homolog, family, tmp_path):
    shapes = [family / f"shape{number}.ply" for number in range(3)]
    made = homolog(
        "collection", family / "template.ply", *shapes, "-o", tmp_path / "model", "--method", "registration",
        "--orient", "given", "--processes", 1,
    )  # fmt: skip
    assert made.code == 0, made.err
    fragment, out = family / "fragment.ply", tmp_path / "whole"
    ended = homolog("complete", fragment, "--model", tmp_path / "model", "-o", out, "--method", "axiomatic")
    assert ended.code == 0, ended.err
    assert ended.out.split() == [str(out / name) for name in ("completed.ply", "points.csv", "completion.json")]
    assert "162 points lie on the fragment" in ended.err
    report = json.loads((out / "completion.json").read_text())
    assert report["match"]["options"]["partial"] == "source" and report["missing_deviation"] > 0
    whole = read_shape(out / "completed.ply").points
    near = np.linalg.norm(whole[:, None] - read_shape(fragment).points, axis=2).min(axis=0)
    assert near.mean() < 0.1
    again = homolog("complete", out / "completed.ply", "--model", tmp_path / "model", "-o", out)
    assert again.is_one_line_of_complaint() and "input" in again.err


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["missing.ply", "--model", "."], "missing.ply"),
        (["fragment.ply", "--model", "."], "is no collection"),
        (["fragment.ply"], "Missing option '--model'"),
        (["fragment.ply", "--model", ".", "-o", "fragment.ply"], "fragment.ply"),
    ],
)
def test_mistakes_are_one_line(homolog, family, monkeypatch, more, said):
    monkeypatch.chdir(family)
    ended = homolog("complete", *more)
    assert ended.is_one_line_of_complaint() and said in ended.err
