"""One choice of features, or of a method without any, for all shapes of a collection."""

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest
from without_weights import axiomatic

from homolog.datasets import demo_folder
from homolog.maps import RegistrationSettings
from homolog.matching import Match, Matcher, map_misfit
from homolog.pairs import ChoiceSettings, MatcherSettings
from homolog.shape_models import ShapeModelSettings, batch, build, choice_for_all, subjects_of
from homolog.shapes import Shape, read_shape, write_shape

pytest.importorskip("h5py")
pytest.importorskip("matplotlib")
pytest.importorskip("PIL.Image")


@pytest.fixture(scope="module")
def people():
    demo = demo_folder()
    return [demo.file(name) for name in demo.names[:2]]


def table(root):
    return list(csv.DictReader((root / "quality.csv").read_text().splitlines()))


@pytest.mark.slow
def test_people_are_matched_by_the_weights_for_people(people, tmp_path):
    one, other = people
    built = build(one, [other], tmp_path / "out", Matcher.from_weights())
    choice = built.folder.choice()
    assert [candidate.name for candidate in choice] == ["people"] and choice[0].map_misfit is None
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["choice"][0]["name"] == "people"
    assert [row["matched_by"] for row in table(tmp_path / "out")] == ["functional-map, people"]
    match = Match.load(built.folder.match_folder(other.stem))
    assert float(table(tmp_path / "out")[0]["map_misfit"]) == pytest.approx(map_misfit(match), rel=1e-4)
    assert match.report["features"]["name"] == "people"
    assert [(each["name"], each["misfit"] < 0.1) for each in match.report["choice"]] == [("people", True)]


@pytest.mark.slow
def test_other_shapes_are_matched_by_what_explains_most_of_them(family, tmp_path, monkeypatch):
    """The best by the medians of what single matches have; later shapes follow without a question."""
    template, files, _ = family
    by_maps = MatcherSettings(registration=RegistrationSettings(most_bent=0.0), choice=ChoiceSettings(registered=-10.0))
    matcher = Matcher.from_weights(settings=by_maps)
    built = build(template, files[:2], tmp_path / "out", matcher)
    best, *others = built.folder.choice()
    assert {"axiomatic", "registration"} <= {best.name, *(candidate.name for candidate in others)}
    assert all(best.map_misfit <= candidate.map_misfit for candidate in others)
    shapes = [read_shape(file) for file in files[:2]]
    for candidate in (best, *others):
        limited = matcher.limited_to(candidate.name)
        alone = [map_misfit(limited.match(read_shape(template), shape)) for shape in shapes]
        assert candidate.map_misfit == pytest.approx(np.median(alone), abs=1e-3)

    def asked(*_, **__):
        raise AssertionError("the choice is made once")

    monkeypatch.setattr(batch, "choice_for_all", asked)
    build(template, files, tmp_path / "out", matcher)
    matched_by = {row["matched_by"] for row in table(tmp_path / "out")}
    assert len(table(tmp_path / "out")) == 3 and len(matched_by) == 1
    assert matched_by.pop().endswith(best.name)


@pytest.mark.slow
def test_nearly_rigid_copies_are_registered(family, tmp_path):
    template, files, _ = family
    built = build(template, files[:2], tmp_path / "out", Matcher.from_weights())
    best = built.folder.choice()[0]
    assert (best.name, best.misfit, best.map_misfit) == ("registration", None, None)
    assert [row["matched_by"] for row in table(tmp_path / "out")] == ["registration"] * 2


@pytest.mark.slow
def test_of_what_is_registered_nothing_is_adapted_and_that_is_said(family, tmp_path):
    template, files, _ = family
    built = build(template, files[:1], tmp_path / "out", Matcher.from_weights(), settings=ShapeModelSettings(adapt=4))
    assert built.warnings == ("nothing was adapted: these shapes are matched best by a method without weights",)
    assert json.loads((tmp_path / "out" / "report.json").read_text())["adaptation"] is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "told"), [("hands", "no weights know both shapes: those that were chosen, 'hands'"), ("people", "")]
)
def test_weights_that_were_chosen_for_all_are_doubted_for_a_shape_that_they_do_not_know(people, name, told):
    match = Matcher.from_weights().limited_to(name).match(*people)
    found = [warning for warning in match.warnings if warning.startswith("no weights")]
    assert len(found) == bool(told) and all(warning.startswith(told) for warning in found)


@pytest.mark.slow
@pytest.mark.parametrize(("doubtful", "count"), [(0.0, 1), (10.0, 0)])
def test_a_method_that_was_chosen_for_all_is_doubted_for_a_shape_that_it_maps_badly(people, doubtful, count):
    settings = MatcherSettings(choice=ChoiceSettings(doubtful=doubtful))
    match = Matcher.from_weights(settings=settings).limited_to("registration").match(*people)
    assert sum("the best map, by 'registration'" in warning for warning in match.warnings) == count
    assert [each["name"] for each in match.report["choice"]] == ["registration"]


@pytest.mark.slow
def test_one_odd_shape_does_not_decide(family, people, tmp_path):
    template, files, _ = family
    matcher = Matcher.from_weights()
    settings = ShapeModelSettings()
    odd = [people[0], tmp_path / "none.ply"]
    alone = choice_for_all(read_shape(template), subjects_of(files), matcher, settings)
    both = choice_for_all(read_shape(template), subjects_of([*files, *odd]), matcher, settings)
    assert both[0].name == alone[0].name


def test_at_most_eight_shapes_are_asked(make, tmp_path):
    def names(shapes, options):
        assert all(first.name == "template" for first, _ in shapes)
        return tuple(second.name for _, second in shapes)

    matcher = SimpleNamespace(
        preprocess=lambda shape, **_: shape, feature_choice=SimpleNamespace(is_open=True, candidates=names)
    )

    for number in range(30):
        write_shape(tmp_path / f"{number:02d}.ply", make.blob(0))
    subjects = subjects_of(sorted(tmp_path.glob("*.ply")))
    found = choice_for_all(Shape(make.blob(0).points, name="template"), subjects, matcher)
    assert len(found) == 8 and (found[0], found[-1]) == ("00.ply", "29.ply") and list(found) == sorted(found)
    assert choice_for_all(make.blob(0), subjects, axiomatic()) == ()
