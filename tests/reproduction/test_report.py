"""Tables of cells in Markdown: whose weights a figure is of is said once, for each row, or for each column."""

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


def test_weights_of_all_rows_are_said_once():
    found = table(cats__paper__people=1.0, cats__ours__people=2.0, dogs__ours__people=3.0)
    assert found == [
        "Weights: people.",
        "",
        "|  | the paper | the paper's setting | ours |",
        "| --- | --- | --- | --- |",
        "| cats | 2.0 | 1.00 | 2.00 |",
        "| dogs |  |  | 3.00 |",
    ]


def test_rows_of_other_weights_have_one_column_together():
    found = table(cats__ours__one=1.0, cats__axiomatic__none=2.0, dogs__ours__other=3.0)
    assert found == [
        "|  | weights | the paper | ours | axiomatic |",
        "| --- | --- | --- | --- | --- |",
        "| cats | one | 2.0 | 1.00 | 2.00 |",
        "| dogs | other |  | 3.00 |  |",
    ]


def test_a_row_of_several_weights_has_a_column_for_each():
    found = table(cats__ours__one=1.0, cats__ours__other=2.0, dogs__ours__other=3.0)
    assert found == [
        "|  | the paper | ours, one | ours, other |",
        "| --- | --- | --- | --- |",
        "| cats | 2.0 | 1.00 | 2.00 |",
        "| dogs |  |  | 3.00 |",
    ]


def test_rows_without_weights_are_in_the_columns_of_the_others():
    assert table(cats__ours__none=1.0, dogs__ours__one=3.0)[-2:] == ["| cats | 2.0 | 1.00 |", "| dogs |  | 3.00 |"]
