"""What the documentation says of recipes and losses is what the code does."""

import doctest
import importlib
import importlib.util
import re
from pathlib import Path

import pytest

from homolog.training import BUILTIN_LOSSES

ROOT = Path(__file__).parents[2]


def test_the_table_of_keys_is_up_to_date():
    spec = importlib.util.spec_from_file_location("recipe_table", ROOT / "tools" / "recipe_table.py")
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    assert tool.table() in tool.PAGE.read_text(encoding="utf-8"), "run python tools/recipe_table.py"


def test_losses_stand_in_the_documentation_with_their_default_weights():
    page = (ROOT / "docs" / "training.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| ([\d.]+) \|", page.partition("## Losses\n")[2], re.MULTILINE)
    assert len(rows) >= 7
    assert all(BUILTIN_LOSSES[name].weight == float(weight) for name, weight in rows)


@pytest.mark.parametrize(
    "module", ["core.settings", "training.loop", "training.losses", "training.recipes", "training.settings"]
)
def test_examples_in_docstrings_run(module):
    ran = doctest.testmod(importlib.import_module(f"homolog.{module}"))
    assert ran.attempted and not ran.failed
