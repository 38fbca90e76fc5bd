"""Eigenpairs against closed forms and a dense solver."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sparse
import scipy.sparse.linalg as sparse_linalg
import torch
import trimesh

from homolog.core.errors import ArgumentError, ShapeError
from homolog.geometry import (
    Spectrum,
    cloud_laplacian,
    compute_operators,
    lowest_eigenpairs,
    mesh_laplacian,
    spectrum,
)
from homolog.geometry.lanczos import BlockLanczos
from homolog.shapes import Shape


def dense_pairs(laplacian: sparse.spmatrix, mass: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All eigenpairs by LAPACK."""
    return scipy.linalg.eigh(laplacian.toarray(), np.diag(mass))


def assert_agrees(found: Spectrum, laplacian: sparse.spmatrix, mass: np.ndarray, k: int) -> None:
    """The same eigenvalues, and the same subspaces for clusters of equal ones."""
    values, vectors = dense_pairs(laplacian, mass)
    scale = values[k - 1] + 1e-3 / mass.sum()
    assert found.eigenvalues.shape == (k,) and found.eigenvectors.shape == (len(mass), k)
    np.testing.assert_allclose(found.eigenvalues, values[:k], atol=1e-7 * scale)
    np.testing.assert_allclose(found.eigenvectors.T @ (mass[:, None] * found.eigenvectors), np.eye(k), atol=1e-8)
    errors = laplacian @ found.eigenvectors - mass[:, None] * found.eigenvectors * found.eigenvalues
    assert np.linalg.norm(errors / np.sqrt(mass)[:, None], axis=0).max() < 1e-5 * scale
    assert found.residual < 1e-6
    starts = np.flatnonzero(np.diff(values, prepend=-np.inf) > 1e-5 * scale)
    for first, last in zip(starts, [*starts[1:], len(values)], strict=True):
        if first >= k:
            break
        # The found vectors of this cluster must lie in the span of all its true ones.
        inside = vectors[:, first:last].T @ (mass[:, None] * found.eigenvectors[:, first : min(last, k)])
        np.testing.assert_allclose(np.linalg.svd(inside, compute_uv=False), 1, atol=1e-5)


def laplacian_of(shape) -> tuple[sparse.csr_matrix, np.ndarray]:
    return mesh_laplacian(shape.points, shape.faces)


def apart(make, count: int, subdivisions: int, *, growth: float = 0.0):
    """Spheres that do not touch, of one size or growing."""
    shapes = []
    for i in range(count):
        sphere = make.sphere(subdivisions, radius=1 + growth * i)
        shapes.append(type(sphere)(sphere.points + np.array([4.0 * i, 0, 0]), sphere.faces))
    return make.joined(shapes)


@pytest.mark.parametrize("modality", ["mesh", "cloud"])
def test_a_sphere_has_the_eigenvalues_of_spherical_harmonics(modality: str, make) -> None:
    sphere = make.sphere(4)
    build = laplacian_of(sphere) if modality == "mesh" else cloud_laplacian(sphere.points)
    found = lowest_eigenpairs(*build, 49)
    assert "block Lanczos" in found.method
    expected = np.concatenate([np.full(2 * degree + 1, degree * (degree + 1.0)) for degree in range(7)])
    np.testing.assert_allclose(found.eigenvalues[0], 0, atol=1e-9)
    np.testing.assert_allclose(found.eigenvalues[1:], expected[1:], rtol=0.02 if modality == "mesh" else 0.05)
    # The constants and the coordinates, up to a turn among the latter.
    np.testing.assert_allclose(found.eigenvectors[:, 0], 1 / np.sqrt(build[1].sum()), rtol=1e-6)
    in_span = found.eigenvectors[:, 1:4].T @ (build[1][:, None] * sphere.points)
    np.testing.assert_allclose(in_span @ in_span.T, np.eye(3) * 4 * np.pi / 3, atol=0.2)


def test_a_flat_square_has_the_eigenvalues_of_cosines(make) -> None:
    found = lowest_eigenpairs(*laplacian_of(make.grid(33)), 12)
    p, q = np.meshgrid(np.arange(6), np.arange(6))
    expected = np.sort((np.pi**2 * (p**2 + q**2)).ravel())[:12]
    np.testing.assert_allclose(found.eigenvalues[1:], expected[1:], rtol=0.03)


