"""Paths and files, on their own."""

import sys

import pytest

from homolog.errors import ArgumentError
from homolog.files import atomic_path, expanded, sha256


def written(path):
    with atomic_path(path):
        raise AssertionError("never reached")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows knows no ~name")
@pytest.mark.parametrize("use", [expanded, sha256, written])
def test_a_home_folder_that_is_not_there_is_named(use):
    with pytest.raises(ArgumentError, match=r"^~nobody-of-that-name/a\.off: there is no such user's home folder"):
        use("~nobody-of-that-name/a.off")
