"""What --help shows."""

import pytest

from homolog.cli.app import app
from homolog.cli.help import help_of


def test_paragraphs_are_lines_and_examples_stay_as_they_are():
    def command():
        """Do something.

        With a sentence that is
        broken where the code ends.

        Examples:
          homolog command a.ply \\
            b.ply
        """

    assert help_of(command) == (
        "Do something.\n\nWith a sentence that is broken where the code ends.\n\n"
        "Examples:\n  homolog command a.ply \\\n    b.ply"
    )


@pytest.mark.parametrize("group", ["", "synth", "volume", "data"])
def test_every_command_has_it(group):
    groups = {
        "": app,
        **{one.name or one.typer_instance.info.name: one.typer_instance for one in app.registered_groups},
    }
    commands = groups[group].registered_commands
    assert commands
    for one in commands:
        assert one.help == help_of(one.callback) and one.help
