"""Training: what is written, that it can be stopped anywhere, and that pairs and processes add up."""

import json
import multiprocessing
import random
import re
import shutil
import signal
import subprocess
import sys
import time

import pytest
import torch
from safetensors.torch import load_file

from homolog import evaluation
from homolog.core.errors import ArgumentError, TrainingError, WeightsError
from homolog.features import load_weights
from homolog.geometry import OperatorCache
from homolog.shapes import write_shape
from homolog.training import loop, read_recipe, validation
from homolog.training.data import TrainingSet
from homolog.training.objective import pair_losses
from homolog.training.run_folder import weights_info
from homolog.training.sampling import PairSampler
from homolog.training.state import TrainingState

WRITTEN = {"last.safetensors", "best.safetensors", "weights.safetensors", "report.json"}


def written(run):
    return {path.name for path in run.iterdir() if not path.name.startswith("events.out")} - {".lock"}


def tensors_of(run, name="last"):
    return load_file(run / f"{name}.safetensors")


def alike(run, other, name="last"):
    one, two = tensors_of(run, name), tensors_of(other, name)
    return one.keys() == two.keys() and all(torch.equal(tensor, two[key]) for key, tensor in one.items())


@pytest.fixture(scope="module")
def trained(meshes, small, tmp_path_factory):
    """A short training, with all kinds of clouds and an average of the weights."""
    recipe = small(
        clouds={"noise": [0.01], "subsampled": [0.5], "resampled": [700]},
        optimiser={"average": 0.9},
        validation={"score_every": 6, "score_pairs": 1},
    )
    run = tmp_path_factory.mktemp("runs") / "trained"
    told = []
    state = loop.train(recipe, meshes, run, device="cpu", progress=lambda *progress: told.append(progress))
    return recipe, run, state, told


def test_what_a_training_writes(trained):
    _, run, state, told = trained
    assert written(run) == {*WRITTEN, "scored-pairs.txt"}
    assert any(path.name.startswith("events.out") for path in run.iterdir())
    assert told[0] == (1, 4, "operators of ape") and told[-1][:2] == (6, 6)
    report = json.loads((run / "report.json").read_text())
    assert (report["steps"], report["shapes"], report["device"]) == (6, 4, "cpu")
    assert [record["step"] for record in report["validations"]] == [3, 6]
    assert report["validations"] == state.records
    assert 0 < report["validations"][1]["geodesic error/mesh"] < 100
    assert 0 < report["validations"][1]["geodesic error/cloud"] < 100
    assert report["best_validation_loss"] == min(record["validation/total"] for record in state.records)
    assert report["recipe"]["optimiser"]["average"] == 0.9


def test_the_weights_are_the_best_ones(trained):
    _, run, _, _ = trained
    found = load_weights(run / "weights.safetensors")
    network, info = found.network, found.info
    assert (info.name, info.licence, info.upright) == ("small", "CC0-1.0", True)
    assert (info.n_eigenpairs, info.map_eigenpairs, info.laplacian) == (24, 12, "robust")
    assert info.near_isometric and info.temperature == 0.1
    best = tensors_of(run, "best")
    for name, weight in network.named_parameters():
        assert torch.equal(weight, best[f"average.{name}"])
    assert not torch.equal(best["average.last.bias"], best["weights.last.bias"])


def test_what_weights_are_for_is_said_by_the_recipe_and_not_derived(small):
    """An ablation without orthogonality, or with turned shapes, is matched as the full training is."""
    ablated = weights_info(small(loss={"orthogonality": 0.0}, augmentation={"turn": "any"}))
    assert ablated.near_isometric and ablated.upright
    told = weights_info(small(near_isometric=False, upright=False, loss={"soft_temperature": 0.05}))
    assert not told.near_isometric and not told.upright and told.temperature == 0.05
    organs = weights_info(read_recipe("organs"))
    assert organs.upright and not organs.near_isometric and organs.temperature == 0.05


def test_equal_trainings_write_equal_weights(meshes, small, tmp_path):
    for name in ("one", "two"):
        loop.train(small(training={"steps": 2}, validation={"pairs": 0}), meshes, tmp_path / name, device="cpu")
    one, two = ((tmp_path / name / "weights.safetensors").read_bytes() for name in ("one", "two"))
    assert one == two


