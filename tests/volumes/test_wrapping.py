"""One closed surface around many shells, against volumes and distances that are known."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
import trimesh

from homolog.core.errors import ArgumentError, ShapeError
from homolog.shapes import Shape
from homolog.volumes import wrapping_surface


def joined(*meshes):
    return Shape(*(np.array(each) for each in (lambda m: (m.vertices, m.faces))(trimesh.util.concatenate(meshes))))


def pieces_of(mesh, keep):
    piece = mesh.copy()
    piece.update_faces(keep)
    piece.remove_unreferenced_vertices()
    return piece


def as_trimesh(shape):
    return trimesh.Trimesh(shape.points, shape.faces, process=False)


def radii(shape):
    return np.linalg.norm(shape.points, axis=1)


@pytest.fixture(autouse=True)
def _layers_are_told_on_a_coarse_grid(monkeypatch):
    """Balls need no finer one."""
    monkeypatch.setattr(importlib.import_module("homolog.volumes.wrapping"), "_COARSE", 48)


@pytest.fixture(scope="module")
def ball():
    return trimesh.creation.icosphere(4)


def test_two_overlapping_bowls_make_a_ball(ball):
    height = ball.triangles_center[:, 2]
    shape = joined(pieces_of(ball, height > -0.2), pieces_of(ball.copy().apply_scale(1.001), height < 0.2))
    found = wrapping_surface(shape, points=2000, resolution=64)
    assert as_trimesh(found).is_watertight and as_trimesh(found).body_count == 1
    assert as_trimesh(found).volume == pytest.approx(4 / 3 * np.pi, rel=0.02)
    assert np.abs(radii(found) - 1).max() < 0.03 and 1500 < found.n_points < 2500


def test_holes_are_closed_and_cavities_and_specks_left_out(ball):
    open_ball = pieces_of(ball, ball.triangles_center[:, 2] < 0.9)
    inner = ball.copy().apply_scale(0.5)
    inner.invert()
    speck = ball.copy().apply_scale(0.05).apply_translation([1.5, 0, 0])
    found = wrapping_surface(joined(open_ball, inner, speck), points=None, resolution=64)
    assert as_trimesh(found).body_count == 1 and found.points[:, 0].max() < 1.05
    assert radii(found).min() > 0.85
    assert as_trimesh(found).volume == pytest.approx(4 / 3 * np.pi, rel=0.05)


@pytest.mark.parametrize("which", ["every third triangle", pytest.param("one of the shells", marks=pytest.mark.slow)])
def test_triangles_may_face_either_way(ball, which):
    height = ball.triangles_center[:, 2]
    bowls = [pieces_of(ball, height > -0.2), pieces_of(ball.copy().apply_scale(1.001), height < 0.2)]
    shape = joined(*bowls)
    number = np.arange(len(shape.faces))
    turned = number % 3 == 0 if which == "every third triangle" else number < len(bowls[0].faces)
    faces = np.where(turned[:, None], shape.faces[:, ::-1], shape.faces)
    found = wrapping_surface(Shape(shape.points, faces), points=None, resolution=64)
    assert as_trimesh(found).volume == pytest.approx(4 / 3 * np.pi, rel=0.02)


@pytest.mark.slow
def test_a_coat_over_a_whole_body_is_left_out_and_kept_where_there_is_no_body(ball):
    height = ball.triangles_center[:, 2]
    coat = pieces_of(ball.copy().apply_scale(1.1), height > 0)
    dressed = wrapping_surface(joined(ball, coat), points=None, resolution=64)
    assert np.abs(radii(dressed) - 1).max() < 0.03
    below = pieces_of(ball, height < 0.1)
    instead = wrapping_surface(joined(below, coat), points=None, resolution=64)
    upper = instead.points[:, 2] > 0.3
    assert np.abs(radii(instead)[upper] - 1.1).max() < 0.04
    assert np.abs(radii(instead)[instead.points[:, 2] < -0.2] - 1).max() < 0.04


def test_what_nearly_touches_stays_apart_by_more_than_a_voxel(ball):
    """Two balls on a bridge far from where they nearly touch: the way from one to the other stays as long."""
    arm = [trimesh.creation.icosphere(3, 0.4).apply_translation([x, 0, 0]) for x in (-0.43, 0.43)]
    bridge = trimesh.creation.box([1.2, 0.2, 0.2]).apply_translation([0, -0.5, 0])
    posts = [trimesh.creation.box([0.2, 0.4, 0.2]).apply_translation([x, -0.4, 0]) for x in (-0.5, 0.5)]
    shape = joined(*arm, bridge, *posts)
    kept_apart = wrapping_surface(shape, points=None, resolution=64)  # voxels of 0.026 and a gap of 0.06
    assert as_trimesh(kept_apart).euler_number == 2  # a bow, not a ring
    middle = np.abs(kept_apart.points[:, 0]) < 0.02
    assert (kept_apart.points[middle, 1] < -0.35).all()


def test_errors():
    with pytest.raises(ShapeError, match="no faces"):
        wrapping_surface(Shape(np.random.default_rng(0).normal(size=(50, 3))))
    with pytest.raises(ArgumentError, match="resolution"):
        wrapping_surface(joined(trimesh.creation.box()), resolution=3)
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.01]], [[0, 1, 2], [0, 2, 3]], process=False)
    with pytest.raises(ShapeError, match="enclose nothing"):
        wrapping_surface(joined(flat), resolution=32)
