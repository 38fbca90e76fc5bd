"""``homolog synth``: shapes made for training and tests."""

from __future__ import annotations

import typer

from homolog.cli.synth_part import part
from homolog.cli.synth_people import people
from homolog.cli.synth_views import views

synth = typer.Typer(name="synth", no_args_is_help=True, help="Make shapes for training and tests, with ground truth.")

for command in (people, views, part):
    synth.command()(command)
