"""Features and methods of one's own."""

from __future__ import annotations

import sys
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from dirty_shapes import dirtied
from torch import nn

import homolog
from homolog.core.errors import ArgumentError
from homolog.core.plugins import offered
from homolog.features import FeatureInfo, as_extractor
from homolog.maps import nearest_neighbour
from homolog.matching import Matcher, refine
from homolog.methods import FunctionMethod, Supports, find_method, method_names
from homolog.pairs import MatcherSettings, PointMaps

ARRAYS = ("source_to_target", "target_to_source", "source_confidence", "target_confidence")
INFO = FeatureInfo(name="blobs", upright=False, map_eigenpairs=40)
OWN = FeatureInfo(name="own", input="operators", upright=False, map_eigenpairs=40)


def assert_same(found, expected):
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


# ---- methods of two parts


def test_maps_of_two_parts_by_a_method_of_ones_own_are_kept():
    theirs = FunctionMethod("theirs", lambda pair: None, Supports(parts=True))
    pair = SimpleNamespace(are_parts=True, settings=MatcherSettings(), fit=object(), method=theirs)
    maps = PointMaps(torch.zeros(3, dtype=torch.long), torch.zeros(4, dtype=torch.long))
    assert refine(pair, maps) is maps


# ---- features


class Wrapped(nn.Module):
    """A module that is called with operators."""

    def __init__(self, network):
        super().__init__()
        self.network = network

    def forward(self, operators):
        return self.network(operators.points, operators)


@pytest.mark.parametrize("method", ["functional-map", "nearest-features"])
def test_features_by_a_function_or_a_module_are_those_of_the_network(build, blobs, network, method):
    expected = build(method).match(blobs.source, blobs.target)
    for own in (lambda shape: network(shape.points, shape).detach().numpy(), Wrapped(network)):
        found = Matcher(own, OWN, settings=MatcherSettings(method=method), device="cpu").match(
            blobs.source, blobs.target
        )
        assert_same(found, expected)
        assert found.report["features"]["name"] == "own"


def given_for(dirty, features):
    """Features of the points of a damaged file, in its order; those of points that are left out are far off."""
    rows = np.full((dirty.shape.n_points, features.shape[1]), 1e3)
    kept = dirty.clean_index >= 0
    rows[kept] = features[dirty.clean_index[kept]]
    return rows


@pytest.mark.parametrize("partial", [None, "source"])
@pytest.mark.parametrize("method", ["functional-map", "nearest-features"])
def test_arrays_of_features_follow_the_points_of_the_files(build, blobs, method, partial):
    """Repairs on both sides take points out amid others; the arrays do not know of that."""
    source, target = dirtied(blobs.source), dirtied(blobs.target)
    own = build(method)
    features = [own.preprocess(shape).features.numpy() for shape in (blobs.source, blobs.target)]
    rows = tuple(map(given_for, (source, target), features))
    settings = MatcherSettings(method=method, alignment=None)
    matcher = Matcher(OWN, settings=settings, device="cpu")
    found = matcher.match(source.shape, target.shape, features=rows, partial=partial)
    clean = matcher.match(blobs.source, blobs.target, features=tuple(features), partial=partial)
    lifted = np.where(source.clean_index < 0, -1, clean.source_to_target[source.clean_index])
    first = np.array([np.flatnonzero(target.clean_index == point)[0] for point in range(blobs.target.n_points)])
    np.testing.assert_array_equal(found.source_to_target, np.where(lifted < 0, -1, first[lifted]))
    if partial is None:
        assert_same(clean, own.match(blobs.source, blobs.target))


def test_arrays_in_one_call(blobs, build):
    features = tuple(build().preprocess(shape).features.numpy() for shape in (blobs.source, blobs.target))
    found = homolog.match(blobs.source, blobs.target, features=features, method="nearest-features", device="cpu")
    assert_same(found, build("nearest-features").match(blobs.source, blobs.target))
    assert found.report["features"]["name"] == "given"


@pytest.mark.parametrize("gather", [list, tuple, lambda arrays: [each.tolist() for each in arrays]])
def test_arrays_come_in_any_sequence(blobs, gather):
    features = [np.asarray(shape.points) for shape in (blobs.source, blobs.target)]
    words = {"method": "nearest-features", "device": "cpu"}
    found = homolog.match(blobs.source, blobs.target, features=gather(features), **words)
    assert_same(found, homolog.match(blobs.source, blobs.target, features=tuple(features), **words))


