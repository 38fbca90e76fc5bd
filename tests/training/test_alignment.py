"""Shapes that do not stand alike are turned before they are trained on."""

import json
import shutil

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from homolog.core.errors import ArgumentError, DataError, TrainingError
from homolog.datasets import ShapeFolder
from homolog.features import (
    ORIENTER_NETWORK,
    DiffusionNet,
    FeatureInfo,
    NetworkSettings,
    Orienter,
    load_weights,
    save_weights,
)
from homolog.geometry import OperatorSettings, compute_operators
from homolog.maps import rotation_angle
from homolog.matching import Matcher
from homolog.pairs import MatcherSettings
from homolog.shapes import Shape, read_shape, write_shape
from homolog.training import alignment, loop
from homolog.training.data import TrainingSet
from homolog.training.sampling import SampledShape
from homolog.training.store import unit_mesh
from homolog.training.validation import scores


@pytest.fixture(scope="module")
def turned(meshes, tmp_path_factory):
    """The meshes made longer, each turned at random, and how."""
    root, turns = tmp_path_factory.mktemp("turned"), {}
    for number, file in enumerate(sorted((meshes / "off").iterdir())):
        shape, turns[file.stem] = read_shape(file), Rotation.random(random_state=number).as_matrix()
        write_shape(root / file.name, Shape(shape.points * [1, 1.6, 0.6] @ turns[file.stem].T, shape.faces))
    return root, turns


@pytest.fixture(scope="module")
def trained(turned, small, tmp_path_factory):
    """A short training on aligned shapes, and its store."""
    recipe, run, kept = small(data={"align": True}, training={"steps": 1}), tmp_path_factory.mktemp("r") / "run", []
    told = []

    class Store(loop.ShapeStore):
        def prepare(self, *arguments):
            kept.append(self)
            super().prepare(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "ShapeStore", Store)
        loop.train(recipe, turned[0], run, device="cpu", progress=lambda *step: told.append(step))
    assert told[0] == (1, 6, "aligning shapes")
    return recipe, run, kept[0]


def test_the_store_gives_shapes_that_stand_alike(trained, turned):
    """As the one that none is turned for, both in the list and in what is trained on."""
    _, run, store = trained
    listed = json.loads((run / "alignment.json").read_text())
    (root,) = (name for name, how in listed.items() if how["misfit"] == 0)
    for name, how in listed.items():
        turn = np.array(how["rotation"]) @ turned[1][name] @ turned[1][root].T
        assert rotation_angle(torch.tensor(turn)) < 15
        files = torch.tensor(read_shape(turned[0] / f"{name}.off").points)
        given = store.shape(SampledShape(name, 0, 0)).mesh.points.double()
        expected = (files - files.mean(dim=0)) @ torch.tensor(how["rotation"]).double().T / store.frame(name).scale
        assert torch.cdist(given, expected).amin(dim=1).max() < 1e-3


def test_the_scores_are_of_shapes_that_are_turned_as_those_trained_on(meshes, tmp_path):
    """Upright weights on turned shapes score as on the shapes before, if told how to turn them back."""
    shutil.copytree(meshes, tmp_path / "turned")
    turns = {}
    for number, file in enumerate(sorted((tmp_path / "turned" / "off").iterdir())):
        shape, turns[file.stem] = read_shape(file), Rotation.random(random_state=number).as_matrix()
        write_shape(file, Shape(shape.points @ turns[file.stem].T, shape.faces))
    torch.manual_seed(0)
    network = DiffusionNet(NetworkSettings(width=16, out_channels=16, blocks=2))
    settings = MatcherSettings(operators=OperatorSettings(24))
    matcher = Matcher(network, FeatureInfo(map_eigenpairs=12), settings=settings, device="cpu")
    back = {name: turn.T for name, turn in turns.items()}
    before, told, untold = (
        scores(matcher, ShapeFolder.open(folder), [("ape", "bee"), ("cat", "dog")], tmp_path / "pairs", rotations=how)
        for folder, how in ((meshes, None), (tmp_path / "turned", back), (tmp_path / "turned", None))
    )
    assert told == pytest.approx(before, abs=1.0)
    assert min(untold[way] - before[way] for way in before) > 3


