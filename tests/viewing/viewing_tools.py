"""What a page holds: its elements, and the arrays of its scene."""

import base64
import json
import zlib
from html.parser import HTMLParser

import numpy as np


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
