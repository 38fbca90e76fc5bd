"""The names of methods: those in the package, and those that installed packages offer, without importing any."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path
from pkgutil import iter_modules

from homolog.core.plugins import offered

GROUP = "homolog.methods"
"""The group of entry points."""
AUTO = "auto"
"""Stands for the method that suits the shapes and their features."""

_FOLDER = Path(__file__).parents[1] / "methods"
_NOT_METHODS = ("protocol", "registry")


def method_names() -> tuple[str, ...]:
    """Names of all methods, ``"auto"`` first.

    Examples:
        >>> from homolog.methods import method_names
        >>> "functional-map" in method_names()
        True
    """
    return (AUTO, *own_methods(), *offered_methods())


def own_methods() -> dict[str, str]:
    """Name and module of the methods in the package: each module has one, called ``METHOD``."""
    modules = [module.name for module in iter_modules([str(_FOLDER)]) if module.name not in _NOT_METHODS]
    return {name.replace("_", "-"): f"homolog.methods.{name}" for name in modules}


def offered_methods() -> dict[str, EntryPoint]:
    """Name and entry point of the methods of installed packages."""
    return offered(GROUP, (AUTO, *own_methods()))
