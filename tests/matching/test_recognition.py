"""Of several kinds of features, those are compared that know a pair; where none do, the best map decides."""

from collections import Counter
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import homolog
from homolog.core.errors import ArgumentError
from homolog.features import FeatureInfo, Orientation
from homolog.matching import Match, Matcher, map_misfit, search
from homolog.matching.search import orient
from homolog.matching.warnings import unknown_shape_warnings
from homolog.methods import registration
from homolog.methods.registration import started
from homolog.pairs import ChoiceSettings, MatcherSettings, PairOptions
from homolog.shapes import Shape
from homolog.synthesis import view


@dataclass(frozen=True, eq=False)
class Positions:
    """Features of positions, or noise, and an orienter that knows each shape alike."""

    name: str
    misfit: float
    tells: bool = True
    n_eigenpairs: int = 64
    knows_parts: bool = False
    most: float = 1.0
    lender: str = ""

    @property
    def info(self):
        return FeatureInfo(
            name=self.name,
            n_eigenpairs=self.n_eigenpairs,
            near_isometric=False,
            partial=self.knows_parts,
            most_misfit=self.most,
            lender=self.lender,
        )

    def orienter(self, operators):
        return (Orientation(torch.eye(3), self.misfit),)

    def __call__(self, operators):
        if not self.tells:
            generator = torch.Generator().manual_seed(operators.points.shape[0])
            return torch.randn(operators.points.shape[0], 16, generator=generator)
        waves = 3 * torch.randn(3, 64, generator=torch.Generator().manual_seed(0))
        return torch.cat([(operators.points @ waves).sin(), (operators.points @ waves).cos()], dim=1)


def chosen(extractors, shapes, settings=None, orient="given"):
    matcher = Matcher(extractors, settings=settings)
    return matcher.pair(shapes.source, shapes.target, PairOptions(orient=orient))[0]


def doubts(pair):
    """What is said of the pair's choice, whose maps tell all that is asked of them."""
    source, target = (side.repaired.shape for side in (pair.source, pair.target))
    maps = np.zeros(source.n_points, int), np.zeros(target.n_points, int)
    return unknown_shape_warnings(pair, Match(source, target, *maps))


def test_features_that_know_the_pair_are_taken_before_others_are_asked(blobs):
    pair = chosen([Positions("usual", 0.05), Positions("others", 0.01)], blobs)
    assert pair.extractor.info.name == "usual"
    assert [candidate.name for candidate in pair.choice] == ["usual"]
    assert doubts(pair) == ()


@pytest.mark.parametrize(("partial", "first"), [(None, "usual"), ("source", "of parts"), ("both", "of parts")])
def test_of_partial_pairs_those_that_know_parts_are_asked_first(blobs, partial, first):
    """And of full ones last; those that know the pair better are taken all the same."""
    usual, of_parts = Positions("usual", 0.05), Positions("of parts", 0.05, knows_parts=True)
    options = PairOptions(partial=partial, orient="given")
    pair = Matcher([usual, of_parts]).pair(blobs.source, blobs.target, options)[0]
    assert pair.extractor.info.name == first and [candidate.name for candidate in pair.choice] == [first]
    other = Matcher([usual, Positions("of parts", 0.3, knows_parts=True)]).pair(blobs.source, blobs.target, options)[0]
    assert other.extractor.info.name == "usual"


@pytest.mark.parametrize(("partial", "taken"), [(None, ["animals", "people"]), ("source", ["parts of animals"])])
def test_features_with_a_lent_orienter_know_what_the_lender_knows(blobs, partial, taken):
    """Of both, those are asked that suit the pair, however much better the other's orienter likes it."""
    people, animals = Positions("people", 0.3), Positions("animals", 0.06 if partial is None else 0.01)
    parts = Positions("parts of animals", 0.01 if partial is None else 0.06, knows_parts=True, lender="animals")
    options = PairOptions(partial=partial, orient="given")
    pair = Matcher([people, animals, parts]).pair(blobs.source, blobs.target, options)[0]
    assert [candidate.name for candidate in pair.choice] == taken


class Turning(Positions):
    """Features whose orienter finds every shape to lie on its side."""

    def orienter(self, operators):
        return (Orientation(torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), self.misfit),)