@pytest.mark.parametrize("k", [1, 2, 17, 60, 128])
def test_the_iteration_agrees_with_a_dense_solver(k: int, make) -> None:
    for shape in (make.sphere(3), make.blob(3)):
        laplacian, mass = laplacian_of(shape)
        found = lowest_eigenpairs(laplacian, mass, k)
        assert found.method.startswith("block Lanczos")
        assert_agrees(found, laplacian, mass, k)


def test_a_torus_and_a_cloud_agree_with_a_dense_solver(make) -> None:
    torus = trimesh.creation.torus(1.0, 0.35, major_sections=32, minor_sections=20)
    for laplacian, mass in (mesh_laplacian(torus.vertices, torus.faces), cloud_laplacian(make.blob(3).points)):
        assert_agrees(lowest_eigenpairs(laplacian, mass, 40), laplacian, mass, 40)


@pytest.mark.parametrize("k", [2, 9, 30, 45, 46, 100, 128])
def test_identical_pieces_repeat_every_eigenvalue_and_none_is_missed(k: int, make) -> None:
    # Five equal spheres: multiplicities up to 25, three times the first block.
    laplacian, mass = laplacian_of(apart(make, 5, 2))
    assert_agrees(lowest_eigenpairs(laplacian, mass, k), laplacian, mass, k)


@pytest.mark.parametrize("k", [3, 12, 40])
def test_pieces_of_different_size_agree_with_a_dense_solver(k: int, make) -> None:
    laplacian, mass = laplacian_of(apart(make, 12, 1, growth=0.2))
    found = lowest_eigenpairs(laplacian, mass, k)
    assert found.method.startswith("block Lanczos")
    assert_agrees(found, laplacian, mass, k)
    np.testing.assert_allclose(found.eigenvalues[:12], 0, atol=1e-9)


def test_more_pieces_than_eigenpairs_are_no_trouble_where_a_dense_solve_is_out_of_reach(make) -> None:
    laplacian, mass = laplacian_of(apart(make, 160, 1))  # 6,720 points
    found = lowest_eigenpairs(laplacian, mass, 100)
    assert found.method.startswith("block Lanczos") and found.residual < 1e-6
    np.testing.assert_allclose(found.eigenvalues, 0, atol=1e-9)
    np.testing.assert_allclose(found.eigenvectors.T @ (mass[:, None] * found.eigenvectors), np.eye(100), atol=1e-8)


def test_points_without_a_face_do_not_disturb_the_rest(make) -> None:
    sphere = make.sphere(3)
    loose = np.random.default_rng(0).normal(size=(30, 3)) * 5
    laplacian, mass = mesh_laplacian(np.vstack([sphere.points, loose]), sphere.faces)
    found = lowest_eigenpairs(laplacian, mass, 36)
    assert found.method.startswith("block Lanczos")
    assert_agrees(found, laplacian, mass, 36)


@pytest.mark.parametrize(("subdivisions", "k"), [(2, 10), (2, 162), (2, 500), (3, 130), (3, 642), (0, 1)])
def test_small_problems_and_most_of_a_spectrum_are_solved_densely(subdivisions: int, k: int, make) -> None:
    laplacian, mass = laplacian_of(make.blob(subdivisions))
    found = lowest_eigenpairs(laplacian, mass, k)
    assert found.method == "dense"
    assert_agrees(found, laplacian, mass, min(k, len(mass)))


def test_results_are_the_same_on_every_call_and_signs_are_fixed(make) -> None:
    laplacian, mass = laplacian_of(make.blob(3))
    first, second = lowest_eigenpairs(laplacian, mass, 30), lowest_eigenpairs(laplacian, mass, 30)
    np.testing.assert_array_equal(first.eigenvectors, second.eigenvectors)
    largest = np.abs(first.eigenvectors).argmax(axis=0)
    assert (first.eigenvectors[largest, np.arange(30)] > 0).all()
    assert (first.eigenvalues >= 0).all() and (np.diff(first.eigenvalues) >= 0).all()


