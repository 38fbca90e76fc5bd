"""One image of a match, for a paper: drawn on the processor, the same on any machine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from homolog.core.arguments import is_number
from homolog.core.choices import PICTURE_WIDTHS, Side
from homolog.core.errors import ArgumentError, bad_value, needs_extra
from homolog.core.files import expanded
from homolog.pairs import SIDES
from homolog.viewing.drawing import RADIUS, SAMPLES, Canvas, averaged, shape_drawing, view_rotation
from homolog.viewing.png import write_png
from homolog.viewing.scene import Body, Scene

# Of the picture's height: left free on all sides, and between the shapes.
_MARGIN, _GAP = 0.04, 0.06
# A point is seen if nothing lies before it by more than this, in the unit of the scene.
_BEHIND = 0.02


def picture_of(scene: Scene, *, width: int = 2000, lines: int = 0) -> UInt8[np.ndarray, "height width 3"]:
    """Draw both shapes side by side on white, in the colours of the scene's first layer; half as high as wide.

    Surfaces are shaded, points of clouds are balls. Nothing is cut off.

    Args:
        scene: what is drawn.
        width: of the picture, in pixels.
        lines: how many thin lines join visible points of the source and their counterparts, where these are visible.

    Raises:
        ArgumentError: if the width is not from 100 to 6000, or the number of lines negative.
        MissingExtraError: if lines are asked for without the extra ``picture``.
    """
    if not (is_number(width) and int(width) == width and PICTURE_WIDTHS[0] <= width <= PICTURE_WIDTHS[1]):
        raise bad_value("width", width, f"a whole number of pixels from {PICTURE_WIDTHS[0]} to {PICTURE_WIDTHS[1]}")
    if not (is_number(lines) and int(lines) == lines and lines >= 0):
        raise bad_value("lines", lines, "a whole number, 0 or more")
    size = (int(width) // 2 * SAMPLES, int(width) * SAMPLES)
    places, unit = _projected(scene, size)
    canvas = Canvas.blank(int(width) // 2, int(width))
    for side in SIDES:
        body, colours = scene.bodies[side], scene.layers[0].colours[side].astype(np.float64)
        canvas.draw(shape_drawing(places[side], body.faces, colours, unit * _reach(body)))
    image = canvas.image
    if lines:
        image = _with_lines(image, scene, places, _chosen(scene, places, canvas.depth, unit, lines))
    return averaged(image)


def write_picture(path: str | Path, scene: Scene, *, width: int = 2000, lines: int = 0) -> None:
    """Write ``picture_of`` a scene as PNG.

    Raises:
        ArgumentError: as ``picture_of`` does, and if the file does not end in .png or cannot be written.
        MissingExtraError: without the extra ``picture``.
    """
    check_picture(path)
    write_png(path, picture_of(scene, width=width, lines=lines))


def check_picture(path: str | Path) -> None:
    """Check, before any work is done, that a file's name ends in .png and that the extra ``picture`` is installed."""
    if expanded(path).suffix.lower() != ".png":
        raise ArgumentError(f"{path} must end in .png; pictures are written as PNG only")
    with needs_extra("pictures", "picture"):
        import PIL  # noqa: F401


def _projected(scene: Scene, size: tuple[int, int]) -> tuple[dict[Side, Float[np.ndarray, "n 3"]], float]:
    """All points in the image: pixels of samples and depth (n, 3); and the length of the scene's unit there."""
    turned = {side: scene.bodies[side].points @ view_rotation().T for side in SIDES}
    reach = {side: _reach(scene.bodies[side]) for side in SIDES}
    boxes = {
        side: (points.min(axis=0) - reach[side], points.max(axis=0) + reach[side]) for side, points in turned.items()
    }
    extents = {side: high - low for side, (low, high) in boxes.items()}
    unit, begins = _fitted(extents["source"], extents["target"], size)
    places: dict[Side, np.ndarray] = {}
    for side, (low, high) in boxes.items():
        x = begins[side] + unit * (turned[side][:, 0] - low[0])
        y = size[0] / 2 - unit * (turned[side][:, 1] - (low[1] + high[1]) / 2)
        places[side] = np.stack([x, y, unit * turned[side][:, 2]], axis=1)
    return places, unit


