"""The pretrained weights: their names and files, without loading any."""

from __future__ import annotations

from pathlib import Path

from homolog.core.errors import WeightsError
from homolog.core.files import expanded

DEFAULT_WEIGHTS = "people"
"""The name of the weights that ``load_weights`` reads where none are given."""
AUTO_WEIGHTS = "auto"
"""In place of a name: the pretrained weights of all kinds, of which those are used that know a pair best."""
KINDS = ("people", "animals", "hands", "heads")
"""The names of the pretrained weights of these kinds, the usual ones first."""
OF_PARTS = ("views", "animal_parts")
"""The names of those that were trained on partial shapes of one of these kinds, and are for partial pairs."""

_FOLDER = Path(__file__).parents[1] / "features" / "pretrained"


def pretrained_weights() -> dict[str, Path]:
    """Name and file of each of the pretrained weights."""
    return {file.stem: file for file in sorted(_FOLDER.glob("*.safetensors"))}


def weights_file(given: str | Path) -> Path:
    """The file of weights that a user named: a path, or the name of pretrained weights.

    Raises:
        WeightsError: if there is neither.
    """
    known = pretrained_weights()
    if str(given) and expanded(given).is_file():
        return expanded(given)
    if str(given) in known:
        return known[str(given)]
    raise WeightsError(
        f"there are no weights {str(given)!r}; "
        f"give the path of a file, or one of the pretrained ones: {', '.join(known)}"
    )
