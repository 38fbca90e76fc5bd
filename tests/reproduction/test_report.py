"""Tables of cells in Markdown: whose weights a figure is of is said once, for each row, or for each column."""

import pytest

from homolog.reproduction.cells import NO_WEIGHTS
from homolog.reproduction.experiments import Row
from homolog.reproduction.report import figure_table

ROWS = (Row(name="cats", data="blobs", paper=2.0), Row(name="dogs", data="blobs"))


def cell(mean):
    figures = {"mean": mean, "mean_without_self_pairs": None, "unit": "sqrt(area) / 100", "pairs": 2}
    return {"figures": {**figures, "self_pairs": 0, "is_whole": True, "f1": None}}


def table(**means):
    """Of cells by row, column and weights, joined by two underscores."""
    cells = {tuple(key.split("__")): cell(mean) for key, mean in means.items()}
    keys = {key: (*key[:2], NO_WEIGHTS if key[2] == "none" else key[2]) for key in cells}
    return figure_table(ROWS, {keys[key]: each for key, each in cells.items()}).splitlines()


ONE_FOR_ALL = [
    "Weights: people.",
    "",
    "|  | the paper | the paper's setting | ours |",
    "| --- | --- | --- | --- |",
    "| cats | 2.0 | 1.00 | 2.00 |",
    "| dogs |  |  | 3.00 |",
]
ONE_FOR_EACH_ROW = [
    "|  | weights | the paper | ours | axiomatic |",
    "| --- | --- | --- | --- | --- |",
    "| cats | one | 2.0 | 1.00 | 2.00 |",
    "| dogs | other |  | 3.00 |  |",
]
SEVERAL_FOR_A_ROW = [
    "|  | the paper | ours, one | ours, other |",
    "| --- | --- | --- | --- |",
    "| cats | 2.0 | 1.00 | 2.00 |",
    "| dogs |  |  | 3.00 |",
]


@pytest.mark.parametrize(
    ("means", "expected"),
    [
        ({"cats__paper__people": 1.0, "cats__ours__people": 2.0, "dogs__ours__people": 3.0}, ONE_FOR_ALL),
        ({"cats__ours__one": 1.0, "cats__axiomatic__none": 2.0, "dogs__ours__other": 3.0}, ONE_FOR_EACH_ROW),
        ({"cats__ours__one": 1.0, "cats__ours__other": 2.0, "dogs__ours__other": 3.0}, SEVERAL_FOR_A_ROW),
    ],
    ids=["one for all", "one for each row", "several for a row"],
)
def test_weights_are_told_where_they_differ(means, expected):
    assert table(**means) == expected


def test_rows_without_weights_are_in_the_columns_of_the_others():
    assert table(cats__ours__none=1.0, dogs__ours__one=3.0)[-2:] == ["| cats | 2.0 | 1.00 |", "| dogs |  | 3.00 |"]
