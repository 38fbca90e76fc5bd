"""Lent orienters: weights that know the training shapes give theirs, turned to how these stand."""

import json
import logging
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import homolog
from homolog.core.errors import ArgumentError, WeightsError
from homolog.features import ORIENTER_NETWORK, DiffusionNet, FeatureInfo, NetworkFeatures, Orientation, save_weights
from homolog.geometry import compute_operators
from homolog.maps import rotation_angle
from homolog.shapes import Shape, write_shape
from homolog.training import lending, lent_orienter, loop, read_recipe
from homolog.training.data import TrainingSet
from homolog.training.store import ShapeStore

STANDS = torch.from_numpy(Rotation.from_euler("xyz", [80, 20, -60], degrees=True).as_matrix()).float()


class Knows:
    """An orienter that finds shapes to stand in one way, some degrees to either side, in turn."""

    def __init__(self, misfit, *, rotation=STANDS, degrees=10.0, flipped=False):
        self.misfit, self.rotation, self.degrees, self.flipped, self.asked = misfit, rotation, degrees, flipped, 0

    def __call__(self, operators):
        self.asked += 1
        turn = self.degrees * (-1) ** self.asked + 180 * (self.flipped and self.asked % 2)
        around = torch.from_numpy(Rotation.from_euler("y", turn, degrees=True).as_matrix()).float()
        return (Orientation(around @ self.rotation, self.misfit),)

    def turned(self, rotation):
        return Knows(self.misfit, rotation=rotation.T @ self.rotation, degrees=self.degrees)

    def to(self, device):
        return self


@pytest.fixture
def lend(meshes, small, monkeypatch):
    """``lend(orienters by name, limit, section of the recipe...)``: what is lent to a training on four shapes."""

    def lent(orienters, most_misfit=1.0, **changes):
        def weights(name):
            info = FeatureInfo(name=name, licence=f"that of {name}", most_misfit=most_misfit)
            return NetworkFeatures(None, info, orienters[name])

        monkeypatch.setattr(lending, "load_weights", weights)
        monkeypatch.setattr(lending, "KINDS", tuple(orienters))
        recipe = small(**changes)
        shapes = TrainingSet.open(meshes, recipe)
        return lent_orienter(ShapeStore(shapes, recipe, compute_operators), shapes.trained)

    return lent


def test_those_that_know_the_shapes_best_lend_and_stand_them_as_they_are(lend):
    found = lend({"some": Knows(0.12), "best": Knows(0.11), "none": Knows(0.4)})
    assert (found.lender, found.licence, found.misfit, found.alike) == ("best", "that of best", 0.11, 1.0)
    assert lend({"first": Knows(0.09), "others": None}).lender == "first"  # which know them well enough
    assert found.turned == pytest.approx(float(rotation_angle(STANDS)), abs=0.5)
    stands = torch.stack([found.orienter(None)[0].rotation for _ in range(4)])
    assert rotation_angle(stands).max() < 10.5


def test_none_is_lent_where_none_know_the_shapes(lend):
    assert lend({"some": Knows(0.13)}) is None
    assert lend({"strict": Knows(0.1)}, most_misfit=0.08) is None
    assert lend({"some": Knows(0.01)}, orienter={"lender": "none"}) is None


def test_shapes_that_do_not_stand_alike_are_named_and_get_none(lend, caplog):
    assert lend({"some": Knows(0.05, flipped=True)}) is None
    assert "'some' know the shapes, but find" in caplog.text and "[data] align" in caplog.text


def test_weights_that_a_recipe_names_lend_in_any_case(lend):
    assert lend({"mine": Knows(0.5), "best": Knows(0.01)}, orienter={"lender": "mine"}).lender == "mine"
    with pytest.raises(ArgumentError, match="lender is 'mine', which has no orienter; give other weights"):
        lend({"mine": None}, orienter={"lender": "mine"})


def test_a_wrong_name_is_refused_before_anything_is_made(meshes, small, tmp_path):
    with pytest.raises(WeightsError, match="there are no weights 'peple'"):
        loop.train(small(orienter={"lender": "peple"}), meshes, tmp_path / "run", device="cpu")
    assert not (tmp_path / "run").exists()


def test_a_turned_orienter_is_the_same_for_shapes_that_stand_otherwise(make):
    torch.manual_seed(0)
    orienter = homolog.features.Orienter(DiffusionNet(ORIENTER_NETWORK).eval())
    basis = compute_operators(make.blob(3)).basis.truncated(64)
    here, there = (
        each.network(basis.points @ turn.T, basis)
        for each, turn in ((orienter, STANDS), (orienter.turned(STANDS), torch.eye(3)))
    )
    torch.testing.assert_close(there, here @ STANDS, atol=1e-5, rtol=0)