@pytest.mark.parametrize(
    ("features", "said"),
    [
        ([np.zeros((480, 4))], "are 1 of them, but must be two arrays"),
        (np.zeros((3, 480, 4)), "are 3 of them, but must be two arrays"),
        ("ab", "is 'ab', but must be arrays, .*; give weights='ab'"),
        ({"source": np.zeros((480, 4)), "target": np.zeros((560, 4))}, "are a dict, but must be two arrays"),
        (3, "are a int, but must be two arrays"),
    ],
)
def test_what_is_not_two_arrays_is_one_line(blobs, features, said):
    with pytest.raises(ArgumentError, match=said) as caught:
        homolog.match(blobs.source, blobs.target, features=features, device="cpu")
    assert "\n" not in str(caught.value)
    with pytest.raises(ArgumentError, match=said):
        Matcher(OWN, device="cpu").match(blobs.source, blobs.target, features=features)


def test_weights_beside_features_are_refused(blobs):
    with pytest.raises(ArgumentError, match="both weights and features are given"):
        homolog.match(blobs.source, blobs.target, weights="people", features=lambda shape: shape.points)


@pytest.mark.parametrize(
    ("settings", "method", "expected"),
    [("axiomatic", None, "axiomatic"), ("registration", "axiomatic", "axiomatic"), ("axiomatic", "auto", "auto")],
)
def test_a_method_of_the_settings_holds_unless_another_is_given(blobs, settings, method, expected):
    found = homolog.match(
        blobs.source,
        blobs.target,
        features=lambda shape: shape.points,
        method=method,
        settings=MatcherSettings(method=settings),
        device="cpu",
    )
    assert found.report["settings"]["method"] == expected


@pytest.mark.parametrize(
    ("features", "said"),
    [
        (lambda shape: torch.zeros(3, 2), r"features 'own' of <lambda> have shape \(3, 2\), but must have one row of"),
        (lambda shape: shape.points[:, 0], r"have shape \(480,\), but must have one row of .* \(480, d\)"),
        (lambda shape: shape.points * np.nan, "of <lambda> hold NaN or infinite numbers, but must be finite"),
        (lambda shape: None, r"features 'own' of <lambda> are a NoneType without numbers, but .*, \(480, d\)"),
        (lambda shape: "much", "features 'own' of <lambda> are a str without numbers"),
        (lambda shape: [[1.0], [1.0, 2.0]], "of <lambda> are a list without numbers"),
        (lambda shape: 3.0, r"of <lambda> have shape \(\), but"),
        (3, "features is a int, but must be a feature extractor, a network or a function of operators"),
    ],
)
def test_features_that_cannot_be_are_one_line(blobs, features, said):
    with pytest.raises(ArgumentError, match=said) as caught:
        Matcher(features, OWN, device="cpu").match(blobs.source, blobs.target)
    assert "\n" not in str(caught.value)


def failing(given):
    raise KeyError("out of\norder")


def test_features_that_fail_name_themselves_and_the_shape(blobs):
    name = blobs.source.name
    with pytest.raises(ArgumentError, match=f"^{name}: features 'failing' failed: KeyError: ") as caught:
        homolog.match(blobs.source, blobs.target, features=failing, device="cpu")
    assert isinstance(caught.value.__cause__, KeyError) and "\n" not in str(caught.value)


def test_features_of_a_wrong_shape_are_named_once(blobs):
    said = rf"^{blobs.source.name}: features '<lambda>' have shape \(3, 3\), but must"
    with pytest.raises(ArgumentError, match=said):
        homolog.match(blobs.source, blobs.target, features=lambda shape: torch.eye(3), device="cpu")


def test_a_module_that_takes_tensors_is_told_what_it_is_given(blobs):
    with pytest.raises(
        ArgumentError, match=r"features 'Linear' failed: TypeError: .*; a module is called with Operators"
    ):
        homolog.match(blobs.source, blobs.target, features=torch.nn.Linear(3, 4), device="cpu")


