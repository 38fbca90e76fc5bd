"""What is left of a file's name that came from a browser: one that no system takes for anything else."""

from __future__ import annotations

import re
from pathlib import PurePath

from homolog.shapes import check_suffix

# What separates folders, or what some system does not allow in a name.
_SPECIAL = re.compile(r'[\\/:*?"<>|]')
# In signs of up to four bytes; systems allow 255 bytes.
_LONGEST_STEM, _LONGEST_SUFFIX = 56, 7


def plain_name(name: str) -> str:
    """A name without folders, signs that mean something to a system, or a length that none allows.

    Raises:
        ShapeError: if its suffix is none of a shape's file.
    """
    last = re.split(r"[\\/]", name)[-1]
    plain = _SPECIAL.sub("_", "".join(sign if sign.isprintable() else "_" for sign in last))
    short = PurePath(plain).stem[:_LONGEST_STEM] + PurePath(plain).suffix[:_LONGEST_SUFFIX]
    check_suffix(short)
    return short
