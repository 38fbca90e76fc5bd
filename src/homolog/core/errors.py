"""Errors that a user can cause, each one line that says what is wrong and what to do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

from homolog.core.messages import one_line, shown


class HomologError(Exception):
    """Base of all errors that a user can cause: a mistake in what was given to Homolog, not in Homolog itself.

    The message is one line: the file or argument, what was found, what is allowed, what to do. The command line
    prints it without a traceback and exits with code 2.

    Examples:
        >>> import homolog
        >>> try:
        ...     homolog.set_working_memory(-1)
        ... except homolog.HomologError as error:
        ...     print(error)
        working memory is -1, but must be a positive number of mebibytes
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class ArgumentError(HomologError, ValueError):
    """An argument or option has a value that is not allowed."""


class UndeterminedError(ArgumentError):
    """What is given does not determine a functional map."""


class ShapeError(HomologError, ValueError):
    """A shape, or the file it comes from, cannot be used."""


class WeightsError(HomologError, ValueError):
    """A weight file cannot be read or does not fit the network."""


class DataError(HomologError, ValueError):
    """A folder of shapes, a list of pairs or a ground-truth file is not as it should be."""


class TrainingError(HomologError, RuntimeError):
    """A training cannot go on: a loss is not finite, or a checkpoint does not fit."""


class MissingExtraError(HomologError, ImportError):
    """An optional package is needed; the message names the extra that brings it."""

    def __init__(self, need: str, package: str, extra: str) -> None:
        self._given = need, package, extra
        super().__init__(
            f"{need} needs the package {package}, which is not installed; run: pip install 'homolog[{extra}]'"
        )

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str, str, str]]:
        """What it was made of, so that a worker's error can be raised in the process that waits for it."""
        return type(self), self._given


@contextmanager
def needs_extra(need: str, extra: str) -> Iterator[None]:
    """Around imports of an optional package: name the extra that installs it, and what needs it, if it is missing.

    Raises:
        MissingExtraError: if a package is missing.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingExtraError(need, str(error.name).partition(".")[0], extra) from None


def bad_choice(name: str, found: Any, allowed: Sequence[str], hint: str = "") -> ArgumentError:
    """Build the error for a word that is not among those allowed, with the nearest one as a suggestion.

    Args:
        name: the argument as the caller wrote it.
        found: its value.
        allowed: the words.
        hint: what else to do.
    """
    near = get_close_matches(str(found), allowed, n=1)
    guess = f"; did you mean {near[0]!r}?" if near else ""
    tail = f"; {hint}" if hint else ""
    return ArgumentError(f"{name} is {shown(found)}, but must be one of {', '.join(allowed)}{guess}{tail}")


def bad_value(name: str, found: Any, allowed: str) -> ArgumentError:
    """Build the error for a value outside its range: ``name`` is ``found``, but must be ``allowed``."""
    return ArgumentError(f"{name} is {shown(found)}, but must be {allowed}")
