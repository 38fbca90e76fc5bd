"""How the figures of a run join those of earlier ones."""

import importlib.util
import json
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "benchmarks" / "bench.py"
if not SCRIPT.is_file():
    pytest.skip("the benchmarks are not beside the tests", allow_module_level=True)


@pytest.fixture(scope="module")
def bench():
    spec = importlib.util.spec_from_file_location("bench", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def kept(path):
    return {(row["name"], row["points"]): row["yardsticks"] for row in json.loads(path.read_text())}


def test_figures_of_one_step_leave_the_others(bench, tmp_path):
    path = tmp_path / "latest.json"
    bench.keep([bench.row("features", 5000, 1.0, 0.5, 100), bench.row("features", 20000, 2.0, 0.5, 100)], path)
    bench.keep([bench.row("cloud_map", 5000, 3.0, 0.5, 100), bench.row("features", 5000, 1.0, 0.25, 100)], path)
    # Each figure is in the yardstick of its own run.
    assert kept(path) == {("features", 5000): 4, ("features", 20000): 4, ("cloud_map", 5000): 6}
    rows = json.loads(path.read_text())
    assert isinstance(rows, list)
    assert all(set(row) == {"name", "points", "seconds", "yardsticks", "peak_mb"} for row in rows)
    assert [file.name for file in tmp_path.iterdir()] == ["latest.json"]
