"""A folder of shapes: its splits, pairs and ground truth, and what can be wrong with it."""

import itertools
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from homolog.core.errors import ArgumentError, DataError
from homolog.datasets import ShapeFolder, drawn_pairs, read_description
from homolog.shapes import write_shape


@pytest.fixture
def folder(tmp_path, make):
    """Four spheres d, a, c, b with some template points."""
    root = tmp_path / "set"
    (root / "off").mkdir(parents=True)
    (root / "corres").mkdir()
    for radius, name in enumerate("dacb", 1):
        write_shape(root / "off" / f"{name}.off", make.sphere(1, radius=radius))
        (root / "corres" / f"{name}.vts").write_text("1\n42\n7\n7\n")
    return root


def many(root, n):
    """A folder of n names; the files are empty, as only their names are asked for."""
    for below, suffix in (("off", "off"), ("corres", "vts")):
        (root / below).mkdir(parents=True, exist_ok=True)
        for number in range(n):
            (root / below / f"shape{number:03d}.{suffix}").touch()
    return ShapeFolder.open(root)


def test_names_shapes_and_template_points(folder):
    found = ShapeFolder.open(str(folder))
    assert found.names == ("a", "b", "c", "d")
    assert found.root == folder
    assert found.shape("c").n_points == 42
    assert np.linalg.norm(found.shape("c").points[0]) == pytest.approx(3)
    assert found.template_correspondence("c").tolist() == [0, 41, 6, 6]
    assert found.template_correspondence("c").dtype == np.int64


def test_one_common_point_is_enough(folder):
    (folder / "corres" / "a.vts").write_text("5\n")
    assert ShapeFolder.open(folder).template_correspondence("a").tolist() == [4]


def test_a_home_folder(folder, monkeypatch):
    monkeypatch.setenv("HOME", str(folder.parent))
    assert ShapeFolder.open("~/set").root == folder


def test_the_bundled_bodies(demo_folder):
    assert ShapeFolder.open(demo_folder).names == ("amber", "boris")


@pytest.mark.parametrize(("n", "n_train"), [(25, 5), (100, 80), (21, 1)])
def test_the_last_twenty_are_for_testing(tmp_path, n, n_train):
    found = many(tmp_path, n)
    assert found.split("train") == found.names[:n_train]
    assert found.split("test") == found.names[n_train:]
    assert len(found.split("test")) == 20
    assert found.split("all") == found.names
    assert len(found.pairs("test")) == 400


def test_small_sets_are_for_testing_alone(tmp_path):
    found = many(tmp_path, 20)
    assert found.split("test") == found.names
    with pytest.raises(DataError, match=r"no shapes in split 'train'; list them in .*train\.txt, or use split 'all'"):
        found.split("train")


def test_split_files(folder):
    (folder / "train.txt").write_text("d\na\n")
    (folder / "test.txt").write_text("c\n\n")
    found = ShapeFolder.open(folder)
    assert found.split("train") == ("d", "a")
    assert found.split("test") == ("c",)
    assert found.split("all") == tuple("abcd")
    assert found.pairs("train") == (("d", "d"), ("d", "a"), ("a", "d"), ("a", "a"))


def test_without_lists_all_ordered_pairs_and_self_pairs(folder):
    assert ShapeFolder.open(folder).pairs("test") == tuple(itertools.product("abcd", repeat=2))


def test_pairs_txt(folder):
    (folder / "pairs.txt").write_text("b,a\n\n c , d \na,a\n")
    found = ShapeFolder.open(folder)
    assert found.pairs("test") == found.pairs("all") == (("b", "a"), ("c", "d"), ("a", "a"))
    assert found.split("test") == tuple("abcd")
    with pytest.raises(DataError, match="no shapes in split 'train'"):
        found.pairs("train")


def test_pairs_txt_with_split_files(folder):
    (folder / "pairs.txt").write_text("b,a\nc,d\nd,a\n")
    (folder / "test.txt").write_text("a d")
    (folder / "train.txt").write_text("c")
    found = ShapeFolder.open(folder)
    assert found.pairs("test") == (("d", "a"),)
    assert found.pairs("all") == (("b", "a"), ("c", "d"), ("d", "a"))
    with pytest.raises(DataError, match="lists no pair with both shapes in split 'train'"):
        found.pairs("train")


def test_a_list_of_pairs_overrides_the_split(folder):
    (folder / "pairs.txt").write_text("b,a\n")
    (folder / "test.txt").write_text("a")
    own = folder.parent / "own.csv"
    own.write_text("d,c\nc,d\n")
    assert ShapeFolder.open(folder).pairs("test", listed=own) == (("d", "c"), ("c", "d"))
    assert ShapeFolder.open(folder).pairs("train", listed=str(own)) == (("d", "c"), ("c", "d"))


def message(call):
    with pytest.raises(DataError) as caught:
        call()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_parts_lack_some_template_points(folder):
    (folder / "corres" / "a.vts").write_text("5\n-1\n7\n")
    assert ShapeFolder.open(folder).template_correspondence("a").tolist() == [4, -1, 6]


@pytest.mark.parametrize("opened", [ShapeFolder.open, ShapeFolder.without_truth])
def test_no_folder(tmp_path, opened):
    (tmp_path / "a.off").touch()
    assert message(lambda: opened(tmp_path / "nix")) == f"there is no folder {tmp_path / 'nix'}"
    assert message(lambda: opened(tmp_path / "a.off")) == f"{tmp_path / 'a.off'} is a file; give the folder"