def test_the_loss_falls(meshes, small, tmp_path):
    recipe = small(
        training={"steps": 40},
        validation={"every": 5, "pairs": 4},
        optimiser={"learning_rate": 0.005, "warmup_steps": 5},
    )
    records = loop.train(recipe, meshes, tmp_path / "run", device="cpu").records
    first, last = records[0], records[-1]
    assert last["validation/total"] < 0.9 * first["validation/total"]


def test_half_precision_trains_alike(meshes, small, tmp_path):
    half = small(training={"precision": "bf16"}, validation={"pairs": 0})
    exact = small(validation={"pairs": 0})
    states = [loop.train(recipe, meshes, tmp_path / name, device="cpu") for name, recipe in (("h", half), ("e", exact))]
    halves, exacts = (torch.nn.utils.parameters_to_vector(state.network.parameters()) for state in states)
    assert 0 < (halves - exacts).norm() < 0.02 * exacts.norm()


def test_the_same_recipe_gives_the_same_weights(meshes, small, tmp_path):
    for name, threads in (("one", 1), ("two", 3)):
        recipe = small(data={"workers": threads}, clouds={"noise": [0.01]})
        state = loop.train(recipe, meshes, tmp_path / name, device="cpu")
    assert state.step == 6
    assert alike(tmp_path / "one", tmp_path / "two")


def test_a_finished_run_stays_as_it_is(trained, meshes):
    recipe, run, _, _ = trained
    before = {path: path.read_bytes() for path in run.iterdir()}
    state = loop.train(recipe, meshes, run, device="cpu", resume=True)
    assert state.step == 6
    assert {path: path.read_bytes() for path in run.iterdir()} == before


@pytest.mark.parametrize("resume", [False, True])
def test_one_training_at_a_time_in_a_folder(meshes, small, tmp_path, resume):
    """The second leaves everything alone, and may come once the first has ended."""
    met = []

    def come_between(*told):
        if not met:
            met.append({path.name for path in (tmp_path / "run").iterdir()})
            with pytest.raises(ArgumentError, match=r"another training is at work in .*run; wait for it") as caught:
                loop.train(small(), meshes, tmp_path / "run", device="cpu", resume=True)
            assert "\n" not in str(caught.value)
            met.append({path.name for path in (tmp_path / "run").iterdir()})

    state = loop.train(small(), meshes, tmp_path / "run", device="cpu", resume=resume, progress=come_between)
    assert state.step == 6
    assert met[0] == met[1]
    assert loop.train(small(), meshes, tmp_path / "run", device="cpu", resume=True).step == 6


def test_half_precision_on_a_cpu_is_warned_of(meshes, small, tmp_path, caplog):
    loop.train(small(training={"precision": "bf16", "steps": 1}), meshes, tmp_path / "run", device="cpu")
    assert "precision is 'bf16', which is for GPUs" in caplog.text


def test_turned_shapes_and_upright_weights_are_warned_of(meshes, small, tmp_path, caplog):
    for upright, turn, warned in ((True, "any", True), (False, "any", False), (True, "vertical", False)):
        caplog.clear()
        recipe = small(upright=upright, augmentation={"turn": turn}, training={"steps": 1}, validation={"pairs": 0})
        loop.train(recipe, meshes, tmp_path / f"{upright}-{turn}", device="cpu")
        assert ("set upright = false" in caplog.text) == warned


@pytest.mark.parametrize("pre_aligned", [False, True])
def test_parts_are_scored_as_parts(meshes, small, tmp_path, monkeypatch, pre_aligned):
    shutil.copytree(meshes, tmp_path / "set")
    (tmp_path / "set" / "pairs.txt").write_text("ape,bee\ncat,dog\n")
    seen = []

    def evaluate(matcher, folder, protocol):
        seen.append(protocol)
        return evaluation.evaluate(matcher, folder, protocol)

    monkeypatch.setattr(validation, "evaluate", evaluate)
    recipe = small(partial={"pre_aligned": pre_aligned}, validation={"score_every": 6, "score_pairs": 1})
    state = loop.train(recipe, tmp_path / "set", tmp_path / "run", device="cpu")
    assert [(protocol.partial, protocol.pre_aligned) for protocol in seen] == [(True, pre_aligned)] * 2
    assert 0 <= state.records[-1]["geodesic error/mesh"] < 150