@pytest.mark.parametrize("supports", [None, Supports(needs_features=False)])
def test_a_method_that_fails_names_itself_and_the_pair(blobs, supports):
    def theirs(pair):
        return 1 / 0

    theirs.supports = supports or Supports(needs_features=False, refinement=False)
    said = (
        f"^method 'theirs' failed on {blobs.source.name} -> {blobs.target.name}: ZeroDivisionError: division by zero$"
    )
    with pytest.raises(ArgumentError, match=said) as caught:
        homolog.match(blobs.source, blobs.target, method=theirs, device="cpu")
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (None, "are a NoneType without numbers"),
        (np.zeros((3, 2)), r"have shape \(3, 2\)"),
        (np.full((480, 2), np.inf), "hold NaN or infinite numbers"),
    ],
)
def test_what_an_extractor_of_one_s_own_gives_is_checked_as_well(blobs, values, said):
    class Theirs:
        info = FeatureInfo(name="theirs")

        def __call__(self, operators):
            return values

    with pytest.raises(ArgumentError, match=f"features 'theirs' of Theirs {said}") as caught:
        Matcher(Theirs(), device="cpu").match(blobs.source, blobs.target)
    assert "\n" not in str(caught.value)


def test_arrays_without_numbers_name_their_shape(blobs):
    words = [["a"]] * 480, np.zeros((560, 4))
    with pytest.raises(ArgumentError, match="features 'source' are a list without numbers"):
        Matcher(OWN, device="cpu").match(blobs.source, blobs.target, features=words)


def test_arrays_of_another_length_name_their_shape(blobs):
    wrong = np.zeros((480, 4)), np.zeros((480, 4))
    with pytest.raises(ArgumentError, match=r"features 'target' have shape \(480, 4\), but must .* \(560, d\)"):
        Matcher(OWN, device="cpu").match(blobs.source, blobs.target, features=wrong)
    with pytest.raises(ArgumentError, match="features 'own' are given with each pair, but none are"):
        Matcher(OWN, device="cpu").match(blobs.source, blobs.target)


def test_features_can_be_trained_on(build, blobs):
    """They are ordinary tensors, on which layers of one's own find gradients."""
    pair, _ = build().pair(blobs.source, blobs.target)
    shape = build().preprocess(blobs.source)
    for features in (pair.x.features, pair.y.features, shape.features):
        layer = nn.Linear(features.shape[1], 1)
        layer(features).sum().backward()
        torch.testing.assert_close(layer.weight.grad[0], features.sum(dim=0), rtol=1e-3, atol=1e-3)


def test_an_extractor_with_gradients_keeps_them(network, blobs, build):
    extractor = as_extractor(Wrapped(network), OWN)
    operators = build().preprocess(blobs.source).operators
    extractor(operators).sum().backward()
    assert network.last.weight.grad is not None
    network.zero_grad(set_to_none=True)


# ---- methods


def nearest_points(pair):
    x, y = pair.x.operators.points, pair.y.operators.points
    return PointMaps(nearest_neighbour(x, y).index, nearest_neighbour(y, x).index)


METHOD = FunctionMethod("nearest-points", nearest_points, Supports(needs_features=False, refinement=False))


@pytest.fixture
def expected(build, blobs):
    """What the method finds, from the operators' points."""
    first, second = (
        build("axiomatic").preprocess(shape).operators.points.numpy() for shape in (blobs.source, blobs.target)
    )
    distances = np.linalg.norm(first[:, None] - second[None], axis=2)
    return distances.argmin(axis=1), distances.argmin(axis=0)


def test_a_method_by_function(blobs, expected):
    matcher = Matcher(settings=MatcherSettings(method=METHOD), device="cpu")
    assert matcher.extractor is None
    found = matcher.match(blobs.source, blobs.target)
    assert np.mean(found.source_to_target == expected[0]) > 0.99
    assert np.mean(found.target_to_source == expected[1]) > 0.99
    assert found.method == found.report["method"] == found.report["settings"]["method"] == "nearest-points"
    assert matcher.describe()["settings"]["method"] == "nearest-points"


def test_a_method_is_told_by_its_name_and_never_copied(blobs):
    class Locked:
        name, supports = METHOD.name, METHOD.supports

        def __init__(self):
            self.lock = threading.Lock()  # which nothing can copy

        def __call__(self, pair):
            with self.lock:
                return METHOD(pair)

    matcher = Matcher(settings=MatcherSettings(method=Locked()), device="cpu")
    report = matcher.match(blobs.source, blobs.target).report
    assert report["settings"] == matcher.describe()["settings"]
    assert report["settings"]["method"] == METHOD.name


def test_a_function_as_method_has_one_name_everywhere(blobs, build):
    def by_rank(pair):
        return METHOD(pair)

    matcher = build(by_rank)
    found = matcher.match(blobs.source, blobs.target)
    told = found.report["settings"]["method"], matcher.describe()["settings"]["method"]
    assert {found.method, *told} == {"by_rank"}


