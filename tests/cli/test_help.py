"""What --help shows."""

import re

import pytest
import typer
from typer.main import get_command

from homolog.cli.app import app
from homolog.cli.lazy import command_of, help_of, lazy_group
from homolog.cli.wording import in_options, speak_of


def commands_below(group, words=()):
    """Each command of a group, and of the groups in it, with the words that call it."""
    for name in group.commands:
        command = group.commands[name]
        yield from (
            commands_below(command, (*words, name)) if hasattr(command, "commands") else [((*words, name), command)]
        )


COMMANDS = dict(commands_below(get_command(app)))


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


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_has_help_with_examples_of_itself(words):
    said = COMMANDS[words].help
    assert said.split("\n\n")[0].endswith(".")
    examples = re.findall(r"^  homolog .*", said, flags=re.MULTILINE)
    assert any(example.startswith(f"  homolog {' '.join(words)}") for example in examples)


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_the_names_of_options_are_the_same_everywhere(words):
    for param in COMMANDS[words].params:
        if param.name == "output":
            assert param.opts == ["--output", "-o"]
        if param.param_type_name == "argument" and param.name == "data":
            assert param.metavar == "DATA"
        if param.name == "result":
            assert param.metavar == "RESULT"
        if "--json" in param.opts:
            assert (param.metavar, param.is_flag) == ("FILE", False)
        if "-n" in param.opts:
            assert param.opts[0].startswith("--n-")


GROUPS = ["Input", "Method", "Partial shapes", "Output", "Other"]


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_groups_of_options_have_one_order(words):
    shown = list(dict.fromkeys(getattr(param, "rich_help_panel", None) for param in COMMANDS[words].params))
    known = [GROUPS.index(group) for group in shown if group in GROUPS]
    assert known == sorted(known)
    assert "Other" not in shown[:-1]


def test_examples_give_options_that_exist():
    for words, command in COMMANDS.items():
        known = {option for param in command.params for option in (*param.opts, *param.secondary_opts)} | {"--help"}
        for example in re.findall(rf"^  homolog {' '.join(words)} .*", command.help, flags=re.MULTILINE):
            given = set(re.findall(r"(?<!\S)--?[a-z][\w-]*", example.partition("|")[0]))
            assert given <= known, (example, given - known)


def test_flags_show_no_value_and_options_stand_in_groups(homolog):
    shown = homolog("match", "--help")
    assert shown.code == 0 and "<bool>" not in shown.out
    groups = re.findall(r"^╭─ (.*?) ─", shown.out, flags=re.MULTILINE)
    assert groups == ["Arguments", "Input", "Method", "Partial shapes", "Output", "Other"]
    assert "<bool>" not in homolog("--help").out


def test_a_group_imports_a_command_when_it_is_looked_up():
    group = get_command(
        typer.Typer(
            cls=lazy_group(there="homolog.cli.doctor:doctor", gone="no_such_module:command"), callback=lambda: None
        )
    )
    assert list(group.commands) == group.list_commands(None) == ["there", "gone"]
    assert group.commands["there"].help == help_of(__import__("homolog.cli.doctor").cli.doctor.doctor)
    assert group.commands["there"] is group.commands["there"]
    with pytest.raises(ModuleNotFoundError):
        group.commands["gone"]


def test_a_command_is_its_function_with_its_docstring(capsys):
    def greet(name: str, loud: bool = typer.Option(False, "--loud")) -> None:
        """Greet somebody."""
        print(name.upper() if loud else name)

    command = command_of("greet", greet)
    command(["you", "--loud"], standalone_mode=False)
    assert capsys.readouterr().out == "YOU\n"
    assert (command.name, command.help) == ("greet", "Greet somebody.")


def test_words_of_the_library_are_told_as_options_of_the_command_that_runs(monkeypatch):
    monkeypatch.setattr("homolog.cli.wording._options", {})
    told = "look at both (Matcher.alternatives), or trust the files (orient='given')"
    assert in_options(told) == told
    speak_of(COMMANDS["match",].params)
    assert in_options(told) == "look at both (--alternatives), or trust the files (--orient given)"
