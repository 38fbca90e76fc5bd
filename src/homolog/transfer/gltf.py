"""glTF files whose faults are told with their names."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from homolog.core.errors import DataError
from homolog.shapes.formats.gltf import GlbWriter, Gltf
from homolog.shapes.formats.parsing import UnreadableError

__all__ = ["GlbWriter", "GltfReader"]


class GltfReader(Gltf):
    """The parts of a GLB or glTF file.

    Args:
        path: the file; its buffers may be inside or beside it.

    Raises:
        DataError: if it is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            super().__init__(path)
        except (UnreadableError, OSError, ValueError, KeyError, TypeError) as error:
            raise DataError(f"{path} cannot be read as glTF ({error}); export it again") from None

    def accessor(self, number: int) -> np.ndarray:
        """The rows (count, width) of an accessor, as ``Gltf`` reads them.

        Raises:
            DataError: if the file does not hold them.
        """
        try:
            return super().accessor(number)
        except (UnreadableError, KeyError, IndexError, ValueError, TypeError) as error:
            raise DataError(f"{self.path} has a damaged accessor {number} ({error}); export it again") from None
