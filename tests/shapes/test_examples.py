"""The examples of the documentation do what they say."""

import doctest
import importlib
import pkgutil

import pytest

import homolog.shapes

# The process that reads VTK files changes the search path when it is run; a module of it has no examples.
MODULES = [
    module.name
    for module in pkgutil.walk_packages(homolog.shapes.__path__, "homolog.shapes.")
    if not module.name.endswith("vtk_process")
]


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_public_functions_have_examples():
    names = ("Shape", "as_shape", "check", "demo_shapes", "read_shape", "register_format", "repair", "stand_upright")
    for name in (*names, "write_shape"):
        assert ">>>" in getattr(homolog.shapes, name).__doc__, name
