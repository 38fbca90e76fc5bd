"""Safe names for files that a browser sends."""

from __future__ import annotations

import re
from pathlib import PurePath

from homolog.shapes import check_suffix

# They separate folders, or some system does not allow them in a name.
_SPECIAL = re.compile(r'[\\/:*?"<>|]')
# In characters of up to four bytes; systems allow 255 bytes.
_LONGEST_STEM, _LONGEST_SUFFIX = 56, 7


def safe_file_name(name: str) -> str:
    """The last part of a file's name, without characters that mean something to a system, and not too long.

    Raises:
        ShapeError: if its suffix is not that of a shape's file.
    """
    last = re.split(r"[\\/]", name)[-1]
    plain = _SPECIAL.sub("_", "".join(character if character.isprintable() else "_" for character in last))
    short = PurePath(plain).stem[:_LONGEST_STEM] + PurePath(plain).suffix[:_LONGEST_SUFFIX]
    check_suffix(short)
    return short