def test_training_can_begin_with_weights(trained, meshes, small, tmp_path):
    """Where it begins is where the other training ended, however it is interrupted; then it moves on."""
    recipe, run, _, _ = trained
    begun = load_weights(run / "weights.safetensors").network
    fresh = loop.train(recipe, meshes, tmp_path / "fresh", device="cpu")
    untrained = small(training={"steps": 1}, optimiser={"learning_rate": 1e-12}, network={"dropout": 0.2})
    state = loop.train(untrained, meshes, tmp_path / "one", device="cpu", weights=run / "weights.safetensors")
    for name, weight in state.network.named_parameters():
        torch.testing.assert_close(weight, dict(begun.named_parameters())[name], atol=1e-9, rtol=0)
    for name in ("a", "b"):
        state = loop.train(recipe, meshes, tmp_path / name, device="cpu", weights=run / "weights.safetensors")
    assert alike(tmp_path / "a", tmp_path / "b") and not alike(tmp_path / "a", tmp_path / "fresh")
    assert fresh.step == state.step == 6
    info = load_weights(run / "weights.safetensors").info
    report = json.loads((tmp_path / "a" / "report.json").read_text())
    assert report["started_from"] == {"name": "small", "licence": "CC0-1.0", "sha256": info.sha256}
    assert json.loads((tmp_path / "fresh" / "report.json").read_text())["started_from"] is None
    again = loop.train(recipe, meshes, tmp_path / "a", device="cpu", resume=True, weights=run / "weights.safetensors")
    assert again.step == 6 and alike(tmp_path / "a", tmp_path / "b")


def test_weights_of_another_network_or_none_at_all(trained, meshes, small, tmp_path, caplog):
    weights = trained[1] / "weights.safetensors"
    with pytest.raises(WeightsError, match=r"weights\.safetensors has width 16, but the recipe's \[network\] says 8"):
        loop.train(small(network={"width": 8}), meshes, tmp_path / "a", device="cpu", weights=weights)
    with pytest.raises(WeightsError, match="nothing"):
        loop.train(small(), meshes, tmp_path / "b", device="cpu", weights=tmp_path / "nothing.safetensors")
    for settings in ({"blocks": 3}, {"out_channels": 8}, {"gradient_product": "published"}):
        with pytest.raises(WeightsError, match=f"has {next(iter(settings))} "):
            TrainingState.new(small(network=settings), weights=weights)
    others = small(operators={"n_neighbours": 20}, training={"steps": 1}, licence="other")
    loop.train(others, meshes, tmp_path / "c", device="cpu", weights=weights)
    assert "trained with n_neighbours 14, and the recipe's [operators] say 20" in caplog.text
    assert (
        "under 'CC0-1.0', which counts for what comes of them as well; the recipe's licence is 'other'" in caplog.text
    )


def test_nothing_is_overwritten(meshes, small, tmp_path):
    (tmp_path / "file").write_text("mine")
    for run, words in ((tmp_path, "holds files already"), (tmp_path / "file", "cannot be made a folder")):
        with pytest.raises(ArgumentError, match=words):
            loop.train(small(), meshes, run, device="cpu")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_without_validation_the_latest_weights_are_kept(meshes, small, tmp_path):
    loop.train(small(validation={"pairs": 0}, training={"steps": 2}), meshes, tmp_path, device="cpu")
    assert written(tmp_path) == WRITTEN - {"best.safetensors"}
    network = load_weights(tmp_path / "weights.safetensors").network
    assert torch.equal(network.last.bias, tensors_of(tmp_path)["weights.last.bias"])


# ---- one step


def gradient_after(meshes, recipe, run, monkeypatch):
    """The gradient of the first step, before it is clipped, and its losses."""
    kept = []

    def check(self, losses, norm):
        kept.append(self.gradient.clone())

    with monkeypatch.context() as patch:
        patch.setattr(loop._Training, "_check", check)
        loop.train(recipe, meshes, run, device="cpu")
    return kept


