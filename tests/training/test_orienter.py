"""The orienter: it is trained after the network, from the same shapes, and turns them upright."""

import json

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from scipy.spatial.transform import Rotation

from homolog.core.errors import ArgumentError, TrainingError
from homolog.features import ORIENTER_RADIUS, load_weights, save_weights
from homolog.geometry import compute_operators
from homolog.maps import rotation_angle
from homolog.shapes import Shape, write_shape
from homolog.training import OrienterSettings, loop, orienter, train_orienter
from homolog.training.data import TrainingSet
from homolog.training.store import ShapeStore


def store_of(root, recipe, device="cpu"):
    return ShapeStore(TrainingSet.open(root, recipe), recipe, compute_operators, device)


def weights_of(one):
    return torch.nn.utils.parameters_to_vector(one.network.parameters())


@pytest.fixture(scope="module")
def learnt(meshes, small):
    """An orienter of 400 steps, and the shapes that it knows."""
    store = store_of(meshes, small(clouds={"noise": [0.01]}))
    told = []
    found, loss = train_orienter(
        store, store.shapes.trained, OrienterSettings(steps=400), seed=1, progress=lambda *step: told.append(step)
    )
    assert told[-1] == (400, 400, "training the orienter") and 0 < loss < 0.5
    return store, found


@pytest.mark.slow
def test_it_turns_shapes_upright(learnt):
    store, found = learnt
    for number, name in enumerate(store.shapes.trained):
        operators = compute_operators(store.shapes.shape(name), settings=store.recipe.operators)
        turn = torch.from_numpy(Rotation.random(random_state=number).as_matrix()).float()
        assert rotation_angle(found(operators.turned(turn))[0].rotation @ turn) < 30


@pytest.mark.slow
def test_weights_keep_it_bit_for_bit(learnt, small, tmp_path):
    found = learnt[1]
    network = loop.TrainingState.new(small()).result()
    save_weights(tmp_path / "w.safetensors", network, loop.weights_info(small()), orienter=found)
    kept = load_weights(tmp_path / "w.safetensors").orienter
    assert kept.network.settings == found.network.settings and not kept.network.training
    for name, tensor in found.network.state_dict().items():
        assert torch.equal(tensor, kept.network.state_dict()[name])


def test_the_same_seed_gives_the_same_one_and_leaves_torchs_own_seed_alone(meshes, small, device):
    """Bit for bit on a CPU; GPUs add up in any order."""
    torch.manual_seed(5)
    before, recipe, three = torch.get_rng_state(), small(clouds={"cut": [0.5]}), OrienterSettings(steps=3)
    one, other, third = (
        weights_of(train_orienter(store_of(meshes, recipe, device), ("ape", "bee"), three, seed=seed)[0])
        for seed in (0, 0, 1)
    )
    assert torch.equal(one, other) if device.type == "cpu" else torch.allclose(one, other, atol=1e-3)
    assert not torch.allclose(one, third, atol=1e-3)
    assert torch.equal(torch.get_rng_state(), before)


def radius(points, mass):
    """Centre and root-mean-square distance from it."""
    shares = (mass / mass.sum())[:, None]
    centre = (shares * points).sum(dim=0)
    return centre, float((shares * (points - centre).square()).sum().sqrt())


def test_partial_clouds_are_centred_and_belong_where_they_lie_on_the_mesh(meshes, small):
    store = store_of(meshes, small(clouds={"cut": [0.5]}))
    examples = orienter._examples(store, ["cat"], np.random.default_rng(0))[0]
    mesh = store.samples("cat", -1)
    centre, size = radius(mesh.bases[0].points, mesh.bases[0].mass)
    whole = (mesh.points - centre) * ORIENTER_RADIUS / size
    assert len(examples) == 3 and [len(variant) for variant in examples] == [2, 2, 2]
    for example in examples[2]:
        own, extent = radius(example.basis.points, example.basis.mass)
        assert own.norm() < 1e-3 < 0.1 < example.upright.mean(dim=0).norm()
        assert extent == pytest.approx(ORIENTER_RADIUS, rel=1e-3)
        assert torch.cdist(example.upright, whole).amin(dim=1).max() < 1e-3
        assert example.basis.eigenvectors.dtype == torch.float16


