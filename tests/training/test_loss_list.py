"""Losses: built-in ones, and those of one's own from Python, by a recipe, and from installed packages."""

import sys
from dataclasses import replace

import pytest
import torch

from homolog.core.errors import ArgumentError, DataError
from homolog.core.plugins import offered
from homolog.features import DiffusionNet, NetworkSettings
from homolog.geometry import OperatorSettings, compute_operators
from homolog.shapes import Shape
from homolog.training import (
    BUILTIN_LOSSES,
    QUANTITIES,
    Loss,
    LossSettings,
    PairQuantities,
    TrainingShape,
    losses_of,
    pair_losses,
    read_recipe,
    train,
)
from homolog.training.losses import installed_losses

FEW = LossSettings(map_eigenpairs=10)


@pytest.fixture(scope="module")
def pair(make):
    """Two shapes of a few points, and a network."""
    blob = make.blob(2)
    operators = OperatorSettings(n_eigenpairs=12)

    def both(shape, name):
        bases = [compute_operators(each, settings=operators).basis for each in (shape, shape.as_cloud())]
        return TrainingShape(name, *bases)

    torch.manual_seed(0)
    network = DiffusionNet(NetworkSettings(width=8, out_channels=8, blocks=1)).eval()
    return network, both(blob, "blob"), both(Shape(blob.points * [1, 1.2, 0.9], blob.faces), "long")


def mapped(c_xy, c_yx):
    """A loss of one's own."""
    return c_xy.square().mean() + c_yx.square().mean()


def quantities(pair, **options):
    network, x, y = pair
    bases = [x.mesh, y.mesh, x.cloud, y.cloud]
    return PairQuantities(x, y, network.several([b.points for b in bases], bases), FEW, **options)


# --- what a loss is


def test_a_loss_of_one_s_own_is_one_more_term_of_the_sum(pair):
    network, x, y = pair
    mine = Loss("mine", 0.5, requires={"c_xy", "c_yx"}, function=mapped)
    plain = pair_losses(network, x, y, settings=FEW)
    found = pair_losses(network, x, y, settings=FEW, losses=losses_of(FEW, [mine]))
    assert list(found) == ["bijectivity", "orthogonality", "alignment", "infonce", "mine", "total"]
    needed = quantities(pair)
    torch.testing.assert_close(found["mine"], 0.5 * mapped(needed.c_xy, needed.c_yx))
    torch.testing.assert_close(found["total"], plain["total"] + found["mine"])
    network.zero_grad()
    found["mine"].backward()
    gradient = network.last.weight.grad.clone()
    assert gradient.norm() > 0
    network.zero_grad()
    both = pair_losses(network, x, y, settings=FEW, losses=losses_of(FEW, [mine]))["total"]
    alone = pair_losses(network, x, y, settings=FEW)["total"]
    (both - alone).backward()
    torch.testing.assert_close(network.last.weight.grad, gradient, rtol=1e-2, atol=1e-3 * float(gradient.norm()))


