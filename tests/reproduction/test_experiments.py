"""The experiments that come with the package: what they name is there, and the paper's figures are the paper's."""

import pytest

from homolog.core.errors import ArgumentError
from homolog.datasets import read_description
from homolog.evaluation import Protocol
from homolog.methods import method_names
from homolog.reproduction import COLUMNS, data_places, experiment_names, read_experiment, trainings
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
    assert {*known, "supervised", "outliers"} == set(experiment_names())
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
    for weights in ("loss.alignment", "loss.infonce"):
        if weights in plan.changes:
            assert recipe.loss.weights[weights.removeprefix("loss.")] == 0


def test_every_training_and_dataset_is_used():
    experiments = [read_experiment(name) for name in experiment_names()]
    assert {plan.name for each in experiments for plan in each.trainings} == set(trainings())
    for place in data_places().values():
        assert read_description(place.dataset)
        assert place.folders


def test_the_paper_has_no_search_and_no_refinement():
    paper, ours = COLUMNS["paper"], COLUMNS["ours"]
    assert (paper.orient, paper.clutter, paper.left_out) == ("given", "keep", ("refinement", "alignment"))
    assert (ours.orient, ours.clutter, ours.left_out) == ("auto", "remove", ())


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