def test_a_training_scores_shapes_as_it_turned_them(meshes, small, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(loop, "scores", lambda *given, rotations, **options: seen.append(rotations) or {})
    recipe = small(data={"align": True}, training={"steps": 1}, validation={"score_every": 1, "score_pairs": 1})
    loop.train(recipe, meshes, tmp_path / "run", device="cpu")
    listed = json.loads((tmp_path / "run" / "alignment.json").read_text())
    (rotations,) = seen
    assert {name: rotation.tolist() for name, rotation in rotations.items()} == {
        name: how["rotation"] for name, how in listed.items()
    }


def test_shapes_are_turned_as_the_weights_know_them_that_a_training_starts_from(turned, small, tmp_path, monkeypatch):
    """And their orienter is kept: what it turned is what the new weights know."""
    torch.manual_seed(0)
    recipe = small(data={"align": True}, training={"steps": 1})
    orienter = Orienter(DiffusionNet(ORIENTER_NETWORK).eval())
    save_weights(tmp_path / "start.safetensors", DiffusionNet(recipe.network), FeatureInfo(), orienter=orienter)
    monkeypatch.setattr(loop, "train_orienter", None)
    monkeypatch.setattr(alignment, "joint_rotations", None)
    run = tmp_path / "run"
    loop.train(recipe, turned[0], run, device="cpu", weights=tmp_path / "start.safetensors")
    for name, how in json.loads((run / "alignment.json").read_text()).items():
        shape = unit_mesh(TrainingSet.open(turned[0], recipe), name)[0]
        best = orienter(compute_operators(shape, settings=recipe.operators))[0]
        assert rotation_angle(torch.tensor(how["rotation"]).float() @ best.rotation.T) < 0.1
    kept = load_weights(run / "weights.safetensors").orienter.network.state_dict()
    assert all(torch.equal(kept[key], weight) for key, weight in orienter.network.state_dict().items())


def test_a_resumed_training_reads_how_shapes_were_turned(trained, turned, monkeypatch):
    recipe, run, _ = trained
    monkeypatch.setattr(alignment, "joint_rotations", None)
    assert loop.train(recipe, turned[0], run, device="cpu", resume=True).step == 1
    file = run / "alignment.json"
    whole = file.read_text()
    ragged = '{"ape": {"rotation": [[1], [0, 1]], "misfit": 0}}'
    damaged = (whole[:40], "[]", '{"ape": 3}', whole.replace("misfit", "fit"), "[" * 10**5, ragged)
    for damage in (*damaged, whole.replace("1.0", "NaN"), whole.replace("1.0", "5.0")):
        assert damage != whole
        file.write_text(damage)
        with pytest.raises(DataError, match=r"alignment\.json (is damaged|cannot be \w+).*; remove it") as caught:
            loop.train(recipe, turned[0], run, device="cpu", resume=True)
        assert "\n" not in str(caught.value)
    file.write_text(whole)


def test_with_other_shapes_or_without_alignment_a_training_cannot_go_on(trained, turned, small):
    _, run, _ = trained
    with pytest.raises(TrainingError, match=r"data\.align = True, but the recipe has False"):
        loop.train(small(training={"steps": 1}), turned[0], run, device="cpu", resume=True)


def test_weights_do_not_say_how_shapes_were_turned(trained):
    assert load_weights(trained[1] / "weights.safetensors").info.upright


def test_shapes_unlike_all_others_are_named(caplog):
    alignment._warn_of_outliers({"a": 0.0, "b": 0.02, "c": 0.03, "d": 0.07, "e": 0.03})
    assert "d: unlike all other shapes (misfit above 0.060)" in caplog.text
    caplog.clear()
    alignment._warn_of_outliers({"a": 0.0, "b": 0.02, "c": 0.03})
    alignment._warn_of_outliers({"a": 0.0})
    assert not caplog.text


def test_partial_shapes_are_not_aligned(small):
    with pytest.raises(ArgumentError, match=r"\[data\] align is True, but must be false with a section \[partial\]"):
        small(data={"align": True}, partial={})
