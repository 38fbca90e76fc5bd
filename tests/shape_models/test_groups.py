"""Groups of a collection: read from a table, compared, and written; the command as well."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from homolog.core.errors import ArgumentError, DataError
from homolog.shape_models import (
    ModelSettings,
    ShapeModelFolder,
    StoredModel,
    compared_groups,
    read_groups,
    write_comparison,
)
from homolog.shapes import Shape, read_shape
from homolog.shapes.formats.ply import read_ply_property
from homolog.statistics import ShapeModel

NAMES = tuple(f"bone{number}" for number in range(10))


@pytest.fixture
def stored(make, tmp_path):
    """As a stored model: ten turned and moved shapes; those of the second half have a bump."""
    blob, random = make.blob(2), np.random.default_rng(0)
    bump = np.exp(-((blob.points - blob.points[7]) ** 2).sum(axis=1) / 0.1)
    points = np.stack(
        [
            (blob.points * (1 + 0.15 * (number >= 5) * bump[:, None]) + 0.01 * random.standard_normal((162, 3)))
            @ make.rotation(number).T
            + number
            for number in range(10)
        ]
    )
    model = ShapeModel(blob.points, np.zeros((0, 162, 3)), np.zeros(0))
    found = StoredModel(ShapeModelFolder(tmp_path), NAMES, ModelSettings(), model, blob, None)
    for name, value in {"points": lambda: points, "bump": bump}.items():
        object.__setattr__(found, name, value)
    return found


@pytest.fixture
def table(tmp_path):
    """Five controls and four patients, one shape without a group."""
    groups = ["controls"] * 5 + ["patients"] * 4 + [""]
    rows = [f"{name}.ply,{group}" for name, group in zip(NAMES, groups, strict=True)]
    (tmp_path / "groups.csv").write_text("\n".join(["name,group", *rows]) + "\n")
    return tmp_path / "groups.csv"


def test_a_bump_is_found_where_it_is(stored, table, tmp_path):
    groups = read_groups(table, NAMES)
    assert groups == {"controls": list(NAMES[:5]), "patients": list(NAMES[5:9])}
    found = compared_groups(stored, groups)
    assert found.comparison.is_exact and found.comparison.permutations == 126
    different = found.comparison.p_corrected <= 0.05
    assert different[stored.bump > 0.7].all() and different[stored.bump < 0.01].mean() < 0.1
    assert found.along_normals[7] > 0.1 and found.comparison.p_overall == pytest.approx(1 / 126)
    paths = write_comparison(tmp_path / "out", found)
    names = ["comparison.ply", "points.csv", "mean-controls.ply", "mean-patients.ply", "comparison.json"]
    assert [path.name for path in paths] == names
    np.testing.assert_array_equal(read_ply_property(paths[0], "p_corrected"), found.comparison.p_corrected)
    with paths[1].open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["q"]) for row in rows] == found.comparison.q.tolist()
    apart = read_shape(paths[3]).points - read_shape(paths[2]).points
    np.testing.assert_allclose(apart, found.comparison.difference, atol=1e-12)
    np.testing.assert_array_equal(read_shape(paths[2]).faces, stored.mean.faces)
    report = json.loads(paths[4].read_text())
    assert report["points_below_level_corrected"] == different.sum() and report["groups"]["patients"] == [*NAMES[5:9]]


def test_the_order_of_the_groups_is_that_which_was_given(stored, table):
    groups = read_groups(table, NAMES)
    found = compared_groups(stored, groups, ["patients", "controls"])
    assert found.groups == ("patients", "controls") and found.along_normals[7] < -0.1


def test_a_cloud_has_no_normals(stored, table):
    object.__setattr__(stored, "mean", Shape(stored.mean.points))
    found = compared_groups(stored, read_groups(table, NAMES))
    assert np.isnan(found.along_normals).all()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("shape,kind\na,b\n", "with the columns name and group"),
        ("name,group\nnobody,x\n", "names 'nobody', but the collection has no such shape"),
        ("name,group\nbone1,x\nbone1,y\n", "names bone1 2 times"),
    ],
)
def test_tables_that_cannot_be(tmp_path, text, said):
    (tmp_path / "groups.csv").write_text(text)
    with pytest.raises(DataError, match=said):
        read_groups(tmp_path / "groups.csv", NAMES)
    with pytest.raises(DataError, match="cannot be read"):
        read_groups(tmp_path / "none.csv", NAMES)


def test_groups_that_cannot_be(stored, tmp_path):
    three = {"a": [*NAMES[:3]], "b": [*NAMES[3:6]], "c": [*NAMES[6:]]}
    with pytest.raises(ArgumentError, match=r"there are 3: a, b, c; say which two"):
        compared_groups(stored, three)
    with pytest.raises(ArgumentError, match="group is 'd', but must be one of a, b, c"):
        compared_groups(stored, three, ["a", "d"])
    found = compared_groups(stored, {"a/b": [*NAMES[:5]], "c": [*NAMES[5:]]}, permutations=100)
    with pytest.raises(ArgumentError, match="cannot be part of a file's name"):
        write_comparison(tmp_path / "out", found)
    assert not (tmp_path / "out").exists()


def test_points_that_a_mask_leaves_out_are_compared_with_nothing_and_correct_nothing(stored, table, tmp_path):
    """As if the template never had them: the same numbers, and the same correction."""
    kept = stored.bump < 0.01
    groups = read_groups(table, NAMES)
    with_mask = replace(stored, weights=kept.astype(float))
    object.__setattr__(with_mask, "points", stored.points)
    masked = compared_groups(with_mask, groups)
    assert np.isnan(masked.comparison.p[~kept]).all()
    small = replace(stored, mean=Shape(stored.mean.points[kept]))
    object.__setattr__(small, "points", lambda: stored.points()[:, kept])
    without = compared_groups(small, groups).comparison
    np.testing.assert_array_equal(masked.comparison.p_corrected[kept], without.p_corrected)
    np.testing.assert_allclose(masked.comparison.difference[kept], without.difference, atol=1e-12)
    assert masked.figures()["points"] == kept.sum() and masked.comparison.p_overall == without.p_overall
    assert len(write_comparison(tmp_path / "out", masked)) == 5
