"""The result of a match."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from homolog.files import atomic_path

Route = Literal["functional-map", "features", "axiomatic"]


@dataclass(frozen=True, eq=False)
class Correspondence:
    """Point maps both ways between two shapes, in the indices of the shapes as they were given.

    Args:
        source_to_target: for each source point its target point's index (n_source,), int64; -1 = no counterpart.
        target_to_source: for each target point its source point's index (n_target,), int64; -1 = no counterpart.
        source_confidence: trust in each entry of ``source_to_target``, from 0 to 1; 0 where that is -1.
        target_confidence: likewise for ``target_to_source``.
        route: how the maps were found.
        warnings: what the user should know, a line each.
    """

    source_to_target: Int[np.ndarray, " n_source"]
    target_to_source: Int[np.ndarray, " n_target"]
    source_confidence: Float[np.ndarray, " n_source"]
    target_confidence: Float[np.ndarray, " n_target"]
    route: Route
    warnings: tuple[str, ...] = field(default=())

    def swapped(self) -> Correspondence:
        """The same maps with source and target exchanged."""
        return Correspondence(
            source_to_target=self.target_to_source,
            target_to_source=self.source_to_target,
            source_confidence=self.target_confidence,
            target_confidence=self.source_confidence,
            route=self.route,
            warnings=self.warnings,
        )

    def save(self, path: str | Path) -> None:
        """Write the four arrays as a ``.npz`` file, whole or not at all."""
        # NumPy adds a suffix to a name that has none, but not to a file.
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(
                file,
                source_to_target=self.source_to_target,
                target_to_source=self.target_to_source,
                source_confidence=self.source_confidence,
                target_confidence=self.target_confidence,
            )