@pytest.mark.parametrize("k", [0, -3])
def test_a_number_of_eigenpairs_below_one_is_refused(k: int, make) -> None:
    with pytest.raises(ArgumentError, match="n_eigenpairs"):
        lowest_eigenpairs(*laplacian_of(make.grid(3)), k)


def test_negative_pivots_count_the_eigenvalues_below(make) -> None:
    laplacian, mass = laplacian_of(make.sphere(2))
    problem = spectrum._Problem.build(laplacian, mass)
    values, _ = dense_pairs(laplacian, mass)
    for value in (-0.1, 0.5, 4.0, 9.0, 33.3, 150.0, 1e5):
        assert problem.count_below(value) == (values < value).sum()


@pytest.mark.parametrize("hidden", [1, 5, 20])
def test_a_missed_eigenpair_is_noticed(hidden: int, make, monkeypatch) -> None:
    """An iteration that has never heard of one eigenvector must not pass for complete."""
    laplacian, mass = laplacian_of(make.blob(3))
    values, vectors = dense_pairs(laplacian, mass)
    lost = torch.from_numpy(np.sqrt(mass) * vectors[:, hidden])

    class Forgetful(BlockLanczos):
        def __init__(self, inverse, kernel, **options):
            super().__init__(inverse, torch.cat([kernel, lost[None]]), **options)

    monkeypatch.setattr(spectrum, "BlockLanczos", Forgetful)
    found = lowest_eigenpairs(laplacian, mass, 30)
    assert found.method == "dense, after block Lanczos failed"
    np.testing.assert_allclose(found.eigenvalues, values[:30], atol=1e-8 * values[29])


def test_a_missed_copy_is_noticed_below_a_cluster_that_is_cut_by_k(make) -> None:
    laplacian, mass = laplacian_of(apart(make, 5, 2))
    problem = spectrum._Problem.build(laplacian, mass)
    values, vectors = dense_pairs(laplacian, mass)
    rows = np.sqrt(mass)[:, None] * vectors
    k = 30  # within the 25-fold cluster that begins at 20
    whole = (torch.from_numpy(values[: k + 1]), torch.from_numpy(rows[:, : k + 1]))
    assert spectrum._complete(problem, whole, k) is not None
    lacking = np.delete(np.arange(k + 2), 12)  # one of the 15 that begin at 5
    part = (torch.from_numpy(values[lacking]), torch.from_numpy(rows[:, lacking]))
    assert spectrum._complete(problem, part, k) is None


def test_the_last_resorts_say_what_they_did(make, monkeypatch) -> None:
    laplacian, mass = laplacian_of(make.blob(3))
    monkeypatch.setattr(spectrum, "_shift_and_invert", lambda *_: None)
    found = lowest_eigenpairs(laplacian, mass, 20)
    assert found.method == "dense, after block Lanczos failed"
    assert_agrees(found, laplacian, mass, 20)
    monkeypatch.setattr(spectrum, "_DENSE_LIMIT", 600)
    found = lowest_eigenpairs(laplacian, mass, 20)
    assert found.method == "ARPACK, after block Lanczos failed"
    assert_agrees(found, laplacian, mass, 20)


def test_the_last_resort_says_when_it_missed_an_eigenpair(make, monkeypatch, caplog) -> None:
    laplacian, mass = laplacian_of(make.blob(3))
    whole = sparse_linalg.eigsh

    def forgetful(matrix, k, **options):
        values, vectors = whole(matrix, k + 1, **options)
        kept = np.argsort(values) != 5
        return values[kept], vectors[:, kept]

    monkeypatch.setattr(spectrum, "_shift_and_invert", lambda *_: None)
    monkeypatch.setattr(spectrum, "_DENSE_LIMIT", 600)
    monkeypatch.setattr(spectrum.sparse_linalg, "eigsh", forgetful)
    found = lowest_eigenpairs(laplacian, mass, 20)
    assert found.method == "ARPACK, incomplete, after block Lanczos failed"
    assert "missed" in caplog.text
    assert found.eigenvectors.shape == (len(mass), 20)


