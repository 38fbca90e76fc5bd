"""The one loss that needs ground truth: which samples correspond, and what it costs where they do not resemble."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from homolog.core.errors import DataError
from homolog.datasets import DatasetDescription
from homolog.geometry import compute_operators
from homolog.shapes import read_shape
from homolog.training import BUILTIN_LOSSES, LossSettings, train
from homolog.training.data import TrainingSet
from homolog.training.sampling import SampledShape
from homolog.training.store import ShapeStore, unit_mesh

SUPERVISED = {"supervised": 2.0}


def store_of(root, recipe):
    return ShapeStore(TrainingSet.open(root, recipe), recipe, compute_operators)


def supervised(*given, **named):
    return BUILTIN_LOSSES["supervised"].function(*given, **named)


@pytest.mark.parametrize("clouds", [{}, {"noise": [0.01]}, {"subsampled": [0.5]}, {"resampled": [800]}, {"cut": [0.5]}])
def test_points_of_the_template_are_found_among_the_samples(meshes, small, clouds):
    """Where they lie is looked up in the files."""
    store = store_of(meshes, small(samples={"points": 300}, clouds=clouds, loss=SUPERVISED))
    for name in ("ape", "dog"):
        vertices = np.loadtxt(meshes / "corres" / f"{name}.vts", dtype=int) - 1
        _, frame = unit_mesh(store.shapes, name)
        places = frame.to_unit(read_shape(meshes / "off" / f"{name}.off").points[vertices])
        shape = store.shape(SampledShape(name, len(clouds), 1))
        rows = shape.template_rows
        assert len(rows) == 100
        known = rows >= 0
        assert 20 < known.sum() < 100
        found = shape.mesh.points[rows[known]].double().numpy()
        assert np.abs(found - places[known.numpy()]).max() < 1e-5
        distances = np.linalg.norm(shape.mesh.points.double().numpy()[None] - places[:, None], axis=2).min(axis=1)
        assert ((distances < 1e-5) == known.numpy()).all()  # and none that is among the samples is missed


def test_ground_truth_is_not_read_unless_it_is_asked_for(meshes, small, tmp_path):
    import shutil

    shutil.copytree(meshes / "off", tmp_path / "off")
    shape = SampledShape("ape", 0, 0)
    assert store_of(tmp_path, small()).shape(shape).template_rows is None
    with pytest.raises(DataError, match=r"ape\.vts"):
        store_of(tmp_path, small(loss=SUPERVISED)).shape(shape)


def test_its_value(meshes, small):
    """Cross entropy of the rows that correspond, by hand."""
    store = store_of(meshes, small(samples={"points": 400}, loss=SUPERVISED))
    x, y = (store.shape(SampledShape(name, 0, 0)) for name in ("ape", "dog"))
    generator = torch.Generator().manual_seed(0)
    features = [torch.randn(shape.mesh.n_points, 6, generator=generator) for shape in (x, y)]
    settings = LossSettings(infonce_temperature=0.2)
    pairs = [
        (int(i), int(j)) for i, j in zip(x.template_rows, y.template_rows, strict=True) if min(int(i), int(j)) >= 0
    ]
    assert 20 < len(pairs) < 90
    one, other = (
        torch.stack([each[row] / each[row].norm() for row in rows])
        for each, rows in zip(features, zip(*pairs, strict=True), strict=True)
    )
    expected = torch.nn.functional.cross_entropy(one @ other.T / 0.2, torch.arange(len(pairs)))
    found = supervised(*features, x, y, settings)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6)
    nowhere = replace(y, template_rows=torch.full_like(y.template_rows, -1))
    assert supervised(*features, x, nowhere, settings) == 0
    for other in (replace(y, template_rows=None), replace(y, template_rows=y.template_rows[1:])):
        with pytest.raises(DataError, match="ape and dog have no common template"):
            supervised(*features, x, other, settings)


def test_a_pair_of_points_counts_once(meshes, small):
    """Several points of the template may lie at one vertex of both shapes."""
    store = store_of(meshes, small(samples={"points": 400}, loss=SUPERVISED))
    x, y = (store.shape(SampledShape(name, 0, 0)) for name in ("ape", "dog"))
    features = [torch.nn.functional.one_hot(torch.arange(400)).float() for _ in range(2)]
    twice = [replace(shape, template_rows=shape.template_rows.repeat(2)) for shape in (x, y)]
    once = supervised(*features, x, y, LossSettings())
    assert supervised(*features, *twice, LossSettings()) == once


def test_datasets_without_a_template(meshes, small):
    recipe = small(loss=SUPERVISED)
    shapes = TrainingSet.open(meshes, recipe, DatasetDescription(name="maps", truth="same-numbering"))
    with pytest.raises(DataError, match="has no template, but 'same-numbering'; leave out the loss supervised"):
        shapes.template("ape")


def test_training_by_it_brings_corresponding_points_together(meshes, small, tmp_path):
    weights = {"bijectivity": 0.0, "orthogonality": 0.0, "alignment": 0.0, "infonce": 0.0, **SUPERVISED}
    recipe = small(samples={"points": 300}, loss=weights, training={"steps": 30}, network={"dropout": 0.0})
    state = train(recipe, meshes, tmp_path / "run", operators=compute_operators, device="cpu")
    first, *_, last = [record["validation/supervised"] for record in state.records]
    assert last < 0.9 * first
