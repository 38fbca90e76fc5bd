"""``homolog volume``: masks to meshes and clouds that other commands read."""

import numpy as np
import pytest

from homolog.shapes import read_shape

sitk = pytest.importorskip("SimpleITK")
pytest.importorskip("skimage")


@pytest.fixture
def mask(tmp_path):
    """A ball of radius 6 mm, labelled 2, in anisotropic voxels, and one voxel labelled 1."""
    k, j, i = np.mgrid[:16, :30, :30]
    values = (((i - 15) * 0.5) ** 2 + ((j - 15) * 0.5) ** 2 + (k - 8) ** 2 < 36).astype(np.uint8) * 2
    values[0, 0, 0] = 1
    image = sitk.GetImageFromArray(values)
    image.SetSpacing((0.5, 0.5, 1.0))
    sitk.WriteImage(image, str(tmp_path / "ball.mhd"))
    return tmp_path / "ball.mhd"


def test_a_surface(homolog, mask, tmp_path):
    ended = homolog("volume", "surface", mask, "--label", 2, "--points", 300, "-o", tmp_path / "ball.ply")
    assert (ended.code, ended.out.strip(), ended.err) == (0, str(tmp_path / "ball.ply"), "")
    shape = read_shape(tmp_path / "ball.ply")
    assert shape.n_points == pytest.approx(300, rel=0.05)
    assert np.linalg.norm(shape.points - [7.5, 7.5, 8], axis=1) == pytest.approx(6.0, abs=0.5)


def test_slices(homolog, mask, tmp_path):
    options = ["--label", 2, "--every", 2, "--span", 0, 0.5, "--points", 100]
    ended = homolog("volume", "slices", mask, *options, "-o", tmp_path / "slices.xyz", "-q")
    assert (ended.code, ended.out, ended.err) == (0, "", "")
    cloud = read_shape(tmp_path / "slices.xyz")
    assert cloud.n_points == 100 and set(cloud.points[:, 2]) <= {3.0, 5.0, 7.0}


def test_mistakes_are_one_line(homolog, mask, tmp_path):
    for arguments, told in (
        (["volume", "surface", mask, "--label", 9], "no voxel has label 9"),
        (["volume", "surface", tmp_path / "none.nrrd"], "no such file"),
        (["volume", "slices", mask, "--span", 0.5, 0.1], "must be two shares"),
        (["volume", "surface", mask, "--smoothing", -1], "smoothing"),
        (["info", mask], "homolog volume surface"),
    ):
        ended = homolog(*arguments)
        assert ended.code == 2 and ended.err.count("\n") == 1 and told in ended.err
