"""The maps of other ways round, read from the folder of a result."""

import shutil

import numpy as np
import pytest

from homolog.core.errors import DataError
from homolog.matching import Match, alternative_folder, load_alternatives


@pytest.fixture
def result(make, tmp_path):
    """A result with two alternatives, which differ."""
    blob = make.blob(1)
    for number in (1, 2, 3):
        folder = tmp_path if number == 1 else alternative_folder(tmp_path, number)
        Match(blob, blob, np.roll(np.arange(42), number), np.arange(42)).save(folder)
    return tmp_path


def test_alternatives_come_in_their_order(result):
    match = Match.load(result)
    assert [int(each.source_to_target[3]) for each in (match, *load_alternatives(result, match))] == [2, 1, 0]


def test_none_are_read_behind_a_gap_and_of_other_folders(result):
    shutil.rmtree(result / "alternative-2")
    (result / "alternative-old").mkdir()
    assert load_alternatives(result, Match.load(result)) == []


def test_faulty_alternatives(result, make):
    match, other = Match.load(result), make.sphere(1)
    small = make.grid(3)
    Match(other, small, np.zeros(42, int), np.zeros(9, int)).save(result / "alternative-3")
    with pytest.raises(DataError, match="alternative-3 holds a match of other shapes"):
        load_alternatives(result, match)
    (result / "alternative-2" / "source.ply").unlink()
    with pytest.raises(DataError, match=r"alternative-2 has no source\.ply"):
        load_alternatives(result, match)
