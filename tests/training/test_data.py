"""Which shapes are found in which folders, and in which pairs."""

import itertools
import shutil
from dataclasses import replace

import numpy as np
import pytest

from homolog.core.errors import ArgumentError, DataError
from homolog.datasets import DatasetDescription, ShapeFolder, read_description
from homolog.shapes import read_shape, stand_upright, write_shape
from homolog.training.data import TrainingSet
from homolog.training.recipes import read_recipe
from homolog.training.settings import PartialSettings


@pytest.fixture
def parts(tmp_path, make):
    """Complete and partial shapes, in folders as the SHREC'16 benchmark has them."""
    blob = make.blob(1)
    for place in ("null/cat", "null/wild_cat", "null/dog", "cuts/cuts_cat_shape_1", "cuts/cuts_wild_cat_shape_1"):
        (tmp_path / place).parent.mkdir(exist_ok=True)
        write_shape(tmp_path / f"{place}.off", blob)
    write_shape(tmp_path / "cuts" / "cuts_dog_shape_1.off", blob)
    write_shape(tmp_path / "cuts" / "cuts_dog_shape_2.off", blob)
    return tmp_path


def test_a_folder_with_ground_truth(meshes, small):
    found = TrainingSet.open(meshes, small(validation={"score_every": 1}))
    assert found.names == ("ape", "bee", "cat", "dog") == found.used
    assert found.pairs == ()
    assert len(found.held_out) == 2
    assert found.truth is not None
    assert found.shape("bee").n_points == 642
    assert TrainingSet.open(meshes, small()).truth is None


def test_scores_without_ground_truth_are_none_and_the_log_says_why(meshes, tmp_path, small, caplog):
    shutil.copytree(meshes / "off", tmp_path / "off")
    (tmp_path / "corres").mkdir()
    assert TrainingSet.open(tmp_path, small(validation={"score_every": 5})).truth is None
    assert "no scores, though [validation] score_every is 5" in caplog.text
    assert "ape" in caplog.text or "corres" in caplog.text


def test_held_out_shapes_are_not_trained_on(meshes, small):
    found = TrainingSet.open(meshes, small(validation={"shapes": 2, "pairs": 9}))
    held_out = set(itertools.chain.from_iterable(found.held_out))
    assert len(found.names) == len(held_out) == 2
    assert set(found.held_out) == set(itertools.permutations(held_out, 2))
    assert {*found.names, *held_out} == {"ape", "bee", "cat", "dog"} == set(found.used)
    seeds = [TrainingSet.open(meshes, small(seed=seed, validation={"shapes": 2})).names for seed in range(20)]
    assert len(set(seeds)) > 3


def test_a_folder_of_meshes_alone(meshes, tmp_path, small):
    for file in (meshes / "off").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "notes.txt").write_text("not a shape")
    (tmp_path / ".hidden.off").write_text("")
    found = TrainingSet.open(tmp_path, small(data={"split": "train", "leave_out": ["d*"]}))
    assert found.names == ("ape", "bee", "cat")
    (tmp_path / "ape.ply").write_text("")
    with pytest.raises(DataError, match=r"ape\.off and ape\.ply|ape\.ply and ape\.off"):
        TrainingSet.open(tmp_path, small())


def test_splits(meshes, tmp_path, small):
    (tmp_path / "off").symlink_to(meshes / "off")
    (tmp_path / "train.txt").write_text("dog\nbee\n")
    assert TrainingSet.open(tmp_path, small(data={"split": "train"})).names == ("bee", "dog")


def test_parts_find_their_full_shapes(parts, small):
    found = TrainingSet.open(parts, small(partial={}))
    assert set(found.pairs) == {
        ("cat", "cuts_cat_shape_1"),
        ("wild_cat", "cuts_wild_cat_shape_1"),
        ("dog", "cuts_dog_shape_1"),
        ("dog", "cuts_dog_shape_2"),
    }
    kept = TrainingSet.open(parts, small(partial={}, data={"leave_out": ["*_2"]}, validation={"shapes": 2}))
    assert len(kept.pairs) == 1
    assert len(kept.held_out) == 2
    assert not set(kept.pairs) & set(kept.held_out)
    assert kept.files["dog"].parent.name == "null"


