"""Tables of docs/results.md that are made of cells: they are those of the cells that are kept, and of one's own."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = """# Results

Before.

<!-- cells of plain -->
an old table
<!-- end of cells -->

Between.

<!-- cells of shared -->
nobody ran this
<!-- end of cells -->
"""


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("results_tables", ROOT / "tools" / "results_tables.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_tables_of_the_page_are_those_of_the_cells_that_are_kept(tool):
    text = tool.PAGE.read_text(encoding="utf-8")
    assert tool.filled(text, tool.CELLS) == text, "run python tools/results_tables.py"
    marked = set(re.findall(r"<!-- cells of (\w+) -->", text))
    assert marked == {folder.name for folder in tool.CELLS.iterdir() if folder.is_dir()}


def test_a_table_has_the_rows_that_somebody_ran(tool, ready):
    found = tool.filled(PAGE, ready)
    start, _, rest = PAGE.partition("an old table\n")
    assert found.startswith(start)
    assert found.endswith(rest)
    table = found.removeprefix(start).removesuffix(rest)
    rows = [line.split(" | ") for line in table.splitlines() if line.startswith("| blobs")]
    assert [row[:2] for row in rows] == [["| blobs, mesh", "2.0"], ["| blobs, noisy cloud", ""]]
    assert all(re.match(r"\d+\.\d\d / \d+\.\d\d", figure) for row in rows for figure in row[2:4])
    assert "gone" not in table
    assert tool.filled(found, ready) == found
