"""What a page holds: its elements, and the arrays of its scene; and where it draws what, in a browser."""

import base64
import json
import zlib
from html.parser import HTMLParser
from io import BytesIO

import numpy as np
import pytest

SIDES = ("source", "target")


class Parts(HTMLParser):
    """Every element with its attributes, and the text of scripts by their ids."""

    def __init__(self, page):
        super().__init__()
        self.elements, self.scripts, self.title, self._inside = [], {}, "", None
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        self._inside = dict(attributes).get("id", tag) if tag in ("script", "title") else None

    def handle_endtag(self, tag):
        self._inside = None

    def handle_data(self, data):
        if self._inside == "title":
            self.title += data
        elif self._inside:
            self.scripts[self._inside] = self.scripts.get(self._inside, "") + data


def arrays_of(parts):
    block = zlib.decompress(base64.b64decode(parts.scripts["arrays"]))

    def read(place):
        return np.frombuffer(block, dtype=place["kind"], count=place["length"], offset=place["begin"])

    told = json.loads(parts.scripts["scene"])
    for first in told.get("maps", [])[:1]:  # what the page shows to begin with
        told |= {"method": first["method"], "layers": first["layers"]}
        told["bodies"] = [body | first["sides"][side] for side, body in enumerate(told["bodies"])]
    return told, read


def on_page(page, scene, side, points):
    """Where on the page points are seen, and how deep, by the camera's own matrices."""
    camera = page.evaluate("side => homolog.camera(side)", SIDES.index(side))
    view, clip = (np.reshape(camera[name], (4, 4)).T for name in ("view", "clip"))
    homogeneous = np.concatenate([scene.bodies[side].points[points], np.ones((len(points), 1))], axis=1)
    x, y, depth, w = clip @ view @ homogeneous.T
    part = camera["part"]
    return part["left"] + (x / w + 1) / 2 * part["width"], (1 - y / w) / 2 * part["height"], depth / w


def foremost(page, scene, side):
    """The point nearest to the camera, and where it is seen."""
    everything = np.arange(len(scene.bodies[side].points))
    x, y, depth = on_page(page, scene, side, everything)
    point = int(depth.argmin())
    return point, float(x[point]), float(y[point])


def comes(page, condition):
    """Whether a condition comes to hold within a minute, as the page draws."""
    return any(condition() or page.wait_for_timeout(100) for _ in range(600))


def colour_at(page, x, y):
    """What is drawn at a place of the page."""
    image = pytest.importorskip("PIL.Image")
    shot = page.screenshot(clip={"x": round(x) - 1, "y": round(y) - 1, "width": 3, "height": 3})
    return image.open(BytesIO(shot)).convert("RGB").getpixel((1, 1))