def test_partial_pairs_may_be_listed(meshes, tmp_path, small):
    (tmp_path / "off").symlink_to(meshes / "off")
    everything = TrainingSet.open(tmp_path, small(partial={}))
    assert everything.pairs == () and len(everything.names) == 4
    (tmp_path / "pairs.txt").write_text("ape,bee\ncat,ape\ndog,dog\n")
    assert TrainingSet.open(tmp_path, small(partial={})).pairs == (("ape", "bee"), ("cat", "ape"))


def test_without_ground_truth_or_lists_nothing_is_kept_for_a_test(meshes, tmp_path, small):
    shutil.copytree(meshes / "off", tmp_path / "off")
    recipe = small(data={"split": "train"})
    assert TrainingSet.open(tmp_path, recipe).names == ("ape", "bee", "cat", "dog")
    (tmp_path / "train.txt").write_text("ape\ncat\ndog\n")
    assert TrainingSet.open(tmp_path, recipe).names == ("ape", "cat", "dog")


def test_a_described_set_leaves_its_test_out(meshes, small):
    described = DatasetDescription(name="mine", split="last", n_test=1, up="x")
    found = TrainingSet.open(meshes, small(data={"split": "train"}, validation={"score_every": 1}), described)
    assert found.names == ("ape", "bee", "cat")
    assert found.up == found.truth.up == "x"
    assert TrainingSet.open(meshes, small(data={"split": "train", "up": "z"}), described).up == "z"
    assert TrainingSet.open(
        meshes, small(data={"split": "test"}, validation={"shapes": 0}), replace(described, n_test=2)
    ).names == (
        "cat",
        "dog",
    )


def test_the_numbering_that_is_a_set_s_truth_is_not_trained_on(meshes, small):
    described = DatasetDescription(split="train", shuffled=True, truth="same-numbering", up="x")
    found = TrainingSet.open(meshes, small(), described)
    shape, file = found.shape("bee"), stand_upright(read_shape(meshes / "off" / "bee.off"), "x")
    assert (shape.points != file.points).any(axis=1).mean() > 0.9
    np.testing.assert_array_equal(np.sort(shape.points, axis=0), np.sort(file.points, axis=0))
    corners = shape.points[shape.faces], file.points[file.faces]
    np.testing.assert_array_equal(*corners)
    np.testing.assert_array_equal(shape.points, ShapeFolder.without_truth(meshes, described).shape("bee").points)


def test_parts_of_a_described_set(parts_set, small):
    root, known = parts_set
    described = read_description("shrec16_cuts")
    recipe = small(data={"split": "train"}, partial={}, validation={"score_every": 1})
    found = TrainingSet.open(root, recipe, described)
    assert set(found.pairs) == {(partner, name) for name, (partner, *_) in known.items()}
    assert found.up == "z" and found.truth.description == described
    assert found.files["dog"] == root / "null" / "dog.off"
    assert recipe.for_dataset(described).partial.pre_aligned is True
    assert small(partial={"pre_aligned": False}).for_dataset(described).partial.pre_aligned is False
    assert recipe.for_dataset().partial == PartialSettings(full="null", parts="cuts", pre_aligned=False)
    with pytest.raises(ArgumentError, match="shrec16_cuts is a dataset of partial shapes"):
        TrainingSet.open(root, small(), described)
    with pytest.raises(ArgumentError, match=r"\[partial\] full is 'whole', but shrec16_cuts has 'null'"):
        TrainingSet.open(root, small(partial={"full": "whole"}), described)


def test_recipes_for_shrec16_name_the_folders_of_its_sets():
    for kind in ("cuts", "holes"):
        recipe = read_recipe(kind)
        own, described = recipe.for_dataset(), recipe.for_dataset(read_description(f"shrec16_{kind}"))
        assert (own.partial.full, own.partial.parts, own.data.up) == ("null", kind, "z")
        assert (described.partial.full, described.partial.parts, described.data.up) == ("null", kind, "z")


def test_shapes_of_one_class_make_a_pair(tmp_path, meshes, small):
    (tmp_path / "off").mkdir()
    for name, source in (("cat1", "ape"), ("cat2", "bee"), ("dog1", "cat"), ("dog2", "dog")):
        shutil.copy(meshes / "off" / f"{source}.off", tmp_path / "off" / f"{name}.off")
    described = DatasetDescription(pairs="same-class", truth="none", split="train")
    found = TrainingSet.open(tmp_path, small(data={"split": "train"}), described)
    assert set(found.pairs) == {("cat1", "cat2"), ("cat2", "cat1"), ("dog1", "dog2"), ("dog2", "dog1")}


