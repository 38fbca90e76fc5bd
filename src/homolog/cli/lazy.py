"""Commands that are imported when they run or when their help is asked for."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, MutableMapping
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from homolog.cli.wording import speak_of
from homolog.core.errors import HomologError, bad_choice, bad_value
from homolog.core.files import PATH_NEEDED, keeping

OTHER = "Other"
"""The last group of options in a command's help."""


class Command(TyperCommand):
    """A command whose flags show no type, as they take no value, and whose ``--help`` stands with its other options."""

    def get_params(self, ctx: Any) -> list[Any]:
        """All parameters, ``--help`` included."""
        params = _without_types_of_flags(super().get_params(ctx))
        params[-1].rich_help_panel = OTHER
        return params

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments.

        Raises:
            ArgumentError: if one that names a file or folder is empty, which would be taken for the current folder.
        """
        given = list(args)
        try:
            left: list[str] = super().parse_args(ctx, args)
        except Exception as error:
            # The parser does not tell of every mistake in which command it was made, whose help shows what is right.
            if getattr(error, "ctx", ctx) is None:
                error.ctx = ctx  # type: ignore[attr-defined]
            raise
        texts, _, _ = self.make_parser(ctx).parse_args(args=given)
        for param in () if ctx.resilient_parsing else self.params:
            empty = "" in _listed(texts.get(param.name))
            if empty and any(_names_files(param, one) for one in _listed(ctx.params[param.name])):
                name = param.opts[0] if param.opts[0].startswith("-") else str(param.metavar).rstrip(".")
                raise bad_value(name, "", PATH_NEEDED)
        return left

    def invoke(self, ctx: Any) -> Any:
        """Run it."""
        speak_of(self.params)
        with keeping(inputs_of(self.params, ctx.params)):
            return super().invoke(ctx)


OUTPUTS = ("output", "page", "picture", "json", "csv", "plot", "field", "distances", "table", "point_map", "particles")
"""The parameters of commands that name what is written; all others that name files, name what is read."""


def inputs_of(params: list[Any], values: dict[str, Any]) -> Iterator[Path]:
    """The files and folders that a command reads, by its parameters; a name may be that of a file as well."""
    for param in params:
        for one in _listed(values.get(param.name)):
            if _names_files(param, one) and param.name not in OUTPUTS:
                yield Path(one)
                yield from _beside(one) if isinstance(one, Path) else ()


def _listed(value: Any) -> list[Any]:
    """The values of a parameter, which takes one or several."""
    return list(value) if isinstance(value, list | tuple) else [value]


def _names_files(param: Any, value: Any) -> bool:
    """Whether a value of a parameter is the path of a file or folder, or may be one."""
    return isinstance(value, Path) or (isinstance(value, str) and "FILE" in (param.metavar or ""))


def _beside(path: Path) -> tuple[Path, ...]:
    """The other files that a shape is read from; what is wrong with it, the command tells."""
    from homolog.shapes import files_of_shape

    try:
        return files_of_shape(path)[1:] if path.suffix else ()
    except (HomologError, OSError, ValueError):
        return ()


def _without_types_of_flags(params: list[Any]) -> list[Any]:
    for param in params:
        if getattr(param, "is_flag", False):
            param.metavar = ""
    return params


class _Commands(MutableMapping[str, Any]):
    """The commands of a group by name; each is imported when it is looked up."""

    def __init__(self, targets: dict[str, str]) -> None:
        self._targets, self._loaded = targets, dict[str, Any]()

    def __getitem__(self, name: str) -> Any:
        if name not in self._loaded:
            module, _, function = self._targets[name].partition(":")
            self._loaded[name] = command_of(name, getattr(import_module(module), function))
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._targets)

    def __len__(self) -> int:
        return len(self._targets)

    def __setitem__(self, name: str, command: Any) -> None:
        self._loaded[name] = command

    def __delitem__(self, name: str) -> None:
        del self._targets[name]


def lazy_group(**targets: str) -> type[TyperGroup]:
    """The class of a group of commands.

    Args:
        targets: for each command, or group of commands, its ``module:name``.
    """

    class LazyGroup(TyperGroup):
        def __init__(self, **settings: Any) -> None:
            super().__init__(**{**settings, "commands": {}})
            self.commands = _Commands(targets)

        def list_commands(self, ctx: Any) -> list[str]:
            return list(self.commands)

        def get_params(self, ctx: Any) -> list[Any]:
            return _without_types_of_flags(super().get_params(ctx))

        def resolve_command(self, ctx: Any, args: list[str]) -> Any:
            if args[0] not in self.commands and not args[0].startswith("-"):
                raise bad_choice(f"the command after {ctx.command_path!r}", args[0], self.list_commands(ctx))
            return super().resolve_command(ctx, args)

    return LazyGroup


def lazy_typer(name: str, *, help: str, **targets: str) -> typer.Typer:
    """A group of commands below ``homolog``; see ``lazy_group``."""
    return typer.Typer(
        name=name,
        cls=lazy_group(**targets),
        callback=lambda: None,  # without commands or a callback it would be no group
        add_completion=False,
        no_args_is_help=True,
        help=help,
    )


def command_of(name: str, function: Callable[..., Any] | typer.Typer) -> Any:
    """The command that runs a function, with its docstring as help; or the group that a Typer is."""
    if isinstance(function, typer.Typer):
        return typer.main.get_command(function)
    alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="rich")
    alone.command(name, cls=Command, help=help_of(function))(function)
    return typer.main.get_command(alone)


def help_of(function: Callable[..., Any]) -> str:
    """The docstring with each paragraph on one line, so that it wraps where the terminal ends; examples stay."""
    paragraphs = [paragraph.split("\n") for paragraph in inspect.cleandoc(function.__doc__ or "").split("\n\n")]
    laid_out = [any(line.startswith(" ") for line in lines) for lines in paragraphs]
    return "\n\n".join(("\n" if kept else " ").join(lines) for lines, kept in zip(paragraphs, laid_out, strict=True))
