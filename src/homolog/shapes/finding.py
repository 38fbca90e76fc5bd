"""One thing that was found in a shape or in its file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["note", "repaired", "unusable"]


@dataclass(frozen=True)
class Finding:
    """One thing found: which rule, how often, how serious it is, and what is done about it.

    Args:
        rule: a short name such as ``"duplicate points"``.
        count: how many points, faces or edges it concerns.
        severity: ``"note"`` changes nothing, ``repair`` puts ``"repaired"`` right, and ``"unusable"`` stops
            it.
        action: what is done, or what to do.
    """

    rule: str
    count: int
    severity: Severity
    action: str

    def __str__(self) -> str:
        return f"{self.count} {self.rule}: {self.action}"