def test_a_step_of_several_pairs_is_the_mean_of_single_ones(meshes, small, tmp_path, monkeypatch):
    """Computed here from the losses alone; the shapes are of unequal sizes."""
    recipe = small(training={"steps": 1, "pairs_per_step": 3}, clouds={"resampled": [700]}, samples={"points": 0})
    found = gradient_after(meshes, recipe, tmp_path / "run", monkeypatch)[0]
    network = TrainingState.new(recipe).network
    shapes = TrainingSet.open(meshes, recipe)
    store = loop.ShapeStore(shapes, recipe, OperatorCache.default().operators)
    loader = loop.PairLoader(store, None, [])
    expected = torch.zeros_like(found)
    for pair in loader.pairs(PairSampler(shapes, recipe).of_step(0)):
        network.zero_grad()
        losses = pair_losses(
            network,
            pair.x,
            pair.y,
            settings=recipe.loss,
            augmentation=recipe.augmentation,
            generator=torch.Generator().manual_seed(pair.sampled.seed),
        )
        losses["total"].backward()
        expected += torch.cat([weight.grad.flatten() for weight in network.parameters()]) / 3
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5 * float(expected.abs().max()))


@pytest.mark.parametrize("longest", [0.0, 1e-3, 1e6])
def test_gradients_are_clipped(meshes, small, tmp_path, monkeypatch, longest):
    recipe = small(training={"steps": 1}, optimiser={"gradient_clip": longest}, validation={"pairs": 0})
    whole = gradient_after(meshes, recipe, tmp_path / "whole", monkeypatch)[0]
    seen = []
    take = TrainingState.take_step

    def take_step(self, *given):
        seen.append(torch.cat([weight.grad.flatten() for weight in self.network.parameters()]))
        take(self, *given)

    monkeypatch.setattr(TrainingState, "take_step", take_step)
    loop.train(recipe, meshes, tmp_path / "clipped", device="cpu")
    expected = whole * min(1.0, longest / float(whole.norm())) if longest else whole
    torch.testing.assert_close(seen[0], expected)


def test_a_loss_that_is_not_finite_stops_and_names_the_pair(meshes, small, tmp_path, monkeypatch):
    recipe = small(training={"pairs_per_step": 2})
    bad = PairSampler(TrainingSet.open(meshes, recipe), recipe).of_step(3)[1]

    def losses_with_one_bad(network, x, y, **options):
        losses = pair_losses(network, x, y, **options)
        if options.get("generator") is not None and options["generator"].initial_seed() == bad.seed:
            return {**losses, "total": losses["total"] * float("nan")}
        return losses

    monkeypatch.setattr(loop, "pair_losses", losses_with_one_bad)
    with pytest.raises(TrainingError, match=f"step 4: the loss of {bad} is not finite"):
        loop.train(recipe, meshes, tmp_path / "run", device="cpu")
    last = tensors_of(tmp_path / "run")
    assert all(torch.isfinite(tensor).all() for tensor in last.values())
    assert steps_done(tmp_path / "run") == 3


# ---- stopping and going on

START = [sys.executable, "-m", "homolog", "train"]
SLOW = {"training": {"steps": 30, "pairs_per_step": 2}, "validation": {"every": 7}, "optimiser": {"average": 0.9}}


def steps_done(run):
    """Of the latest checkpoint, read in one go: safe_open opens a file twice, and another may have taken its place."""
    try:
        whole = (run / "last.safetensors").read_bytes()
    except FileNotFoundError:
        return 0
    header = json.loads(whole[8 : 8 + int.from_bytes(whole[:8], "little")])
    return json.loads(header["__metadata__"]["progress"])["step"]


def lines_but_for_progress(stderr):
    """What a command says, without the lines of progress that come every half minute on a busy machine."""
    progress = re.compile(r".*: \d+ of \d+(, about .* left)?$")
    return [line for line in stderr.splitlines() if not progress.match(line)]


def wait_for(run, step, is_alive):
    while steps_done(run) < step and is_alive():
        time.sleep(0.001)


