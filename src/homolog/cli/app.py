"""All subcommands of ``homolog``."""

from __future__ import annotations

from typing import Annotated

import typer

from homolog.cli.collection import collection
from homolog.cli.data import data
from homolog.cli.demo import demo
from homolog.cli.doctor import doctor
from homolog.cli.evaluate import evaluate
from homolog.cli.help import help_of
from homolog.cli.info import info
from homolog.cli.match import match
from homolog.cli.reconstruct import reconstruct
from homolog.cli.serve import serve
from homolog.cli.synth import synth
from homolog.cli.train import train
from homolog.cli.transfer import transfer
from homolog.cli.view import view
from homolog.cli.volume import volume
from homolog.core.versions import version_of

app = typer.Typer(
    name="homolog",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def _print_version(*, asked: bool) -> None:
    if asked:
        typer.echo(f"homolog {version_of('homolog')}")
        raise typer.Exit


@app.callback()
def homolog(
    *,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    """Find dense correspondences between non-rigid 3D shapes: meshes and point clouds, whole or partial."""


for command in (match, view, serve, transfer, collection, train, evaluate, reconstruct, info, doctor, demo):
    app.command()(command)
for group in (synth, volume, data):
    app.add_typer(group)
for each in (app, synth, volume, data):
    for registered in each.registered_commands:
        if registered.callback:
            registered.help = help_of(registered.callback)
