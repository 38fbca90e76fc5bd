"""Small loose pieces beside a shape: they change nothing about the shape's own operators."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from homolog.core.errors import ShapeError
from homolog.geometry import (
    Operators,
    OperatorSettings,
    cloud_laplacian,
    compute_operators,
    mesh_laplacian,
    unit_frame,
)
from homolog.geometry.components import main_points
from homolog.shapes import Shape

SETTINGS = OperatorSettings(n_eigenpairs=40)


def as_modality(shape: Shape, modality: str) -> Shape:
    return shape.as_cloud() if modality == "cloud" else shape


@pytest.fixture(scope="module", params=["mesh", "cloud"])
def both(request, demo, make) -> tuple[Operators, Operators]:
    """Operators of a body alone, and beside 300 pieces that come before it in the file."""
    littered = make.littered(demo.amber, 300, first=True)
    shapes = (as_modality(shape, request.param) for shape in (demo.amber, littered))
    alone, beside = (compute_operators(shape, settings=SETTINGS) for shape in shapes)
    return alone, beside


def test_three_hundred_pieces_leave_the_body_its_own_eigenpairs(both) -> None:
    alone, beside = both
    assert beside.n_points == alone.n_points + 1200 and beside.n_eigenpairs == 40
    assert (beside.eigenvalues[1:] > 0.1 * beside.eigenvalues[-1] / 40).all()
    torch.testing.assert_close(beside.eigenvalues, alone.eigenvalues, rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(beside.eigenvectors[1200:], alone.eigenvectors, rtol=0, atol=1e-3)
    assert not beside.eigenvectors[:1200].any()
    assert beside.in_main_component.tolist() == [False] * 1200 + [True] * alone.n_points


def test_pieces_change_neither_the_frame_nor_the_other_operators_of_the_body(both) -> None:
    alone, beside = both
    assert beside.scale == pytest.approx(alone.scale, rel=1e-12)
    torch.testing.assert_close(beside.points[1200:], alone.points)
    torch.testing.assert_close(beside.mass[1200:], alone.mass)
    assert 0 < beside.mass[:1200].sum() < 1e-5 * alone.mass.sum()
    functions = torch.from_numpy(np.random.default_rng(1).standard_normal((beside.n_points, 2))).float()
    for name in ("laplacian", "gradient_x", "gradient_y"):
        image = getattr(beside, name) @ functions
        torch.testing.assert_close(image[1200:], getattr(alone, name) @ functions[1200:], rtol=1e-3, atol=1e-3)
        assert not image[:1200].any()
    gram = beside.coefficients(beside.eigenvectors)
    torch.testing.assert_close(gram, torch.eye(40), atol=1e-4, rtol=0)


@pytest.mark.parametrize("modality", ["mesh", "cloud"])
def test_components_of_similar_size_all_count(modality: str, make) -> None:
    spheres = [make.sphere(1, radius=1 + 0.1 * i) for i in range(12)]
    apart = [Shape(sphere.points + np.array([40.0 * i, 0, 0]), sphere.faces) for i, sphere in enumerate(spheres)]
    shape = as_modality(make.joined(apart), modality)
    assert main_points(shape).all()
    operators = compute_operators(shape, settings=SETTINGS)
    assert operators.in_main_component.all() and operators.n_pieces == 12


def test_components_below_a_hundredth_of_the_largest_ones_area_do_not_count(make) -> None:
    large = make.sphere(2)
    for radius, main in ((0.11, True), (0.09, False)):
        small = make.sphere(1, radius=radius)
        shape = make.joined([large, Shape(small.points + 5, small.faces)])
        assert main_points(shape)[: large.n_points].all()
        assert (main_points(shape)[large.n_points :] == main).all()


def test_all_points_of_a_cloud_of_uneven_density_count(make) -> None:
    # One half of the points on a tenth of a strip: three times the spacing elsewhere.
    rng = np.random.default_rng(0)
    along = np.r_[rng.random(2000), 1 + 9 * rng.random(2000)]
    assert main_points(Shape(np.stack([along, rng.random(4000), np.sin(along)], axis=1))).all()
    assert main_points(Shape(rng.random((20, 3)))).all()
    # Where half of the points seem to be in small components, nothing is left out.
    sparse = np.stack([np.arange(1000) * 3.0, np.zeros(1000), np.ones(1000)], axis=1)
    assert main_points(Shape(np.r_[make.grid(33).points, sparse])).all()


def test_single_points_far_from_a_cloud_do_not_count(make) -> None:
    cloud = Shape(np.r_[make.blob(3).points, [[9.0, 0, 0], [0, -50.0, 0]]])
    assert main_points(cloud).tolist() == [True] * 642 + [False] * 2
    assert unit_frame(cloud).scale == pytest.approx(unit_frame(make.blob(3).as_cloud()).scale, rel=1e-12)


UNUSABLE = {
    "NaN or infinite": lambda points, faces: (np.where(np.arange(12)[:, None] == 3, np.nan, points), faces),
    "20.*but 12 points": lambda points, faces: (points, np.r_[faces, [[0, 1, 20]]]),
    "from -1 to": lambda points, faces: (points, np.r_[faces, [[0, 1, -1]]]),
    "no faces": lambda points, faces: (points, faces[:0]),
    "has 2 points": lambda points, faces: (points[:2], np.array([[0, 1, 1]])),
    "points have shape": lambda points, faces: (points[:, :2], faces),
    "faces have shape": lambda points, faces: (points, faces[:, [0, 1, 2, 2]]),
}


@pytest.mark.parametrize("words", UNUSABLE)
def test_what_no_operator_can_be_computed_of_is_refused_in_one_line(words: str, make) -> None:
    sphere = make.sphere(0)
    points, faces = UNUSABLE[words](sphere.points, sphere.faces)
    for compute in (
        lambda: compute_operators(Shape(points, faces, name="scan.ply", allow_broken=True)),
        lambda: unit_frame(Shape(points, faces, name="scan.ply", allow_broken=True)),
        lambda: mesh_laplacian(points, faces),
    ):
        with pytest.raises(ShapeError, match=words.replace("points have shape", "have shape")) as raised:
            compute()
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize("points", [np.zeros((40, 3)), np.arange(40.0)[:, None] * [1, 2, 3], np.full((40, 3), np.nan)])
def test_clouds_that_the_library_cannot_triangulate_are_refused_in_one_line(points: np.ndarray) -> None:
    for compute in (lambda: cloud_laplacian(points), lambda: compute_operators(Shape(points, name="scan.ply"))):
        with pytest.raises(ShapeError) as raised:
            compute()
        assert "\n" not in str(raised.value) and "GC_SAFETY" not in str(raised.value)
    with pytest.raises(ShapeError, match=r"^scan\.ply"):
        compute_operators(Shape(points, name="scan.ply"))
