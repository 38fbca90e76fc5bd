"""What public objects of geometry and maps print: at most five lines and 500 characters, and never whole arrays."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from homolog import geometry, maps
from homolog.core.reprs import short_repr


@pytest.fixture(scope="module")
def objects(make) -> dict[type, Any]:
    """One of each public class, of a shape of a few thousand points."""
    sphere = make.sphere(4)
    settings = geometry.OperatorSettings(n_eigenpairs=20)
    operators = geometry.compute_operators(sphere, settings=settings)
    laplacian, mass = geometry.mesh_laplacian(sphere.points, sphere.faces)
    features = torch.eye(300)
    surface = geometry.Surface(sphere.points, sphere.faces)
    reference = geometry.ReferenceSurface(surface)
    found = [
        surface,
        reference,
        reference.project(sphere.points),
        geometry.split_long(surface, 0.05, most=30_000),
        operators,
        operators.basis,
        settings,
        geometry.OperatorCache(Path("some") / "folder"),
        geometry.unit_frame(sphere),
        geometry.lowest_eigenpairs(laplacian, mass, 5),
        maps.nearest_neighbour(features, features),
        maps.sinkhorn_matches(features, features),
        maps.RefinementSettings(),
        maps.ConfidenceSettings(),
        maps.CoarseFit(0.5, 1.0, 1.0),
        maps.CoarseMapSettings(),
        maps.RegistrationSettings(),
        maps.RegistrationStart(maps.Similarity(torch.eye(3), 2.0, torch.zeros(3))),
        maps.SampledSurface(torch.zeros(300, 3), torch.ones(300)),
        maps.LandmarkRows(torch.arange(2), torch.arange(2), torch.ones(2)),
        geometry.find_clutter(sphere),
        geometry.ClutterSettings(),
        maps.Similarity(torch.eye(3), 2.0, torch.zeros(3)),
    ]
    return {type(each): each for each in found}


def test_each_public_class_prints_little(objects) -> None:
    public = {getattr(package, name) for package in (geometry, maps) for name in package.__all__}
    classes = {each for each in public if inspect.isclass(each)}
    assert classes == set(objects)
    for kind, each in objects.items():
        shown = repr(each)
        assert shown.startswith(kind.__name__ + "(")
        assert len(shown.splitlines()) <= 5 and len(shown) <= 500, shown


def test_operators_say_their_sizes_scale_and_method(objects) -> None:
    shown = repr(objects[geometry.Operators])
    for part in ("2562 points", "20 eigenpairs", "scale=3.5", "block Lanczos", "cpu"):
        assert part in shown


def test_arrays_show_kind_and_shape_and_few_numbers_themselves() -> None:
    @dataclass
    class Thing:
        matrix: torch.Tensor
        centre: np.ndarray
        name: str

        __repr__ = short_repr

    thing = Thing(torch.zeros(7, 2), np.array([0.5, 1 / 3, -2]), "a")
    assert repr(thing) == "Thing(matrix=float32 (7, 2), centre=[0.5, 0.3333, -2], name='a')"
