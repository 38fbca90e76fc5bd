"""An evaluation in several processes, part by part, against that of one."""

from functools import partial

import numpy as np
import pytest

from homolog.core.errors import DataError
from homolog.core.tasks import run_tasks
from homolog.datasets import ShapeFolder
from homolog.evaluation import Protocol, evaluate
from homolog.matching import Matcher
from homolog.pairs import MatcherSettings
from homolog.shapes import Shape, write_shape


@pytest.fixture
def folder(tmp_path, make):
    """Four stretched blobs with one numbering, and pairs of three sources in no order."""
    blob, names = make.blob(2), ("a", "b", "c", "d")
    for below in ("off", "corres"):
        (tmp_path / below).mkdir()
    for number, name in enumerate(names):
        write_shape(tmp_path / "off" / f"{name}.off", Shape(blob.points * [1, 1 + 0.1 * number, 1], blob.faces))
        np.savetxt(tmp_path / "corres" / f"{name}.vts", np.arange(1, blob.n_points + 1), fmt="%d")
    (tmp_path / "pairs.txt").write_text("a,b\nb,a\nc,d\na,c\nb,d\na,d\na,b\n")
    return ShapeFolder.open(tmp_path)


def next_point(source, target, *, step=1):
    """A map that is wrong by a step of the numbering."""
    return np.roll(np.arange(source.n_points), step)


def nowhere(source, target):
    return np.full(target.n_points, -1)


def same(one, other):
    assert [pair.pair for pair in one.pairs] == [pair.pair for pair in other.pairs]
    assert all((mine.errors == theirs.errors).all() for mine, theirs in zip(one.pairs, other.pairs, strict=True))
    without = [{**each.to_dict(), "seconds": None} for each in (one, other)]
    assert without[0] == without[1]


@pytest.fixture
def parts(monkeypatch):
    """Parts of at most two pairs, in this process; the names of their sources."""
    told = []

    def run(phases, *, processes, **others):
        told.extend(name for name, _ in phases[0])
        run_tasks(phases, processes=1, **others)

    monkeypatch.setattr("homolog.evaluation.runner._PAIRS_OF_A_PART", 2)
    monkeypatch.setattr("homolog.evaluation.runner.run_tasks", run)
    return told


def test_parts_have_one_source_each_and_are_put_together_in_the_order_of_the_pairs(folder, parts):
    protocol, match = Protocol(split="all"), partial(next_point, step=2)
    same(evaluate(None, folder, protocol, match=match, processes=3), evaluate(None, folder, protocol, match=match))
    assert parts == ["a", "a", "b", "c"]


def test_maps_to_nowhere_are_scored_in_parts_as_well(folder, parts):
    protocol = Protocol(split="all")
    same(evaluate(None, folder, protocol, match=nowhere, processes=2), evaluate(None, folder, protocol, match=nowhere))


def test_a_fault_of_a_part_is_raised(folder, parts):
    (folder.root / "corres" / "d.vts").write_text("9999\n")
    with pytest.raises(DataError, match=r"d\.vts"):
        evaluate(None, folder, Protocol(split="all"), match=next_point, processes=2)


@pytest.mark.process
@pytest.mark.slow
def test_a_matcher_goes_to_other_processes(folder):
    matcher = Matcher(settings=MatcherSettings(method="axiomatic"))
    protocol = Protocol(split="all", n_pairs=2)
    same(evaluate(matcher, folder, protocol, processes=2), evaluate(matcher, folder, protocol))
