"""A match in a notebook: an image of both shapes, and a table of figures."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from homolog.core.errors import MissingExtraError, needs_extra
from homolog.viewing.picture import picture_of, write_picture
from homolog.viewing.scene import SIDES, Scene

if TYPE_CHECKING:
    from PIL.Image import Image


def plot(scene: Scene, path: str | Path | None = None, *, width: int = 1000, lines: int = 0) -> Image:
    """The image of ``picture_of``, which notebooks display as the value of a cell.

    Args:
        scene: what is drawn.
        path: write it there as PNG, too.
        width: of the image, in pixels; it is half as high.
        lines: so many join points of the source and their counterparts.

    Raises:
        ArgumentError: as ``write_picture`` does.
        MissingExtraError: without the extra ``picture``.

    Examples:
        >>> import homolog
        >>> from homolog.viewing import plot, scene_of
        >>> match = homolog.match(*homolog.demo_shapes(), method="axiomatic")
        >>> image = plot(scene_of(match), "match.png", lines=20)
        >>> image.size
        (1000, 500)
    """
    with needs_extra("pictures", "picture"):
        from PIL import Image
    if path is None:
        return Image.fromarray(picture_of(scene, width=width, lines=lines))
    write_picture(path, scene, width=width, lines=lines)
    with Image.open(path) as written:
        return written.copy()


def notebook_html(scene: Scene, figures: Mapping[str, object] | None = None) -> str:
    """HTML of a match for a notebook: both shapes side by side, coloured alike, and a table of figures.

    Without the extra ``picture`` there is the table alone.

    Args:
        scene: what is drawn.
        figures: rows to add, by their names.
    """
    bodies = [scene.bodies[side] for side in SIDES]
    rows: dict[str, list[object]] = {"": [*SIDES], "file": [body.title for body in bodies]}
    rows["points"] = [f"{len(body.points):,}" for body in bodies]
    rows["matched"] = [f"{(body.counterpart >= 0).mean():.1%}" for body in bodies]
    rows["mean confidence"] = [f"{body.confidence.mean():.2f}" for body in bodies]
    rows |= {name: [value] for name, value in {"method": scene.method, **(figures or {})}.items()}
    table = "".join(_row(name, cells) for name, cells in rows.items())
    return f"<div>{_image(scene)}<table>{table}</table></div>"


def _image(scene: Scene) -> str:
    content = BytesIO()
    try:
        plot(scene, width=640).save(content, format="PNG")
    except MissingExtraError as error:
        return f"<p>{html.escape(str(error))}</p>"
    data = base64.b64encode(content.getvalue()).decode("ascii")
    return f'<img alt="{html.escape(scene.title)}" src="data:image/png;base64,{data}">'


def _row(name: str, cells: Sequence[object]) -> str:
    row = "".join(f'<td colspan="{3 - len(cells)}">{html.escape(str(cell))}</td>' for cell in cells)
    return f"<tr><th>{html.escape(name)}</th>{row}</tr>"
