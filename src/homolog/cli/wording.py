"""What the library says of its arguments, in the words of the command that runs: ``target_up`` is ``--target-up``."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

_options: dict[str, str] = {}


def speak_of(parameters: Iterable[Any]) -> None:
    """Have arguments called by the options of these parameters, those of the command that runs."""
    _options.clear()
    _options.update({each.name: each.opts[0] for each in parameters if each.opts[0].startswith("--")})


def in_options(text: str) -> str:
    """A message of the library with its arguments called by the options that set them.

    An option's name may be a word of any text: it is one where it has an underscore, is set (``partial='source'``), or
    is what a sentence is about (``partial is 'source', but modality is 'mesh'``).
    """
    for name, option in _options.items():
        text = re.sub(rf"(?<![\w/.-]){name}='?([\w.-]+)'?", rf"{option} \1", text)
        text = re.sub(rf"(?<![\w/.-])Matcher\.{name}(?![\w/.-])", option, text)
        text = re.sub(rf"(^|, but ){name}(?= is )", rf"\1{option}", text)
        if "_" in name:
            text = re.sub(rf"(?<![\w/.-]){name}(?![\w/-]|\.\w)", option, text)
    return text
