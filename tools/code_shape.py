"""Print the shape of the code: lengths of functions, helpers that are called once, docstrings, examples, types.

Run from the root of the checkout::

    python tools/code_shape.py
    python tools/code_shape.py src/homolog/maps --list

Lines of a body leave out its docstring. A helper is a private function or method. It counts as called once if its
file uses its name in one place; ``--list`` prints those of at most three lines, which are the ones to inline. Exported
is what stands in the ``__all__`` of a package.
"""

from __future__ import annotations

import argparse
import ast
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

Function = ast.FunctionDef | ast.AsyncFunctionDef
Documented = Function | ast.ClassDef

_SHORT = 3
# Decorators that leave a function one to call by its name; others, such as a command's, register it somewhere.
_PLAIN_DECORATORS = {"staticmethod", "classmethod", "property", "cached_property", "cache", "contextmanager"}


@dataclass(frozen=True)
class Definition:
    """A function, the file it is in, and how often that file uses its name."""

    path: Path
    node: Function
    uses: int

    @property
    def lines(self) -> int:
        """Lines of the body, without the docstring."""
        body = self.node.body[1:] if ast.get_docstring(self.node) else self.node.body
        return (self.node.end_lineno or 0) - body[0].lineno + 1 if body else 0

    @property
    def is_public(self) -> bool:
        """Whether its name begins with a letter."""
        return not self.node.name.startswith("_")

    @property
    def is_annotated(self) -> bool:
        """Whether all arguments and the result have types."""
        given = self.node.args
        arguments = [*given.posonlyargs, *given.args, *given.kwonlyargs]
        typed = all(each.annotation for each in arguments if each.arg not in ("self", "cls"))
        return typed and self.node.returns is not None

    @property
    def is_called_once(self) -> bool:
        """Whether it is a helper with one use, to be had by its name alone."""
        is_private = self.node.name.startswith("_") and not self.node.name.startswith("__")
        decorators = {each.id if isinstance(each, ast.Name) else "" for each in self.node.decorator_list}
        return is_private and self.uses == 1 and decorators <= _PLAIN_DECORATORS

    def __str__(self) -> str:
        return f"{self.path}:{self.node.lineno} {self.node.name}"


def definitions(root: Path) -> Iterator[Definition]:
    """All functions and methods below a folder."""
    for path in sorted(root.rglob("*.py")):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        uses = Counter(node.id for node in nodes if isinstance(node, ast.Name))
        uses += Counter(node.attr for node in nodes if isinstance(node, ast.Attribute))
        functions = [node for node in nodes if isinstance(node, Function)]
        names = Counter(node.name for node in functions)
        for node in functions:
            # Of methods of one name in several classes, uses cannot be told apart.
            yield Definition(path, node, uses[node.name] if names[node.name] == 1 else names[node.name])


def exported(root: Path) -> list[Documented]:
    """The functions and classes that stand in the ``__all__`` of a package."""
    statements = [
        (path, node) for path in root.rglob("*.py") for node in ast.parse(path.read_text(encoding="utf-8")).body
    ]
    lists = [
        ast.literal_eval(node.value)
        for path, node in statements
        if path.name == "__init__.py" and isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
    ]
    names = {name for each in lists for name in each}
    return [node for _, node in statements if isinstance(node, Documented) and node.name in names]


def share(count: int, total: int) -> str:
    """In per cent."""
    return f"{100 * count / max(total, 1):.0f} %"


def documented(kind: str, nodes: Sequence[Documented]) -> str:
    """How many of these have a docstring and an example in it."""
    texts = [ast.get_docstring(node) or "" for node in nodes]
    explained, shown = sum(map(bool, texts)), sum(">>>" in text for text in texts)
    told = f"with a docstring {share(explained, len(texts))}, with an example {share(shown, len(texts))}"
    return f"{len(texts)} {kind}: {told}"


def report(functions: list[Definition], root: Path) -> Iterator[str]:
    """The figures, a line each."""
    sizes = sorted(each.lines for each in functions)
    longest = max(functions, key=lambda each: each.lines)
    public = [each for each in functions if each.is_public]
    helpers = [each for each in functions if each.is_called_once]
    short = [each for each in helpers if each.lines <= _SHORT]
    ninetieth = sizes[int(0.9 * (len(sizes) - 1))]
    yield f"{len(sizes)} functions, lines of a body: median {median(sizes):.0f}, 90th percentile {ninetieth}"
    yield f"the longest: {longest.lines} lines, {longest}"
    yield f"helpers that are called once: {len(helpers)}, of them with at most {_SHORT} lines: {len(short)}"
    annotated = share(sum(each.is_annotated for each in public), len(public))
    yield documented("public functions and methods", [each.node for each in public]) + f", annotated {annotated}"
    yield documented("exported functions and classes", exported(root))


def main() -> None:
    """Print the report of a folder."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", default=Path("src"))
    parser.add_argument("--list", action="store_true", help=f"name helpers of at most {_SHORT} lines, called once")
    arguments = parser.parse_args()
    functions = list(definitions(arguments.folder))
    if not functions:
        parser.error(f"there is no function in any .py file below {arguments.folder}")
    for each in functions if arguments.list else ():
        if each.is_called_once and each.lines <= _SHORT:
            print(each)
    print("\n".join(report(functions, arguments.folder)))


if __name__ == "__main__":
    main()