def test_shapes_that_are_aligned_already_are_not_turned_by_features_that_are_chosen(blobs):
    matcher = Matcher([Positions("usual", 0.2), Turning("others", 0.05, knows_parts=True)])
    source, target = (matcher.preprocess(shape) for shape in (blobs.source, blobs.target))
    pair = matcher.paired(source, target, PairOptions(partial="target", pre_aligned=True))
    assert pair.extractor.info.name == "others"
    assert torch.equal(pair.x.rotation, torch.eye(3)) and torch.equal(pair.y.rotation, torch.eye(3))


def test_the_pretrained_weights_of_parts_stand_in_for_those_with_their_orienter():
    auto = Matcher.from_weights().feature_choice.extractors
    assert [each.info.name for each in auto] == ["people", "animals", "hands", "heads", "views", "animal_parts"]
    source, target = homolog.demo_shapes()
    full = Matcher.from_weights().pair(source, target)[0]
    assert [candidate.name for candidate in full.choice] == ["people"]
    seen = view(source, seed=1).mesh.shape
    part = Matcher.from_weights().pair(seen, target, partial="source")[0]
    assert [candidate.name for candidate in part.choice] == ["views"]


@pytest.mark.parametrize("orient", ["auto", "given"])
def test_those_that_know_it_better_are_taken_where_the_usual_ones_do_not(blobs, orient):
    pair = chosen([Positions("usual", 0.2), Positions("others", 0.06)], blobs, orient=orient)
    assert pair.extractor.info.name == "others"
    assert [(candidate.name, candidate.misfit) for candidate in pair.choice] == [("others", 0.06), ("usual", 0.2)]
    assert torch.equal(pair.x.features, Positions("others", 0)(pair.x.operators))


ALL_MAPS = MatcherSettings(choice=ChoiceSettings(registered=-10.0))
"""Also those of shapes that are registered with less contradiction than any other map could have."""


def test_features_may_say_that_they_know_shapes_less_well(blobs):
    strict = Positions("strict", 0.11, most=0.08)
    told = {each.name: each.map_misfit for each in chosen([Positions("usual", 0.5), strict], blobs, ALL_MAPS).choice}
    assert set(told) == {"strict", "axiomatic", "registration"} and None not in told.values()
    assert chosen([Positions("usual", 0.5), replace(strict, misfit=0.07)], blobs).extractor.info.name == "strict"


def test_automatic_weights_are_not_left_aside_by_a_method_that_needs_none():
    settings = MatcherSettings(method="registration")
    assert Matcher.from_weights("auto", settings=settings).warnings == ()
    assert "'people' are left aside" in Matcher.from_weights("people", settings=settings).warnings[0]


def test_features_with_a_smaller_misfit_than_they_allow_do_not_hide_those_that_know_the_pair(blobs):
    strict, others = Positions("strict", 0.09, most=0.08), Positions("others", 0.095)
    assert chosen([Positions("usual", 0.5), strict, others], blobs).extractor.info.name == "others"
    assert chosen([strict, others], blobs).extractor.info.name == "others"


def test_a_pair_whose_best_map_is_no_good_is_said_to_be_doubtful(blobs):
    features = [Positions("some", 0.5), Positions("others", 0.9)]
    pair = chosen(features, blobs)
    assert pair.extractor is None or pair.choice[0].name != pair.extractor.info.name
    assert doubts(pair) == ()
    strict = replace(pair.settings, choice=ChoiceSettings(doubtful=pair.choice[0].map_misfit - 0.01))
    (said,) = doubts(replace(pair, settings=strict))
    assert said.startswith("the match is doubtful: no weights know both shapes, and the best map, by 'registration'")


def test_a_pair_that_none_know_gets_the_best_map(blobs):
    good, bad, ignorant = Positions("good", 0.3), Positions("bad", 0.2, tells=False), Positions("ignorant", 0.5)
    pair = chosen([bad, good, ignorant], blobs, ALL_MAPS)
    told = {candidate.name: candidate.map_misfit for candidate in pair.choice}
    assert set(told) == {"good", "bad", "axiomatic", "registration"}
    assert pair.choice[0].map_misfit == min(told.values())
    assert told["bad"] > max(told["good"], told["registration"]) + 1


