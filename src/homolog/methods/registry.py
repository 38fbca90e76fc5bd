"""Finding methods by name: those in this package, and those that installed packages offer.

A package offers a method by an entry point of the group ``homolog.methods`` that leads to a ``Method``, or to a
function of a ``Pair``. Names are found without loading any of them.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from homolog.core.errors import ArgumentError, bad_choice
from homolog.core.plugins import described, fault, offered

GROUP = "homolog.methods"
"""The group of entry points."""
AUTO = "auto"
"""Stands for the method that suits the shapes and their features."""

_NOT_METHODS = ("protocol", "registry")


def method_names() -> tuple[str, ...]:
    """Names of all methods, ``"auto"`` first.

    Examples:
        >>> from homolog.methods import method_names
        >>> "functional-map" in method_names()
        True
    """
    own = (AUTO, *_own())
    return (*own, *offered(GROUP, own))


def find_method(name: str) -> Any:
    """The method of a name.

    Raises:
        ArgumentError: if there is none, or the package that offers it cannot be loaded.
    """
    own = _own()
    others = offered(GROUP, (AUTO, *own))
    if name in own:
        return import_module(own[name]).METHOD
    if name not in others:
        raise bad_choice("method", str(name), method_names())
    try:
        return others[name].load()
    except Exception as error:  # the cause tells whoever writes the package where it is
        found = f"{described(others[name])} cannot be loaded ({fault(error)})"
        raise ArgumentError(f"{found}; mend or uninstall it, or choose another method") from error


def _own() -> dict[str, str]:
    """Name and module of the methods in this package: each module has one, called ``METHOD``."""
    package = __name__.rpartition(".")[0]
    path = import_module(package).__path__
    modules = [module.name for module in iter_modules(path) if module.name not in _NOT_METHODS]
    return {name.replace("_", "-"): f"{package}.{name}" for name in modules}