def test_sets_for_testing_alone_are_not_trained_on(meshes, small):
    with pytest.raises(DataError, match="no shapes in split 'train'"):
        TrainingSet.open(meshes, small(data={"split": "train"}), DatasetDescription(split="test"))


@pytest.mark.parametrize("up", ["x", "z"])
def test_shapes_are_stood_upright(meshes, small, up):
    """Those for the losses and those for the scores alike."""
    recipe = small(data={"up": up}, validation={"score_every": 1})
    found = TrainingSet.open(meshes, recipe)
    given = read_shape(meshes / "off" / "ape.off")
    for shape in (found.shape("ape"), found.truth.shape("ape")):
        np.testing.assert_array_equal(shape.points, stand_upright(given, up).points)
        np.testing.assert_allclose(shape.points[:, 1], given.points[:, "xyz".index(up)])


def test_pairs_of_a_shape_with_itself_are_no_pairs(meshes, tmp_path, small):
    shutil.copytree(meshes / "off", tmp_path / "off")
    (tmp_path / "pairs.txt").write_text("ape,ape\nbee,bee\n")
    with pytest.raises(DataError, match="lists no pair"):
        TrainingSet.open(tmp_path, small(partial={}))


def test_what_is_wrong_is_said(meshes, parts, tmp_path, small):
    empty = tmp_path / "empty"
    empty.mkdir()
    cases = [
        (tmp_path / "gone", {}, "no such folder"),
        (empty, {}, "no meshes"),
        (meshes, {"data": {"leave_out": ["[abc]*"]}}, "1 of its shapes are left"),
        (meshes, {"validation": {"shapes": 4}}, "0 of its shapes are left"),
        (parts, {"partial": {"parts": "holes"}}, "has full shapes, but no folder 'holes'"),
        (parts, {"partial": {}, "validation": {"shapes": 4}}, "no pair is left"),
    ]
    for root, changes, words in cases:
        with pytest.raises(DataError, match=words):
            TrainingSet.open(root, small(**changes))
    (parts / "cuts" / "lone.off").write_bytes((parts / "null" / "cat.off").read_bytes())
    with pytest.raises(DataError, match="lone: no full shape"):
        TrainingSet.open(parts, small(partial={}))
    (parts / "cuts" / "cat.off").write_bytes((parts / "null" / "cat.off").read_bytes())
    with pytest.raises(DataError, match="have one name"):
        TrainingSet.open(parts, small(partial={}))


def test_clouds_are_trained_on_where_that_is_asked_for(tmp_path, make, small):
    for name in ("a", "b"):
        write_shape(tmp_path / f"{name}.ply", make.blob(1).as_cloud())
    with pytest.raises(DataError, match=r"has no faces, .*have \[data\] clouds = true"):
        TrainingSet.open(tmp_path, small()).shape("a")
    assert TrainingSet.open(tmp_path, small(data={"clouds": True})).shape("a").faces is None


def test_files_that_can_only_hold_points_are_found_where_clouds_are_asked_for(tmp_path, make, small):
    for name in ("a.csv", "b.xyz", "c.npy", "d.ply"):
        write_shape(tmp_path / name, make.blob(1).as_cloud())
    (tmp_path / "notes.txt").write_text("not a shape")
    recipe = small(data={"clouds": True}, validation={"shapes": 0, "pairs": 2})
    assert TrainingSet.open(tmp_path, recipe).names == ("a", "b", "c", "d")
    with pytest.raises(DataError, match="1 of its shapes are left"):
        TrainingSet.open(tmp_path, small(validation={"shapes": 0}))


def test_lists_of_full_shapes_are_for_tests_and_those_with_partial_ones_for_training(meshes, tmp_path, small):
    (tmp_path / "off").symlink_to(meshes / "off")
    (tmp_path / "pairs.txt").write_text("ape,bee\ncat,ape\n")
    assert TrainingSet.open(tmp_path, small()).pairs == ()
    assert TrainingSet.open(tmp_path, small(partial={})).pairs == (("ape", "bee"), ("cat", "ape"))