def kill_at(step, recipe, meshes, run, *, later=0.0):
    """Train in a process of its own, and kill that once its checkpoint has so many steps, or so many seconds later."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["homolog.training.loop", "lightning_fabric", "torch.utils.tensorboard"])
    process = context.Process(
        target=loop.train, args=(recipe, meshes, run), kwargs={"device": "cpu", "resume": True}, daemon=True
    )
    process.start()
    wait_for(run, step, process.is_alive)
    time.sleep(later)
    process.kill()
    process.join()
    assert process.exitcode == -signal.SIGKILL


@pytest.mark.process
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")
@pytest.mark.parametrize("minutes", [0, 0.002])
def test_killed_twice_it_ends_as_if_it_had_not_been(meshes, small, tmp_path, minutes):
    """Right after a checkpoint, or some steps later, which are then taken again."""
    recipe = small(**{**SLOW, "training": {**SLOW["training"], "checkpoint_minutes": minutes}})
    chance = random.Random(0)
    for step in (chance.randrange(2, 9), chance.randrange(13, 20)):
        kill_at(step, recipe, meshes, tmp_path / "run", later=20 * minutes)
        assert step <= steps_done(tmp_path / "run") < 30
    state = loop.train(recipe, meshes, tmp_path / "run", device="cpu", resume=True)
    whole = loop.train(recipe, meshes, tmp_path / "whole", device="cpu")
    assert state.step == whole.step == 30
    for name in ("last", "best", "weights"):
        assert alike(tmp_path / "run", tmp_path / "whole", name)
    found, expected = ([{**record, "minutes": 0} for record in one.records] for one in (state, whole))
    assert found == expected


@pytest.mark.process
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")
def test_a_polite_stop_saves_first(meshes, as_toml, tmp_path):
    changes = {"training": {"steps": 3000, "checkpoint_minutes": 0.01}}
    (tmp_path / "long.toml").write_text(as_toml(**changes))
    run = tmp_path / "run"
    command = [*START, meshes, "-o", run, "--recipe", tmp_path / "long.toml", "--device", "cpu"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            wait_for(run, 5, lambda: process.poll() is None)
            process.send_signal(signal.SIGTERM)
            out, err = process.communicate(timeout=300)
        finally:
            process.kill()
    assert (process.returncode, out) == (143, "")
    said, last = lines_but_for_progress(err)
    step = steps_done(run)
    assert said == f"Stopped after step {step} of 3000 and saved; --resume goes on from there."
    assert last.startswith("Interrupted")
    assert json.loads((run / "report.json").read_text())["steps"] == step


@pytest.mark.process
@pytest.mark.skipif(sys.platform == "win32", reason="gloo needs other settings there")
def test_where_one_process_fails_all_do_and_the_first_one_says_it(as_toml, tmp_path, make):
    """A cloud among the meshes is found by the process that prepares it: shapes are dealt out by turns."""
    for number, faulty in enumerate(("b", "c")):
        data = tmp_path / faulty
        data.mkdir()
        for name in "abcd":
            shape = make.blob(2)
            write_shape(data / f"{name}.ply", shape.as_cloud() if name == faulty else shape)
        (tmp_path / "two.toml").write_text(as_toml(training={"pairs_per_step": 2}, validation={"pairs": 0}))
        options = [data, "-o", tmp_path / f"run{number}", "--device", "cpu", "--processes", "2"]
        ended = subprocess.run(
            [*START, *map(str, options), "--recipe", tmp_path / "two.toml"],
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )
        assert (ended.returncode, ended.stdout) == (2, "")
        told = [line for line in lines_but_for_progress(ended.stderr) if not line.startswith("[W")]
        assert len(told) == 1 and told[0].startswith("Error: ") and f"{faulty}.ply has no faces" in told[0]


@pytest.mark.process
@pytest.mark.skipif(sys.platform == "win32", reason="gloo needs other settings there")
@pytest.mark.parametrize(("steps", "tolerance"), [(1, 1e-4), (5, 0.02)])
def test_two_processes_take_the_steps_of_one(meshes, small, as_toml, tmp_path, steps, tolerance):
    """The same gradients at first; later, what rounding made of them, which Adam's first steps enlarge."""
    changes = {"training": {"steps": steps, "pairs_per_step": 4}, "validation": {"pairs": 0}, "orienter": {"steps": 2}}
    (tmp_path / "four.toml").write_text(as_toml(**changes))
    loop.train(small(**changes), meshes, tmp_path / "one", device="cpu")
    options = [meshes, "-o", tmp_path / "two", "--device", "cpu", "--processes", "2"]
    ended = subprocess.run(
        [*START, *map(str, options), "--recipe", tmp_path / "four.toml"],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines() == [str(tmp_path / "two" / "weights.safetensors")]
    assert ended.stderr.count(f"Trained {steps} steps") == 1
    assert load_weights(tmp_path / "two" / "weights.safetensors").orienter is not None
    one, two = tensors_of(tmp_path / "one"), tensors_of(tmp_path / "two")
    for name, tensor in one.items():
        if name.startswith("exp_avg."):  # a tenth of the first gradient, or a running mean of all
            assert (tensor - two[name]).norm() <= tolerance * tensor.norm(), name
    assert one["exp_avg.last.weight"].norm() > 0
