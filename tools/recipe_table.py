"""Writes the table of a recipe's keys into docs/training.md, from the settings and their docstrings.

python tools/recipe_table.py
"""

from __future__ import annotations

import inspect
import re
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Any, get_type_hints

from homolog.core.settings import described
from homolog.training import Recipe
from homolog.training.settings import PartialSettings

PAGE = Path(__file__).parents[1] / "docs" / "training.md"
# What the table stands between.
START, END = "### All keys\n\n", "\n`homolog.training.Recipe.json_schema()`"


def table() -> str:
    """The table in Markdown: a row for each key, under the section that it belongs to."""
    sections = {field.name: type(getattr(Recipe(), field.name)) for field in fields(Recipe)} | {
        "partial": PartialSettings
    }
    rows = ["| key | default | allowed | meaning |", "|---|---|---|---|"]
    rows += _rows(Recipe, [name for name, kind in sections.items() if not is_dataclass(kind)])
    for name, kind in sections.items():
        if is_dataclass(kind):
            rows.append(f"| **`[{name}]`** | | | {_sentence(inspect.getdoc(kind) or '')} |")
            rows += _rows(kind, [field.name for field in fields(kind) if field.name != "weights"])
    return "\n".join(rows) + "\n"


def _rows(settings: Any, names: list[str]) -> list[str]:
    hints, explained = get_type_hints(settings, include_extras=True), _arguments(settings)
    return [
        f"| `{field.name}` | {_default(field)} | {described(hints[field.name])} | {explained[field.name]} |"
        for field in fields(settings)
        if field.name in names
    ]


def _default(field: Field[Any]) -> str:
    value = field.default if field.default_factory is MISSING else field.default_factory()
    if value is None or value == {}:
        return "absent"
    text = {True: "true", False: "false"}[value] if isinstance(value, bool) else repr(value).replace("'", '"')
    return f"`{'[' + text[1:-1].rstrip(',') + ']' if isinstance(value, tuple) else text}`"


def _arguments(settings: type) -> dict[str, str]:
    """What a docstring, and those of the settings that it extends, say of each argument."""
    texts = [inspect.cleandoc(kind.__doc__ or "").partition("Args:\n")[2] for kind in settings.__mro__]
    arguments = r"^    (\w+): (.*(?:\n {8}.*)*)"
    found = [each for text in texts for each in re.findall(arguments, text.partition("\n\n")[0], re.MULTILINE)]
    return {name: " ".join(said.replace("``", "`").split()).replace("|", "\\|") for name, said in found}


def _sentence(text: str) -> str:
    first = text.partition("\n\n")[0].partition(". ")[0]
    return " ".join(first.replace("``", "`").split()).rstrip(".")


def main() -> None:
    """Put the table where it belongs."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(START)
    PAGE.write_text(before + START + table() + END + rest.partition(END)[2], encoding="utf-8")


if __name__ == "__main__":
    main()