def test_methods_without_features_are_tried_where_no_features_are_plausible(blobs):
    matcher = Matcher([Positions("some", 0.5), Positions("others", 0.9)], settings=ALL_MAPS)
    match = matcher.match(blobs.source, blobs.target, orient="given")
    assert match.method in ("axiomatic", "registration")
    assert match.report["choice"][0]["name"] == match.method
    assert {candidate["name"] for candidate in match.report["choice"]} == {"axiomatic", "registration"}


def test_where_a_registration_contradicts_itself_nowhere_no_other_map_is_looked_at(blobs):
    features = [Positions("good", 0.3), Positions("others", 0.9)]
    registered = chosen(features, blobs)
    assert registered.method.name == "registration" and registered.choice[0].map_misfit < 1
    assert [each.map_misfit for each in registered.choice[1:]] == [None, None]
    least = replace(ALL_MAPS.choice, registered=registered.choice[0].map_misfit - 0.01)
    assert len(chosen(features, blobs, replace(ALL_MAPS, choice=least)).choice) == 3


@pytest.fixture(scope="module")
def copies(make):
    """A shape and one that is a little longer, without a bend, and turned."""
    shape = make.blob(3)
    turn = Rotation.from_rotvec([0.9, -0.4, 1.3]).as_matrix()
    return SimpleNamespace(source=shape, target=Shape(shape.points * [1.06, 1.0, 0.97] @ turn.T, shape.faces))


def test_features_are_left_out_of_nearly_rigid_copies(copies):
    pair = chosen([Positions("some", 0.2), Positions("others", 0.25)], copies, orient="auto")
    assert pair.method.name == "registration"
    assert [each.name for each in pair.choice] == ["registration", "some", "others"]
    assert pair.choice[0].map_misfit < 1 and [each.map_misfit for each in pair.choice[1:]] == [None, None]
    assert pair.maps is not None  # the map that tells the misfit is not made twice
    for usual, others, first in ((0.2, 0.11, "others"), (0.11, 0.2, "registration"), (0.09, 0.2, "usual")):
        known = chosen([Positions("usual", usual), Positions("others", others)], copies, orient="auto")
        assert known.choice[0].name == first


@dataclass(frozen=True, eq=False)
class KnowsOne(Positions):
    """Features that know one shape, by its size, and no other."""

    size: float = 0.0

    def orienter(self, operators):
        knows = abs(operators.scale - self.size) < 1e-3 * self.size
        return (Orientation(torch.eye(3), self.misfit if knows else 0.5),)


@pytest.mark.parametrize(("misfit", "most", "first"), [(0.06, 1.0, "others"), (0.11, 1.0, None), (0.06, 0.05, None)])
def test_features_that_know_one_of_both_well_are_taken_though_the_other_is_odd(copies, misfit, most, first):
    """Even of nearly rigid copies: a wrong map by closest points may tear less."""
    size = homolog.compute_operators(copies.source).scale
    pair = chosen([Positions("usual", 0.3), KnowsOne("others", misfit, most=most, size=size)], copies, orient="auto")
    assert pair.choice[0].name == (first or "registration")
    assert first is None or pair.choice[0].misfit == 0.5
    said = doubts(pair)
    assert len(said) == (first is not None)
    assert all("'others', have a misfit of 0.50" in each for each in said)


@pytest.mark.parametrize(("most", "warned"), [(0.08, True), (1.0, False)])
def test_a_warning_goes_by_what_the_features_say_of_themselves(blobs, most, warned):
    """Though their map is the best: other shapes have that misfit as well."""
    matcher = Matcher([Positions("usual", 0.5), Positions("strict", 0.1, most=most)], settings=ALL_MAPS)
    pair, _ = matcher.pair(blobs.source, blobs.target, partial="both", orient="given")
    assert pair.choice[0].name == "strict"
    assert [f"but at most {most:g} of shapes" in each for each in doubts(pair)] == [True] * warned


