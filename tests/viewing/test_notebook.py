"""What a notebook shows of a match: an image, and a table."""

import base64
import re
import sys
from html.parser import HTMLParser
from io import BytesIO

import numpy as np
import pytest

from homolog.core.errors import ArgumentError, MissingExtraError
from homolog.viewing import notebook_html, picture_of, plot, scene_of

image = pytest.importorskip("PIL.Image", reason="pillow is missing; pip install 'homolog[picture]'")


def test_plot_is_the_picture(known, tmp_path):
    scene = scene_of(known)
    pixels = picture_of(scene, width=300, lines=3)
    drawn = plot(scene, tmp_path / "match.png", width=300, lines=3)
    np.testing.assert_array_equal(np.asarray(drawn), pixels)
    with image.open(tmp_path / "match.png") as written:
        np.testing.assert_array_equal(np.asarray(written), pixels)
    np.testing.assert_array_equal(np.asarray(plot(scene, width=300, lines=3)), pixels)
    with pytest.raises(ArgumentError, match=r"must end in \.png"):
        plot(scene, tmp_path / "match.jpg")


class Table(HTMLParser):
    """The rows of a table, and all tags."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.tags = [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("th", "td"):
            self.rows[-1].append("")

    def handle_data(self, data):
        self.rows[-1][-1] += data


def test_html_has_the_picture_and_the_figures(known):
    known.report["inputs"]["source"]["file"] = "<script>alert(1).off"
    scene = scene_of(known)
    page = notebook_html(scene, {"flipped & torn": 0.5})
    (data,) = re.findall(r'src="data:image/png;base64,([^"]*)"', page)
    np.testing.assert_array_equal(np.asarray(image.open(BytesIO(base64.b64decode(data)))), picture_of(scene, width=640))
    table = Table(page)
    assert "script" not in table.tags and "src=" not in page.replace('src="data:', "")
    assert table.rows == [
        ["", "source", "target"],
        ["file", "<script>alert(1).off", "other.off"],
        ["points", "162", "162"],
        ["matched", "98.8%", "100.0%"],
        ["mean confidence", f"{known.source_confidence.mean():.2f}", "0.50"],
        ["method", "axiomatic"],
        ["flipped & torn", "0.5"],
    ]


def test_without_pillow_there_is_the_table(known, monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    scene = scene_of(known)
    page = notebook_html(scene)
    assert "<img" not in page and "homolog[picture]" in page and "mean confidence" in page
    with pytest.raises(MissingExtraError, match=r"homolog\[picture\]"):
        plot(scene)
