"""Make the pictures of the site anew: run the blocks of pages, in order, and keep the pictures that these pages show.

Run from the root of the checkout, with Chromium on the path::

    python tools/make_gallery.py docs/gallery.md docs/tutorials/collections.md
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from sybil.document import Document
from sybil.evaluators.python import PythonEvaluator
from sybil.example import Example
from sybil.parsers.markdown import CodeBlockParser

_ROOT = Path(__file__).parents[1]
_IMAGES = _ROOT / "docs" / "images"


def make(page: Path) -> None:
    """Run one page's blocks in a folder that is thrown away, and keep its pictures."""
    print(page)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "tools").symlink_to(_ROOT / "tools")
        os.chdir(folder)
        for block in Document.parse(str(page), *_PARSERS).examples():
            block.evaluate()
        os.chdir(_ROOT)
        for picture in re.findall(r"images/(\w+\.png)", page.read_text(encoding="utf-8")):
            if (folder / picture).is_file():
                shutil.copyfile(folder / picture, _IMAGES / picture)
                print(f"  {picture}")


def _run_in_shell(block: Example) -> None:
    """With the programs of this interpreter's environment, in which all that pages install is there."""
    lines = [line for line in block.parsed.splitlines() if not line.startswith("pip install ")]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    subprocess.run(["bash", "-euo", "pipefail", "-c", "\n".join(lines)], env={**os.environ, "PATH": path}, check=True)


_PARSERS = (CodeBlockParser("sh", _run_in_shell), CodeBlockParser("python", PythonEvaluator()))


def main() -> None:
    """Read which pages from the command line, and make their pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", type=Path, nargs="+")
    for page in parser.parse_args().pages:
        make(page.resolve())


if __name__ == "__main__":
    main()
