"""The page that two files are dropped on."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path

from homolog.serving.limits import Limits
from homolog.shapes import readable_suffixes
from homolog.viewing import page_style

_PARTS = Path(__file__).parent / "page"


@dataclass(frozen=True)
class Page:
    """A page, and what a browser may do for it.

    Args:
        text: in HTML; styles and program are in it.
        policy: its content security policy.
    """

    text: str
    policy: str


def upload_page(limits: Limits, made_with: str) -> Page:
    """The page; it looks like that of a result, loads nothing, and runs nothing but its own program.

    Args:
        limits: what it tells of them.
        made_with: in a few words, how matches are made.
    """
    facts = {
        "suffixes": readable_suffixes(),
        "bytes": limits.file_bytes,
        "mb": f"{limits.max_mb:g}",
        "madeWith": made_with,
    }
    style, program = page_style() + _part("page.css"), _part("page.js")
    parts = {
        "style": style,
        # Within a script, no text may look like the script's end.
        "facts": json.dumps(facts).replace("<", "\\u003c"),
        "program": program,
    }
    text = re.sub(r"@(\w+)@", lambda place: parts[place[1]], _part("page.html"))
    return Page(text, _policy(style, program))


def _policy(style: str, program: str) -> str:
    return "; ".join(
        (
            "default-src 'none'",
            f"script-src '{_digest(program)}'",
            f"style-src '{_digest(style)}'",
            "connect-src 'self'",
            "frame-src 'self'",
            "img-src data:",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        )
    )


def _digest(text: str) -> str:
    """By which a browser knows that what stands in the page was put there by us."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def _part(name: str) -> str:
    return (_PARTS / name).read_text(encoding="utf-8")
