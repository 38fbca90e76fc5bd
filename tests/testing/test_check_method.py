"""The common suite of methods: Homolog's own pass it, and so does a small one; broken ones do not."""

import pytest
import torch

from homolog.core.errors import ArgumentError
from homolog.maps import nearest_neighbour
from homolog.matching import Matcher, match
from homolog.methods import AUTO, FunctionMethod, Supports, method_names
from homolog.pairs import PointMaps
from homolog.shapes import demo_shapes
from homolog.testing import check_method

BY_POSITION = Supports(needs_features=False, refinement=False)


def nearest_points(pair):
    """A method of one function: the nearest points of shapes that stand alike."""
    x, y = pair.x.operators.points, pair.y.operators.points
    return PointMaps(nearest_neighbour(x, y).index, nearest_neighbour(y, x).index)


# Their search for the way round takes most of the time.
SLOW = dict.fromkeys(("axiomatic", "registration"), pytest.mark.slow)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=SLOW.get(name, ())) for name in method_names() if name != AUTO]
)
def test_every_method_passes(name):
    check_method(name)


def test_a_small_method_passes():
    check_method(FunctionMethod("nearest-points", nearest_points, BY_POSITION))


@pytest.mark.slow
def test_a_method_that_is_refined_passes_without_features():
    check_method(FunctionMethod("nearest-points", nearest_points, Supports(needs_features=False)))


def test_a_method_that_compares_features_though_it_says_it_needs_none():
    def compares(pair):
        return nearest_points(pair) if pair.settings.refinement is None else pair.x.needed_features()

    with pytest.raises(AssertionError, match="body 1 to body 2: body 1 has no features"):
        check_method(FunctionMethod("broken", compares, BY_POSITION))


def test_a_method_for_full_meshes_passes():
    only_meshes = Supports(needs_features=False, refinement=False, clouds=False, partial=False)
    check_method(FunctionMethod("nearest-points", nearest_points, only_meshes))


def indices_of_the_files(pair):
    """Takes the points as given, not as repaired: too many entries."""
    x, y = (torch.from_numpy(shape.given.points).float() for shape in (pair.x, pair.y))
    return PointMaps(nearest_neighbour(x, y).index, nearest_neighbour(y, x).index)


def by_number(pair):
    """Point i goes to point i, whatever it is."""
    n_x, n_y = (shape.operators.n_points for shape in (pair.x, pair.y))
    return PointMaps(torch.arange(n_x) % n_y, torch.arange(n_y) % n_x)


def at_random(pair):
    n_x, n_y = (shape.operators.n_points for shape in (pair.x, pair.y))
    return PointMaps(torch.randint(n_y, (n_x,)), torch.randint(n_x, (n_y,)))


def changing(pair):
    """Centres the points that it was given, in place."""
    for shape in (pair.x, pair.y):
        shape.operators.points.sub_(1.0)
    return nearest_points(pair)


def zeroing_mass(pair):
    """Wipes the mass by an array that shares its memory, once it has its maps."""
    maps = nearest_points(pair)
    pair.x.operators.mass.numpy()[:] = 0
    return maps


def scaling_gradients(pair):
    maps = nearest_points(pair)
    pair.y.operators.gradient_x.values().mul_(2)
    return maps


def abstaining(pair):
    maps = nearest_points(pair)
    return PointMaps(torch.where(maps.x_to_y > 5, maps.x_to_y, -1), maps.y_to_x)


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (indices_of_the_files, "but must be a"),
        (by_number, "order of points"),
        (at_random, "determinism"),
        (changing, "purity"),
        (zeroing_mass, "purity, two meshes: it changed mass of the shape given to it"),
        (scaling_gradients, "purity, two meshes: it changed gradient_x"),
        (abstaining, "holds -1 to"),
        (lambda pair: (1, 2), "gave a tuple, but must give homolog.pairs.PointMaps"),
    ],
    ids=["indices of the files", "by number", "at random", "changing", "zeroing", "scaling", "abstaining", "a tuple"],
)
def test_broken_methods_are_caught(function, words):
    """Each by the promise that it breaks."""
    torch.manual_seed(0)
    with pytest.raises(AssertionError, match=words):
        check_method(FunctionMethod("broken", function, BY_POSITION))


def test_what_a_method_supports_is_said_in_one_way():
    with pytest.raises(AssertionError, match=r"supports of method 'broken' is a dict, but must be homolog"):
        check_method(FunctionMethod("broken", nearest_points, {"clouds": False}))


def test_a_bare_function_passes_by_its_own_maps():
    """Were they refined, maps of this kind would end elsewhere; as arrays and lists they pass as well."""

    def bare(pair):
        maps = nearest_points(pair)
        return PointMaps(maps.x_to_y.numpy(), maps.y_to_x.tolist())

    check_method(bare)


@pytest.mark.parametrize("function", [changing, zeroing_mass, scaling_gradients])
def test_a_match_refuses_a_method_that_changes_what_it_is_given(function):
    """Others would go on with it: refinement, confidences, the next pair of an evaluation."""
    shapes = demo_shapes()
    with pytest.raises(ArgumentError, match=r"method 'broken' changed \w+ of (amber|boris)\.off in place, .*on a copy"):
        match(*shapes, method=FunctionMethod("broken", function, BY_POSITION))


def test_a_match_refuses_features_that_change_what_they_are_given():
    def features(operators):
        operators.points.zero_()
        return torch.ones(operators.n_points, 2)

    with pytest.raises(ArgumentError, match=r"what computes the features .* changed points in place"):
        Matcher(features).preprocess(demo_shapes()[0])