@pytest.fixture(scope="module")
def bent(copies):
    x, y, z = copies.source.points.T
    points = np.stack([np.sin(0.9 * y) * (1.2 - x), np.cos(0.9 * y) * (1.2 - x), z], axis=1)
    return SimpleNamespace(source=copies.source, target=Shape(points, copies.source.faces))


def test_bent_shapes_are_no_rigid_copies(bent):
    matcher = Matcher(None, settings=MatcherSettings(method="registration"))
    assert not started(orient(matcher.pair(bent.source, bent.target)[0])).start.near_rigid


def test_shapes_that_are_trusted_to_stand_alike_are_not_looked_at(copies):
    matcher = Matcher(None, settings=MatcherSettings(method="registration"))
    given, found = (matcher.pair(copies.source, copies.target, PairOptions(orient=how))[0] for how in ("given", "auto"))
    assert started(given).start is None
    assert started(orient(found)).start.near_rigid


@pytest.mark.slow
@pytest.mark.parametrize(("shapes", "wanted"), [("copies", ["registration"]), ("bent", ["axiomatic", "registration"])])
def test_what_the_choice_found_of_a_pair_is_not_looked_for_again(shapes, wanted, request, monkeypatch):
    """The way round and the start of a registration, and maps that were tried; the match is that without a choice."""
    given, calls = request.getfixturevalue(shapes), Counter()

    def counted(module, name):
        function = getattr(module, name)

        def call(*args, **options):
            calls[name] += 1
            return function(*args, **options)

        monkeypatch.setattr(module, name, call)

    counted(registration, "registration_start")
    counted(registration, "registered_surfaces")
    counted(search, "closest_point_rotations")
    # With the operators that methods without features use alone.
    matcher = Matcher([Positions(name, misfit, n_eigenpairs=128) for name, misfit in (("usual", 0.5), ("others", 0.6))])
    pair = matcher.pair(given.source, given.target)[0]
    before = dict(calls)
    match = matcher.match_pair(pair)
    assert pair.method.name in wanted
    assert not Counter(calls) - Counter(before)
    plain = Matcher(None, settings=MatcherSettings(method=pair.method.name)).match(given.source, given.target)
    assert np.array_equal(match.source_to_target, plain.source_to_target)
    assert np.array_equal(match.target_to_source, plain.target_to_source)
    assert match.report["orientation"] == plain.report["orientation"]
    if shapes == "copies":
        return
    others = matcher.alternatives(pair, 2)
    assert np.array_equal(others[0].target_to_source, match.target_to_source)
    assert others[0].report["choice"] == match.report["choice"]


def test_a_method_that_was_asked_for_is_kept(blobs):
    settings = MatcherSettings(method="nearest-features")
    pair = chosen([Positions("bad", 0.3, tells=False), Positions("good", 0.4)], blobs, settings)
    assert pair.method.name == "nearest-features"
    assert "axiomatic" not in [candidate.name for candidate in pair.choice]


def test_a_shape_is_seen_once_by_each(blobs, monkeypatch):
    matcher = Matcher([Positions("usual", 0.2), Positions("others", 0.06)])
    source, target = (matcher.preprocess(shape) for shape in (blobs.source, blobs.target))
    first, second = matcher.paired(source, target), matcher.paired(source, target)
    assert first.source is second.source
    assert first.target is second.target


def test_maps_contradict_themselves_more_where_they_tear(blobs):
    match = homolog.match(blobs.source, blobs.source, method="registration")
    good = match.quality
    torn = replace(good, source=replace(good.source, dirichlet_energy=good.source.dirichlet_energy + 3))
    assert map_misfit(replace(match, quality=torn)) > map_misfit(match)
    with pytest.raises(ArgumentError, match="has no figures of quality; give one of"):
        map_misfit(replace(match, quality=None))


def test_several_need_an_orienter_each(blobs):
    def lacking(operators):
        return operators.points

    with pytest.raises(ArgumentError, match="have no orienter"):
        Matcher([Positions("usual", 0.1), lacking])


def test_several_expect_the_same_operators():
    with pytest.raises(ArgumentError, match="'few', 'many' expect different operators"):
        Matcher([Positions("few", 0.1), Positions("many", 0.1, n_eigenpairs=100)])
