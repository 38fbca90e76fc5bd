"""The result of a match."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Float, Int

from homolog.core.errors import DataError
from homolog.core.files import atomic_path, expanded
from homolog.matching.quality import MapQuality

Route = Literal["functional-map", "nearest-features", "registration", "axiomatic"]
"""How maps were found."""

_ARRAYS = ("source_to_target", "target_to_source", "source_confidence", "target_confidence")


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
        quality: figures of the maps as a whole; None where they were read from a file.
    """

    source_to_target: Int[np.ndarray, " n_source"]
    target_to_source: Int[np.ndarray, " n_target"]
    source_confidence: Float[np.ndarray, " n_source"]
    target_confidence: Float[np.ndarray, " n_target"]
    route: Route
    warnings: tuple[str, ...] = field(default=())
    quality: MapQuality | None = None

    def inverse(self) -> Correspondence:
        """The same maps with source and target exchanged."""
        return Correspondence(
            source_to_target=self.target_to_source,
            target_to_source=self.source_to_target,
            source_confidence=self.target_confidence,
            target_confidence=self.source_confidence,
            route=self.route,
            warnings=self.warnings,
            quality=None if self.quality is None else self.quality.inverse(),
        )

    @classmethod
    def load(cls, path: str | Path, *, route: Route, warnings: tuple[str, ...] = ()) -> Correspondence:
        """Read what ``save`` wrote; route and warnings are in the report beside it.

        Raises:
            DataError: if the file is not there, is damaged, or holds something else.
        """
        try:
            with np.load(expanded(path), allow_pickle=False) as stored:
                missing = [name for name in _ARRAYS if name not in stored.files]
                arrays = {name: stored[name] for name in _ARRAYS if name not in missing}
        except (OSError, ValueError, EOFError, BadZipFile) as error:
            raise DataError(f"{path} cannot be read as the arrays of a match ({error}); match again") from None
        if missing:
            raise DataError(f"{path} has no array {missing[0]!r}; it must be what homolog match wrote")
        if any(
            array.ndim != 1 or array.dtype.kind != kind for array, kind in zip(arrays.values(), "iiff", strict=True)
        ):
            raise DataError(f"{path} holds arrays that are not those of a match; match again")
        return cls(**arrays, route=route, warnings=warnings)

    def save(self, path: str | Path) -> None:
        """Write the four arrays as a ``.npz`` file, whole or not at all."""
        # NumPy adds a suffix to a name that has none, but not to a file.
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **{name: getattr(self, name) for name in _ARRAYS})
