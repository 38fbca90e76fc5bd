"""The matcher's settings, choice of method, steps and complaints."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from homolog.core import pretrained as pretrained_module
from homolog.core.errors import ArgumentError, HomologError, ShapeError, WeightsError
from homolog.core.progress import Timings
from homolog.features import FeatureInfo
from homolog.geometry import OperatorSettings, compute_operators, unit_frame
from homolog.maps import normalised, sinkhorn_matches
from homolog.matching import MapQuality, Match, Matcher, Quality, low_confidence_warnings
from homolog.methods.functional_map import functional_maps
from homolog.pairs import (
    AlignmentSettings,
    AxiomaticSettings,
    FunctionalMapSettings,
    MatcherSettings,
    PairOptions,
    SoftMapSettings,
    WarningSettings,
    choose_device,
)
from homolog.shapes import Shape

PAIRS = [("mesh", "mesh"), ("cloud", "cloud"), ("mesh", "cloud"), ("cloud", "mesh")]


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_method_per_modality(build, source, target):
    with_clouds = "cloud" in (source, target)
    assert build("auto").method_of(source, target).name == ("nearest-features" if with_clouds else "functional-map")
    assert build("auto", with_network=False).method_of(source, target).name == "axiomatic"
    for method in ("functional-map", "nearest-features", "registration", "axiomatic"):
        assert build(method).method_of(source, target).name == method


def test_features_alone_say_what_goes_where_on_shapes_that_are_not_nearly_isometric(build, blobs):
    info = FeatureInfo(upright=False, map_eigenpairs=40, near_isometric=False)
    found = build(info=info).match(blobs.source, blobs.target)
    assert found.method == "nearest-features"
    matcher = build()
    features = (normalised(matcher.preprocess(shape).features) for shape in (blobs.target, blobs.source))
    soft = sinkhorn_matches(*features, temperature=0.1, iterations=10)
    np.testing.assert_array_equal(found.target_to_source, soft.y_to_x)
    np.testing.assert_array_equal(found.source_to_target, soft.x_to_y)
    # A method that is asked for is taken, and not refined either.
    unrefined = build("functional-map", info=info).match(blobs.source, blobs.target)
    assert unrefined.method == "functional-map"
    assert (
        unrefined.target_to_source != build("functional-map").match(blobs.source, blobs.target).target_to_source
    ).any()


@pytest.mark.parametrize("as_cloud", ["source", "target", "both"])
@pytest.mark.parametrize("method", ["auto", "axiomatic"])
def test_as_cloud_leaves_the_faces_out_and_keeps_their_scale(build, blobs, as_cloud, method):
    seen = {}

    def spy(shape, *, settings, scale):
        seen[shape.name] = shape, scale
        return compute_operators(shape, settings=settings, scale=scale)

    found = build(method, operators=spy).match(blobs.source, blobs.target, as_cloud=as_cloud)
    for side, given in (("source", blobs.source), ("target", blobs.target)):
        used, scale = seen[side]
        np.testing.assert_array_equal(used.points, given.points)
        if as_cloud in (side, "both"):
            assert used.faces is None
            assert scale == pytest.approx(unit_frame(given).scale, rel=1e-12)
        else:
            np.testing.assert_array_equal(used.faces, given.faces)
    assert found.method == ("nearest-features" if method == "auto" else "axiomatic")
    assert len(found.source_to_target) == blobs.source.n_points


def test_as_cloud_keeps_the_points_that_no_face_uses(build, blobs):
    """Faces of a small part alone say nothing about the cloud, its scale included."""
    few = Shape(blobs.source.points, blobs.source.faces[:20], name="few")
    prepared = build("nearest-features").preprocess(few, as_cloud=True)
    assert prepared.repaired.shape.n_points == blobs.source.n_points and prepared.n_left_out == 0
    assert prepared.operators.scale == pytest.approx(unit_frame(blobs.source.as_cloud()).scale)


def test_as_cloud_of_a_cloud_is_the_cloud(build, blobs):
    source, target = blobs.of("cc")
    plain, found = (build("nearest-features").match(source, target, as_cloud=choice) for choice in (None, "both"))
    np.testing.assert_array_equal(found.source_to_target, plain.source_to_target)


def test_prepared_shapes_can_be_matched_again(build, blobs):
    matcher = build("functional-map")
    source, target = matcher.preprocess(blobs.source), matcher.preprocess(blobs.target)
    assert (source.modality, target.modality) == ("mesh", "mesh")
    assert source.features.shape == (480, 64)
    assert matcher.preprocess(blobs.source, as_cloud=True).modality == "cloud"
    plain = matcher.match(blobs.source, blobs.target)
    for _ in range(2):
        found = matcher.find(matcher.paired(source, target))
        np.testing.assert_array_equal(found.source_to_target, plain.source_to_target)
        np.testing.assert_array_equal(found.target_confidence, plain.target_confidence)


def test_functional_maps_have_the_size_asked_for(build, blobs, network):
    def size(partial=None, of_parts=False, **settings):
        info = FeatureInfo(map_eigenpairs=40, partial=of_parts)
        settings = MatcherSettings(functional_map=FunctionalMapSettings(**settings))
        matcher = Matcher(network, info, settings=settings, device="cpu")
        prepared = [matcher.preprocess(shape) for shape in (blobs.source, blobs.target)]
        pair = matcher.paired(*prepared, PairOptions(partial=partial))
        c_xy, c_yx = functional_maps(pair)
        assert c_xy.shape == c_yx.shape == c_yx.mT.shape
        assert pair.map_size == len(c_xy)
        return c_xy.shape[0]

    assert size() == 40
    assert size(n_eigenpairs=25) == 25
    for partial in ("source", "target"):
        assert size(n_eigenpairs=25, partial=partial, n_eigenpairs_partial=30) == 30
        assert size(partial=partial) == 50
        assert size(partial=partial, of_parts=True) == 40


def test_operators_are_those_that_the_weights_were_trained_with(network):
    info = FeatureInfo(n_eigenpairs=60, laplacian="cotangent", n_neighbours=20)
    assert Matcher(network, info, device="cpu").preprocess.settings == OperatorSettings(60, "cotangent", 20)
    own = OperatorSettings(30)
    settings = MatcherSettings(operators=own)
    assert Matcher(network, info, settings=settings, device="cpu").preprocess.settings == own


def test_a_functional_map_takes_functions_from_source_to_target(build, blobs):
    """Direction: ``c_st`` carries the source's coordinates to those of the target's true counterparts."""
    matcher = build("functional-map")
    source, target = (matcher.preprocess(shape).operators for shape in (blobs.source, blobs.target))
    c_st, _ = functional_maps(matcher.paired(*map(matcher.preprocess, (blobs.source, blobs.target))))
    heights = torch.from_numpy(blobs.source.points[:, 1].astype(np.float32))
    carried = target.truncated(40).eigenvectors @ c_st @ source.truncated(40).coefficients(heights[:, None])
    expected = heights[torch.from_numpy(blobs.target_to_source)]
    assert torch.corrcoef(torch.stack([carried[:, 0], expected]))[0, 1] > 0.9


def test_raw_products_skip_the_normalisation(build, blobs, network):
    """Between two clouds with features stretched point by point, only normalised ones give the same map."""
    source, target = (build("nearest-features").preprocess(shape) for shape in blobs.of("cc"))
    by_length = {}
    shuffled = torch.randperm(len(source.features), generator=torch.Generator().manual_seed(0))
    for raw in (False, True):
        settings = MatcherSettings(method="nearest-features", soft_map=SoftMapSettings(normalise=not raw))
        matcher = Matcher(network, FeatureInfo(upright=False), settings=settings, device="cpu")
        method = matcher.method_of("cloud", "cloud")
        stretch = torch.logspace(-1, 0.5, len(source.features))[shuffled, None]
        stretched = replace(source, features=source.features * stretch)
        options = PairOptions(partial="target")
        plain, found = (method(matcher.paired(each, target, options)) for each in (source, stretched))
        by_length[raw] = (plain.y_to_x == found.y_to_x).float().mean()
    assert by_length[False] > 0.99
    assert by_length[True] < 0.8


def test_steps_are_measured_in_order(build, blobs):
    heard = []
    timings = Timings(listener=heard.append)
    build("nearest-features").match(blobs.source, blobs.target, timings=timings)
    names = [step.name for step in timings.finished]
    assert names == heard
    assert set(names) == {
        *(
            f"{what} {side}"
            for what in ("repair", "proxy of", "operators of", "orientation of", "features of")
            for side in ("source", "target")
        ),
        "map",
    }
    assert len(names) == 11
    assert names[-1] == "map"
    assert all(step.seconds > 0 and step.process_peak_mb > 10 for step in timings.finished)


def test_the_memory_of_large_shapes_is_said_in_advance(build, blobs, monkeypatch, caplog):
    monkeypatch.setattr("homolog.pairs.preprocessing._MANY", blobs.source.n_points)
    with caplog.at_level("WARNING", logger="homolog"):
        build("nearest-features").preprocess(blobs.source)
    assert "points: matching it needs some" in caplog.text


def test_weights_from_a_file(build, blobs, weights):
    matcher = Matcher.from_weights(weights, device="cpu")
    assert matcher.extractor.info.map_eigenpairs == 40
    assert not matcher.extractor.info.upright
    assert not matcher.extractor.network.training
    plain, found = build("auto").match(*blobs.of("mm")), matcher.match(*blobs.of("mm"))
    np.testing.assert_array_equal(found.source_to_target, plain.source_to_target)


def test_warnings_of_low_confidence_are_the_same_either_way_round_and_pass_over_points_without_a_counterpart():
    """Three of four source points have none; the others and all target points are trusted."""
    found = Match(
        Shape(np.eye(4, 3)),
        Shape(np.eye(2, 3)),
        source_to_target=np.array([0, -1, -1, -1]),
        target_to_source=np.array([0, 0]),
        source_confidence=np.array([0.9, 0, 0, 0]),
        target_confidence=np.array([0.9, 0.8]),
        method="nearest-features",
    )
    assert low_confidence_warnings(found) == low_confidence_warnings(found.inverse()) == ()
    unsure = replace(found, target_confidence=np.array([0.1, 0.2]))
    assert (
        "doubtful" in low_confidence_warnings(unsure)[0] and "doubtful" in low_confidence_warnings(unsure.inverse())[0]
    )


def test_maps_that_tear_are_doubted_however_sure_they_are():
    side = Quality(0.98, cycle_error=0.01, dirichlet_energy=20.0, flipped_triangles=0.05, confidence=0.9)
    few = replace(side, dirichlet_energy_99=1.5)  # it tears a few edges
    shape = Shape(np.eye(2, 3))
    sure = Match(
        shape, shape, np.zeros(2, int), np.zeros(2, int), np.full(2, 0.9), np.full(2, 0.9), method="nearest-features"
    )
    torn = replace(side, dirichlet_energy_99=5.0)
    for quality in (None, MapQuality(few, few), MapQuality(side, side)):  # the last as an earlier version wrote it
        assert low_confidence_warnings(replace(sure, quality=quality)) == ()
    for quality in (MapQuality(torn, few), MapQuality(few, torn), MapQuality(None, torn)):
        (warning,) = low_confidence_warnings(replace(sure, quality=quality))
        assert "tears the shapes (Dirichlet energy" in warning
    unsure = replace(sure, source_confidence=np.zeros(2), quality=MapQuality(torn, torn))
    assert len(low_confidence_warnings(unsure)) == 1  # one warning is enough


@pytest.mark.parametrize("given", [None, OperatorSettings(n_eigenpairs=50)])
def test_operators_are_those_the_weights_were_trained_with(blobs, network, given):
    """Unless the settings say otherwise."""
    info = FeatureInfo(n_eigenpairs=60, upright=False)
    matcher = Matcher(network, info, settings=MatcherSettings(operators=given), device="cpu")
    assert matcher.preprocess(blobs.source).operators.n_eigenpairs == (50 if given else 60)


@pytest.mark.parametrize("method", ["functional-map", "nearest-features"])
def test_methods_that_need_weights(method):
    with pytest.raises(ArgumentError, match=rf"method '{method}' needs weights.*axiomatic"):
        Matcher(settings=MatcherSettings(method=method))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda m, s: Matcher(settings=MatcherSettings(method="nearest-feature")),
            ["method is 'nearest-feature'", "did you mean 'nearest-features'?"],
        ),
        (lambda m, s: Matcher(settings=MatcherSettings(method="funtional-map")), ["did you mean 'functional-map'?"]),
        (lambda m, s: Matcher(device="cude"), ["device is 'cude'", "did you mean 'cuda'?"]),
        (lambda m, s: choose_device("gpu9"), ["device is 'gpu9'", "auto, cpu, cuda"]),
        (lambda m, s: m.match(s, s, partial="sorce"), ["partial is 'sorce'", "did you mean 'source'?"]),
        (lambda m, s: m.match(s, s, partial=""), ["partial is ''", "source, target"]),
        (lambda m, s: m.match(s, s, source_up="w"), ["source_up is 'w'", "x, y, z"]),
        (lambda m, s: m.match(s, s, target_up=None), ["target_up is None", "'x', 'y', 'z'"]),
        (lambda m, s: m.match(s, s, as_cloud="sorce"), ["as_cloud is 'sorce'", "did you mean 'source'?"]),
        (
            lambda m, s: m.paired(m.preprocess(s), m.preprocess(s), PairOptions(partial="targt")),
            ["partial is 'targt'", "did you mean 'target'?"],
        ),
    ],
)
def test_words_that_are_not_choices(build, blobs, call, words):
    with pytest.raises(ArgumentError) as caught:
        call(build("axiomatic", with_network=False), blobs.source)
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words)
    assert isinstance(caught.value, HomologError)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize(
    ("make_settings", "said"),
    [
        (
            lambda: FunctionalMapSettings(n_eigenpairs=0),
            "n_eigenpairs is 0, but must be a whole number of at least 1, or None",
        ),
        (lambda: FunctionalMapSettings(n_eigenpairs=40.0), "n_eigenpairs is 40.0"),
        (
            lambda: FunctionalMapSettings(n_eigenpairs_partial=0),
            "n_eigenpairs_partial is 0, but must be a whole number of at least 1, or None",
        ),
        (lambda: FunctionalMapSettings(n_eigenpairs_partial=True), "n_eigenpairs_partial is True"),
        (
            lambda: FunctionalMapSettings(regularisation=-1e-9),
            "regularisation is -1e-09, but must be a number of at least 0",
        ),
        (lambda: FunctionalMapSettings(regularisation=np.nan), "regularisation is nan"),
        (lambda: SoftMapSettings(temperature=0), "temperature is 0, but must be a number above 0, or None"),
        (lambda: SoftMapSettings(temperature="cold"), "temperature is 'cold'"),
        (lambda: SoftMapSettings(temperature=np.inf), "temperature is inf"),
        (lambda: SoftMapSettings(iterations=0), "iterations is 0, but must be a whole number of at least 1"),
        (lambda: SoftMapSettings(normalise=1), "normalise is 1, but must be true or false"),
        (lambda: AxiomaticSettings(n_eigenpairs=0), "n_eigenpairs is 0, but must be a whole number of at least 1"),
        (lambda: AlignmentSettings(steps=0), "steps is 0, but must be a whole number of at least 1"),
        (
            lambda: AlignmentSettings(similar="x"),
            "similar is 'x', but must be a number of at least -1",
        ),
        (lambda: AlignmentSettings(scales=(1, 0)), "scales holds 0, but must be a list, each of them a number above 0"),
        (lambda: AlignmentSettings(scales=()), "scales is empty, but must hold at least one"),
        (lambda: AlignmentSettings(rotations=[]), "rotations is empty, but must hold at least one"),
        (
            lambda: AlignmentSettings(rotations=[(3, 90)]),
            "rotations holds 3, but must be a list, each of them a list of 2: a whole number of at least 0 and of at "
            "most 2, a number",
        ),
        (lambda: WarningSettings(least_confidence=2), "least_confidence is 2, but must be a number of at least 0 and"),
        (lambda: WarningSettings(most_dirichlet_energy=None), "most_dirichlet_energy is None, but must be a number"),
        (lambda: MatcherSettings(method=5), "method is 5, but must be the name of a method, or a function of a hom"),
        (lambda: MatcherSettings(warnings={}), "warnings is {}, but must be WarningSettings"),
        (
            lambda: Matcher(settings=MatcherSettings(method="axiomatik"), device="cpu"),
            "method is 'axiomatik', but must be one of auto, axiomatic",
        ),
        (lambda: MatcherSettings(refinement="no"), "refinement is 'no', but must be RefinementSettings, or None"),
        (lambda: MatcherSettings(alignment=False), "alignment is False, but must be AlignmentSettings, or None"),
        (lambda: MatcherSettings(soft_map=None), "soft_map is None, but must be SoftMapSettings"),
        (lambda: MatcherSettings(operators=128), "operators is 128, but must be OperatorSettings, or None"),
    ],
)
def test_settings_out_of_range(make_settings, said):
    with pytest.raises(ArgumentError) as caught:
        make_settings()
    assert str(caught.value).startswith(said)


def test_settings_are_shown_by_what_differs_from_the_default():
    assert repr(MatcherSettings()) == "MatcherSettings()"
    changed = MatcherSettings(method="axiomatic", refinement=None, warnings=WarningSettings(least_confidence=0.5))
    shown = "MatcherSettings(method='axiomatic', refinement=None, warnings=WarningSettings(least_confidence=0.5))"
    assert repr(changed) == shown
    assert eval(shown) == changed


def test_settings_at_the_edge_of_their_range():
    FunctionalMapSettings(n_eigenpairs=np.int64(1), n_eigenpairs_partial=1, regularisation=0)
    SoftMapSettings(temperature=np.float32(1e-9), iterations=1)
    MatcherSettings(alignment=None, refinement=None, operators=None)


def test_strict_refuses_what_needs_repair_before_operators_are_computed(blobs, build):
    def never(*args, **kwargs):
        raise AssertionError("operators were computed")

    torn = Shape(blobs.source.points, np.concatenate([blobs.source.faces, blobs.source.faces[:1]]), name="torn.ply")
    with pytest.raises(ShapeError, match=r"torn\.ply: 1 duplicate faces: .*\(refused as strict\)"):
        build("axiomatic", operators=never).match(torn, blobs.target, strict=True)


def test_bad_choices_are_found_before_any_work(blobs, build):
    def never(*args, **kwargs):
        raise AssertionError("operators were computed")

    for wrong in ({"partial": "sorce"}, {"as_cloud": "all"}):
        with pytest.raises(ArgumentError):
            build("axiomatic", operators=never).match(blobs.source, blobs.target, **wrong)


def test_device_words(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert choose_device("auto") == choose_device("cpu") == torch.device("cpu")
    with pytest.raises(ArgumentError, match="finds no CUDA device"):
        choose_device("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert choose_device("auto") == choose_device("cuda") == torch.device("cuda")


def test_unusable_shapes_are_named(build, blobs):
    line = Shape(np.outer(np.arange(10.0), [1, 2, 3]), name="stick.xyz")
    for pair in ((line, blobs.source), (blobs.source, line)):
        with pytest.raises(ShapeError, match=r"stick\.xyz cannot be used"):
            build("axiomatic").match(*pair)


def test_weights_that_are_not_there():
    with pytest.raises(WeightsError, match=r"no weights 'nowhere\.safetensors'"):
        Matcher.from_weights("nowhere.safetensors")


def test_weights_by_name(weights, tmp_path, monkeypatch):
    """As the command line finds them."""
    (tmp_path / "blobs.safetensors").write_bytes(weights.read_bytes())
    monkeypatch.setattr(pretrained_module, "_FOLDER", tmp_path)
    assert Matcher.from_weights("blobs", device="cpu").extractor.info.name == "blobs"
    with pytest.raises(
        WeightsError, match=r"no weights 'people'; give the path of a file, or one of the pretrained ones: blobs"
    ):
        Matcher.from_weights("people")


KINDS = {
    "number": (
        lambda m, s: m.match(3, s),
        "source: a shape is needed, but int was given; give a Shape, a path, points (n, 3)",
    ),
    "bytes": (lambda m, s: m.match(s, b"b.ply"), "target: a shape is needed, but bytes was given"),
    "array": (lambda m, s: m.preprocess(s.points), "shape is a ndarray, but must be a Shape"),
    "operators": (lambda m, s: m.preprocess.operators("a.ply"), "shape is a str, but must be a Shape"),
    "shape": (lambda m, s: m.preprocess.features(s), "operators is a Shape, but must be Operators; compute them"),
    "shapes": (lambda m, s: m.find(s), "pair is a Shape, but must be a Pair; make one with Matcher.pair"),
    "options": (lambda m, s: m.match(s, s, {"partial": "source"}), "options is a dict, but must be PairOptions; make"),
    "info": (lambda m, s: Matcher(info="people"), "info is a str, but must be FeatureInfo; homolog.load_weights gives"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_arguments_of_another_kind(build, blobs, kind):
    call, said = KINDS[kind]
    with pytest.raises(ArgumentError) as caught:
        call(build("axiomatic", with_network=False), blobs.source)
    assert str(caught.value).startswith(said)
    assert "\n" not in str(caught.value)


def test_the_axiomatic_method_has_its_own_operators_whatever_weights_are_given(blobs, network):
    """Weights of other operators do not change what it finds."""
    info = FeatureInfo(n_eigenpairs=60, laplacian="cotangent")
    settings = MatcherSettings(method="axiomatic")
    given, none = Matcher(network, info, settings=settings, device="cpu"), Matcher(settings=settings, device="cpu")
    assert given.preprocess.settings == none.preprocess.settings == OperatorSettings()
    assert (
        given.extractor.info
        == none.extractor.info
        == FeatureInfo(name="axiomatic", licence="none", input="xyz", upright=False)
    )
    own = MatcherSettings(method="axiomatic", operators=OperatorSettings(70))
    assert Matcher(network, info, settings=own, device="cpu").preprocess.settings == OperatorSettings(70)
