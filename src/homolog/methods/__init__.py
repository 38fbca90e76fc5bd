"""Ways to find point maps; each is one module of this package, or of a package that offers it."""

from typing import TYPE_CHECKING, Any

from homolog.methods.registry import AUTO, GROUP, find_method, method_names

if TYPE_CHECKING:
    from homolog.methods.protocol import FunctionMethod, Method, Supports, as_method

__all__ = ["AUTO", "GROUP", "FunctionMethod", "Method", "Supports", "as_method", "find_method", "method_names"]


def __getattr__(name: str) -> Any:
    """What a method is made of, loaded when it is first used: names of methods are known without."""
    if name in __all__:
        from homolog.methods import protocol

        return getattr(protocol, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
