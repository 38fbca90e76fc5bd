"""Masks read from files: where voxels lie is asked of the library that wrote them."""

import numpy as np
import pytest

from homolog.core.errors import ShapeError
from homolog.volumes import read_mask

sitk = pytest.importorskip("SimpleITK")

SIZE = (7, 5, 4)


@pytest.fixture
def image():
    """A volume with two labels, anisotropic, turned and shifted."""
    values = np.zeros(SIZE, dtype=np.uint8)
    values[1:5, 2:4, 1:3] = 3
    values[5, 1, 2] = 4
    image = sitk.GetImageFromArray(values.T)
    image.SetSpacing((0.7, 0.8, 2.5))
    image.SetOrigin((-100.0, 20.0, 1500.0))
    cosine, sine = np.cos(0.3), np.sin(0.3)
    image.SetDirection((cosine, -sine, 0, sine, cosine, 0, 0, 0, -1))
    return image


def written(image, path, *, compressed=False):
    plain = path.with_name(path.name.lower())
    sitk.WriteImage(image, str(plain), useCompression=compressed)
    return plain.rename(path)


@pytest.mark.parametrize(
    ("name", "compressed"),
    [
        ("mask.mhd", False),
        ("mask.mhd", True),
        ("mask.MHA", True),
        ("mask.nii", False),
        ("mask.nii.gz", True),
        ("mask.nrrd", True),
        ("mask.nhdr", False),
    ],
)
def test_every_format_gives_the_same_voxels_in_the_same_places(image, tmp_path, name, compressed):
    mask = read_mask(written(image, tmp_path / name, compressed=compressed))
    assert mask.inside.shape == SIZE
    assert mask.inside.sum() == 4 * 2 * 2 + 1
    marked = np.argwhere(mask.inside)
    expected = [image.TransformIndexToPhysicalPoint([int(i) for i in place]) for place in marked]
    np.testing.assert_allclose(mask.positions(marked), expected, atol=1e-4)


@pytest.mark.parametrize("name", ["mask.nii", "mask.nii.gz"])
@pytest.mark.parametrize("share", [0.9, 0.97])
def test_a_file_that_ends_too_early_is_no_mask_with_less_inside(image, tmp_path, name, share):
    path = written(image, tmp_path / name, compressed=name.endswith("gz"))
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ShapeError, match=rf"{name} ends after \d+ of {352 + 7 * 5 * 4} bytes"):
        read_mask(path)


def test_a_header_that_promises_more_voxels_than_there_are(image, tmp_path):
    path = written(sitk.Cast(image, sitk.sitkInt16), tmp_path / "mask.mhd")
    path.write_text(path.read_text().replace("DimSize = 7 5 4", "DimSize = 7 5 6"))
    with pytest.raises(ShapeError, match=r"mask.raw ends after 280 of 420 bytes"):
        read_mask(path)


def test_one_label(image, tmp_path):
    path = written(image, tmp_path / "mask.nrrd")
    assert np.argwhere(read_mask(path, label=4).inside).tolist() == [[5, 1, 2]]
    with pytest.raises(ShapeError, match="no voxel has label 7; those there are 0, 3, 4"):
        read_mask(path, label=7)


def test_cropping_moves_nothing(image, tmp_path):
    mask = read_mask(written(image, tmp_path / "mask.nrrd"), label=3)
    box = mask.cropped(2)
    assert box.inside.shape == (8, 6, 6)
    np.testing.assert_allclose(box.positions(np.argwhere(box.inside)), mask.positions(np.argwhere(mask.inside)))


def test_what_is_no_mask(tmp_path):
    def saved(values, name="mask.nrrd"):
        return written(sitk.GetImageFromArray(values), tmp_path / name)

    for values, reason in (
        (np.zeros((3, 3, 3), dtype=np.uint8), "marks no voxel"),
        (np.arange(1000, dtype=np.int16).reshape(10, 10, 10), "looks like an image"),
        (np.full((3, 3, 3), 0.5, dtype=np.float32), "fractions"),
        (np.full((3, 3, 3), np.nan, dtype=np.float32), "no numbers"),
        (np.ones((3, 3), dtype=np.uint8), "give one volume"),
    ):
        with pytest.raises(ShapeError, match=reason) as told:
            read_mask(saved(values))
        assert "\n" not in str(told.value)


def test_files_that_cannot_be_read(image, tmp_path):
    written(image, tmp_path / "mask.mhd")
    (tmp_path / "mask.raw").unlink()
    (tmp_path / "rubbish.nii.gz").write_bytes(b"rubbish")
    for name, reason in (
        ("mask.mhd", "mask.raw, which is not there"),
        ("rubbish.nii.gz", "cannot be read as a volume"),
        ("none.nrrd", "no such file"),
        ("mesh.ply", "is no volume"),
    ):
        with pytest.raises(ShapeError, match=reason) as told:
            read_mask(tmp_path / name)
        assert "\n" not in str(told.value)
