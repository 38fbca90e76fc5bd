"""Take a picture of the page of ``homolog serve`` while it matches the two demo bodies.

Run from the root of the checkout, with Chromium on the path::

    homolog serve --no-open --port 8080 &
    python tools/picture_serve.py http://127.0.0.1:8080 docs/images/serve.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

from picture_view import opened_browser

_BODIES = Path(__file__).parents[1] / "src" / "homolog" / "demo_data" / "off"
# The last but three, so that the steps before it are listed.
_STEP = "features of target"
_MILLISECONDS = 300_000


def take(address: str, picture: Path) -> None:
    """Give the page both bodies, and keep what is seen once it has come to a step near the end."""
    with opened_browser((1200, 720)) as tab:
        tab.set_default_timeout(_MILLISECONDS)
        tab.goto(address)
        for side, body in (("source", "amber"), ("target", "boris")):
            tab.set_input_files(f"[data-side={side}] input", _BODIES / f"{body}.off")
        tab.wait_for_selector(f"#steps li:has-text('{_STEP}')")
        tab.screenshot(path=picture)


def main() -> None:
    """Read the address and the path from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address")
    parser.add_argument("picture", type=Path)
    given = parser.parse_args()
    take(given.address, given.picture)


if __name__ == "__main__":
    main()
