"""Ways to find point maps; each is one module of this package, or of a package that offers it.

A name is imported when it is first used: the names of methods are known without PyTorch.
"""

from typing import TYPE_CHECKING

from homolog.core.lazy import lazy_names

if TYPE_CHECKING:
    from homolog.methods.protocol import FunctionMethod, as_method
    from homolog.methods.registry import AUTO, GROUP, find_method, method_names
    from homolog.pairs import Method, Supports

__all__ = ["AUTO", "GROUP", "FunctionMethod", "Method", "Supports", "as_method", "find_method", "method_names"]

_MODULES = {
    "AUTO": "registry",
    "GROUP": "registry",
    "FunctionMethod": "protocol",
    "Method": "protocol",
    "Supports": "protocol",
    "as_method": "protocol",
    "find_method": "registry",
    "method_names": "registry",
}
__getattr__ = lazy_names(__name__, _MODULES)
