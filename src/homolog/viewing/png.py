"""Images as PNG files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from homolog.core.errors import needs_extra
from homolog.core.files import atomic_path


def write_png(path: str | Path, pixels: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write an image as PNG, whole or not at all.

    Raises:
        ArgumentError: as ``atomic_path`` does.
        MissingExtraError: without the extra ``picture``.
    """
    with needs_extra("pictures", "picture"):
        from PIL import Image
    with atomic_path(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="PNG")
