"""The examples in docstrings run, each in an empty folder with two bodies to try things on.

An example is a block of ``>>>`` in the docstring of whatever the package defines, private or not. Beside the names of
its own module it may use ``homolog``, ``np`` and ``torch``, and the files ``source.ply`` and ``target.ply``. What it
prints is compared as doctest does, with ``...`` for anything; ``# doctest: +SKIP`` is for what cannot run here.
"""

import ast
import doctest
import importlib
import inspect
import io
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

import homolog
from homolog.shapes import write_shape

ROOT = Path(homolog.__file__).parent
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


@dataclass(frozen=True)
class Documented:
    """A docstring with examples in it: of what, in which file and from which line on."""

    name: str
    path: Path
    text: str
    line: int

    @property
    def module(self):
        parts = self.path.relative_to(ROOT.parent).with_suffix("").parts
        return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def documented(node, name, path):
    """The docstrings with examples of a module, class or function and of all within it, found without importing."""
    if ">>>" in (ast.get_docstring(node) or ""):
        yield Documented(name, path, ast.get_docstring(node), node.body[0].lineno - 1)
    for child in node.body:
        if isinstance(child, ast.ClassDef | ast.FunctionDef):
            yield from documented(child, f"{name}.{child.name}", path)


def all_documented(root):
    for path in sorted(root.rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        if ">>>" in source:
            yield from documented(ast.parse(source), path.relative_to(root).with_suffix("").as_posix(), path)


EXAMPLES = list(all_documented(ROOT))


def failures(example, names):
    """What doctest says of the examples in a docstring; nothing if they print what they should."""
    parsed = doctest.DocTestParser().get_doctest(
        example.text, dict(names), example.name, str(example.path), example.line
    )
    told = io.StringIO()
    doctest.DocTestRunner(optionflags=OPTIONS, verbose=False).run(parsed, out=told.write)
    return told.getvalue()


@pytest.fixture(scope="module")
def bodies(tmp_path_factory, demo):
    folder = tmp_path_factory.mktemp("bodies")
    write_shape(folder / "source.ply", demo.amber)
    write_shape(folder / "target.ply", demo.boris)
    return folder


# Those that take longer than some five seconds.
SLOW = (
    "evaluation/runner.evaluate",
    "matching/alternatives.load_alternatives",
    "matching/in_one_call.match",
    "matching/matcher.Matcher",
    "matching/misfit.map_misfit",
    "matching/result.Match",
    "symmetries/finding.Symmetry",
    "testing/method_checks.check_method",
    "viewing/notebook.plot",
    "viewing/scene.scene_of",
)


def marked(example):
    return pytest.param(example, id=example.name, marks=[pytest.mark.slow] if example.name in SLOW else [])


@pytest.mark.parametrize("example", map(marked, EXAMPLES))
def test_examples_print_what_they_say(example, bodies, tmp_path, monkeypatch):
    shutil.copytree(bodies, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    module = importlib.import_module(example.module)
    told = failures(example, {**vars(module), "homolog": homolog, "np": np, "torch": torch})
    assert not told, told


# Names of which nothing is called have nothing to show.
CALLED = [
    name
    for name in homolog.__all__
    if inspect.isroutine(found := getattr(homolog, name))
    or (inspect.isclass(found) and not issubclass(found, BaseException))
]


@pytest.mark.parametrize("name", CALLED)
def test_every_public_name_has_an_example(name):
    assert ">>>" in (inspect.getdoc(getattr(homolog, name)) or "")


def test_examples_that_are_wrong_are_noticed(tmp_path):
    (tmp_path / "one.py").write_text(
        'def double(x):\n    """Twice.\n\n    >>> double(2)\n    5\n    """\n    return 2 * x\n'
    )
    (wrong,) = all_documented(tmp_path)
    assert wrong.name == "one.double" and "Expected:\n    5\nGot:\n    4" in failures(
        wrong, {"double": lambda x: 2 * x}
    )
    assert failures(wrong, {"double": lambda x: 5}) == ""
