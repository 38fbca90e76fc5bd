"""Shapes that are read some at a time, against arrays of all."""

import numpy as np
import pytest

from homolog.core.errors import ArgumentError
from homolog.core.files import all_or_nothing, write_npy, write_npy_rows
from homolog.statistics import (
    FileRows,
    compactness,
    generalisation,
    generalised_procrustes,
    principal_modes,
    specificity,
)


@pytest.fixture
def shapes():
    """Sixty shapes of 30 points whose modes are ever smaller."""
    rng = np.random.default_rng(2)
    modes = np.linalg.qr(rng.standard_normal((90, 59)))[0].T.reshape(59, 30, 3)
    middle = rng.standard_normal((30, 3)) * [1, 2, 3]
    return middle + np.tensordot(rng.standard_normal((60, 59)) * 0.8 ** np.arange(59), modes, axes=1) * 0.3


@pytest.fixture
def in_file(shapes, tmp_path, monkeypatch):
    """The same in a file, of which seven are in memory at a time."""
    monkeypatch.setattr("homolog.statistics.rows._BLOCK_BYTES", 7 * shapes[0].nbytes)
    write_npy(tmp_path / "points.npy", shapes)
    return FileRows(tmp_path / "points.npy")


def test_rows_of_a_file_are_those_of_the_array(shapes, in_file):
    assert in_file.shape == shapes.shape and len(in_file) == 60
    assert (in_file[3] == shapes[3]).all() and (in_file[5:9] == shapes[5:9]).all()
    assert (np.stack(list(in_file)) == shapes).all()


@pytest.mark.parametrize("scale", [False, True])
def test_alignment_in_blocks(shapes, in_file, scale, monkeypatch):
    found = generalised_procrustes(in_file, scale=scale)
    monkeypatch.undo()  # now all at once
    expected = generalised_procrustes(shapes, scale=scale)
    for name in ("points", "mean", "rotations", "scales", "shifts", "distances"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-10)
    np.testing.assert_allclose(found[4], found.points[4])


def test_faults_are_found_in_any_block(shapes, tmp_path, in_file):
    for number, value in ((50, np.nan), (59, shapes[59, 0])):
        faulty = shapes.copy()
        faulty[number] = value
        write_npy(tmp_path / "points.npy", faulty)
        with pytest.raises(ArgumentError, match=r"NaN|all the same"):
            generalised_procrustes(FileRows(tmp_path / "points.npy"))


def test_the_first_modes_are_those_of_all(shapes, in_file):
    every, first = principal_modes(shapes), principal_modes(in_file, most=8)
    assert every.rest == pytest.approx(0, abs=1e-12) and len(every.variances) == 59
    np.testing.assert_allclose(first.variances, every.variances[:8], rtol=1e-5)
    np.testing.assert_allclose(first.modes, every.modes[:8], atol=2e-3)
    np.testing.assert_allclose(first.mean, every.mean)
    assert first.total == pytest.approx(every.total) == pytest.approx(shapes.var(axis=0, ddof=1).sum())
    np.testing.assert_allclose(compactness(first), compactness(every)[:8], rtol=1e-5)
    np.testing.assert_allclose(first.coefficients(in_file), every.coefficients(shapes)[:, :8], atol=1e-2)


def test_few_shapes_have_no_more_modes_than_there_are(shapes):
    every, some = principal_modes(shapes[:5]), principal_modes(shapes[:5], most=3)
    np.testing.assert_allclose(some.variances, every.variances[:3])
    assert some.rest == pytest.approx(every.variances[3])
    with pytest.raises(ArgumentError, match="most is 0"):
        principal_modes(shapes, most=0)


def test_curves_of_the_first_modes_are_those_of_all_modes_there(shapes, in_file):
    every, first = principal_modes(shapes), principal_modes(in_file, most=20)
    left_out = generalisation(in_file, first)
    assert len(left_out.mean) == 20
    np.testing.assert_allclose(left_out.mean[:12], generalisation(shapes, every).mean[:12], rtol=1e-2)
    random, other = specificity(first, in_file), specificity(every, shapes)
    assert abs(random.mean[19] - other.mean[19]) < 4 * other.error[19]  # other random shapes


def test_specificity_is_the_same_in_parts(shapes, monkeypatch):
    model = principal_modes(shapes)
    expected = specificity(model, shapes, samples=50, seed=1).mean
    monkeypatch.setattr("homolog.statistics.curves._MOST_DISTANCES", 60 * 8)
    np.testing.assert_array_equal(specificity(model, shapes, samples=50, seed=1).mean, expected)


def test_rows_are_written_as_an_array_is(shapes, tmp_path):
    write_npy(tmp_path / "whole.npy", shapes)
    assert write_npy_rows(tmp_path / "rows.npy", iter(shapes), 60) == tmp_path / "rows.npy"
    assert (tmp_path / "rows.npy").read_bytes() == (tmp_path / "whole.npy").read_bytes()
    with all_or_nothing():
        waits = write_npy_rows(tmp_path / "later.npy", iter(shapes), 60)
        assert waits != tmp_path / "later.npy" and (FileRows(waits)[59] == shapes[59]).all()
    assert (tmp_path / "later.npy").is_file() and not waits.exists()