def test_no_shapes(tmp_path):
    said = message(lambda: ShapeFolder.open(tmp_path))
    assert "no shapes; put them at" in said
    assert "NAME.off" in said


def test_missing_ground_truth_says_which_file_goes_where(folder):
    (folder / "corres" / "c.vts").unlink()
    (folder / "corres" / "b.vts").unlink()
    said = message(lambda: ShapeFolder.open(folder))
    assert "2 of 4 shapes have no ground truth" in said
    assert str(folder / "corres" / "b.vts") in said


@pytest.mark.parametrize(
    "content",
    [b"", b"\n", b"1\n0\n", b"-3\n", b"one\n", b"1 2\n3 4\n", b"1.5\n", b"\xff\xfe\x00", b"9" * 30, b"1\nnan\n"],
)
def test_ground_truth_that_is_no_list_of_vertices(folder, content, recwarn):
    (folder / "corres" / "a.vts").write_bytes(content)
    said = message(lambda: ShapeFolder.open(folder).template_correspondence("a"))
    assert "a.vts must hold a vertex number a line" in said
    assert not recwarn.list


def test_unknown_names_in_lists(folder):
    found = ShapeFolder.open(folder)
    (folder / "test.txt").write_text("a\nzebra\n")
    said = message(lambda: found.split("test"))
    assert "test.txt names 'zebra'" in said
    assert "zebra.off" in said
    own = folder / "own.txt"
    own.write_text("a,yak\n")
    assert "own.txt names 'yak'" in message(lambda: found.pairs("test", listed=own))


@pytest.mark.parametrize("content", [b"", b" \n\n", b"\xff\xfe\xff"])
def test_split_files_without_names(folder, content):
    (folder / "test.txt").write_bytes(content)
    assert "test.txt" in message(lambda: ShapeFolder.open(folder).pairs("test"))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a,b\nc\n", "line 2: 'c' must be SOURCE,TARGET"),
        (b"a,b,c\n", "line 1: 'a,b,c' must be SOURCE,TARGET"),
        (b"a b\n", "line 1: 'a b' must be SOURCE,TARGET"),
        (b"\n\n", "lists no pairs"),
        (b"", "lists no pairs"),
        (b"\xff\xfe", "there is no such list of pairs"),
        (b"a,\n", "names ''"),
    ],
)
def test_malformed_lists_of_pairs(folder, content, said):
    own = folder / "own.txt"
    own.write_bytes(content)
    assert said in message(lambda: ShapeFolder.open(folder).pairs("all", listed=own))


def test_a_list_of_pairs_that_is_not_there(folder):
    found = ShapeFolder.open(folder)
    assert "there is no such list of pairs" in message(lambda: found.pairs("all", listed=folder / "gone.txt"))
    assert "there is no such list of pairs" in message(lambda: found.pairs("all", listed=folder))


def test_a_split_that_is_none(folder):
    with pytest.raises(ArgumentError, match=r"split is 'tset'.*did you mean 'test'"):
        ShapeFolder.open(folder).split("tset")


# ---- pairs drawn at random


def test_drawn_pairs_of_a_set_as_large_as_the_benchmarks(tmp_path):
    pairs = many(tmp_path, 25).pairs("test")
    drawn = drawn_pairs(pairs, 20, seed=0)
    assert len(set(drawn)) == 20
    assert set(drawn) < set(pairs)
    assert all(source != target for source, target in drawn)
    assert list(drawn) == sorted(drawn)
    for side in (0, 1):
        assert len({pair[side] for pair in drawn}) > 10
    assert drawn == drawn_pairs(reversed(pairs), 20, seed=0)[::-1] == drawn_pairs([*pairs, *pairs], 20, seed=0)
    assert set(drawn) < set(drawn_pairs(pairs, 30, seed=0))
    assert len(set(drawn) & set(drawn_pairs(pairs, 20, seed=1))) < 8


def test_drawn_pairs_stay_the_same_for_ever():
    """Of ``printf '3 a,b' | sha256sum`` and so on, a,b, b,c and c,a give the smallest."""
    pairs = list(itertools.product("abc", repeat=2))
    assert drawn_pairs(pairs, 3, seed=3) == (("a", "b"), ("b", "c"), ("c", "a"))


def test_every_pair_is_drawn_about_as_often():
    pairs = list(itertools.product("abcde", repeat=2))
    counts = Counter(pair for seed in range(1000) for pair in drawn_pairs(pairs, 5, seed=seed))
    assert len(counts) == 20
    assert all(190 < count < 310 for count in counts.values())


@pytest.mark.parametrize("count", [0, -1, 7])
def test_more_pairs_than_there_are(count):
    with pytest.raises(ArgumentError, match=rf"n_pairs is {count}, but must be from 1 to the number of .*, 6"):
        drawn_pairs(itertools.product("abc", repeat=2), count, seed=0)


def test_a_folder_is_shown_in_one_line(tmp_path):
    folder = many(tmp_path, 25)
    assert repr(folder) == f"ShapeFolder({str(tmp_path)!r}: 25 shapes, y up)"
    assert " of faust_r, y up)" in repr(replace(folder, description=read_description("faust_r")))