@pytest.mark.parametrize("pre_aligned", [False, True])
def test_partial_shapes_belong_on_their_full_partners(meshes, small, tmp_path, make, pre_aligned):
    """A ball of half the size beside its partner."""
    ball = make.blob(3)
    for name, size, away in (("big", 1.0, 0.0), ("part", 0.5, 2.0)):
        write_shape(tmp_path / f"{name}.off", Shape(ball.points * size + away, ball.faces))
    (tmp_path / "pairs.txt").write_text("big,part\n")
    store = store_of(tmp_path, small(partial={"pre_aligned": pre_aligned}, data={"split": "all"}))
    whole, part = (orienter._examples(store, [name], np.random.default_rng(0))[0][0][0] for name in ("big", "part"))
    centre, size = radius(whole.upright, whole.basis.mass)
    own, half = radius(part.upright, part.basis.mass)
    assert centre.norm() < 0.01 and size == pytest.approx(ORIENTER_RADIUS, rel=0.02)
    assert half == pytest.approx(size / 2, rel=0.02)
    per_unit = ORIENTER_RADIUS / radius(torch.tensor(ball.points).float(), torch.ones(len(ball.points)))[1]
    away = torch.tensor(2.0 - ball.points.mean(axis=0) / 2).float() * per_unit
    torch.testing.assert_close(own, pre_aligned * away, atol=0.04, rtol=0)


def test_many_shapes_have_fewer_examples_each(meshes, small, monkeypatch):
    monkeypatch.setattr(orienter, "_MOST_EXAMPLES", 4)
    store = store_of(meshes, small())
    examples = orienter._examples(store, store.shapes.trained, np.random.default_rng(0))
    assert [[len(variant) for variant in shape] for shape in examples] == [[1, 1], [1, 1]]


def test_it_needs_shapes_and_steps_and_a_sensible_rate(meshes, small):
    store = store_of(meshes, small())
    for names, steps in (((), 3), (("ape",), 0)):
        with pytest.raises(ArgumentError, match="needs a shape and a step"):
            train_orienter(store, names, OrienterSettings(steps=steps))
    with pytest.raises(TrainingError, match=r"of the orienter: the loss is not finite; lower \[orienter\]"):
        train_orienter(store, ("ape",), OrienterSettings(steps=20, learning_rate=1e30))


# ---- at the end of a training


@pytest.fixture(scope="module")
def finished(meshes, small, tmp_path_factory):
    """A training without an orienter, and the recipe that asks for one."""
    recipe = small(training={"steps": 2})
    run = tmp_path_factory.mktemp("runs") / "finished"
    loop.train(recipe, meshes, run, device="cpu")
    return run, small(training={"steps": 2}, orienter={"steps": 4, "lender": "none"})


def test_a_training_ends_with_it(finished, meshes, tmp_path):
    """Resumed or not, with the same bytes; a second time there is nothing to do."""
    run, recipe = finished
    assert load_weights(run / "weights.safetensors").orienter is None
    before = load_file(run / "weights.safetensors")
    loop.train(recipe, meshes, tmp_path / "whole", device="cpu")
    loop.train(recipe, meshes, run, device="cpu", resume=True)
    files = run / "weights.safetensors", tmp_path / "whole" / "weights.safetensors"
    assert files[0].read_bytes() == files[1].read_bytes()
    after = load_file(run / "weights.safetensors")
    assert all(torch.equal(tensor, after[name]) for name, tensor in before.items()) and len(after) > len(before)
    report = json.loads((run / "report.json").read_text())
    assert report["orienter"]["steps"] == 4 and 0 < report["orienter"]["loss"] < 2
    kept = {path: path.read_bytes() for path in run.iterdir()}
    loop.train(recipe, meshes, run, device="cpu", resume=True)
    assert {path: path.read_bytes() for path in run.iterdir()} == kept


def test_weights_for_any_pose_have_none(meshes, small, tmp_path):
    recipe = small(
        upright=False, augmentation={"turn": "any"}, training={"steps": 1}, orienter={"steps": 2, "lender": "none"}
    )
    loop.train(recipe, meshes, tmp_path / "run", device="cpu")
    assert load_weights(tmp_path / "run" / "weights.safetensors").orienter is None
    assert json.loads((tmp_path / "run" / "report.json").read_text())["orienter"] is None


def test_an_interrupt_leaves_weights_without_it(meshes, small, tmp_path, caplog):
    recipe, run = small(training={"steps": 1}, orienter={"steps": 5, "lender": "none"}), tmp_path / "run"

    def interrupt(done, total, what):
        if what == "training the orienter" and done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        loop.train(recipe, meshes, run, device="cpu", progress=interrupt)
    assert "Stopped before the orienter was trained; --resume trains it." in caplog.text
    assert load_weights(run / "weights.safetensors").orienter is None
    assert loop.train(recipe, meshes, run, device="cpu", resume=True).step == 1
    assert load_weights(run / "weights.safetensors").orienter is not None