def test_a_method_by_function_saves_its_report(blobs, tmp_path):
    found = homolog.match(blobs.source, blobs.target, method=METHOD, device="cpu")
    found.save(tmp_path / "result")
    assert homolog.Match.load(tmp_path / "result").method == "nearest-points"


def zoomed_out(maps, x, y, settings):
    """ZoomOut as published, with the pairs of both maps: no samples, no features, one round after the other."""
    y_to_x, x_to_y = (indices.tolist() for indices in (maps.y_to_x, maps.x_to_y))
    for _, size, _ in settings.rounds(x.shape[1]):
        phi_x, phi_y = x[:, :size].double(), y[:, :size].double()
        pulled = torch.cat([phi_x[y_to_x], phi_x])
        c_xy = torch.linalg.lstsq(torch.cat([phi_y, phi_y[x_to_y]]), pulled).solution
        c_yx = torch.linalg.lstsq(pulled, torch.cat([phi_y, phi_y[x_to_y]])).solution
        y_to_x = torch.cdist(phi_y, phi_x @ c_xy.T).argmin(dim=1).tolist()
        x_to_y = torch.cdist(phi_x, phi_y @ c_yx.T).argmin(dim=1).tolist()
    return np.array(y_to_x)


@pytest.mark.parametrize("modality", ["mm", "cm"])
def test_a_method_without_features_is_refined_without(blobs, modality):
    method = FunctionMethod("nearest", nearest_points, Supports(needs_features=False))
    shapes, settings = blobs.of(modality), MatcherSettings(method=method, smoothing=None)
    matcher = Matcher(settings=settings, device="cpu")
    found = matcher.match(*shapes)
    pair = matcher.pair(*shapes)[0]
    phi = pair.x.operators.eigenvectors, pair.y.operators.eigenvectors
    expected = zoomed_out(nearest_points(pair), *phi, settings.refinement)
    assert np.mean(found.target_to_source == expected) > 0.97
    assert np.mean(found.target_to_source == nearest_points(pair).y_to_x.numpy()) < 0.9
    assert_same(homolog.match(*shapes, method=method, settings=settings, device="cpu"), found)


def test_a_partial_shape_is_refined_without_features(blobs):
    method = FunctionMethod("nearest", nearest_points, Supports(needs_features=False))
    found = homolog.match(blobs.source, blobs.source, method=method, partial="target", pre_aligned=True, device="cpu")
    assert np.mean(found.target_to_source == np.arange(blobs.source.n_points)) > 0.9


