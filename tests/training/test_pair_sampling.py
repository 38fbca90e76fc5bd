"""The order of pairs."""

from collections import Counter

from homolog.training.data import TrainingSet
from homolog.training.sampling import PairSampler


def drawn(root, recipe, steps):
    sampler = PairSampler(TrainingSet.open(root, recipe), recipe)
    return [pair for step in range(steps) for pair in sampler.of_step(step)]


def test_every_shape_is_once_first_and_once_second_in_a_round(meshes, small):
    pairs = drawn(meshes, small(), 240)
    for start in range(0, 240, 4):
        several = pairs[start : start + 4]
        assert {pair.x.name for pair in several} == {pair.y.name for pair in several} == {"ape", "bee", "cat", "dog"}
    assert all(pair.x.name != pair.y.name for pair in pairs)
    assert len({(pair.x.name, pair.y.name) for pair in pairs}) == 12


def test_steps_of_several_pairs_see_the_same_order(meshes, small):
    singles = drawn(meshes, small(), 12)
    assert drawn(meshes, small(training={"pairs_per_step": 3}), 4) == singles
    assert drawn(meshes, small(), 12) == singles
    assert drawn(meshes, small(seed=4), 12) != singles


def test_every_variant_and_subset_is_drawn(meshes, small):
    recipe = small(clouds={"noise": [0.1], "subsampled": [0.5]}, samples={"subsets": 4})
    pairs = drawn(meshes, recipe, 200)
    for side in ("x", "y"):
        seen = Counter((getattr(pair, side).variant, getattr(pair, side).subset) for pair in pairs)
        assert len(seen) == 12
    assert len({pair.seed for pair in pairs}) == 200
    assert {pair.x.subset for pair in drawn(meshes, small(samples={"points": 0}), 20)} == {0}


def test_listed_pairs_come_once_in_a_round(meshes, tmp_path, small):
    (tmp_path / "off").symlink_to(meshes / "off")
    (tmp_path / "pairs.txt").write_text("ape,bee\ncat,ape\ndog,ape\n")
    pairs = drawn(tmp_path, small(partial={}), 9)
    for start in range(0, 9, 3):
        assert {pair.x.name for pair in pairs[start : start + 3]} == {"ape", "cat", "dog"}


def test_validation_pairs_stay_the_same(meshes, small):
    recipe = small(validation={"pairs": 5})
    sampler = PairSampler(TrainingSet.open(meshes, recipe), recipe)
    assert sampler.held_out() == sampler.held_out()
    assert len(sampler.held_out()) == 5


def test_validation_is_drawn_apart_from_training(meshes, small):
    recipe = small(validation={"pairs": 5})
    sampler = PairSampler(TrainingSet.open(meshes, recipe), recipe)
    trained = {pair.seed for step in range(5) for pair in sampler.of_step(step)}
    assert trained.isdisjoint(pair.seed for pair in sampler.held_out())
