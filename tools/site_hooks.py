"""What MkDocs asks of this project while it builds the site: pages that are not written by hand, and links to them.

The reference of the commands is made by the command line itself. Pages that belong elsewhere in the tree, such as the
changelog, are taken from where they lie; links are written as they hold in the tree, and are led to the pages here.
"""

from __future__ import annotations

import posixpath
import re
import subprocess
import sys
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

_ROOT = Path(__file__).parents[1]
# Pages of the site, and where they lie in the tree.
_ELSEWHERE = {
    "changelog.md": "CHANGELOG.md",
    "contributing.md": "CONTRIBUTING.md",
    "trained.md": "results/README.md",
    "demo-licence.md": "src/homolog/demo_data/LICENSE.md",
    "weights-licence.md": "src/homolog/features/pretrained/LICENSE.md",
    "animals-licence.md": "src/homolog/synthesis/animal_data/LICENSE.md",
}
_LINK = re.compile(r"(?<=\]\()([^)\s#:]+)(?=[)#])")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that do not lie in ``docs/``."""
    for page, place in _ELSEWHERE.items():
        files.append(File.generated(config, page, content=(_ROOT / place).read_text(encoding="utf-8")))
    files.append(File.generated(config, "commands.md", content=commands()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links that hold in the tree to the pages of the site."""
    here = _ELSEWHERE.get(page.file.src_uri, f"docs/{page.file.src_uri}")
    return _LINK.sub(lambda link: _led(link[1], posixpath.dirname(here), page.file.src_uri), markdown)


def _led(link: str, folder: str, page: str) -> str:
    meant = posixpath.normpath(posixpath.join(folder, link))
    pages = {place: page for page, place in _ELSEWHERE.items()}
    there = pages.get(meant, meant.removeprefix("docs/"))
    return posixpath.relpath(there, posixpath.dirname(page) or ".")


def commands() -> str:
    """The reference of all commands in Markdown, as the command line tells it of itself."""
    told = subprocess.run(
        [sys.executable, "-m", "typer", "homolog.cli.app", "utils", "docs", "--name", "homolog", "--title", "Commands"],
        capture_output=True,
        text=True,
        check=True,
        cwd=_ROOT,
    ).stdout
    # Lists of subcommands cut each description short, and the contents beside the page name them all.
    told = re.sub(r"\*\*Commands\*\*:\n\n(\* .*\n)+\n?", "", told)
    return re.sub(r"^Examples?:\n((?:  .*\n|\n)+)", _examples, told, flags=re.MULTILINE)


def _examples(found: re.Match[str]) -> str:
    lines = [line.strip() for line in found[1].splitlines() if line.strip()]
    return "\n".join(["**Examples**:", "", "```sh", *lines, "```", "", ""])
