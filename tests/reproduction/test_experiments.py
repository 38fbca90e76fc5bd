"""The experiments that come with the package: what they name is there, and the paper's figures are the paper's."""

import itertools
from dataclasses import replace

import pytest

from homolog.core.errors import ArgumentError
from homolog.datasets import read_description
from homolog.evaluation import Protocol
from homolog.methods import method_names
from homolog.reproduction import COLUMNS, data_places, experiment_names, read_experiment, trainings
from homolog.reproduction.experiments import training_of
from homolog.training import read_recipe

# Cao and Bernard, CVPR 2023: mean errors x100, row by row.
PAPER = {
    "complete": [2.0, 2.4, 4.4, 3.1, 4.1, 6.6, 4.0, 4.5, 5.8],
    "partial": [7.6, 12.2, 15.9, 16.7],
    "views": [6.3],
    "pose": [4.7, 5.6, 5.3, 6.2, 6.0, 6.8, 8.8, 12.0, 14.0, 14.2, 13.9, 14.7],
    "supervised": [1.5, None, 4.8, None, 5.2, None, 6.8, None, 6.9, None, 8.1, None],
    "sampling": [2.6, 3.0, 3.3, 4.4, None, None, None, None],
}


def test_names():
    known = {"complete", "generalise", "partial", "views", "lungs", "ablation", "pose", "noise", "sampling"}
    assert {*known, "supervised", "outliers", "baselines", "partial_baselines", "best"} == set(experiment_names())
    with pytest.raises(ArgumentError, match=r"'complet', but must be one of .*did you mean 'complete'"):
        read_experiment("complet")


@pytest.mark.parametrize("name", experiment_names())
def test_what_an_experiment_names_is_there(name):
    experiment = read_experiment(name)
    assert experiment.title
    assert experiment.about
    assert len({row.name for row in experiment.rows}) == len(experiment.rows) > 0
    for row in experiment.rows:
        assert row.data in data_places()
        assert row.method in method_names()
        assert row.training or not row.trained_only
        Protocol(modality=row.modality, noise=row.noise, outliers=row.outliers, turn=row.turn)
        assert not experiment.axis or row.curve


@pytest.mark.parametrize("name", PAPER)
def test_figures_of_the_paper(name):
    assert [row.paper for row in read_experiment(name).rows] == PAPER[name]


@pytest.mark.parametrize("plan", trainings().values(), ids=lambda plan: plan.name)
def test_trainings_can_be_read(plan):
    recipe = read_recipe(plan.recipe, plan.changes)
    descriptions = [data_places()[name].description for name in plan.data]
    assert len({each.up for each in descriptions}) == 1  # links to shapes of several say nothing of it
    assert not (recipe.partial and len(plan.data) > 1)
    for weights in ("loss.alignment", "loss.infonce", "loss.coupling"):
        if weights in plan.changes:
            assert recipe.loss.weights[weights.removeprefix("loss.")] == plan.changes[weights]


def test_every_training_and_dataset_is_used():
    experiments = [read_experiment(name) for name in experiment_names()]
    used = {row.training for each in experiments for row in each.rows if row.training}
    assert used == set(trainings())
    for place in data_places().values():
        assert read_description(place.dataset)
        assert place.folders


def test_the_paper_has_no_search_and_no_refinement():
    paper, ours = COLUMNS["paper"], COLUMNS["ours"]
    assert (paper.orient, paper.clutter, paper.left_out) == ("given", "keep", ("refinement", "alignment"))
    assert (ours.orient, ours.clutter, ours.left_out) == ("auto", "remove", ())


def test_baselines_change_losses_alone():
    """They share data, network and steps with the row's own training, and their recipes can be read."""
    for name in ("baselines", "partial_baselines"):
        experiment = read_experiment(name)
        assert experiment.columns[0] == "ours"
        for row, column in itertools.product(experiment.rows, experiment.columns):
            plan, own = training_of(row, column), trainings()[row.training]
            if COLUMNS[column].method:
                assert plan is None
                continue
            changed = {key: value for key, value in plan.changes.items() if own.changes.get(key) != value}
            assert plan == replace(own, name=plan.name, changes=plan.changes)
            assert (plan.name == own.name) == (not changed)
            assert all(key.startswith("loss.") for key in changed)
            weights = read_recipe(plan.recipe, plan.changes).loss.weights
            assert any(weights.values())
            assert column == "ours" or weights["alignment"] == weights["infonce"] == 0
    planned = {plan.name for plan in read_experiment("baselines").trainings}
    assert {"faust", "faust_surfmnet", "faust_geomfmaps", "scape_ulrssm"} < planned


def test_terms_past_the_paper_are_switched_one_at_a_time():
    rows = [row for row in read_experiment("best").rows if row.split == "train"]
    plain = read_recipe("best", trainings()["best_plain"].changes)
    for row in rows:
        plan = trainings()[row.training]
        recipe = read_recipe(plan.recipe, plan.changes)
        assert row.trained_only
        assert recipe.data.leave_out[0].endswith(row.names)
        differing = {name for name, weight in recipe.loss.weights.items() if weight != plain.loss.weights[name]}
        others = (recipe.input != "xyz", recipe.operators.n_eigenpairs > 128, len(plan.data) > 1)
        assert len(differing) + sum(others) == (0 if row.training == "best_plain" else 1) + (
            row.training == "best_damped"  # which needs eigenvectors to damp
        )


def test_rows_by_parts_of_their_names():
    experiment = read_experiment("complete")
    assert [row.name for row in experiment.rows_named(("faust",))] == [
        "FAUST_r, mesh",
        "FAUST_r, cloud",
        "FAUST_r, noisy cloud",
    ]
    assert len(experiment.rows_named(("faust", "SCAPE_r, mesh"))) == 4
    assert experiment.rows_named(()) == experiment.rows
    with pytest.raises(ArgumentError, match="only is 'horse', but must be one of FAUST_r, mesh"):
        experiment.rows_named(("horse",))