def test_solves_in_several_threads_give_the_same_eigenpairs(make, monkeypatch) -> None:
    laplacian, mass = laplacian_of(make.blob(3))
    monkeypatch.setattr(spectrum, "_ONE_THREAD_POINTS", 0)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 3)  # blocks of eight do not divide by it
    found = lowest_eigenpairs(laplacian, mass, 30)
    assert found.method == "block Lanczos, blocks of 8"
    assert_agrees(found, laplacian, mass, 30)


def test_the_shift_follows_the_pivots_where_weyls_law_is_off() -> None:
    # A strip: its eigenvalues are those of a line, not of a surface.
    along, across = np.meshgrid(np.linspace(0, 8, 401), [0.0, 0.01], indexing="ij")
    first = np.arange(0, 800, 2)[:, None]
    faces = np.concatenate([first + np.array(corners) for corners in ([0, 1, 2], [2, 1, 3])])
    laplacian, mass = mesh_laplacian(np.stack([along, across, 0 * along], axis=2).reshape(-1, 3), faces)
    problem = spectrum._Problem.build(laplacian, mass)
    shift, _ = spectrum._shifted(problem, 40)
    assert shift < 0.2 * 0.62 * problem.expected_eigenvalue(40)
    found = lowest_eigenpairs(laplacian, mass, 40)
    assert found.method == "block Lanczos, blocks of 8"
    assert_agrees(found, laplacian, mass, 40)
    np.testing.assert_allclose(found.eigenvalues[:20], (np.pi / 8 * np.arange(20)) ** 2, rtol=0.01, atol=1e-9)


def test_when_nothing_works_the_message_says_what_to_do(make, monkeypatch) -> None:
    def fails(*_args, **_options):
        raise sparse_linalg.ArpackError(-1)

    def inaccurate(matrix, k, **_options):
        values, vectors = np.arange(k) + 1.0, np.eye(matrix.shape[0], k)
        return values, vectors

    def out_of_memory(*_args, **_options):
        raise MemoryError

    def singular(*_args):
        raise RuntimeError("Factor is exactly singular")

    blob = make.blob(3)
    laplacian, mass = laplacian_of(blob)
    monkeypatch.setattr(spectrum, "_shift_and_invert", lambda *_: None)
    monkeypatch.setattr(spectrum, "_DENSE_LIMIT", 600)
    for solver, words in ((fails, "ARPACK"), (inaccurate, "residual"), (out_of_memory, "MemoryError")):
        monkeypatch.setattr(spectrum.sparse_linalg, "eigsh", solver)
        with pytest.raises(ShapeError, match=f"not found .*{words}.*remesh"):
            lowest_eigenpairs(laplacian, mass, 20)
    monkeypatch.undo()
    monkeypatch.setattr(spectrum, "_DENSE_LIMIT", 600)
    monkeypatch.setattr(spectrum._Problem, "factorise", singular)
    with pytest.raises(ShapeError, match=r"^scan\.ply: .*singular.*remesh"):
        compute_operators(Shape(blob.points, blob.faces, name="scan.ply"))


def test_arpack_gives_up_instead_of_hanging(make, monkeypatch) -> None:
    laplacian, mass = laplacian_of(make.sphere(3))
    monkeypatch.setattr(spectrum, "_shift_and_invert", lambda *_: None)
    monkeypatch.setattr(spectrum, "_DENSE_LIMIT", 600)
    monkeypatch.setattr(spectrum, "_MOST_RESTARTS", 1)
    with pytest.raises(ShapeError, match="No convergence"):
        lowest_eigenpairs(laplacian, mass, 100)


def test_a_count_of_eigenvalues_that_hits_one_is_survived(make, monkeypatch) -> None:
    laplacian, mass = laplacian_of(make.blob(3))
    whole = spectrum._Problem.count_below
    calls = []

    def hits_once(self, value):
        calls.append(value)
        if len(calls) > 1:
            return whole(self, value)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(spectrum._Problem, "factorise", raise_singular)
            return whole(self, value)

    def raise_singular(*_args):
        raise RuntimeError("Factor is exactly singular")

    monkeypatch.setattr(spectrum._Problem, "count_below", hits_once)
    found = lowest_eigenpairs(laplacian, mass, 20)
    assert found.method == "block Lanczos, blocks of 32" and len(calls) == 2
    assert_agrees(found, laplacian, mass, 20)
    monkeypatch.setattr(spectrum, "_shift_and_invert", lambda *_: None)
    monkeypatch.setattr(spectrum, "_DENSE_LIMIT", 600)
    calls.clear()
    found = lowest_eigenpairs(laplacian, mass, 20)
    assert found.method == "ARPACK, incomplete, after block Lanczos failed"  # as far as can be told
    assert_agrees(found, laplacian, mass, 20)


