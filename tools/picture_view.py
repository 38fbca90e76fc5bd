"""Take a picture of a page that ``homolog view --html`` wrote, with a point marked.

Run from the root of the checkout, with Chromium on the path::

    homolog demo -o homolog-demo
    homolog view homolog-demo --html view.html
    python tools/picture_view.py view.html docs/images/view.png
"""

from __future__ import annotations

import argparse
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

_SIZE = (1200, 700)
# Where to click, in pixels: the left knee of the first demo body.
_PLACE = (258, 424)
_ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


@contextmanager
def opened_browser(size: tuple[int, int]) -> Iterator[Page]:
    """A new tab of so many pixels."""
    program = os.environ.get("HOMOLOG_CHROMIUM") or shutil.which("chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=_ARGUMENTS)
        yield browser.new_page(viewport={"width": size[0], "height": size[1]})
        browser.close()


def take(page: Path, picture: Path, place: tuple[int, int]) -> None:
    """Open a page, click a place of it, and keep what is seen."""
    with opened_browser(_SIZE) as tab:
        tab.goto(page.resolve().as_uri())
        tab.wait_for_selector("body[data-ready]")
        tab.mouse.click(*place)
        tab.wait_for_timeout(500)  # until it is drawn
        tab.screenshot(path=picture)


def main() -> None:
    """Read the two paths, and perhaps where to click, from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--click", type=int, nargs=2, default=_PLACE, metavar=("X", "Y"))
    given = parser.parse_args()
    take(given.page, given.picture, tuple(given.click))


if __name__ == "__main__":
    main()
