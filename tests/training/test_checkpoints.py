"""What a checkpoint keeps, and what is refused."""

import json

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from homolog.core.errors import TrainingError
from homolog.training.checkpoints import load_checkpoint, save_checkpoint
from homolog.training.state import TrainingState


def stepped(recipe, steps):
    """A state after some steps along gradients of no meaning."""
    state = TrainingState.new(recipe)
    random = torch.Generator().manual_seed(0)
    for _ in range(steps):
        step(state, random)
    return state


def step(state, random):
    for weight in state.network.parameters():
        weight.grad = torch.randn(weight.shape, generator=random)
    state.take_step(1e-2, 0.9)


def everything(state):
    return {
        **{f"weight {name}": weight for name, weight in state.network.named_parameters()},
        **{f"average {name}": weight for name, weight in (state.average or {}).items()},
    }


@pytest.mark.parametrize("average", [0.0, 0.9])
@pytest.mark.parametrize("steps", [0, 1, 4])
def test_a_state_comes_back_and_goes_on_alike(tmp_path, small, average, steps):
    recipe = small(optimiser={"average": average, "weight_decay": 0.1})
    state = stepped(recipe, steps)
    state.seconds, state.best, state.records = 12.5, 0.25, [{"step": 1, "validation/total": 0.25}]
    save_checkpoint(tmp_path / "last.safetensors", state, recipe, "digest")
    found = load_checkpoint(tmp_path / "last.safetensors", recipe, "digest")
    assert (found.step, found.seconds, found.best, found.records) == (steps, 12.5, 0.25, state.records)
    for one in (state, found):
        step(one, torch.Generator().manual_seed(1))
    expected = everything(state)
    assert everything(found).keys() == expected.keys()
    assert all(torch.equal(tensor, expected[name]) for name, tensor in everything(found).items())
    assert [path.name for path in tmp_path.iterdir()] == ["last.safetensors"]


def test_adam_against_its_definition(small):
    """Two steps by hand: means of the gradients and their squares, without their bias, and decayed weights."""
    recipe = small(optimiser={"learning_rate": 0.1, "betas": [0.8, 0.9], "weight_decay": 0.5, "average": 0.3})
    state = TrainingState.new(recipe)
    weight = next(iter(state.network.parameters()))
    expected, mean, square, average = weight.detach().double().clone(), 0.0, 0.0, weight.detach().double().clone()
    for number, rate in ((1, 0.1), (2, 0.05)):
        for other in state.network.parameters():
            other.grad = torch.full_like(other, 0.7 * number)
        gradient = 0.7 * number
        mean, square = 0.8 * mean + 0.2 * gradient, 0.9 * square + 0.1 * gradient**2
        root = (square / (1 - 0.9**number)) ** 0.5
        expected = expected * (1 - rate * 0.5) - rate * mean / (1 - 0.8**number) / (root + 1e-8)
        decay = min(0.3, number / (number - 1 + 10))
        average = decay * average + (1 - decay) * expected
        state.take_step(rate, 0.3)
    torch.testing.assert_close(weight.detach().double(), expected, atol=1e-6, rtol=1e-5)
    result = next(iter(state.result().parameters()))
    torch.testing.assert_close(result.detach().double(), average, atol=1e-6, rtol=1e-5)
    assert not state.result().training and state.network.training


def test_the_seed_gives_the_weights_and_leaves_others_alone(small):
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    one, again, other = (TrainingState.new(small(seed=seed)).network.first.weight for seed in (1, 1, 2))
    assert torch.equal(torch.rand(3), expected)
    assert torch.equal(one, again) and not torch.equal(one, other)


def test_another_recipe_or_other_shapes_are_refused(tmp_path, small):
    path = tmp_path / "last.safetensors"
    save_checkpoint(path, stepped(small(), 1), small(), "digest")
    with pytest.raises(TrainingError, match=r"optimiser\.learning_rate = 0\.001, but the recipe has 0\.002"):
        load_checkpoint(path, small(optimiser={"learning_rate": 0.002}), "digest")
    with pytest.raises(TrainingError, match="partial"):
        load_checkpoint(path, small(partial={}), "digest")
    changed = small(name="other", data={"memory_gb": 1.0}, training={"checkpoint_minutes": 9.0})
    assert load_checkpoint(path, changed, "digest").step == 1  # none of these changes a weight
    with pytest.raises(TrainingError, match="other shapes"):
        load_checkpoint(path, small(), "another")


def test_damaged_and_foreign_files_are_refused(tmp_path, small):
    path = tmp_path / "last.safetensors"
    save_checkpoint(path, stepped(small(), 1), small(), "digest")
    whole = path.read_bytes()
    with safe_open(path, framework="pt") as file:
        header = file.metadata()
    tensors = {name: tensor.clone() for name, tensor in load_file(path).items()}  # not where the file is mapped
    first = next(name for name in tensors if name.startswith("exp_avg."))

    def rewritten(changed=tensors, **notes):
        save_file(changed, path, metadata={**header, **notes})

    for damage in (
        lambda: path.write_bytes(whole[:-10]),
        lambda: path.write_bytes(b""),
        lambda: rewritten(format="other"),
        lambda: rewritten(progress="{"),
        lambda: rewritten(progress=json.dumps({**json.loads(header["progress"]), "step": "1"})),
        lambda: rewritten(progress=json.dumps({**json.loads(header["progress"]), "records": 3})),
        lambda: rewritten(progress=json.dumps({**json.loads(header["progress"]), "seconds": float("nan")})),
        lambda: rewritten(progress='{"step": 1}'),
        lambda: rewritten(progress="[" * 100_000),
        lambda: rewritten(recipe="[" * 100_000),
        lambda: rewritten(recipe=json.dumps([1])),
        lambda: rewritten({name: tensor for name, tensor in tensors.items() if name != first}),
        lambda: rewritten({**tensors, "weights.last.bias": torch.zeros(3)}),
        lambda: rewritten({**tensors, first: torch.zeros(3)}),
    ):
        damage()
        with pytest.raises(TrainingError) as caught:
            load_checkpoint(path, small(), "digest")
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)
