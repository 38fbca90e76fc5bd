"""What ``--help`` says of a command, from its docstring."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any


def help_of(command: Callable[..., Any]) -> str:
    """The docstring with each paragraph on one line, so that it wraps where the terminal ends; examples stay."""
    paragraphs = inspect.cleandoc(command.__doc__ or "").split("\n\n")
    return "\n\n".join(_joined(paragraph) for paragraph in paragraphs)


def _joined(paragraph: str) -> str:
    lines = paragraph.split("\n")
    laid_out = any(line.startswith(" ") for line in lines)
    return paragraph if laid_out else " ".join(lines)
