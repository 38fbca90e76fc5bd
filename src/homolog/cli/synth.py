"""``homolog synth``: shapes made for training and tests."""

from __future__ import annotations

import typer

from homolog.cli.synth_people import people

synth = typer.Typer(name="synth", no_args_is_help=True, help="Make shapes for training and tests, with ground truth.")


@synth.callback()
def _synth() -> None:
    """Make shapes for training and tests, with ground truth."""


for command in (people,):
    synth.command()(command)
