"""A proxy stands for a shape, and maps between proxies lead back to the shapes' own points."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from homolog.geometry.proxy import Proxy, proxy_for
from homolog.shapes import Finding, Shape, repair

FINDING = Finding("points of a proxy", 1, "note", "for a test")


def ball(subdivisions, radius=1.0):
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return np.array(mesh.vertices), np.array(mesh.faces)


@pytest.fixture(scope="module")
def fine():
    """A ball of 10,242 points, its first point twice, in front of one that no face uses."""
    points, faces = ball(5)
    return repair(Shape(np.concatenate([points[:1], points, [[9.0, 9, 9]]]), faces + 1, name="fine"))


@pytest.fixture(scope="module")
def proxy(fine):
    return proxy_for(fine, Shape(*ball(3)), finding=FINDING, reach=0.1)


def directions(points):
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def test_real_numbers_are_interpolated_on_the_proxy_and_labels_taken_from_the_nearest_point(fine, proxy):
    lifted = proxy.to_original(proxy.shape.points)
    assert len(lifted) == 10_244 and np.isnan(lifted[-1]).all()
    positions = np.concatenate([fine.shape.points[:1], fine.shape.points])
    assert np.abs(directions(lifted[:-1]) - positions[[0, *range(1, 10_243)]]).max() < 0.01
    labels = proxy.to_original(np.arange(proxy.shape.n_points), fill=-7)
    away = np.linalg.norm(proxy.shape.points[:, None] - positions[None, :500], axis=2)
    assert (away[labels[:500], np.arange(500)] <= away.min(axis=0) + 1e-3).all() and labels[-1] == -7


def test_each_of_its_points_knows_the_nearest_one_of_the_file(fine, proxy):
    there = np.concatenate([fine.shape.points[:1], fine.shape.points])[proxy.kept]
    assert np.linalg.norm(there - proxy.shape.points, axis=1).max() < 1e-9  # a finer ball has the coarser one's points


def test_the_identity_between_two_proxies_is_the_identity_between_the_shapes(fine, proxy):
    found = proxy.original_map(np.arange(proxy.shape.n_points), proxy)
    assert found[-1] == -1 and found[0] == found[1]
    assert (found[1:-1] == np.arange(1, 10_243)).mean() > 0.99


def test_a_rotation_between_proxies_is_a_smooth_rotation_of_all_points(fine, proxy):
    # The map of the coarse ball is off by half its spacing.
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    coarse = proxy.shape.points
    nearest = np.linalg.norm((coarse @ turn.T)[:, None] - coarse[None], axis=2).argmin(axis=1)
    found = proxy.original_map(nearest, proxy)[1:-1]
    points = fine.shape.points
    missed = np.linalg.norm(points[found - 1] - points @ turn.T, axis=1)
    spacing = np.sqrt(4 * np.pi / len(coarse))
    assert missed.mean() < 0.5 * spacing and len(np.unique(found)) > 0.5 * len(points)


def test_a_proxy_and_a_plain_shape_are_mapped_to_each_other(fine, proxy):
    plain = repair(Shape(*ball(3)))
    found = proxy.original_map(np.arange(plain.shape.n_points), plain)
    away = np.linalg.norm(plain.shape.points[found[1:-1]] - fine.shape.points, axis=1)
    assert away.max() < 1.1 * np.sqrt(4 * np.pi / plain.shape.n_points) and found[-1] == -1
    back = plain.original_map(np.arange(proxy.shape.n_points), proxy)
    assert (back == proxy.kept).all()


def test_what_is_far_from_the_proxy_or_maps_to_nothing_has_no_counterpart(fine):
    points, faces = ball(3)
    shifted = proxy_for(fine, Shape(points + np.array([0, 0, 0.6]), faces), finding=FINDING, reach=0.1)
    reach = 0.1 * np.sqrt(trimesh.creation.icosphere(3).area)
    away = np.abs(np.linalg.norm(fine.shape.points - [0, 0, 0.6], axis=1) - 1)
    clear = np.abs(away - reach) > 0.02
    assert ((shifted.clean_index[1:-1] >= 0) == (away <= reach))[clear].all()
    none = np.full(shifted.shape.n_points, -1)
    assert (shifted.original_map(none, shifted) == -1).all()
    lifted = shifted.to_original(np.ones(shifted.shape.n_points), fill=0)
    assert (lifted == (shifted.clean_index >= 0)).all()


def test_points_go_to_the_side_of_a_thin_plate_that_faces_their_way():
    plate = trimesh.creation.box([1, 1, 0.02]).subdivide().subdivide().subdivide().subdivide()
    full = repair(Shape(plate.vertices, plate.faces))
    found = proxy_for(full, full.shape, finding=FINDING, reach=0.1)
    moved = full.shape.points + np.array([0.01, 0.01, 0])
    nearest = np.linalg.norm(moved[:, None] - full.shape.points[None], axis=2).argmin(axis=1)
    inner = np.abs(full.shape.points[:, :2]).max(axis=1) < 0.4
    mapped = found.original_map(nearest, found)
    assert (np.sign(full.shape.points[mapped, 2]) == np.sign(full.shape.points[:, 2]))[inner].all()


def test_it_is_said_in_the_report_and_shown(fine, proxy):
    assert proxy.report.findings[-1] == FINDING and isinstance(proxy, Proxy)
    assert "642 points" in repr(proxy) and "10242 points" in repr(proxy)