def _fitted(
    source: Float[np.ndarray, " 3"], target: Float[np.ndarray, " 3"], size: tuple[int, int]
) -> tuple[float, dict[Side, float]]:
    """The length of the unit with which shapes of these extents just fit into an image, and where each begins."""
    height, width = size
    margin, gap = _MARGIN * height, _GAP * height
    across, tallest = source[0] + target[0], max(source[1], target[1])
    unit = float(min((height - 2 * margin) / tallest, (width - 2 * margin - gap) / across))
    # What is left of the width goes to both sides and between the shapes in equal parts.
    free = (width - unit * across) / 3
    if free < margin:
        return unit, {"source": margin, "target": margin + gap + unit * source[0]}
    return unit, {"source": free, "target": 2 * free + unit * source[0]}


def _reach(body: Body) -> float:
    """How far what is drawn of a point reaches beyond it."""
    return 0.0 if body.faces is not None else RADIUS * body.spacing


def _chosen(
    scene: Scene, places: dict[Side, Float[np.ndarray, "n 3"]], depth: Float[np.ndarray, "h w"], unit: float, lines: int
) -> Int[np.ndarray, " l"]:
    """Visible points of the source with visible counterparts, far from one another."""
    counterpart = scene.bodies["source"].counterpart
    (known,) = np.nonzero(counterpart >= 0)
    seen = _seen(places["source"][known], depth, unit) & _seen(places["target"][counterpart[known]], depth, unit)
    return _spread(places["source"], known[seen], lines)


def _seen(places: Float[np.ndarray, "k 3"], depth: Float[np.ndarray, "h w"], unit: float) -> np.ndarray:
    column, row = places[:, :2].astype(np.int64).T
    before: np.ndarray = depth[row.clip(0, depth.shape[0] - 1), column.clip(0, depth.shape[1] - 1)]
    return before <= places[:, 2] + _BEHIND * unit


def _spread(places: Float[np.ndarray, "n 3"], among: Int[np.ndarray, " k"], number: int) -> Int[np.ndarray, " l"]:
    """Farthest point sampling in the image, from the topmost point on."""
    chosen: list[int] = []
    distance = np.full(len(among), np.inf)
    while len(chosen) < min(number, len(among)):
        next_one = int(distance.argmax()) if chosen else int(places[among, 1].argmin())
        chosen.append(int(among[next_one]))
        distance = np.minimum(distance, np.linalg.norm(places[among, :2] - places[chosen[-1], :2], axis=1))
    return np.array(chosen, dtype=np.int64)


def _with_lines(
    image: Float[np.ndarray, "h w 3"],
    scene: Scene,
    places: dict[Side, Float[np.ndarray, "n 3"]],
    points: Int[np.ndarray, " l"],
) -> Float[np.ndarray, "h w 3"]:
    """Lines from points of the source to their counterparts, in the points' colours, a little darker."""
    with needs_extra("lines in pictures", "picture"):
        from PIL import Image, ImageDraw
    canvas = Image.fromarray(image.round().astype(np.uint8))
    pen = ImageDraw.Draw(canvas)
    thick = max(2, round(image.shape[1] / 1500))
    for point in points:
        counterpart = scene.bodies["source"].counterpart[point]
        ends = [tuple(places["source"][point, :2]), tuple(places["target"][counterpart, :2])]
        colour = tuple(int(0.75 * channel) for channel in scene.layers[0].colours["source"][point])
        pen.line(ends, fill=colour, width=thick)
        for end in ends:
            pen.circle(end, 2 * thick, fill=colour)
    return np.asarray(canvas, dtype=np.float32)
