"""All subcommands of ``homolog``."""

from __future__ import annotations

import typer

from homolog.cli.demo import demo
from homolog.cli.doctor import doctor
from homolog.cli.evaluate import evaluate
from homolog.cli.info import info
from homolog.cli.match import match
from homolog.cli.train import train

app = typer.Typer(
    name="homolog",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Find dense correspondences between non-rigid 3D shapes: meshes and point clouds, whole or partial.",
)
for command in (match, train, evaluate, info, doctor, demo):
    app.command()(command)
