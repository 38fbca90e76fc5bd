"""The unit frame, and the area of a raw cloud."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from homolog.core.errors import ArgumentError, ShapeError
from homolog.geometry import cloud_area, surface_area, unit_frame
from homolog.shapes import Shape


@pytest.fixture(scope="module")
def clouds(demo) -> dict[str, tuple[np.ndarray, float]]:
    """Points and true area."""
    shapes = {"amber": demo.amber, "boris": demo.boris}
    sphere = np.random.default_rng(7).standard_normal((5000, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    return {
        **{name: (shape.points, surface_area(shape)) for name, shape in shapes.items()},
        "sphere": (sphere, 4 * np.pi),
    }


def test_the_area_of_known_meshes(make) -> None:
    assert surface_area(make.grid(5, width=2.0)) == pytest.approx(4.0)
    assert surface_area(make.sphere(5)) == pytest.approx(4 * np.pi, rel=1e-3)


def test_the_frame_centres_and_scales_to_unit_area_and_comes_back(make) -> None:
    blob = make.blob(3)
    moved = Shape(31.0 * blob.points + [5, -7, 900], blob.faces)
    frame = unit_frame(moved)
    inside = Shape(frame.to_unit(moved.points), blob.faces)
    assert surface_area(inside) == pytest.approx(1.0)
    np.testing.assert_allclose(inside.points.mean(axis=0), 0, atol=1e-10)
    np.testing.assert_allclose(inside.points * frame.scale + frame.centre, moved.points)
    assert frame.scale == pytest.approx(np.sqrt(surface_area(moved)))


def test_a_given_length_is_taken_and_the_centre_stays_its_own(make) -> None:
    blob = make.blob(1)
    frame = unit_frame(blob, scale=2.5)
    assert frame.scale == 2.5
    np.testing.assert_allclose(frame.centre, blob.points.mean(axis=0))


@pytest.mark.parametrize("scale", [0, -1.0, float("nan"), float("inf")])
def test_a_length_that_is_none_is_refused(scale: float, make) -> None:
    with pytest.raises(ArgumentError, match="scale"):
        unit_frame(make.grid(3), scale=scale)


def test_a_shape_without_area_has_no_scale() -> None:
    line = np.arange(4.0)[:, None] * np.ones(3)
    for shape in (Shape(line, [[0, 1, 2], [1, 2, 3]], name="rod.ply"), Shape(np.ones((9, 3)), name="rod.ply")):
        with pytest.raises(ShapeError, match=r"rod\.ply: its surface area"):
            unit_frame(shape)


@pytest.mark.parametrize("name", ["amber", "boris", "sphere"])
def test_a_clouds_length_is_within_a_tenth_of_the_truth(name: str, clouds) -> None:
    points, area = clouds[name]
    assert np.sqrt(cloud_area(points) / area) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize(("name", "ratio"), [("amber", 1.0486), ("boris", 1.0726)])
def test_a_bodys_cloud_has_the_area_that_it_always_had(name: str, ratio: float, clouds) -> None:
    """What weights were trained with, and every distance inside depends on: no value that a formula gives."""
    points, area = clouds[name]
    assert cloud_area(points) / area == pytest.approx(ratio, rel=0.02)


@pytest.mark.parametrize("noise", [0.01, 0.02])
@pytest.mark.parametrize("name", ["amber", "boris", "sphere"])
def test_noise_hardly_moves_a_clouds_length(name: str, noise: float, clouds) -> None:
    points, area = clouds[name]
    for seed in range(3):
        moved = points + np.random.default_rng(seed).normal(size=points.shape) * noise * np.sqrt(area)
        assert np.sqrt(cloud_area(moved) / cloud_area(points)) == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("name", ["amber", "boris", "sphere"])
def test_uneven_sampling_hardly_moves_a_clouds_length(name: str, clouds) -> None:
    points, _ = clouds[name]
    rng = np.random.default_rng(0)
    height = (points[:, 1] - points[:, 1].min()) / np.ptp(points[:, 1])
    kept = points[rng.random(len(points)) < 0.25 + 0.75 * height]  # four times denser at the top
    assert np.sqrt(cloud_area(kept) / cloud_area(points)) == pytest.approx(1, abs=0.03)
    doubled = np.concatenate([points, points[points[:, 1] > np.median(points[:, 1])]])
    assert np.sqrt(cloud_area(doubled) / cloud_area(points)) == pytest.approx(1, abs=0.05)


@given(scale=st.floats(1e-3, 1e3), seed=st.integers(0, 1000))
@hypothesis_settings(max_examples=20)
def test_area_follows_scale_and_forgets_rotation_and_translation(make, scale: float, seed: int) -> None:
    rng = np.random.default_rng(5)
    points = rng.standard_normal((300, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    moved = scale * (points @ make.rotation(seed).T + np.random.default_rng(seed).uniform(-3, 3, 3))
    assert cloud_area(moved) == pytest.approx(scale**2 * cloud_area(points), rel=1e-3)


def test_the_order_of_the_points_does_not_matter(clouds) -> None:
    points, _ = clouds["sphere"]
    points = points[:1900]  # all of them are counted
    shuffled = np.random.default_rng(0).permutation(points)
    assert cloud_area(shuffled) == pytest.approx(cloud_area(points), rel=1e-9)
