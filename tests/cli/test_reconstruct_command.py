"""``homolog reconstruct``: clouds to meshes that other commands read."""

import numpy as np
import pytest
import trimesh

from homolog.shapes import Shape, read_shape, write_shape

pytest.importorskip("skimage")


@pytest.fixture
def clouds(tmp_path):
    """Points of two balls, one of them half."""
    points, _ = trimesh.sample.sample_surface(trimesh.creation.icosphere(subdivisions=3), 1500, seed=0)
    write_shape(tmp_path / "ball.xyz", Shape(points))
    write_shape(tmp_path / "bowl.xyz", Shape(points[points[:, 2] < 0.0]))
    return tmp_path / "ball.xyz", tmp_path / "bowl.xyz"


def test_a_cloud_that_does_not_close_is_told_and_the_others_written(homolog, clouds, tmp_path):
    ball, bowl = clouds
    ended = homolog("reconstruct", bowl, ball, "-o", tmp_path / "new" / "out", "--points", 500, "--resolution", 48)
    assert ended.code == 2
    assert ended.err.count("\n") == 1 and "bowl.xyz has gaps too wide" in ended.err
    assert [path.name for path in (tmp_path / "new" / "out").iterdir()] == ["ball.ply"]
    shape = read_shape(tmp_path / "new" / "out" / "ball.ply")
    assert shape.n_points == pytest.approx(500, rel=0.05)
    assert np.linalg.norm(shape.points, axis=1) == pytest.approx(1.0, abs=0.1)
    ended = homolog("reconstruct", ball, "-o", tmp_path / "out", "--resolution", 48)
    assert (ended.code, ended.out.strip(), ended.err) == (0, str(tmp_path / "out"), "")


def test_mistakes_are_one_line(homolog, clouds, tmp_path):
    ball, _ = clouds
    (tmp_path / "other").mkdir()
    write_shape(tmp_path / "other" / "ball.ply", read_shape(ball))
    for arguments, told in (
        ([tmp_path / "none.xyz"], "does not exist"),
        ([ball, tmp_path / "other" / "ball.ply", "-o", tmp_path / "out"], "would both give"),
        ([tmp_path / "other" / "ball.ply", "-o", tmp_path / "other"], "is an input and would be replaced"),
        ([ball, "-o", ball], "is a file"),
        ([ball, "--points", 1], "points"),
    ):
        ended = homolog("reconstruct", *arguments)
        assert ended.code == 2 and ended.err.count("\n") == 1 and told in ended.err
    assert not (tmp_path / "out").exists()


def test_the_files_it_writes_are_checked_and_no_others(homolog, clouds, tmp_path):
    """Before any work is done, which the cloud that does not close would show."""
    _, bowl = clouds
    (tmp_path / "out" / "bowl.ply").mkdir(parents=True)
    ended = homolog("reconstruct", bowl, "-o", tmp_path / "out", "--resolution", 48)
    assert ended.is_one_line_of_complaint() and "bowl.ply is a folder" in ended.err
    (tmp_path / "other" / "report.json").mkdir(parents=True)
    ended = homolog("reconstruct", bowl, "-o", tmp_path / "other", "--resolution", 48)
    assert ended.code == 2 and "bowl.xyz has gaps too wide" in ended.err
