"""Displacement fields: exact where points are displaced, true between them, and as ITK reads them."""

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from homolog.core.errors import ArgumentError
from homolog.volumes import (
    DisplacementField,
    ScatteredInterpolant,
    displacement_field,
    write_displacement_field,
)
from homolog.volumes import displacement as module


def bent(points):
    """A smooth displacement."""
    x, y, z = points.T
    return 0.1 * np.stack([np.sin(2 * y), x * z, np.cos(x + y)], axis=1)


def test_the_spline_is_scipys():
    points = np.random.default_rng(0).random((60, 3))
    places = np.random.default_rng(1).random((40, 3)) * 2 - 0.5
    expected = RBFInterpolator(points, bent(points), kernel="linear", degree=1)(places)
    np.testing.assert_allclose(ScatteredInterpolant(points, bent(points))(places), expected, atol=1e-8)


def test_many_points_are_met_exactly(monkeypatch):
    """With few centres most of it is left to the functions of compact support."""
    monkeypatch.setattr(module, "_CENTRES", 100)
    random = np.random.default_rng(2)
    points = random.random((1500, 3))
    values = bent(points) + 0.01 * random.standard_normal((1500, 3))
    smooth = ScatteredInterpolant(points, values)
    assert np.abs(smooth(points) - values).max() < 1e-8
    places = random.random((300, 3))
    assert np.abs(ScatteredInterpolant(points, bent(points))(places) - bent(places)).max() < 0.02


def test_points_in_a_plane_and_at_one_place():
    points = np.random.default_rng(3).random((50, 3)) * [1, 1, 0]
    assert np.abs(ScatteredInterpolant(points, bent(points))(points) - bent(points)).max() < 1e-8
    twice = np.concatenate([points, points[:1]])
    values = np.concatenate([bent(points), bent(points[:1]) + 1])
    np.testing.assert_allclose(ScatteredInterpolant(twice, values)(points[:1]), bent(points[:1]) + 0.5, atol=1e-8)


def test_a_field_on_a_grid():
    points = np.random.default_rng(4).random((300, 3)) * [1, 2, 1]
    field = displacement_field(points, bent(points), spacing=0.05)
    assert np.abs(field.at(points) - bent(points)).max() < 0.01
    np.testing.assert_allclose(field.origin, points.min(axis=0) - 0.2, atol=0.01)
    assert field.at(np.array([[50.0, 0, 0]])).tolist() == [[0, 0, 0]]
    assert field.folded == 0
    # Space is mirrored where the displacement is minus twice x.
    mirrored = displacement_field(points, points * [-2, 0, 0], spacing=0.1)
    assert mirrored.folded == 1
    half = np.zeros((40, 3, 3, 3))
    half[20:, :, :, 0] = -2 * np.arange(20)[:, None, None]
    assert DisplacementField(half, np.zeros(3), 1.0).folded == pytest.approx(0.5, abs=0.04)


@pytest.mark.parametrize("suffix", [".nrrd", ".mha", ".h5"])
def test_itk_reads_it(tmp_path, suffix):
    itk = pytest.importorskip("SimpleITK")
    points = np.random.default_rng(5).random((80, 3)) * [10, 20, 30]
    field = displacement_field(points, bent(points), spacing=2.0)
    path = tmp_path / f"field{suffix}"
    write_displacement_field(path, field)
    if suffix == ".h5":
        transform = itk.ReadTransform(str(path))
    else:
        image = itk.ReadImage(str(path), itk.sitkVectorFloat64)
        transform = itk.DisplacementFieldTransform(image)
    for point in points[:5]:
        expected = point + field.at(point[None])[0]
        np.testing.assert_allclose(transform.TransformPoint(point.tolist()), expected, atol=1e-5)
    if suffix == ".nrrd":
        head = path.read_bytes()[:600]
        assert b"space: left-posterior-superior" in head and b"kinds: vector domain domain domain" in head
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


def test_mistakes_are_named(tmp_path):
    points = np.random.default_rng(6).random((20, 3))
    with pytest.raises(ArgumentError, match=r"spacing is 0\.001, which makes"):
        displacement_field(points, points, spacing=0.001)
    with pytest.raises(ArgumentError, match="four or more"):
        ScatteredInterpolant(points[:2], points[:2])
    with pytest.raises(ArgumentError, match="spacing is -1"):
        displacement_field(points, points, spacing=-1)
    with pytest.raises(ArgumentError, match=r"must be one of \.nrrd"):
        write_displacement_field(tmp_path / "field.png", displacement_field(points, points, spacing=0.5))
