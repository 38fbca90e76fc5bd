"""``homolog train``: weights from a folder of meshes."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.lazy import OTHER
from homolog.cli.options import (
    Changes,
    DatasetOption,
    DeviceOption,
    Quiet,
    Verbose,
    changes_of,
    cluster_of,
    set_verbosity,
)
from homolog.cli.progress import progress_bar
from homolog.core.errors import HomologError
from homolog.core.files import expanded, refuse_overwriting_inputs, resuming


def train(
    data: Annotated[
        Path,
        typer.Argument(
            metavar="DATA", help="Folder of meshes, or one with off/ and perhaps corres/.", show_default=False
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="RUN",
            help="Folder for checkpoints and weights; new, or empty.",
            show_default=False,
        ),
    ],
    recipe: Annotated[
        str, typer.Option("--recipe", metavar="NAME|FILE", help="A built-in recipe, or a TOML file.")
    ] = "quick",
    changes: Changes = None,
    dataset: DatasetOption = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from RUN's last checkpoint, or begin where there is none.")
    ] = False,
    weights: Annotated[
        str | None,
        typer.Option(
            "--weights",
            metavar="NAME|FILE",
            help="Start from these weights instead of random ones: fewer shapes and steps are then enough. "
            "Ignored with --resume.",
        ),
    ] = None,
    device: DeviceOption = "auto",
    processes: Annotated[int, typer.Option(help="Processes on each machine; with GPUs, one for each.", min=1)] = 1,
    machines: Annotated[int, typer.Option(help="Machines, on each of which this same command runs.", min=1)] = 1,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ray|ADDRESS",
            help="Compute the operators of all shapes first in a Ray cluster, into the cache: ray for one of this "
            "machine, or the address of one whose machines all see the cache and DATA. Needs the extra cluster.",
            show_default=False,
            rich_help_panel=OTHER,
        ),
    ] = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Train a network on meshes, or on clouds, without any ground truth.

    Writes RUN/weights.safetensors (for match and evaluate), RUN/last.safetensors and RUN/best.safetensors
    (checkpoints), RUN/report.json, and curves for TensorBoard. Ctrl-C saves first, and --resume goes on from there.
    With --dataset, the test shapes that its description names are left out, and the axis that points up and where
    partial shapes lie are as it says, unless the recipe says so itself.

    Examples:
      homolog train FAUST_r -o run

      homolog train FAUST_r -o run --dataset faust_r --recipe faust

      homolog train lungs -o run --recipe organs

      homolog train scans -o run --recipe my_recipe.toml --resume

      homolog train FAUST_r -o run --recipe faust --set training.steps=2000 --set loss.infonce=0

      homolog train scans -o run --weights trained_on_others.safetensors

      tensorboard --logdir run
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    settings = homolog.training.read_recipe(recipe, changes_of(changes))
    description = None if dataset is None else homolog.datasets.read_description(dataset)
    first = homolog.training.is_first_process()
    goes_on = resume and homolog.training.is_begun(expanded(output))
    try:
        with resuming(output) if goes_on else nullcontext(), progress_bar(quiet=quiet or not first) as progress:
            refuse_overwriting_inputs([output / name for name in homolog.training.RUN_FILES])
            state = homolog.training.train(
                settings,
                data,
                output,
                description=description,
                resume=resume,
                weights=weights,
                device=device,
                processes=processes,
                machines=machines,
                cluster=cluster_of(cluster),
                progress=progress,
            )
    except HomologError:
        if first:
            raise
        # The first process says it. It must have the time: one that sees those it started fail ends at once, killed.
        raise typer.Exit(0 if homolog.training.is_started_by_another() else 2) from None
    if first and not quiet:
        typer.echo(f"Trained {state.step} steps in {state.seconds / 60:.1f} minutes.", err=True)
        made = expanded(output) / homolog.training.WEIGHTS
        if lender := homolog.load_weights(made).info.lender:
            typer.echo(f"The orienter is from the weights {lender!r}.", err=True)
        typer.echo(made)