MISTAKES = {
    "quantity": (lambda: Loss("mine", 1.0, {"c_xz"}, mapped), r"the loss mine requires is 'c_xz'.*did you mean"),
    "parameter": (lambda: Loss("mine", 1.0, {"c_xy"}, mapped), "does not take what it requires, c_xy: missing"),
    "too many": (lambda: Loss("mine", 1.0, {"c_xy", "c_yx", "rank"}, mapped), "does not take what it requires"),
    "negative": (
        lambda: Loss("mine", -1.0, {"c_xy", "c_yx"}, mapped),
        "weight of mine is -1.0, but must be a number of at",
    ),
    "nan": (
        lambda: Loss("mine", float("nan"), {"c_xy", "c_yx"}, mapped),
        "weight of mine is nan, but must be a number of at",
    ),
    "no function": (lambda: Loss("mine", 1.0, {"c_xy"}, 3), "function of mine is 3, but must be a function of the"),
    "name": (lambda: Loss("total", 1.0, {"c_xy", "c_yx"}, mapped), "name is 'total'"),
    "words": (lambda: Loss("my loss", 1.0, {"c_xy", "c_yx"}, mapped), "name is 'my loss'"),
    "twice": (lambda: losses_of(FEW, [Loss.of("infonce", 1.0, mapped)]), "there are 2 losses 'infonce'; give yours"),
    "none": (
        lambda: losses_of(replace(FEW, weights=dict.fromkeys(BUILTIN_LOSSES, 0.0))),
        "no loss has a weight above 0",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_said_before_anything_is_computed(mistake):
    make, said = MISTAKES[mistake]
    with pytest.raises(ArgumentError, match=said) as caught:
        make()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("value", "said"), [(1.0, "returned float"), (torch.zeros(3), r"returned shape \(3,\)")])
def test_what_is_no_scalar_is_refused(pair, value, said):
    mine = Loss("mine", 1.0, set(), lambda: value)
    with pytest.raises(ArgumentError, match=f"the loss mine {said}, but must return a scalar tensor"):
        pair_losses(*pair, settings=FEW, losses=[mine])


def test_a_loss_that_fails_is_named_with_the_pair(pair):
    mine = Loss("mine", 1.0, set(), lambda: 1 / 0)
    said = "the loss mine failed on .+ -> .+: ZeroDivisionError: division by zero"
    with pytest.raises(ArgumentError, match=said) as caught:
        pair_losses(*pair, settings=FEW, losses=[mine])
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


# --- what it is computed from


def test_every_quantity_can_be_had_and_is_documented(pair):
    true = [name for name in QUANTITIES if name.startswith("true_")]
    found = quantities(pair).of([name for name in QUANTITIES if name not in true])
    assert {*found, *true} == {*QUANTITIES} and true
    for name in true:
        with pytest.raises(DataError, match="have no common template"):
            quantities(pair).of([name])
    assert found["rank"] is None and quantities(pair, partial=True).rank >= 1
    assert found["c_xy"].shape == found["c_yx"].shape == (10, 10)
    for name in QUANTITIES:
        stem = name.removesuffix("_y")
        assert f"`{name}`" in PairQuantities.__doc__ or f"`{stem}_x`" in PairQuantities.__doc__, name


def test_quantities_are_computed_once_and_only_where_a_loss_asks(pair, monkeypatch):
    from homolog.training import quantities as module

    counted = []
    for name in ("functional_map", "registered_positions"):
        original = getattr(module, name)
        monkeypatch.setattr(
            module, name, lambda *given, _f=original, _n=name, **more: counted.append(_n) or _f(*given, **more)
        )
    pair_losses(*pair, settings=FEW)
    assert counted == ["functional_map"] * 2  # for three losses
    counted.clear()
    only = replace(FEW, weights={**dict.fromkeys(BUILTIN_LOSSES, 0.0), "registration": 1.0, "infonce": 1.0})
    assert list(pair_losses(*pair, settings=only)) == ["infonce", "registration", "total"]
    assert counted == ["registered_positions"]


# --- in a recipe


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module on the path, with a loss, and a trace of its having been imported."""
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "mylosses.py").write_text(
        "from pathlib import Path\n"
        "Path(__file__).with_suffix('.trace').touch()\n"
        "def small(c_xy, c_yx, scale=1.0):\n    return scale * (c_xy.square().mean() + c_yx.square().mean())\n"
        "def odd(c_xy, height):\n    return c_xy.sum()\n"
        "number = 3\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path / "lib"))
    yield tmp_path / "lib"
    sys.modules.pop("mylosses", None)


def recipe_with(tmp_path, small, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return path


def test_a_recipe_can_name_a_function_which_is_imported_when_it_is_trained_with(tmp_path, module, pair):
    path = recipe_with(tmp_path, None, "[loss]\nmine = 0.5\n[loss.functions]\nmine = 'mylosses:small'\n")
    settings = read_recipe(path).loss
    assert settings.weights["mine"] == 0.5 and settings.functions == {"mine": "mylosses:small"}
    assert not (module / "mylosses.trace").exists()
    losses = losses_of(settings)
    assert (module / "mylosses.trace").exists()
    assert losses[-1].name == "mine" and losses[-1].requires == {"c_xy", "c_yx"}
    few = replace(settings, map_eigenpairs=10)
    found = pair_losses(*pair, settings=few)
    needed = quantities(pair)
    torch.testing.assert_close(found["mine"], 0.5 * mapped(needed.c_xy, needed.c_yx))


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("mylosses:gone", "has no attribute 'gone'"),
        ("nolosses:small", "No module named 'nolosses'"),
        ("mylosses:number", "3 is not a callable"),
        ("mylosses:odd", "the loss mine requires is 'height'"),
        ("mylosses", "has no attribute ''"),
        ("os:system", "the loss mine requires is 'command'"),
    ],
)
def test_functions_that_cannot_be_used(tmp_path, module, path, said):
    settings = LossSettings(weights={"mine": 1.0}, functions={"mine": path})
    with pytest.raises(ArgumentError, match=said) as caught:
        losses_of(settings)
    assert "\n" not in str(caught.value)


@pytest.fixture
def offer(module):
    """Install a package, as if it were, whose entry points are these lines."""

    def install(lines):
        info = module / "theirs-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[homolog.losses]\n{lines}\n")
        offered.cache_clear()

    yield install
    offered.cache_clear()


def test_installed_losses_are_named_by_their_entry_points(tmp_path, module, offer, pair):
    assert "theirs" not in installed_losses()
    offer("theirs = mylosses:small")
    settings = read_recipe(recipe_with(tmp_path, None, "[loss]\ntheirs = 2.0\n")).loss
    assert not (module / "mylosses.trace").exists()
    found = pair_losses(*pair, settings=replace(settings, map_eigenpairs=10))
    needed = quantities(pair)
    torch.testing.assert_close(found["theirs"], 2 * mapped(needed.c_xy, needed.c_yx))
    with pytest.raises(ArgumentError, match=r"unknown key 'their'; did you mean 'theirs'"):
        LossSettings(weights={"their": 2.0})


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("brokenlosses:small", "RuntimeError: out of order"),
        ("nolosses:small", "No module named 'nolosses'"),
        ("mylosses:number", "3 is not a callable"),
    ],
)
def test_installed_losses_that_cannot_be_used_name_their_package(module, offer, target, said):
    (module / "brokenlosses.py").write_text("raise RuntimeError('out of\\norder')\n")
    offer(f"theirs = {target}")
    with pytest.raises(
        ArgumentError, match=rf"theirs = {target} in homolog.losses of package theirs.*{said}"
    ) as caught:
        losses_of(LossSettings(weights={"theirs": 1.0}))
    assert "\n" not in str(caught.value)
    with pytest.raises(ArgumentError, match=r"'brokenlosses:small', cannot be used \(RuntimeError: out of order\)"):
        losses_of(LossSettings(weights={"own": 1.0}, functions={"own": "brokenlosses:small"}))


def test_an_installed_loss_called_like_a_built_in_one_is_told_of(offer, caplog):
    offer("infonce = mylosses:small")
    losses = losses_of(LossSettings())
    assert losses_of(LossSettings()) == losses
    (told,) = caplog.messages
    assert "infonce = mylosses:small in homolog.losses of package theirs is left out, as Homolog has that name" in told


def test_a_training_minimises_logs_and_validates_a_loss_of_one_s_own(meshes, small, tmp_path):
    calls = []

    def mine(c_xy):
        calls.append(c_xy.shape)
        return c_xy.square().sum()

    heavy = Loss("mine", 1e3, requires={"c_xy"}, function=mine)
    recipe = small(validation={"every": 3}, training={"steps": 3})
    plain = train(recipe, meshes, tmp_path / "plain", device="cpu")
    state = train(recipe, meshes, tmp_path / "own", losses=[heavy], device="cpu")
    record = state.records[-1]
    terms = {key: value for key, value in record.items() if key.startswith("validation/")}
    total = terms.pop("validation/total")
    assert total == pytest.approx(sum(terms.values()), rel=1e-6) and terms["validation/mine"] > 0
    assert "validation/mine" not in plain.records[-1]
    assert len(calls) == 3 + 2  # of steps, and of validation pairs
    assert not torch.equal(state.network.last.weight, plain.network.last.weight)
    from homolog.core.errors import TrainingError

    with pytest.raises(TrainingError, match=r"losses\.mine = 1000\.0, but the recipe has None"):
        train(recipe, meshes, tmp_path / "own", device="cpu", resume=True)
