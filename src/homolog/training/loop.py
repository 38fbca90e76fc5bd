"""The training loop: pairs, gradients, steps, validation and checkpoints."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.core.cluster import Cluster
from homolog.core.ends import end_with_parent
from homolog.core.errors import ArgumentError, TrainingError, needs_extra
from homolog.core.files import expanded
from homolog.core.memory import keep_freed_memory
from homolog.core.progress import Progress, ignore
from homolog.datasets import DatasetDescription
from homolog.features import DiffusionNet
from homolog.geometry import OperatorCache
from homolog.matching import Matcher
from homolog.pairs import Device, MatcherSettings, OperatorSource, choose_device
from homolog.training.data import TrainingSet
from homolog.training.distributed import is_started_by_another, process_group, shared_errors
from homolog.training.interrupts import Interrupts, deferred_interrupts
from homolog.training.lending import lender_of, lent_orienter
from homolog.training.losses import TOTAL, Loss
from homolog.training.objective import losses_of, pair_losses
from homolog.training.orienter import train_orienter
from homolog.training.pairs import PairLoader, TrainingPair
from homolog.training.prefetch import prefetched
from homolog.training.run_folder import RunFolder, weights_info
from homolog.training.sampling import PairSampler
from homolog.training.schedule import learning_rate
from homolog.training.settings import Recipe, TrainingSettings
from homolog.training.state import Record, TrainingState
from homolog.training.store import ShapeStore, keep_operators
from homolog.training.training_log import TrainingLog
from homolog.training.validation import scores, validation_losses

if TYPE_CHECKING:
    from lightning_fabric import Fabric

_log = logging.getLogger(__name__)


def train(
    recipe: Recipe,
    data: str | Path,
    run: str | Path,
    *,
    losses: Sequence[Loss] = (),
    description: DatasetDescription | None = None,
    resume: bool = False,
    weights: str | Path | None = None,
    device: Device = "auto",
    processes: int = 1,
    machines: int = 1,
    cluster: Cluster | None = None,
    operators: OperatorSource | None = None,
    progress: Progress | None = None,
) -> TrainingState:
    """Train a network on a folder of meshes, without any ground truth.

    Cao and Bernard, "Self-Supervised Learning for Multimodal Non-Rigid 3D Shape Matching", CVPR 2023.

    With several processes this starts the others itself, by the command that started this one; every one computes some
    of a step's pairs, and all take the step with the mean gradient. Ctrl-C and SIGTERM save a checkpoint first. After
    the last step the first process finds the orienter, where the weights have none yet: pretrained weights that know
    the shapes lend theirs, see ``lent_orienter``, or else it is trained, see ``train_orienter``.

    Args:
        recipe: what to do.
        data: a folder; see ``TrainingSet.open``.
        run: the folder to write; see ``RunFolder``.
        losses: of one's own, beside those of the recipe.
        description: of the dataset in ``data``; by default the folder is one's own.
        resume: go on from the latest checkpoint in ``run``, or begin where there is none.
        weights: to start from, a file or the name of pretrained ones; random ones by default. Ignored with ``resume``
            where there is a checkpoint.
        device: where to compute.
        processes: on each machine; with GPUs, one for each.
        machines: on each of which the same command runs.
        cluster: whose workers compute the operators of all shapes first, into a cache that they and this machine see.
        operators: where operators come from; by default the cache on disk.
        progress: called with what is done.

    Returns:
        The state after the last step.

    Raises:
        ArgumentError: if ``run`` holds files and ``resume`` is not given, another training is at work in it, or a loss
            cannot be used.
        DataError: if ``data`` has too few shapes.
        ShapeError: if a shape cannot be used.
        TrainingError: if a loss is not finite, or the checkpoint does not fit the recipe or the data.
        WeightsError: if there are no such weights, or they are of another network than the recipe's; likewise of those
            that are to lend an orienter.
        MissingExtraError: without the packages of the extra ``train``.

    Examples:
        With a loss of one's own beside the recipe's, a function of some of the ``QUANTITIES`` of a pair:

        >>> from homolog.training import Loss, read_recipe, train
        >>> def small_maps(c_xy, c_yx):
        ...     return c_xy.square().mean() + c_yx.square().mean()
        >>> mine = Loss("small_maps", 0.5, requires={"c_xy", "c_yx"}, function=small_maps)
        >>> state = train(read_recipe("quick"), "scans", "run", losses=[mine])  # doctest: +SKIP
    """
    recipe = recipe.for_dataset(description)
    objective = losses_of(recipe.loss, losses)
    if recipe.upright and recipe.augmentation.turn == "any":
        _log.warning(
            "upright is true, though [augmentation] turn is 'any'; set upright = false for shapes in any pose."
        )
    lender_of(recipe)  # a wrong name is refused before anything is done
    shapes = TrainingSet.open(data, recipe, description)
    folder = RunFolder(expanded(run), recipe, shapes, tuple(losses))
    fabric = _fabric(recipe.training, device, processes, machines)
    with contextlib.ExitStack() as until_the_end:
        source = operators or OperatorCache.default().operators
        if is_first_process():
            folder.make(resume=resume)
            until_the_end.enter_context(folder.held())
            if recipe.data.align:  # before there are others, which would wait
                folder.align(source, progress or ignore, weights=weights)
            if cluster is not None:  # before there are others, likewise
                rotations = folder.rotations()
                keep_operators(shapes, recipe, source, cluster, rotations=rotations, progress=progress or ignore)
        fabric.launch()
        if is_started_by_another():
            end_with_parent(os.getppid())
        until_the_end.enter_context(process_group())
        report = progress if progress is not None and fabric.is_global_zero else ignore
        with shared_errors():
            store = ShapeStore(shapes, recipe, source, fabric.device, rotations=folder.rotations())
            state = folder.load(fabric.device, weights=weights)
        if state.step < recipe.training.steps:
            with shared_errors():
                store.prepare(shapes.used[fabric.global_rank :: fabric.world_size], report)
            keep_freed_memory()
            with deferred_interrupts() as interrupts:
                _Training(fabric, folder, store, objective, state, report).run(interrupts)
        elif fabric.is_global_zero and not folder.last.is_file():  # the weights that it starts from, as they are
            folder.save_last(state)
        if fabric.is_global_zero and folder.lacks_orienter():
            _add_orienter(folder, store, state, report)
        return state


def is_first_process() -> bool:
    """Whether this is the process that reports and writes, or the only one."""
    _fabric_package()
    from lightning_fabric.utilities.rank_zero import rank_zero_only

    return getattr(rank_zero_only, "rank", 0) == 0


def _fabric_package() -> type[Fabric]:
    logging.getLogger("lightning_fabric").setLevel(logging.WARNING)
    with needs_extra("training", "train"):
        import filelock  # noqa: F401
        import tensorboard  # noqa: F401
        from lightning_fabric import Fabric
    return Fabric


def _fabric(settings: TrainingSettings, device: Device, processes: int, machines: int) -> Fabric:
    kind = choose_device(device).type
    if kind == "cuda" and processes > torch.cuda.device_count():
        raise ArgumentError(
            f"processes is {processes}, but CUDA devices are {torch.cuda.device_count()}; use as many, or --device cpu"
        )
    if kind == "cpu" and settings.precision == "bf16":
        _log.warning("[training] precision is 'bf16', which is for GPUs: here it is coarser and saves no time.")
    return _fabric_package()(
        accelerator=kind,
        devices=processes,
        num_nodes=machines,
        strategy="auto" if processes * machines == 1 else "ddp",
        precision="bf16-mixed" if settings.precision == "bf16" else "32-true",
    )


def _add_orienter(folder: RunFolder, store: ShapeStore, state: TrainingState, progress: Progress) -> None:
    """Find or train the orienter that the weights lack, and write it into them and into the report."""
    settings, names = folder.recipe.orienter, folder.shapes.trained
    told: dict[str, float | str]
    try:
        lent = lent_orienter(store, names, progress=progress)
        orienter, told = (None, {}) if lent is None else (lent.orienter, lent.described())
        if lent is not None:
            _log.info("The orienter is that of the weights %r (misfit %.3f).", lent.lender, lent.misfit)
        if orienter is None or settings.lent_steps:
            how = settings if lent is None else replace(settings, steps=settings.lent_steps)
            seed = folder.recipe.seed
            orienter, loss = train_orienter(store, names, how, start=orienter, seed=seed, progress=progress)
            told |= {"steps": how.steps, "loss": loss}
    except BaseException as error:
        if not isinstance(error, Exception):  # Ctrl-C and the like
            _log.warning("Stopped before the orienter was trained; --resume trains it.")
        raise
    folder.add_orienter(orienter.to(torch.device("cpu")), lender=lent.lender if lent else "")
    folder.save_report(state, torch.device(store.device), orienter=told)


class _Training:
    """The part of a training that one process does."""

    def __init__(
        self,
        fabric: Fabric,
        folder: RunFolder,
        store: ShapeStore,
        losses: Sequence[Loss],
        state: TrainingState,
        progress: Progress,
    ) -> None:
        self.fabric, self.folder, self.store, self.state, self.progress = fabric, folder, store, state, progress
        self.recipe, self.losses = folder.recipe, losses
        self.terms = (*(loss.name for loss in losses), TOTAL)
        self.loader = PairLoader(store, self.recipe.partial, losses)
        self.sampler = PairSampler(folder.shapes, self.recipe)
        self.gradient = _flat_gradient(state.network)
        self.clock = self.saved = time.monotonic()
        self.log = TrainingLog(folder.path, self.terms, state.step) if fabric.is_global_zero else None

    def run(self, interrupts: Interrupts) -> None:
        """Take the steps that are left, until the last one or an interrupt."""
        steps = range(self.state.step, self.recipe.training.steps)
        pairs_of_steps = prefetched(self._load, steps, workers=self.recipe.data.workers)
        with contextlib.closing(self), contextlib.closing(pairs_of_steps):
            if self.log is not None:
                if self.state.step == 0 and self.state.started_from:
                    self._save()  # resumed from here, it knows what it started from
                self._validate_if_due()  # an interrupt is saved at once, and may leave this undone
            for _ in steps:
                stopped = self._step(pairs_of_steps, interrupts)
                if self.log is not None:
                    self._after_step(stopped)
                if stopped:
                    break

    def close(self) -> None:
        """Write out what TensorBoard still holds."""
        if self.log is not None:
            self.log.close()

    # ---- one step

    def _load(self, step: int) -> list[TrainingPair]:
        """The share of a step's pairs that falls to this process."""
        return self.loader.pairs(self.sampler.of_step(step)[self.fabric.global_rank :: self.fabric.world_size])

    def _step(self, pairs_of_steps: Iterator[list[TrainingPair]], interrupts: Interrupts) -> bool:
        """Take one step; whether any process was interrupted."""
        with shared_errors():
            losses = self._gradients(next(pairs_of_steps))
        stopped = self._share(losses, bool(interrupts))
        norm = self.gradient.norm()
        self._check(losses, norm)
        if longest := self.recipe.optimiser.gradient_clip:
            self.gradient.mul_((longest / norm.clamp(min=longest)).clamp(max=1.0))
        rate = learning_rate(self.recipe.optimiser, self.state.step, self.recipe.training.steps)
        self.state.take_step(rate, self.recipe.optimiser.average)
        if self.log is not None:
            self.log.step(self.state.step, losses, norm, rate)
        return stopped

    def _gradients(self, pairs: Sequence[TrainingPair]) -> Float[Tensor, "p t"]:
        """Put this share of the mean gradient into the network; losses of the step's pairs, those of others zero."""
        self.gradient.zero_()
        n_pairs = self.recipe.training.pairs_per_step
        values = torch.zeros(n_pairs, len(self.terms), device=self.fabric.device)
        for place, pair in zip(range(self.fabric.global_rank, n_pairs, self.fabric.world_size), pairs, strict=True):
            losses = self._losses(pair)
            torch.autograd.backward(losses[TOTAL] / n_pairs)
            values[place] = torch.stack([value.detach() for value in losses.values()])
        return values

    def _losses(self, pair: TrainingPair) -> dict[str, Tensor]:
        generator = torch.Generator(self.fabric.device).manual_seed(pair.sampled.seed)
        with self.fabric.autocast():
            return pair_losses(
                self.state.network,
                pair.x,
                pair.y,
                settings=self.recipe.loss,
                losses=self.losses,
                augmentation=self.recipe.augmentation,
                generator=generator,
                partial=self.recipe.partial is not None,
                registration_targets=pair.registration_targets,
                features_from=self.recipe.input,
            )

    def _share(self, losses: Float[Tensor, "p t"], stop: bool) -> bool:
        """Add up gradients and losses of all processes, in place; whether any is to stop."""
        if self.fabric.world_size == 1:
            return stop
        stops = torch.tensor(float(stop), device=self.fabric.device)
        for tensor in (self.gradient, losses, stops):
            self.fabric.all_reduce(tensor, reduce_op="sum")
        return bool(stops)

    def _check(self, losses: Float[Tensor, "p t"], norm: Tensor) -> None:
        """Every process sees the same numbers here, so that all of them stop."""
        if bool(torch.isfinite(losses).all() & torch.isfinite(norm)):
            return
        sampled = self.sampler.of_step(self.state.step)
        bad = [pair for pair, row in zip(sampled, losses, strict=True) if not bool(torch.isfinite(row).all())]
        what = "loss" if bad else "gradient"
        pairs = ", ".join(map(str, bad or sampled))
        raise TrainingError(
            f"step {self.state.step + 1}: the {what} of {pairs} is not finite; lower [optimiser] learning_rate, "
            "or look at these shapes with homolog info"
        )

    # ---- between steps, in the first process

    def _after_step(self, stopped: bool) -> None:
        """Validate and save where that is due, and report progress."""
        self._count_time()
        step, steps = self.state.step, self.recipe.training.steps
        self.progress(step, steps, "training")
        if not stopped or step == steps:
            self._validate_if_due()
        waited = self.clock - self.saved >= 60 * self.recipe.training.checkpoint_minutes
        if waited or stopped or step == steps:
            self._save()
        if stopped and step < steps:
            _log.warning("Stopped after step %d of %d and saved; --resume goes on from there.", step, steps)

    def _validate_if_due(self) -> None:
        watched, records = self.recipe.validation, self.state.records
        scored = self._is_due(watched.score_every)
        done = self.state.step == 0 or (records and records[-1]["step"] == self.state.step)
        if watched.pairs and not done and (scored or self._is_due(watched.every)):
            self._validate(scored=scored)
            self._count_time()

    def _is_due(self, every: int) -> bool:
        """Whether this is one of every so many steps, or the last one; never if ``every`` is 0."""
        return every > 0 and (self.state.step % every == 0 or self.state.step == self.recipe.training.steps)

    def _count_time(self) -> None:
        now = time.monotonic()
        self.state.seconds += now - self.clock
        self.clock = now

    def _save(self) -> None:
        self.folder.save_last(self.state)
        self.folder.save_report(self.state, self.fabric.device)
        self.saved = self.clock

    def _validate(self, *, scored: bool) -> None:
        """Record the validation losses and scores, and save the network if it is the best so far."""
        self.progress(self.state.step, self.recipe.training.steps, "validating")
        network = self.state.result()
        pairs, partial = self.loader.pairs(self.sampler.held_out()), self.recipe.partial is not None
        losses = validation_losses(
            network, pairs, self.recipe.loss, self.losses, partial=partial, features_from=self.recipe.input
        )
        found = {f"validation/{term}": value for term, value in losses.items()}
        if scored:
            found |= {f"geodesic error/{way}": error for way, error in self._scores(network).items()}
        self._note(found)
        if losses[TOTAL] < (math.inf if self.state.best is None else self.state.best):
            self.state.best = losses[TOTAL]
            self.folder.save_best(self.state)

    def _note(self, found: dict[str, float]) -> None:
        finite = {name: value for name, value in found.items() if math.isfinite(value)}  # JSON knows no other numbers
        record: Record = {"step": self.state.step, "minutes": self.state.seconds / 60, **finite}
        self.state.records.append(record)
        if self.log is not None:
            self.log.scalars(self.state.step, found)
        _log.info("step %d: %s", self.state.step, ", ".join(f"{name} {value:.4g}" for name, value in found.items()))

    def _scores(self, network: DiffusionNet) -> dict[str, float]:
        truth = self.folder.shapes.truth
        if truth is None:
            return {}
        matcher = Matcher(
            network,
            weights_info(self.recipe),
            settings=MatcherSettings(operators=self.recipe.operators),
            device="cuda" if self.fabric.device.type == "cuda" else "cpu",
            operators=self.store.operators,
        )
        held_out = self.folder.shapes.held_out[: self.recipe.validation.score_pairs]
        pairs = [self.loader.full_first(pair) for pair in held_out]
        listed = self.folder.path / "scored-pairs.txt"
        return scores(matcher, truth, pairs, listed, partial=self.recipe.partial, rotations=self.store.rotations)


def _flat_gradient(network: DiffusionNet) -> Float[Tensor, " w"]:
    """One vector of which the gradients of all weights become views, so that it is added up and clipped as one."""
    weights = list(network.parameters())
    sizes = [weight.numel() for weight in weights]
    flat = torch.zeros(sum(sizes), device=weights[0].device)
    for weight, part in zip(weights, torch.split(flat, sizes), strict=True):
        weight.grad = part.view_as(weight)
    return flat
