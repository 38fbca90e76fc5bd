"""One choice for all shapes, kept in the manifest of their folder, so that those that come later are matched alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from typing_extensions import NotRequired, TypedDict

from homolog.core.files import write_json
from homolog.core.records import record, stored_record
from homolog.pairs import Candidate


@record
class _Manifest(TypedDict):
    choice: NotRequired[list[Candidate]]


def kept_choice(manifest: Path) -> tuple[Candidate, ...] | None:
    """The choice that was made for all shapes, empty where there was none; None where it is to come."""
    stored = stored_record(manifest, _Manifest)
    return None if stored is None or "choice" not in stored else tuple(Candidate(**each) for each in stored["choice"])


def keep_choice(manifest: Path, choice: Sequence[Candidate]) -> None:
    """Keep the choice that was made for all shapes."""
    stored = stored_record(manifest, _Manifest)
    assert stored is not None
    write_json(manifest, {**stored, "choice": [asdict(candidate) for candidate in choice]})
