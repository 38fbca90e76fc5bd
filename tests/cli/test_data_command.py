"""``homolog data``: lists for people and for pipes, what is known of a set, and what is wrong with a folder."""

import pytest
from rich.console import Console

from homolog.datasets import builtin_descriptions
from homolog.shapes import write_shape


@pytest.fixture
def own(tmp_path, make):
    """Two shapes with common points."""
    root = tmp_path / "own"
    (root / "off").mkdir(parents=True)
    (root / "corres").mkdir()
    for name in "ab":
        write_shape(root / "off" / f"{name}.off", make.sphere(1))
        (root / "corres" / f"{name}.vts").write_text("1\n42\n")
    return root


def test_list_is_plain_where_it_is_piped(homolog):
    ended = homolog("data", "list")
    assert (ended.code, ended.err) == (0, "")
    head, *rows = [line.split("\t") for line in ended.out.splitlines()]
    assert head == ["name", "title", "shapes", "truth", "terms"]
    assert [row[0] for row in rows] == [one.name for one in builtin_descriptions()]
    assert next(row for row in rows if row[0] == "scape_r")[2:4] == ["71", "template-correspondence"]


def test_list_is_a_table_on_a_terminal(homolog, monkeypatch):
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setattr("rich.console.Console", lambda: Console(force_terminal=True, width=200))
    out = homolog("data", "list").out
    assert "┃ name" in out and "│ shrec16_holes" in out and "\t" not in out


@pytest.mark.parametrize("name", [one.name for one in builtin_descriptions()])
def test_show_says_where_to_get_it_and_on_which_terms(homolog, name):
    ended = homolog("data", "show", name)
    described = next(one for one in builtin_descriptions() if one.name == name)
    assert (ended.code, ended.err) == (0, "")
    shown = "".join(character for character in ended.out if character not in "│\n ")
    for text in (described.title, described.source, described.terms, described.citation):
        assert text.replace(" ", "") in shown


def test_show_shrec19(homolog):
    shown = homolog("data", "show", "SHREC19").out
    assert "listed, 407; test without 40" in shown and "off/*.off, 44" in shown


def test_check_a_good_folder(homolog, own):
    ended = homolog("data", "check", "own", own)
    assert (ended.code, ended.err) == (0, "")
    assert ended.out.splitlines()[0] == f"own at {own}: nothing is missing or wrong"
    rows = " ".join(ended.out.split())
    for words in (
        "shapes │ 2 │",
        "points │ 42 │",
        "points with ground truth │ 2 │",
        "split 'test' │ 2 shapes, 4 pairs │",
    ):
        assert words in rows
    quiet = homolog("data", "check", "own", own, "--quiet")
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")


def test_check_says_each_fault_in_a_line(homolog, own):
    (own / "corres" / "a.vts").unlink()
    (own / "corres" / "b.vts").write_text("43\n")
    ended = homolog("data", "check", "own", own)
    assert ended.code == 2
    assert ended.err.splitlines() == [
        f"Error: put a.vts at {own / 'corres' / 'a.vts'}",
        f"Error: {own / 'corres' / 'b.vts'} names vertex 43, but the shape has 42",
    ]
    assert "2 findings" in ended.out.splitlines()[0]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["faust_r", "gone"], "there is no folder gone; put the dataset there; get it from the link FAUST"),
        (["faust", "gone"], "did you mean 'faust_"),
        (["gone.toml", "."], "gone.toml cannot be read"),
    ],
)
def test_mistakes_are_one_line(homolog, arguments, said):
    ended = homolog("data", "check", *arguments)
    assert ended.is_one_line_of_complaint(), ended
    assert said in ended.err
