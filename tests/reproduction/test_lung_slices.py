"""Surfaces and slices of lungs: what is made of clouds in correspondence, and where points of the slices belong."""

import numpy as np
import pytest
import trimesh

from homolog.core.progress import ignore
from homolog.datasets import ShapeFolder, read_description
from homolog.evaluation import Protocol, evaluate
from homolog.reproduction import lung_slices
from homolog.shapes import Shape, write_shape

STRETCH = {"a": (1.0, 1.0, 1.0), "b": (1.1, 0.9, 1.0), "c": (0.95, 1.05, 1.1)}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Three stretched balls of 30 mm, as clouds of which row i is the same point, and what is made of them."""
    root = tmp_path_factory.mktemp("balls")
    ball = trimesh.creation.icosphere(subdivisions=4, radius=30.0)
    (root / "clouds").mkdir()
    for name, stretch in STRETCH.items():
        write_shape(root / "clouds" / f"{name}.ply", Shape(np.asarray(ball.vertices) * stretch))
    described = """
    title = "Balls"
    holds = "clouds"
    unit = "mm"
    shapes = "clouds/*.ply"
    shuffled = true
    truth = "same-numbering"
    split = "either"
    """
    (root / "balls.toml").write_text(described)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lung_slices, "_RESOLUTION", 40)
        patch.setattr(lung_slices, "_POINTS", 800)
        source = ShapeFolder.open(root, root / "balls.toml")
        lung_slices.write_lung_slices(source, root / "made", progress=ignore)
        before = {file: file.stat().st_mtime_ns for file in (root / "made").rglob("*")}
        lung_slices.write_lung_slices(source, root / "made", progress=ignore)
        assert before == {file: file.stat().st_mtime_ns for file in (root / "made").rglob("*")}
    return ShapeFolder.open(root / "made", read_description("lung_slices"))


def test_pairs_of_one_mask_and_of_two(made):
    pairs = [("a", "a-own"), ("a", "b-other"), ("b", "b-own"), ("b", "c-other"), ("c", "c-own"), ("c", "a-other")]
    assert list(made.pairs("test")) == pairs
    surface, slices = made.shape("a"), made.cloud("a-own")
    assert surface.faces is not None
    assert slices.faces is None
    assert np.linalg.norm(surface.points, axis=1) == pytest.approx(30.0, abs=2.5)
    heights = np.unique(slices.points[:, 1].round(3))
    assert np.diff(heights) == pytest.approx(10.0, abs=0.01)  # every fifth of 2 mm


def test_where_points_of_slices_belong(made):
    """On a stretched ball, at the point that was stretched there."""
    truth = made.ground_truth()
    for full, target in made.pairs("test"):
        cloud = made.cloud(target)
        found = truth.of_cloud(full, target, cloud)
        assert len(found.target) > 0.8 * cloud.n_points
        there = cloud.points[found.target] / STRETCH[target[0]] * STRETCH[full]
        away = np.linalg.norm(made.shape(full).points[found.source] - there, axis=1)
        assert away.mean() < 2.5


def test_errors_are_straight_ones_in_millimetres(made):
    def nearest(source, target):
        return np.linalg.norm(source.points[None] - target.points[:, None], axis=2).argmin(axis=1)

    found = evaluate(None, made, Protocol(modality="mesh-to-cloud"), match=nearest)
    assert found.euclidean_unit == "mm"
    errors = {pair.pair[1]: pair.errors.mean() for pair in found.pairs}
    assert errors["a-own"] < 1e-9
    assert 1.0 < errors["b-other"] < 8.0
