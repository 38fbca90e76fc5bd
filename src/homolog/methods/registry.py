"""Finding methods by name: those in this package, and those that installed packages offer.

A package offers a method by an entry point of the group ``homolog.methods`` that leads to a ``Method``, or to a
function of a ``Pair``. Names are found without loading any of them.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

from homolog.core.errors import ArgumentError, bad_choice
from homolog.core.method_names import AUTO, GROUP, method_names, offered_methods, own_methods
from homolog.core.plugins import described, fault

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from homolog.pairs import Method

__all__ = ["AUTO", "GROUP", "find_method", "method_names"]


def find_method(name: str) -> Any:
    """The method of a name.

    A function that a package offers is called as its entry point is, whatever its own name.

    Raises:
        ArgumentError: if there is none, the package that offers it cannot be loaded, or it is called otherwise itself.
    """
    own, others = own_methods(), offered_methods()
    if name in own:
        return import_module(own[name]).METHOD
    if name not in others:
        raise bad_choice("method", name, method_names())
    try:
        loaded = others[name].load()
    except Exception as error:  # the cause tells whoever writes the package where it is
        found = f"{described(others[name])} cannot be loaded ({fault(error)})"
        raise ArgumentError(f"{found}; mend or uninstall it, or choose another method") from error
    return _called(name, loaded, others[name])


def _called(name: str, loaded: Any, point: EntryPoint) -> Method:
    """A method by the name of its entry point: reports and the command would disagree otherwise."""
    from homolog.methods.protocol import FunctionMethod, as_method

    method = as_method(loaded)
    if method.name != name and isinstance(method, FunctionMethod):
        return replace(method, name=name)
    if method.name != name:
        raise ArgumentError(f"{described(point)} leads to a method that is called {method.name!r}; call both alike")
    return method