def test_a_method_for_meshes_is_given_no_cloud(blobs):
    """However the cloud comes about: as a file has it, by an option, or of a shape preprocessed before."""
    method = FunctionMethod("flat", nearest_points, Supports(needs_features=False, refinement=False, clouds=False))
    matcher = Matcher(settings=MatcherSettings(method=method), device="cpu")
    mesh, cloud = blobs.source, blobs.target.as_cloud()
    prepared = matcher.preprocess(mesh), matcher.preprocess(cloud)
    for call, found in (
        (lambda: matcher.match(mesh, cloud), f"{cloud.name} is a cloud"),
        (lambda: homolog.match(cloud, mesh, method=method, device="cpu"), f"{cloud.name} is a cloud"),
        (lambda: matcher.match("no such file", mesh, as_cloud="source"), "as_cloud is 'source'"),
        (lambda: matcher.paired(*prepared), f"{cloud.name} is a cloud"),
    ):
        with pytest.raises(ArgumentError) as caught:
            call()
        assert str(caught.value) == f"{found}, but the method 'flat' matches meshes; use 'auto' for clouds"
    assert matcher.match(mesh, blobs.target).method == "flat"


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A package that offers a method, as if it were installed."""
    (tmp_path / "own_methods.py").write_text(
        "from homolog.maps import nearest_neighbour\n"
        "from homolog.methods import FunctionMethod, Supports\n"
        "from homolog.pairs import PointMaps\n"
        "def nearest(pair):\n"
        "    x, y = pair.x.operators.points, pair.y.operators.points\n"
        "    return PointMaps(nearest_neighbour(x, y).index, nearest_neighbour(y, x).index)\n"
        'METHOD = FunctionMethod("their-method", nearest, Supports(needs_features=False, refinement=False))\n'
        "class Other:\n"
        "    name, supports = 'other-name', METHOD.supports\n"
        "    def __call__(self, pair):\n"
        "        return nearest(pair)\n"
        "OTHER = Other()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "broken_methods.py").write_text("raise RuntimeError('out of\\norder')\n")
    names = ["their-method = own_methods:METHOD", "broken = broken_methods:METHOD", "axiomatic = own_methods:METHOD"]
    names += ["second-name = own_methods:METHOD", "third-name = own_methods:OTHER"]
    info = tmp_path / "theirs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("\n".join(["[homolog.methods]", *names]))
    offered.cache_clear()
    yield
    offered.cache_clear()
    sys.modules.pop("own_methods", None)


def test_a_method_by_entry_point(installed, blobs, expected):
    assert method_names()[-4:] == ("their-method", "broken", "second-name", "third-name")
    assert "own_methods" not in sys.modules  # names are found without loading any
    found = homolog.match(blobs.source, blobs.target, method="their-method", device="cpu")
    assert np.mean(found.target_to_source == expected[1]) > 0.99
    assert found.method == "their-method"
    assert find_method("their-method").supports.needs_features is False
    with pytest.raises(ArgumentError, match=r"method is 'their-methd'.*did you mean 'their-method'"):
        find_method("their-methd")


def test_a_method_is_called_as_its_entry_point_is(installed, blobs):
    found = homolog.match(blobs.source, blobs.target, method="second-name", device="cpu")
    assert found.method == found.report["settings"]["method"] == "second-name"
    said = "entry point third-name = .* leads to a method that is called 'other-name'; call both alike"
    with pytest.raises(ArgumentError, match=said):
        find_method("third-name")


def test_features_that_are_names_or_several_networks_say_where_they_go(blobs):
    for features, said in (
        ("people", "features is 'people', but must be arrays, a function or a network; give weights='people'"),
        ([torch.nn.Identity()] * 2, "are several networks or functions, .* are given to homolog.Matcher"),
    ):
        with pytest.raises(ArgumentError, match=said):
            homolog.match(blobs.source, blobs.target, features=features)
    with pytest.raises(ArgumentError, match=r"features is a str, 'people', .* give Matcher.from_weights\('people'\)"):
        homolog.Matcher("people")
    with pytest.raises(ArgumentError, match=r"device is 'gpu', .*; a graphics card is 'cuda'"):
        homolog.Matcher(device="gpu")


def test_an_installed_method_that_fails_is_one_line(installed, blobs, monkeypatch):
    failing_method = replace(find_method("their-method"), function=failing)
    monkeypatch.setattr("own_methods.METHOD", failing_method)
    with pytest.raises(ArgumentError, match=r"^method 'their-method' failed on .* -> .*: KeyError: .*$") as caught:
        homolog.match(blobs.source, blobs.target, method="their-method", device="cpu")
    assert "\n" not in str(caught.value)


def test_a_method_that_cannot_be_loaded_names_its_package(installed):
    with pytest.raises(ArgumentError) as caught:
        find_method("broken")
    assert "entry point broken = broken_methods:METHOD in homolog.methods of package theirs" in str(caught.value)
    assert "(RuntimeError: out of order)" in str(caught.value) and "\n" not in str(caught.value)


def test_a_method_called_like_one_of_homolog_s_own_is_told_of(installed, caplog):
    assert find_method("axiomatic").name == "axiomatic"
    assert method_names().count("axiomatic") == 1
    (told,) = caplog.messages
    assert "axiomatic = own_methods:METHOD in homolog.methods of package theirs is left out, as Homolog has" in told


@pytest.mark.parametrize(
    ("maps", "said"),
    [
        (lambda pair: (1, 2), "method 'own' gave a tuple, but must give homolog.pairs.PointMaps"),
        (lambda pair: PointMaps(torch.zeros(3, dtype=int), torch.zeros(560, dtype=int)), r"x_to_y of method 'own' is"),
        (lambda pair: PointMaps(torch.zeros(480), torch.zeros(560, dtype=int)), "must be a tensor or array of whole n"),
        (
            lambda pair: PointMaps(torch.full((480,), 560), torch.zeros(560, dtype=int)),
            "holds 560 to 560, but must hold indices of the repaired shape's points, 0 to 559",
        ),
        (lambda pair: PointMaps(torch.full((480,), -1), torch.zeros(560, dtype=int)), "holds -1 to -1, but must"),
    ],
)
def test_maps_that_do_not_fit_are_one_line(blobs, maps, said):
    method = FunctionMethod("own", maps, Supports(needs_features=False, refinement=False))
    with pytest.raises(ArgumentError, match=said) as caught:
        Matcher(settings=MatcherSettings(method=method), device="cpu").match(blobs.source, blobs.target)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("supports", [None, Supports(needs_features=False)])
def test_the_maps_of_a_bare_function_are_refined_only_if_it_says_so(blobs, network, supports):
    def mine(pair):
        return nearest_points(pair)

    if supports is not None:
        mine.supports = supports
    matcher = Matcher(None if supports else network, INFO, settings=MatcherSettings(method=mine), device="cpu")
    found = matcher.match(blobs.source, blobs.target)
    plain = nearest_points(matcher.pair(blobs.source, blobs.target)[0]).y_to_x.numpy()
    same = np.mean(found.target_to_source == plain)
    assert same == 1 if supports is None else same < 0.9
    assert found.method == "mine"


def test_what_a_bare_function_supports_is_said_in_one_way(blobs):
    def mine(pair):
        return nearest_points(pair)

    mine.supports = {"refinement": False}
    with pytest.raises(
        ArgumentError, match=r"supports of method 'mine' is a dict, but must be homolog.methods.Supports"
    ):
        Matcher(settings=MatcherSettings(method=mine), device="cpu")


@pytest.mark.parametrize(
    "convert",
    [
        lambda indices: indices.numpy(),
        lambda indices: indices.tolist(),
        lambda indices: indices.numpy().astype(np.uint16),
        lambda indices: np.ascontiguousarray(indices.numpy()[::-1])[::-1],
        lambda indices: indices.int(),
    ],
    ids=["array", "list", "uint16", "reversed", "int32"],
)
def test_maps_may_be_arrays_or_lists(blobs, convert):
    def converted(pair):
        maps = nearest_points(pair)
        return PointMaps(convert(maps.x_to_y), convert(maps.y_to_x))

    for refinement in (False, True):
        supports = Supports(needs_features=False, refinement=refinement)
        methods = (FunctionMethod("own", function, supports) for function in (converted, nearest_points))
        found, expected = (
            homolog.match(blobs.source, blobs.target, method=method, orient="given", device="cpu") for method in methods
        )
        assert_same(found, expected)


@pytest.mark.parametrize(
    ("features", "said"),
    [
        ((0, None), "features of the target are None, but must be an array"),
        ((None, None), "features of the source are None, but must be an array"),
        ((1j, 0), "features 'source' are complex, but must be real"),
        ((0, np.nan), "features 'target' hold NaN or infinite numbers, but must be finite"),
    ],
)
def test_arrays_of_features_that_cannot_be_compared(blobs, features, said):
    arrays = [
        None if number is None else shape.points + number
        for number, shape in zip(features, (blobs.source, blobs.target), strict=True)
    ]
    with pytest.raises(ArgumentError, match=said) as caught:
        homolog.match(blobs.source, blobs.target, features=arrays, device="cpu")
    assert "\n" not in str(caught.value)


def test_features_of_two_widths_are_called_so(blobs):
    said = "features of the source, source, have width 3 and those of the target, target, 2, but must have the same"
    with pytest.raises(ArgumentError, match=said):
        homolog.match(blobs.source, blobs.target, features=(blobs.source.points, blobs.target.points[:, :2]))
    with pytest.raises(ArgumentError, match="have width 480 and those of the target, target, 560"):
        homolog.match(blobs.source, blobs.target, features=lambda shape: torch.eye(shape.n_points))


@pytest.mark.parametrize("options", [{}, {"method": "nearest-features"}, {"partial": "source"}])
def test_features_that_require_gradients_are_compared_as_they_are(blobs, options):
    plain = [torch.tensor(shape.points) for shape in (blobs.source, blobs.target)]
    learned = [features.clone().requires_grad_() for features in plain]
    for given in (learned, [list(features) for features in learned]):
        found, expected = (
            homolog.match(blobs.source, blobs.target, features=features, device="cpu", **options)
            for features in (given, plain)
        )
        assert_same(found, expected)


@pytest.mark.parametrize("features", [lambda shape: shape.points, "arrays"])
def test_features_that_the_method_does_not_use_are_a_warning(blobs, features):
    given = (blobs.source.points, blobs.target.points) if features == "arrays" else features
    found = homolog.match(blobs.source, blobs.target, features=given, method="registration", device="cpu")
    plain = homolog.match(blobs.source, blobs.target, method="registration", device="cpu")
    name = "given" if features == "arrays" else "<lambda>"
    assert found.warnings[0].startswith(
        f"the weights or features {name!r} are left aside, as the method 'registration' does not use any"
    )
    assert found.warnings[1:] == plain.warnings
    assert_same(found, plain)
