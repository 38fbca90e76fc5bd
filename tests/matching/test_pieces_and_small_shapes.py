"""Shapes match alike with small components beside them; tiny and symmetric ones give a result or a true error."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from homolog.core.errors import ArgumentError, ShapeError, UndeterminedError
from homolog.geometry import OperatorSettings
from homolog.matching import Matcher
from homolog.methods import axiomatic
from homolog.pairs import MatcherSettings
from homolog.shapes import Shape, check

PIECES = 40


@pytest.mark.parametrize("modality", ["mesh", "cloud"])
def test_a_body_among_three_hundred_pieces_matches_the_body_alone(modality, coarse_body, make):
    body = coarse_body(2400)
    littered = make.littered(body, 300)
    found = Matcher(settings=MatcherSettings(method="axiomatic")).match(
        littered, body, as_cloud="both" if modality == "cloud" else None
    )
    n = body.n_points
    extent = np.linalg.norm(np.ptp(body.points, axis=0))
    forth = body.points[found.source_to_target[:n]] - body.points
    assert np.linalg.norm(forth, axis=1).mean() < 2e-3 * extent
    assert (found.target_to_source < n).all()
    assert np.linalg.norm(littered.points[found.target_to_source] - body.points, axis=1).mean() < 2e-3 * extent


@pytest.mark.parametrize("method", ["functional-map", "nearest-features"])
@pytest.mark.parametrize("modality", ["mm", "cc"])
@pytest.mark.parametrize("side", ["source", "target"])
def test_a_network_does_not_mind_pieces_either(build, blobs, make, method, modality, side):
    plain = build(method).match(*blobs.of(modality))
    shapes = {"source": blobs.source, "target": blobs.target}
    n = {name: shape.n_points for name, shape in shapes.items()}
    shapes[side] = make.littered(shapes[side], PIECES)
    shapes = {name: shape if modality == "mm" else shape.as_cloud() for name, shape in shapes.items()}
    found = build(method).match(shapes["source"], shapes["target"])
    forth, back = found.source_to_target[: n["source"]], found.target_to_source[: n["target"]]
    assert forth.max() < n["target"] and back.max() < n["source"]
    assert np.mean(forth == plain.source_to_target) > 0.9
    assert np.mean(back == plain.target_to_source) > 0.9


def test_pieces_go_where_the_nearest_point_of_the_body_goes_and_the_report_says_so(build, blobs, make):
    littered = make.littered(blobs.source, PIECES)
    found = build("axiomatic").match(littered, blobs.target, clutter="keep")
    n = blobs.source.n_points
    nearest = KDTree(blobs.source.points).query(littered.points[n:])[1]
    np.testing.assert_array_equal(found.source_to_target[n:], found.source_to_target[nearest])
    (finding,) = (f for f in check(littered).findings if f.rule == "components")
    assert finding.count == PIECES + 1 and "nearest larger one" in finding.action


def test_pieces_at_a_distance_are_set_apart(build, blobs, make):
    littered = make.littered(blobs.source, PIECES)
    found, plain = (build("axiomatic").match(shape, blobs.target) for shape in (littered, blobs.source))
    n = blobs.source.n_points
    np.testing.assert_array_equal(found.source_to_target[:n], plain.source_to_target)
    assert (found.source_to_target[n:] == -1).all()
    assert found.target_to_source.max() < n


def regular(name: str) -> Shape:
    corners = {
        "tetrahedron": np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]),
        "octahedron": np.concatenate([np.eye(3), -np.eye(3)]),
        "icosahedron": trimesh.creation.icosahedron().vertices,
    }
    solid = trimesh.Trimesh(corners[name]).convex_hull
    return Shape(solid.vertices, solid.faces, name=name)


@pytest.mark.parametrize("name", ["tetrahedron", "octahedron", "icosahedron"])
def test_regular_solids_match_themselves_without_training(name):
    solid = regular(name)
    found = Matcher(settings=MatcherSettings(method="axiomatic")).match(solid, solid)
    np.testing.assert_array_equal(found.source_to_target, np.arange(solid.n_points))
    assert np.isfinite(found.source_confidence).all()


def test_one_eigenpair_is_too_few_for_the_axiomatic_method(blobs):
    settings = MatcherSettings(method="axiomatic", operators=OperatorSettings(n_eigenpairs=1))
    with pytest.raises(ArgumentError, match="n_eigenpairs is 1, but must be at least 2"):
        Matcher(settings=settings).match(blobs.source, blobs.target)


@pytest.mark.slow
def test_an_undetermined_map_is_blamed_on_what_it_comes_from(make, monkeypatch):
    def undetermined(*_args):
        raise UndeterminedError("singular")

    monkeypatch.setattr(axiomatic, "axiomatic_problem", undetermined)
    sphere = make.sphere(1)
    two = make.joined([sphere, Shape(sphere.points + 5, sphere.faces)])
    for shape, words in ((sphere, "too small or too symmetric"), (two, "too many pieces")):
        with pytest.raises(ShapeError, match=words):
            Matcher(settings=MatcherSettings(method="axiomatic")).match(shape, shape)


def test_another_error_of_the_axiomatic_method_stays_as_it_is(make, monkeypatch):
    def wrong(*_args):
        raise ArgumentError("this is something else")

    monkeypatch.setattr(axiomatic, "axiomatic_problem", wrong)
    sphere = make.sphere(1)
    with pytest.raises(ArgumentError, match=r"^this is something else$"):
        Matcher(settings=MatcherSettings(method="axiomatic")).match(sphere, sphere)
