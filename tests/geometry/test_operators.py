"""All of a shape's operators together: what they are, and what does not change them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from homolog.core.errors import ArgumentError, ShapeError
from homolog.geometry import Basis, Operators, OperatorSettings, compute_operators, mesh_laplacian
from homolog.geometry.scale import Frame
from homolog.shapes import Shape

SETTINGS = OperatorSettings(n_eigenpairs=20)
MODALITIES = ("mesh", "cloud")


def operators_of(shape: Shape, modality: str, *, scale: float | None = None) -> Operators:
    return compute_operators(shape.as_cloud() if modality == "cloud" else shape, settings=SETTINGS, scale=scale)


def dense_gradient_size(operators: Operators, values: torch.Tensor) -> torch.Tensor:
    """Lengths of gradients, whatever the tangent frames."""
    return torch.hypot(operators.gradient_x @ values, operators.gradient_y @ values)


@pytest.fixture(scope="module")
def blob(make) -> Shape:
    return make.blob(3)


@pytest.mark.parametrize("modality", MODALITIES)
def test_what_they_are(modality: str, blob: Shape) -> None:
    operators = operators_of(blob, modality)
    n, k = blob.n_points, 20
    assert (operators.n_points, operators.n_eigenpairs) == (n, k)
    assert operators.points.shape == (n, 3) and operators.eigenvectors.shape == (n, k)
    single = (operators.points, operators.mass, operators.eigenvalues, operators.eigenvectors)
    assert all(tensor.dtype == torch.float32 and tensor.is_contiguous() for tensor in single)
    for matrix in (operators.laplacian, operators.gradient_x, operators.gradient_y):
        assert matrix.layout == torch.sparse_csr and matrix.shape == (n, n) and matrix.dtype == torch.float32
    phi, mass = operators.eigenvectors.double(), operators.mass.double()
    torch.testing.assert_close(phi.T @ (mass[:, None] * phi), torch.eye(k, dtype=torch.float64), atol=1e-5, rtol=0)
    residual = operators.laplacian.double() @ phi - mass[:, None] * phi * operators.eigenvalues.double()
    assert (residual.square() / mass[:, None]).sum(dim=0).sqrt().max() < 1e-3 * operators.eigenvalues[-1]
    np.testing.assert_allclose(operators.points.mean(dim=0), 0, atol=1e-6)
    restored = operators.points.double() * operators.scale + operators.centre
    np.testing.assert_allclose(restored, blob.points, atol=1e-5)
    if modality == "mesh":
        assert operators.mass.sum() == pytest.approx(1, rel=1e-4)


def test_a_mesh_is_worked_on_at_unit_area_with_the_laplacian_asked_for(blob: Shape) -> None:
    frame_points = operators_of(blob, "mesh").points.double().numpy()
    for kind in ("robust", "cotangent"):
        operators = compute_operators(blob, settings=OperatorSettings(n_eigenpairs=5, laplacian=kind))
        expected, mass = mesh_laplacian(frame_points, blob.faces, kind=kind)
        np.testing.assert_allclose(operators.laplacian.to_dense(), expected.toarray(), atol=2e-4)
        np.testing.assert_allclose(operators.mass, mass, rtol=1e-4)


@pytest.mark.parametrize("modality", MODALITIES)
def test_the_gradient_of_the_coordinates_has_the_length_of_their_tangent_part(modality: str, make) -> None:
    # On a sphere the squared lengths of the three gradients sum to two.
    operators = operators_of(make.sphere(3), modality)
    squared = sum(dense_gradient_size(operators, operators.points[:, axis]).square() for axis in range(3))
    np.testing.assert_allclose(squared, 2, atol=0.15)


@pytest.mark.parametrize("modality", MODALITIES)
def test_relabelling_the_points_relabels_everything(modality: str, blob: Shape, make) -> None:
    order = np.random.default_rng(0).permutation(blob.n_points)
    first, second = operators_of(blob, modality), operators_of(make.relabelled(blob, order), modality)
    torch.testing.assert_close(second.points, first.points[order])
    torch.testing.assert_close(second.mass, first.mass[order], rtol=1e-4, atol=0)
    torch.testing.assert_close(second.eigenvalues, first.eigenvalues, rtol=1e-4, atol=1e-5)
    overlap = (second.eigenvectors * first.eigenvectors[order] * second.mass[:, None]).sum(dim=0)
    torch.testing.assert_close(overlap.abs(), torch.ones(20), atol=1e-4, rtol=0)  # each up to its sign
    relabelled = first.laplacian.to_dense()[order][:, order]
    torch.testing.assert_close(second.laplacian.to_dense(), relabelled, atol=1e-3, rtol=1e-3)
    values = torch.from_numpy(np.random.default_rng(1).standard_normal((blob.n_points, 2))).float()
    expected = dense_gradient_size(first, values)[order]
    torch.testing.assert_close(dense_gradient_size(second, values[order]), expected, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("modality", MODALITIES)
def test_moving_and_scaling_change_nothing_but_centre_and_length(modality: str, blob: Shape) -> None:
    first = operators_of(blob, modality)
    offset = np.array([3.0, -40.0, 7.0])
    second = operators_of(Shape(25.0 * blob.points + offset, blob.faces), modality)
    assert second.scale == pytest.approx(25 * first.scale, rel=1e-6)
    np.testing.assert_allclose(second.centre, 25 * first.centre.numpy() + offset, atol=1e-6)
    torch.testing.assert_close(second.points, first.points, atol=1e-5, rtol=0)
    torch.testing.assert_close(second.mass, first.mass, rtol=1e-4, atol=0)
    torch.testing.assert_close(second.eigenvalues, first.eigenvalues, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(second.eigenvectors, first.eigenvectors, atol=1e-3, rtol=0)
    values = torch.from_numpy(np.random.default_rng(1).standard_normal((blob.n_points, 2))).float()
    sizes = dense_gradient_size(first, values)
    torch.testing.assert_close(dense_gradient_size(second, values), sizes, atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("modality", MODALITIES)
def test_turning_the_shape_leaves_the_intrinsic_operators(modality: str, blob: Shape, make) -> None:
    first = operators_of(blob, modality)
    second = operators_of(Shape(blob.points @ make.rotation(3).T, blob.faces), modality)
    torch.testing.assert_close(second.eigenvalues, first.eigenvalues, rtol=1e-3, atol=1e-4)
    values = torch.from_numpy(np.random.default_rng(1).standard_normal((blob.n_points, 2))).float()
    sizes = dense_gradient_size(first, values)
    torch.testing.assert_close(dense_gradient_size(second, values), sizes, atol=1e-2, rtol=1e-3)


@pytest.mark.parametrize("modality", MODALITIES)
def test_a_given_length_is_the_inner_unit(modality: str, blob: Shape) -> None:
    own = operators_of(blob, modality)
    half = operators_of(blob, modality, scale=2 * own.scale)
    assert half.scale == 2 * own.scale
    torch.testing.assert_close(half.points, own.points / 2)
    torch.testing.assert_close(half.mass.sum(), own.mass.sum() / 4, rtol=1e-3, atol=0)
    torch.testing.assert_close(half.eigenvalues, 4 * own.eigenvalues, rtol=1e-3, atol=1e-3)


def test_cutting_down_to_fewer_eigenpairs_keeps_the_lowest(blob: Shape) -> None:
    operators = operators_of(blob, "mesh")
    few = operators.truncated(7)
    assert few.n_eigenpairs == 7 and operators.n_eigenpairs == 20
    torch.testing.assert_close(few.eigenvectors, operators.eigenvectors[:, :7], atol=0, rtol=0)
    assert few.mass is operators.mass


def test_coefficients_undo_synthesis(blob: Shape) -> None:
    operators = operators_of(blob, "cloud")
    wanted = torch.from_numpy(np.random.default_rng(1).standard_normal((20, 3))).float()
    torch.testing.assert_close(operators.coefficients(operators.eigenvectors @ wanted), wanted, atol=1e-4, rtol=0)


def test_a_shape_of_few_points_has_as_many_eigenpairs_as_points(make) -> None:
    assert compute_operators(make.sphere(0)).n_eigenpairs == 12


def test_moving_to_a_device_keeps_all_and_the_frame_can_be_read_back(blob: Shape) -> None:
    operators = operators_of(blob, "mesh")
    moved = operators.to("cpu")
    assert (moved.scale, moved.method) == (operators.scale, operators.method)
    torch.testing.assert_close(moved.points, operators.points, atol=0, rtol=0)
    frame = Frame(centre=moved.centre.numpy(), scale=moved.scale)
    np.testing.assert_allclose(frame.to_unit(blob.points), operators.points, atol=1e-6)


def test_bad_settings_and_degenerate_shapes_are_refused(blob: Shape) -> None:
    with pytest.raises(ArgumentError, match="n_eigenpairs"):
        compute_operators(blob, settings=OperatorSettings(n_eigenpairs=0))
    with pytest.raises(ArgumentError, match="laplacian"):
        compute_operators(blob, settings=OperatorSettings(laplacian="cotan"))
    with pytest.raises(ShapeError, match="area"):
        compute_operators(Shape(np.zeros((40, 3))))


def test_neighbouring_points_of_a_cloud_are_a_setting(blob: Shape) -> None:
    counts = {}
    for n_neighbours in (8, 15):
        settings = OperatorSettings(n_eigenpairs=5, n_neighbours=n_neighbours)
        operators = compute_operators(blob.as_cloud(), settings=settings)
        counts[n_neighbours] = operators.gradient_x.values().numel() / blob.n_points
    assert counts == {8: 9, 15: 16}  # the point itself too


@pytest.mark.parametrize(
    "wrong", [{"n_neighbours": 0}, {"n_neighbours": 2}, {"n_eigenpairs": 0}, {"laplacian": "robst"}]
)
def test_settings_that_cannot_be_are_refused(wrong: dict) -> None:
    with pytest.raises(ArgumentError, match=next(iter(wrong))):
        OperatorSettings(**wrong)


@pytest.mark.parametrize("modality", ["mesh", "cloud"])
def test_scaled_operators_are_those_of_the_scaled_shape(make, modality):
    blob = make.blob(2)
    own = operators_of(blob, modality, scale=1.0)
    found, wanted = own.scaled(2.5), operators_of(blob, modality, scale=own.scale / 2.5)
    assert found.scale == pytest.approx(wanted.scale)
    for name in ("points", "mass", "eigenvalues"):
        torch.testing.assert_close(getattr(found, name), getattr(wanted, name), rtol=1e-4, atol=1e-4)
    for name in ("laplacian", "gradient_x", "gradient_y"):
        first, second = getattr(found, name).to_dense(), getattr(wanted, name).to_dense()
        torch.testing.assert_close(first.abs(), second.abs(), rtol=1e-3, atol=1e-3 * float(second.abs().max()))
    gram = found.eigenvectors.T @ (found.mass[:, None] * found.eigenvectors)
    torch.testing.assert_close(gram, torch.eye(len(gram)), rtol=0, atol=1e-4)


def side_of_gradients(operators: Operators | Basis) -> torch.Tensor:
    """The normal that right-handed tangent frames have, by the gradients of the positions in them."""
    if isinstance(operators, Basis):
        along = torch.einsum("njk,kc->njc", operators.gradients, operators.coefficients(operators.points))
        return torch.linalg.cross(along[:, 0], along[:, 1])
    return torch.linalg.cross(operators.gradient_x @ operators.points, operators.gradient_y @ operators.points)


@pytest.mark.parametrize("seed", range(3))
def test_a_turned_cloud_has_the_normals_that_it_would_have_there(seed: int, blob: Shape) -> None:
    cloud, turn = blob.as_cloud(), Rotation.random(random_state=seed).as_matrix()
    given, there = operators_of(cloud, "cloud"), operators_of(Shape(cloud.points @ turn.T, None), "cloud")
    turned = given.turned(torch.from_numpy(turn))
    sides = side_of_gradients(there)

    def share_alike(others: torch.Tensor) -> float:
        return float(((sides * others).sum(dim=1) > 0).float().mean())

    assert share_alike(side_of_gradients(turned)) > 0.995
    assert share_alike(side_of_gradients(given) @ torch.from_numpy(turn).float().T) < 0.9  # or there is nothing to do
    kept = torch.arange(0, cloud.n_points, 2)
    sampled = side_of_gradients(given.basis.sampled(kept).turned(torch.from_numpy(turn).float()))
    assert float(((sides[kept] * sampled).sum(dim=1) > 0).float().mean()) > 0.95  # where a smooth fit tells the normal
    torch.testing.assert_close(turned.turned(torch.from_numpy(turn.T)).gradient_x.values(), given.gradient_x.values())


def test_a_turned_mesh_keeps_its_gradients(blob: Shape) -> None:
    operators = operators_of(blob, "mesh")
    turned = operators.turned(torch.from_numpy(Rotation.random(random_state=0).as_matrix()))
    assert turned.gradient_x is operators.gradient_x
    assert turned.scatter is None