@pytest.mark.parametrize("method", ["dense", "dense, after block Lanczos failed", "ARPACK, after block Lanczos failed"])
def test_every_solver_gives_the_constants_of_pieces_apart(method: str, make, monkeypatch) -> None:
    pieces = apart(make, 6, 2, growth=0.2) if method != "dense" else apart(make, 6, 1, growth=0.2)
    laplacian, mass = laplacian_of(pieces)
    if method != "dense":
        monkeypatch.setattr(spectrum, "_shift_and_invert", lambda *_: None)
        monkeypatch.setattr(spectrum, "_DENSE_LIMIT", 6000 if method.startswith("dense") else 600)
    found = lowest_eigenpairs(laplacian, mass, 20)
    assert found.method == method
    assert_agrees(found, laplacian, mass, 20)
    piece = np.arange(len(mass)) // (len(mass) // 6)
    weights = np.bincount(piece, mass)
    largest_first = np.argsort(-weights)
    for number, vector in enumerate(found.eigenvectors[:, :6].T):
        expected = np.where(piece == largest_first[number], 1 / np.sqrt(weights[largest_first[number]]), 0)
        np.testing.assert_allclose(vector, expected, atol=1e-12)


def test_a_dense_solve_of_what_is_not_finite_is_refused(make) -> None:
    laplacian, mass = laplacian_of(make.grid(5))
    laplacian.data[3] = np.nan
    with pytest.raises(ShapeError, match=r"not found.*remesh"):
        lowest_eigenpairs(laplacian, mass, 5)


def test_a_shift_that_hits_an_eigenvalue_is_survived(make, monkeypatch) -> None:
    laplacian, mass = laplacian_of(make.blob(3))
    whole = spectrum._Problem.factorise
    calls = []

    def singular_once(self, shift):
        calls.append(shift)
        if len(calls) == 1:
            raise RuntimeError("Factor is exactly singular")
        return whole(self, shift)

    monkeypatch.setattr(spectrum._Problem, "factorise", singular_once)
    found = lowest_eigenpairs(laplacian, mass, 20)
    assert found.method == "block Lanczos, blocks of 32"
    assert_agrees(found, laplacian, mass, 20)


def test_block_lanczos_projects_the_operator_onto_an_orthonormal_basis() -> None:
    rng = np.random.default_rng(3)
    n, block = 60, 4
    factor = rng.standard_normal((n, n))
    operator = torch.from_numpy(factor @ factor.T / n)
    kernel = torch.linalg.qr(torch.from_numpy(rng.standard_normal((n, 2)))).Q.T.contiguous()
    krylov = BlockLanczos(lambda rows: rows @ operator, kernel, block=block, capacity=40)
    while krylov.grow():
        pass
    assert krylov.size == 36
    rows = krylov._rows[:42]
    torch.testing.assert_close(rows @ rows.T, torch.eye(42, dtype=torch.float64), atol=1e-12, rtol=0)
    torch.testing.assert_close(rows[:2], kernel, atol=0, rtol=0)
    basis = rows[2:38].T
    values, vectors, errors = krylov.ritz_pairs()
    torch.testing.assert_close(values, torch.linalg.eigvalsh(basis.T @ operator @ basis), atol=1e-10, rtol=0)
    lifted = basis @ vectors
    image = operator @ lifted
    image = image - kernel.T @ (kernel @ image)
    torch.testing.assert_close((image - lifted * values).norm(dim=0), errors, atol=1e-9, rtol=0)
    refined = krylov.refined(values, vectors)
    torch.testing.assert_close(refined, torch.cat([kernel.T, image / values], dim=1), atol=1e-9, rtol=1e-9)
