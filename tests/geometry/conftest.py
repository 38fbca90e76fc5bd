"""Tests of operators compute what other tests remember."""

import pytest


@pytest.fixture(autouse=True)
def _computed_anew(compute_anew, monkeypatch):
    compute_anew(monkeypatch)
