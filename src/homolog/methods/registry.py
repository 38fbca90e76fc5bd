"""Finding methods by name: those in this package, and those that installed packages offer.

A package offers a method by an entry point of the group ``homolog.methods`` that leads to a ``Method``, or to a
function of a ``Pair``. Names are found without loading any of them.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from homolog.core.errors import ArgumentError, bad_choice
from homolog.core.method_names import AUTO, GROUP, method_names, offered_methods, own_methods
from homolog.core.plugins import described, fault

__all__ = ["AUTO", "GROUP", "find_method", "method_names"]


def find_method(name: str) -> Any:
    """The method of a name.

    Raises:
        ArgumentError: if there is none, or the package that offers it cannot be loaded.
    """
    own, others = own_methods(), offered_methods()
    if name in own:
        return import_module(own[name]).METHOD
    if name not in others:
        raise bad_choice("method", name, method_names())
    try:
        return others[name].load()
    except Exception as error:  # the cause tells whoever writes the package where it is
        found = f"{described(others[name])} cannot be loaded ({fault(error)})"
        raise ArgumentError(f"{found}; mend or uninstall it, or choose another method") from error