# ---- at the end of a training


@pytest.mark.slow
def test_weights_of_people_who_lie_get_the_orienter_of_people(tmp_path, caplog):
    """Turned by 120 degrees, they are matched as they stand; the weights that it starts from stay as they are."""
    turn = Rotation.from_rotvec(np.full(3, np.deg2rad(120) / 3**0.5)).as_matrix()
    (tmp_path / "lying").mkdir()
    for shape in homolog.demo_shapes():
        write_shape(tmp_path / "lying" / shape.name, Shape(shape.points @ turn.T, shape.faces))
    changes = {"training.steps": 0, "validation.shapes": 0, "licence": "CC0-1.0", "clouds.noise": []}
    with caplog.at_level(logging.INFO, logger="homolog"):
        loop.train(read_recipe("quick", changes), tmp_path / "lying", tmp_path / "run", weights="people", device="cpu")
    assert "The orienter is that of the weights 'people' (misfit 0.0" in caplog.text
    made, people = homolog.load_weights(tmp_path / "run" / "weights.safetensors"), homolog.load_weights("people")
    assert made.info.lender == "people" and people.info.lender == ""
    for name, weight in people.network.state_dict().items():
        assert torch.equal(weight, made.network.state_dict()[name])
    told = json.loads((tmp_path / "run" / "report.json").read_text())["orienter"]
    assert told["lender"] == "people" and told["misfit"] < 0.1 and told["turned_degrees"] == pytest.approx(120, abs=20)
    shape = homolog.demo_shapes()[0]
    for further in (np.eye(3), Rotation.random(random_state=0).as_matrix()):
        found = made.orienter(compute_operators(Shape(shape.points @ turn.T @ further.T, shape.faces)))[0].rotation
        assert rotation_angle(found @ torch.from_numpy(further).float()) < 30


def test_training_without_steps_needs_weights(meshes, small, tmp_path):
    with pytest.raises(ArgumentError, match="steps is 0, which trains nothing; give --weights"):
        loop.train(small(training={"steps": 0}), meshes, tmp_path / "run", device="cpu")


def test_resumed_weights_keep_whose_orienter_they_hold(meshes, small, tmp_path):
    torch.manual_seed(0)
    recipe, run = small(orienter={"lender": str(tmp_path / "lender.safetensors"), "steps": 2}), tmp_path / "run"
    orienter = homolog.features.Orienter(DiffusionNet(ORIENTER_NETWORK).eval())
    network = DiffusionNet(recipe.network)
    save_weights(tmp_path / "lender.safetensors", network, FeatureInfo(name="somebody"), orienter=orienter)
    loop.train(recipe, meshes, run, device="cpu")
    assert homolog.load_weights(run / "weights.safetensors").info.lender == "somebody"
    more = replace(recipe, orienter=replace(recipe.orienter, lender="none"))
    loop.train(more, meshes, run, device="cpu", resume=True)
    assert homolog.load_weights(run / "weights.safetensors").info.lender == "somebody"


def test_a_lent_orienter_is_trained_on_where_the_recipe_says_so(meshes, small, tmp_path):
    torch.manual_seed(0)
    lent = homolog.features.Orienter(DiffusionNet(ORIENTER_NETWORK).eval())
    features = DiffusionNet(ORIENTER_NETWORK)
    save_weights(tmp_path / "lender.safetensors", features, FeatureInfo(name="somebody"), orienter=lent)
    how = {"lender": str(tmp_path / "lender.safetensors"), "steps": 9, "lent_steps": 2, "learning_rate": 1e-6}
    loop.train(small(orienter=how, training={"steps": 1}), meshes, tmp_path / "run", device="cpu")
    found = homolog.load_weights(tmp_path / "run" / "weights.safetensors")
    assert found.info.lender == "somebody"
    told = json.loads((tmp_path / "run" / "report.json").read_text())["orienter"]
    assert (told["lender"], told["steps"]) == ("somebody", 2) and told["loss"] > 0
    # The first and the last layer are turned; the blocks between are the lender's, and a little on.
    blocks = zip(found.orienter.network.blocks.parameters(), lent.network.blocks.parameters(), strict=True)
    moved = [float((one - other).detach().abs().max()) for one, other in blocks]
    assert 0 < max(moved) < 1e-4
