"""The folder of a track: what was found of each frame is kept, so that the work can be resumed at any time."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from typing_extensions import TypedDict

from homolog.core.array_files import ArrayFileError, read_npy
from homolog.core.files import expanded, sha256, write_json, write_npy
from homolog.core.folders import MANIFEST, prepare_folder, remove_if_unused
from homolog.core.records import record, stored_record
from homolog.core.versions import versions
from homolog.pairs import Candidate
from homolog.shape_models.kept_choice import keep_choice, kept_choice

# A version, increased whenever the same frames and settings give other points.
_MAKING = 1
_WHAT = "the points of a first frame through time, made by homolog track"
_RECORDS, _STEPS = "records", "steps"
FRAMES = "frames"
"""The folder of the first frame's mesh on each frame."""
_FOLDERS = (FRAMES, _RECORDS, _STEPS)


@record
class _Record(TypedDict):
    """Of a frame that was matched."""

    chain: str
    sha256: str
    size: float
    confidence: float
    warnings: list[str]
    matched_by: str


@dataclass(frozen=True, eq=False)
class Step:
    """How the first frame's points come to a later frame.

    Args:
        direct: by the map from the first frame (n, 3).
        chained: by the maps from frame to frame (n, 3).
        size: the square root of the frame's area.
        confidence: mean of the map from the first frame.
        warnings: of that map, a line each.
        matched_by: what found it.
    """

    direct: Float[np.ndarray, "n 3"]
    chained: Float[np.ndarray, "n 3"]
    size: float
    confidence: float
    warnings: tuple[str, ...]
    matched_by: str


def linked(chain: str, digest: str) -> str:
    """The hash of a frame and of all before it that were matched: what its step depends on.

    Args:
        chain: that of the last frame that was matched; that of the first is its file's hash.
        digest: of the frame's file.
    """
    return hashlib.sha256(f"{chain} {digest}".encode()).hexdigest()


@dataclass(frozen=True)
class TrackFolder:
    """The files of a track that can be resumed.

    ``steps/NAME.npy`` holds the positions of a ``Step`` (2, n, 3), ``records/NAME.json`` the rest, with the hash of
    that file and of all frames that it depends on.

    Args:
        root: the folder.
    """

    root: Path

    @classmethod
    @contextmanager
    def opened(cls, root: str | Path, making: dict[str, Any]) -> Iterator[TrackFolder]:
        """Create the folder, or resume one; a new one is removed if an error occurs before any frame is matched.

        Args:
            root: the folder.
            making: all that the points depend on besides the frames, for JSON.

        Raises:
            ArgumentError: if it holds other files, or was begun with other settings, or cannot be written to.
        """
        folder = cls(expanded(root))
        made = json.loads(json.dumps({"way": _MAKING, **making}))
        with remove_if_unused(folder.root, _FOLDERS):
            manifest = {"what": _WHAT, "making": made, "versions": versions()}
            prepare_folder(folder.root, manifest, _FOLDERS, what="a track")
            yield folder

    def choice(self) -> tuple[Candidate, ...] | None:
        """The choice of features that was made for all frames, empty where there was none; None where it is to come."""
        return kept_choice(self.root / MANIFEST)

    def keep_choice(self, choice: Sequence[Candidate]) -> None:
        """Keep the choice that was made for all frames."""
        keep_choice(self.root / MANIFEST, choice)

    def step(self, name: str, chain: str) -> Step | None:
        """What was found of a frame; None if nothing was, or of other frames, or it is damaged."""
        stored, file = stored_record(self.root / _RECORDS / f"{name}.json", _Record), self._positions(name)
        if stored is None or stored["chain"] != chain or not file.is_file() or sha256(file) != stored["sha256"]:
            return None
        try:
            direct, chained = read_npy(file)
        except (ArrayFileError, ValueError):  # by another version
            return None
        told = tuple(stored["warnings"])
        return Step(direct, chained, stored["size"], stored["confidence"], told, stored["matched_by"])

    def keep(self, name: str, chain: str, step: Step) -> None:
        """Keep what was found of a frame; the record comes last, and without it nothing counts."""
        write_npy(self._positions(name), np.stack([step.direct, step.chained]))
        content = {
            "chain": chain,
            "sha256": sha256(self._positions(name)),
            "size": step.size,
            "confidence": step.confidence,
            "warnings": list(step.warnings),
            "matched_by": step.matched_by,
        }
        write_json(self.root / _RECORDS / f"{name}.json", content)

    def forget_frames(self, others: Iterable[str]) -> None:
        """Remove the meshes of frames that were followed here before; what was found of them stays, to be used again.

        Args:
            others: the frames that are followed now.
        """
        known = {path.stem for path in (self.root / _RECORDS).glob("*.json")}
        for name in known - set(others):
            (self.root / FRAMES / f"{name}.ply").unlink(missing_ok=True)

    def _positions(self, name: str) -> Path:
        return self.root / _STEPS / f"{name}.npy"
