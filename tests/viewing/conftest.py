"""Matches whose maps are known."""

from dataclasses import replace

import numpy as np
import pytest

from homolog.matching import Match
from homolog.shapes import Shape
from homolog.viewing import page_of, scene_of_all


@pytest.fixture
def known(make):
    """A blob matched to a relabelled and stretched copy, rightly but for two points that have no counterpart."""
    blob = make.blob(2)
    order = np.random.default_rng(0).permutation(blob.n_points)
    other = make.relabelled(blob, order)
    other = Shape(other.points * [1, 1.2, 1], other.faces)
    forth, back = np.argsort(order), order.copy()
    confidence = np.linspace(0.2, 1, blob.n_points)
    forth[[3, 5]] = -1
    confidence[[3, 5]] = 0
    report = {"inputs": {"source": {"file": "/data/a blob.off"}, "target": {"file": "other.off"}}}
    return Match(blob, other, forth, back, confidence, np.full(blob.n_points, 0.5), method="axiomatic", report=report)


@pytest.fixture
def known_clouds(known):
    """The same without faces."""
    return replace(known, source=known.source.as_cloud(), target=known.target.as_cloud())


@pytest.fixture
def opened(tab, tmp_path):
    """``opened(*results)`` is a tab with the page of a result and its alternatives, from disk with the network off."""

    def load(*results, **size):
        file = tmp_path / "page.html"
        file.write_text(page_of(scene_of_all(results)), encoding="utf-8")
        one = tab(**size)
        one.page.context.set_offline(True)
        one.page.goto(file.as_uri())
        one.page.wait_for_selector("body[data-ready]")
        return one

    return load
