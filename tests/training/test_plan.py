"""The order of pairs."""

from collections import Counter

from homolog.training.data import TrainingSet
from homolog.training.plan import Plan


def drawn(root, recipe, steps):
    plan = Plan(TrainingSet.open(root, recipe), recipe)
    return [draw for step in range(steps) for draw in plan.draws(step)]


def test_every_shape_is_once_first_and_once_second_in_a_round(meshes, small):
    draws = drawn(meshes, small(), 240)
    for start in range(0, 240, 4):
        several = draws[start : start + 4]
        assert {draw.x.name for draw in several} == {draw.y.name for draw in several} == {"ape", "bee", "cat", "dog"}
    assert all(draw.x.name != draw.y.name for draw in draws)
    assert len({(draw.x.name, draw.y.name) for draw in draws}) == 12


def test_steps_of_several_pairs_see_the_same_order(meshes, small):
    singles = drawn(meshes, small(), 12)
    assert drawn(meshes, small(training={"pairs_per_step": 3}), 4) == singles
    assert drawn(meshes, small(), 12) == singles
    assert drawn(meshes, small(seed=4), 12) != singles


def test_every_variant_and_subset_is_drawn(meshes, small):
    recipe = small(clouds={"noise": [0.1], "thinned": [0.5]}, samples={"subsets": 4})
    draws = drawn(meshes, recipe, 200)
    for side in ("x", "y"):
        seen = Counter((getattr(draw, side).variant, getattr(draw, side).subset) for draw in draws)
        assert len(seen) == 12
    assert len({draw.seed for draw in draws}) == 200
    assert {draw.x.subset for draw in drawn(meshes, small(samples={"points": 0}), 20)} == {0}


def test_listed_pairs_come_once_in_a_round(meshes, tmp_path, small):
    (tmp_path / "off").symlink_to(meshes / "off")
    (tmp_path / "pairs.txt").write_text("ape,bee\ncat,ape\ndog,ape\n")
    draws = drawn(tmp_path, small(partial={}), 9)
    for start in range(0, 9, 3):
        assert {draw.x.name for draw in draws[start : start + 3]} == {"ape", "cat", "dog"}


def test_validation_pairs_stay_the_same(meshes, small):
    recipe = small(validation={"pairs": 5})
    plan = Plan(TrainingSet.open(meshes, recipe), recipe)
    assert plan.held_out() == plan.held_out()
    assert len(plan.held_out()) == 5
