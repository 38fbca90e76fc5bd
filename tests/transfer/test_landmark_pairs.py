"""Landmark files of two shapes, in all formats, as pairs."""

import json
import re

import numpy as np
import pytest

from homolog.core.errors import ArgumentError, DataError
from homolog.transfer import read_landmark_pairs

POINTS = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]


def markups(path, labels, *, system="LPS", undefined=()):
    points = [
        {"label": label, "position": point, "positionStatus": "undefined" if label in undefined else "defined"}
        for label, point in zip(labels, POINTS, strict=False)
    ]
    path.write_text(json.dumps({"markups": [{"coordinateSystem": system, "controlPoints": points}]}))
    return path


def fcsv(path, labels):
    rows = [
        f"{n},{x},{y},{z},0,0,0,1,1,1,0,{label},,"
        for n, (label, (x, y, z)) in enumerate(zip(labels, POINTS, strict=False))
    ]
    path.write_text("\n".join(["# CoordinateSystem = RAS", *rows]) + "\n")
    return path


def table(path, labels):
    rows = [f"{label},{x},{y},{z}" for label, (x, y, z) in zip(labels, POINTS, strict=False)]
    path.write_text("\n".join(["name,x,y,z", *rows]) + "\n")
    return path


def test_names_pair_markups_and_fcsv(tmp_path):
    first = markups(tmp_path / "a.mrk.json", ["nose", "tail", "ear"])
    found = read_landmark_pairs(first, fcsv(tmp_path / "b.fcsv", ["ear", "nose", "chin"]))
    assert found.names == ("nose", "ear")
    assert found.source == ((1, 2, 3), (7, 8, 9))
    assert found.target == ((4, 5, 6), (1, 2, 3))
    assert found.left_out == ("tail", "chin")
    assert found.axes == ("LPS", "RAS")


def test_axes_that_are_given_are_those_of_the_shapes(tmp_path):
    first = markups(tmp_path / "a.mrk.json", ["nose"])
    found = read_landmark_pairs(first, fcsv(tmp_path / "b.fcsv", ["nose"]), axes="LPS")
    assert (found.source, found.target, found.axes) == (((1, 2, 3),), ((-1, -2, 3),), (None, None))


def test_a_landmark_that_is_undefined_is_left_out(tmp_path):
    first = markups(tmp_path / "a.mrk.json", ["nose", "tail"], undefined=["tail"])
    found = read_landmark_pairs(first, markups(tmp_path / "b.mrk.json", ["nose", "tail"]))
    assert (found.names, found.left_out) == (("nose",), ("tail",))


@pytest.mark.parametrize("header", ["", "name,x,y,z\n"])
def test_tables_with_names_are_paired_by_them(tmp_path, header):
    (tmp_path / "a.csv").write_text(header + "nose,1,2,3\ntail,4,5,6\n")
    (tmp_path / "b.csv").write_text(header + "tail,7,8,9\nnose,1,1,1\n")
    found = read_landmark_pairs(tmp_path / "a.csv", tmp_path / "b.csv")
    assert found.names == ("nose", "tail")
    assert found.target == ((1, 1, 1), (7, 8, 9))


def test_others_are_paired_by_their_order(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,z\n1,2,3\n4,5,6\n7,8,9\n")
    (tmp_path / "b.txt").write_text("10\n-1\n# the nose\n12\n13\n")
    found = read_landmark_pairs(tmp_path / "a.csv", tmp_path / "b.txt")
    assert found.source == ((1, 2, 3), (7, 8, 9))
    assert found.target == (10, 12)
    assert found.left_out == ("2", "4")


@pytest.mark.parametrize("values", [np.array([5, 6, 7]), np.array([5, 6, 7], dtype=np.uint16), np.array(POINTS)])
def test_arrays_of_indices_or_positions(tmp_path, values):
    np.save(tmp_path / "a.npy", values)
    found = read_landmark_pairs(tmp_path / "a.npy", tmp_path / "a.npy", uncertainty=0.5)
    np.testing.assert_array_equal(found.source, values)
    assert found.uncertainties == (0.5, 0.5, 0.5)


@pytest.mark.parametrize("labels", [["p0", "p0", "p1"], ["F", "F", "F"]])
@pytest.mark.parametrize("write", [markups, fcsv, table])
@pytest.mark.parametrize("is_target", [False, True])
def test_names_that_occur_twice_are_refused(tmp_path, labels, write, is_target):
    """They would pair landmarks by their order though the names say otherwise."""
    names = {markups: "a.mrk.json", fcsv: "a.fcsv", table: "a.csv"}
    files = [write(tmp_path / names[write], labels), markups(tmp_path / "b.mrk.json", ["p0", "p1", "p2"])]
    if write is fcsv and len({*labels}) == 1:  # as Slicer labels all, while their identifiers differ
        with pytest.raises(ArgumentError, match="no landmark has one name on both"):
            read_landmark_pairs(*files)
        return
    with pytest.raises(DataError, match=rf"{re.escape(str(files[0]))} has several .* same name, {labels[0]}, .*; give"):
        read_landmark_pairs(*(files[::-1] if is_target else files))


def test_names_of_one_file_alone_may_repeat(tmp_path):
    """The other file tells no names, so that the order is all there is."""
    (tmp_path / "b.txt").write_text("10\n11\n12\n")
    found = read_landmark_pairs(table(tmp_path / "a.csv", ["F", "F", "F"]), tmp_path / "b.txt")
    assert found.source == tuple(map(tuple, POINTS)) and found.target == (10, 11, 12)


@pytest.mark.parametrize(
    ("header", "row", "repeats"),
    [
        ("x,y,z,visible", "{x},{y},{z},1", False),
        ("x,y,z,label", "{x},{y},{z},1", True),
        ("name,x,y,z", "1,{x},{y},{z}", True),
    ],
)
def test_numbers_that_repeat_are_names_where_the_table_says_so(tmp_path, header, row, repeats):
    rows = [row.format(x=x, y=y, z=z) for x, y, z in POINTS]
    (tmp_path / "a.csv").write_text("\n".join([header, *rows]) + "\n")
    files = tmp_path / "a.csv", table(tmp_path / "b.csv", ["a", "b", "c"])
    if repeats:
        with pytest.raises(DataError, match="same name, 1, but"):
            read_landmark_pairs(*files)
    else:
        assert len(read_landmark_pairs(*files)) == 3


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.stl", b"1", "has the suffix '.stl', but landmarks must have one of"),
        ("a.npy", b"nothing", "a.npy cannot be read as landmarks"),
        ("a.csv", b"", "a.csv cannot be read as landmarks"),
        ("gone.csv", None, "gone.csv cannot be read as landmarks"),
    ],
)
def test_files_that_cannot_be_read(tmp_path, name, content, said):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError) as refused:
        read_landmark_pairs(tmp_path / name, tmp_path / name)
    assert (said in str(refused.value) and "; " in str(refused.value)) or "must have one of" in said


def test_files_without_a_name_in_common_are_named(tmp_path):
    files = [markups(tmp_path / f"{name}.mrk.json", [name]) for name in ("nose", "tail")]
    with pytest.raises(ArgumentError, match=r"nose\.mrk\.json and .*tail\.mrk\.json: no landmark has one name on both"):
        read_landmark_pairs(*files)
