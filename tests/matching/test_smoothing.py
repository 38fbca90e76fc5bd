"""Refined maps that are led by deformations come nearer to the truth, and others stay as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from homolog.geometry import OperatorSettings
from homolog.matching import Matcher, smoothed
from homolog.pairs import MatcherSettings, PairOptions, PointMaps, SmoothingSettings
from homolog.shapes import Shape

SLIDE = 0.15


@pytest.fixture(scope="module")
def body():
    """An uneven closed surface without symmetries."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=4)
    x, y, z = sphere.vertices.T
    size = 1 + 0.25 * np.sin(3 * x + 1) * np.cos(2 * y) + 0.2 * z * x
    return Shape(sphere.vertices * size[:, None] * [1.0, 1.6, 0.8], np.asarray(sphere.faces), name="body")


@pytest.fixture(scope="module")
def stretched(body):
    """The same, longer in one part and bent, so that the points' numbers are the truth."""
    x, y, z = body.points.T
    return Shape(np.stack([x * (1.2 + 0.2 * y), 1.1 * y, z + 0.15 * y**2], axis=1), body.faces, name="stretched")


def pair_of(source, target, **words):
    settings = MatcherSettings(method="axiomatic", operators=OperatorSettings(n_eigenpairs=40))
    return Matcher(settings=settings, device="cpu").pair(source, target, PairOptions(orient="given", **words))[0]


def slid(points):
    """A map of a surface to itself that takes each point to one some way along it, in one direction."""
    aims = points + SLIDE * torch.tensor([0.0, 1.0, 0.0])
    return torch.cdist(aims, points).argmin(dim=1)


def error(maps, pair):
    """Mean distances of both maps from the truth, equal numbers."""
    there = (pair.y.operators.points[maps.x_to_y] - pair.y.operators.points).norm(dim=1).mean()
    back = (pair.x.operators.points[maps.y_to_x] - pair.x.operators.points).norm(dim=1).mean()
    return float(there), float(back)


@pytest.mark.parametrize("as_cloud", [None, "both"])
def test_maps_that_contradict_each_other_come_nearer_to_the_truth(body, stretched, as_cloud):
    """Both slide the same way, so that neither is the other's inverse."""
    pair = pair_of(body, stretched, as_cloud=as_cloud)
    maps = PointMaps(slid(pair.y.operators.points), slid(pair.x.operators.points))
    found = smoothed(pair, maps)
    assert max(error(found, pair)) < 0.5 * min(error(maps, pair))


@pytest.mark.parametrize("deformations", [1, 2])
def test_it_does_not_matter_which_shape_is_the_source(body, stretched, deformations):
    settings = SmoothingSettings(deformations=deformations)
    pair, turned = (
        replace(each, settings=replace(each.settings, smoothing=settings))
        for each in (pair_of(body, stretched), pair_of(stretched, body))
    )
    x_to_y, y_to_x = slid(pair.y.operators.points), slid(pair.x.operators.points)
    one, other = smoothed(pair, PointMaps(x_to_y, y_to_x)), smoothed(turned, PointMaps(y_to_x, x_to_y))
    assert torch.equal(one.x_to_y, other.y_to_x) and torch.equal(one.y_to_x, other.x_to_y)


def test_a_part_is_deformed_onto_its_whole(body, stretched):
    """Its map comes nearer to the truth, whichever of the two is the part, and the whole's points follow."""
    kept = stretched.points[:, 1] > -0.4
    (rows,) = np.nonzero(kept)
    at = np.cumsum(kept) - 1
    part = Shape(stretched.points[rows], at[stretched.faces[kept[stretched.faces].all(axis=1)]], name="part")
    pair = pair_of(body, part, partial="target", pre_aligned=True)
    at_x, at_y = pair.x.operators.points, pair.y.operators.points
    truth, generator = torch.from_numpy(rows), torch.Generator().manual_seed(0)
    scattered = at_x[truth] + SLIDE * torch.randn(len(truth), 3, generator=generator)
    y_to_x = torch.cdist(scattered, at_x).argmin(dim=1)
    maps = PointMaps(torch.cdist(at_x, scattered).argmin(dim=1), y_to_x)
    found = smoothed(pair, maps)

    def missed(there):
        return float((at_x[there] - at_x[truth]).norm(dim=1).mean())

    assert missed(found.y_to_x) < 0.5 * missed(maps.y_to_x)
    assert float((at_y[found.x_to_y[truth]] - at_y).norm(dim=1).mean()) < missed(maps.y_to_x)


def test_maps_that_are_led_are_judged_by_those_that_were_found_each_on_its_own(body, stretched):
    """One deformation gives both maps, so that they agree, right or wrong."""
    led, plain = (
        Matcher(settings=MatcherSettings(method="axiomatic", smoothing=smoothing), device="cpu").match(body, stretched)
        for smoothing in (SmoothingSettings(), None)
    )
    assert (led.source_to_target != plain.source_to_target).any()
    assert np.array_equal(led.source_confidence, plain.source_confidence)
    assert np.array_equal(led.target_confidence, plain.target_confidence)
    assert led.quality == plain.quality


@pytest.mark.parametrize(
    "changed", [{"smoothing": None}, {"refinement": None}, {"method": "registration"}], ids=lambda one: next(iter(one))
)
def test_maps_stay_where_there_is_nothing_to_lead(body, stretched, changed):
    pair = pair_of(body, stretched)
    settings = replace(pair.settings, **changed)
    pair = replace(pair, settings=settings, method=Matcher(settings=settings, device="cpu").method_of("mesh", "mesh"))
    maps = PointMaps(slid(pair.y.operators.points), slid(pair.x.operators.points))
    assert smoothed(pair, maps) is maps
