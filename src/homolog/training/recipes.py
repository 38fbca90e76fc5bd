"""Recipes: TOML files of a training's settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from homolog.core.errors import bad_choice, bad_value
from homolog.core.files import expanded
from homolog.core.settings import read_settings, read_toml
from homolog.training.settings import LossSettings, Recipe

# In the package where it is installed, in the root of the repository where it is not.
_BUILTIN = (Path(__file__).parent / "recipes", Path(__file__).parents[3] / "recipes")


def read_recipe(recipe: str | Path, changes: Mapping[str, Any] | None = None) -> Recipe:
    """Read a recipe from a TOML file, or a built-in one by its name.

    Args:
        recipe: the file, or the name.
        changes: values to use instead of those in the file, by ``"section.key"``, or ``"key"`` of none.

    Raises:
        ArgumentError: if there is no such recipe, or it is not as it should be; one line with file, section and key.

    Examples:
        >>> from homolog.training import read_recipe
        >>> read_recipe("quick").training.steps
        5000
        >>> read_recipe("quick", {"training.steps": 100, "loss.infonce": 0.0}).training.steps
        100
    """
    path = find_recipe(recipe)
    table = read_toml(path)
    for name, value in (changes or {}).items():
        _change(table, name, value)
    return recipe_from(table, str(path))


def _change(table: dict[str, Any], name: str, value: Any) -> None:
    """Set one value of a recipe's nested tables, by the names of its sections and its own, with dots between."""
    *sections, key = name.split(".")
    for section in sections:
        table = table.setdefault(section, {})
        if not isinstance(table, dict):
            raise bad_value("a change", name, "section.key, where the section is one of a recipe")
    table[key] = value


def recipe_from(table: Mapping[str, Any], where: str) -> Recipe:
    """A recipe from nested tables; ``where`` they come from is for messages."""
    loss = table.get("loss")
    if isinstance(loss, Mapping):  # keys that are no settings are weights
        settings = {field.name for field in fields(LossSettings)} - {"weights"}
        weights = {key: value for key, value in loss.items() if key not in settings}
        others = {key: value for key, value in loss.items() if key in settings}
        table = {**table, "loss": {**others, "weights": weights}}
    return read_settings(Recipe, table, f"{where}:")


def find_recipe(recipe: str | Path) -> Path:
    """The file of a recipe that a user named: a path, or the name of a built-in one.

    Raises:
        ArgumentError: if there is neither.
    """
    path = expanded(recipe)
    if path.is_file():
        return path
    builtin = builtin_recipes()
    if str(recipe) in builtin:
        return builtin[str(recipe)]
    raise bad_choice("recipe", str(recipe), list(builtin), "or give the path of a TOML file")


def builtin_recipes() -> dict[str, Path]:
    """Name and file of the built-in recipes."""
    return {file.stem: file for folder in _BUILTIN for file in sorted(folder.glob("*.toml"))}
