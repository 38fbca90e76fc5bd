"""A scene in the browser, served by viser."""

from __future__ import annotations

import html
import io
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from functools import cache
from threading import Event, Lock
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
from jaxtyping import Float, UInt8

from homolog.core.errors import needs_extra
from homolog.pairs import Side
from homolog.viewing.addresses import address_of, free_port
from homolog.viewing.colours import HIDDEN, Ramp
from homolog.viewing.layers import Layer
from homolog.viewing.picking import Ray
from homolog.viewing.scene import SIDES, Body, Mark, Scene, Shown

if TYPE_CHECKING:
    import viser

# Shapes of more points are first drawn as points: what is sent when colours change is then less than a third.
_MANY = 20_000
_MARK = (226, 0, 122)
_MARK_RADIUS = 0.018
_OPENING = np.pi / 6
# What is left of a usual window beside the controls is so much wider than high.
_ASPECT = 1.2
# Height of a caption above its shape, in units of the scene.
_CAPTION = 0.2
# How far from a click a drawn point may be.
_REACH_PIXELS = 7
_WAKE_SECONDS = 0.5
_GAMMA = 2.2
_LIGHTS = {"front": (-4.0, 6.0, 8.0), "back": (4.0, 6.0, -8.0)}
_AMBIENT, _DIRECTED = 1.4, 2.1
_MATERIAL = {"doubleSided": True, "metallicFactor": 0.0, "roughnessFactor": 0.9}


class LiveView:
    """Serves a scene until it is stopped; every browser that opens the address sees, and steers, the same view.

    Args:
        scene: what to show.
        host: the address to listen on; ``127.0.0.1`` is reached from this machine alone.
        port: the first one to try, or 0 for any that is free.

    Raises:
        MissingExtraError: if viser is not installed.
        ArgumentError: if there is no such address here, or no port is free.
    """

    def __init__(self, scene: Scene, host: str = "127.0.0.1", port: int = 8080) -> None:
        with needs_extra("a live view", "view"):
            import viser
        self._scene, self._host = scene, host
        self._shown = Shown(surface=max(len(body.points) for body in scene.bodies.values()) <= _MANY)
        self._layer = scene.layers[0]
        self._lock, self._stale, self._ended = Lock(), Event(), Event()
        self._normals = cache(lambda side: _normals(scene.bodies[side]))
        free = free_port(host, port)
        with _silence():
            self._server = viser.ViserServer(host=host, port=free, label="Homolog", verbose=False)
        self._set_up_scene()
        self._set_up_controls()
        self.redraw()

    @property
    def address(self) -> str:
        """What to open in a browser on this machine."""
        return address_of(self._host, self.port)

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return self._server.get_port()

    def serve(self) -> None:
        """Redraw whatever is changed in a browser, until ``end`` is called, from a signal's handler or another thread.

        Sliders change faster than large shapes are sent: what has piled up meanwhile is drawn once.
        """
        while not self._ended.is_set():
            if self._stale.wait(_WAKE_SECONDS):
                self._stale.clear()
                self.redraw()

    def end(self) -> None:
        """Let ``serve`` return soon."""
        self._ended.set()

    def stop(self) -> None:
        """Stop listening."""
        with _silence():
            self._server.stop()

    def redraw(self) -> None:
        """Send both shapes as they are to be drawn now."""
        with self._lock:
            for side in SIDES:
                self._draw(side, self._scene.bodies[side])

    # ---- the scene

    def _set_up_scene(self) -> None:
        server = self._server
        server.scene.set_up_direction("+y")
        self._set_up_lights()
        bodies = self._scene.bodies.values()
        width = max(abs(body.offset[0]) + np.ptp(body.points[:, 0]) / 2 for body in bodies)
        height = max(np.ptp(body.points[:, 1]) / 2 for body in bodies) + _CAPTION
        away = max(height, width / _ASPECT) / np.tan(_OPENING / 2)
        server.initial_camera.fov = _OPENING
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        server.initial_camera.position = (0.0, 0.08 * away, 1.1 * away)
        server.scene.on_click()(self._clicked)
        for side, body in self._scene.bodies.items():
            caption = server.scene.add_label(f"/{side}/caption", f"{side}: {body.title}")
            caption.position = (body.offset[0], body.points[:, 1].max() + _CAPTION / 2, 0.0)

    def _set_up_lights(self) -> None:
        """Plain lights leave colours as they are; a lit surrounding costs seconds where no graphics card draws it."""
        scene = self._server.scene
        scene.configure_environment_map(None)
        scene.configure_default_lights(enabled=False)
        scene.add_light_ambient("/lights/all", intensity=_AMBIENT)
        for name, place in _LIGHTS.items():
            scene.add_light_directional(f"/lights/{name}", position=place, intensity=_DIRECTED)

    def _draw(self, side: Side, body: Body) -> None:
        scene, name, place = self._server.scene, f"/{side}/shape", tuple(body.offset)
        colours = self._scene.colours(self._layer, side, self._shown)
        self._lay_beneath(side, body)
        if body.is_surface(self._shown):
            mesh = _coloured_mesh(body, self._normals(side), colours)
            scene.add_glb(name, mesh, position=place, cast_shadow=False)
            return
        mask = body.mask(self._shown)
        size = 1.2 * body.spacing * min(2.0, max(self._shown.share, 0.01) ** -0.25)
        scene.add_point_cloud(
            name,
            body.points[mask],
            colours[mask],
            point_size=size,
            point_shape="circle",
            precision="float32",
            position=place,
        )

    def _lay_beneath(self, side: Side, body: Body) -> None:
        """A pale surface beneath a mesh that is drawn as points: it does not change, and is sent once."""
        scene, name = self._server.scene, f"/{side}/beneath"
        if body.is_surface(self._shown):
            scene.remove_by_name(name)
        elif body.faces is not None and scene.get_handle_by_name(name) is None:
            mesh, place = (body.points, body.faces), tuple(body.offset)
            scene.add_mesh_simple(name, *mesh, color=HIDDEN, side="double", position=place, cast_shadow=False)

    # ---- controls

    def _set_up_controls(self) -> None:
        gui = self._server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        title = html.escape(self._scene.title)
        gui.add_html(_paragraph(f"<b>{title}</b><br>Method: {self._scene.route}. Points count from 0."))
        names = [layer.name for layer in self._scene.layers]
        self._choice = gui.add_dropdown("Colours", names)
        self._legend = gui.add_html(_legend(self._layer))
        meshes = any(body.faces is not None for body in self._scene.bodies.values())
        drawn = "surfaces" if self._shown.surface else "points"
        self._drawn = gui.add_dropdown("Meshes as", ["surfaces", "points"], initial_value=drawn, visible=meshes)
        self._confidence = gui.add_slider("Confidence", 0.0, 1.0, 0.01, 0.0, hint="Points below it are not shown.")
        self._share = gui.add_slider("Points (%)", 1, 100, 1, 100, hint="Of clouds, and of meshes drawn as points.")
        self._told = gui.add_html(_paragraph("Click a point to mark its counterpart."))
        self._clear = gui.add_button("Clear", visible=False)
        self._clear.on_click(lambda _: self.mark(None))
        for control in (self._choice, self._drawn, self._confidence, self._share):
            control.on_update(self._changed)

    def _changed(self, event: Any) -> None:
        self._layer = self._scene.layer(self._choice.value)
        self._shown = Shown(self._confidence.value, self._share.value / 100, self._drawn.value == "surfaces")
        self._legend.content = _legend(self._layer)
        self._stale.set()

    # ---- the mark

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        camera = event.client.camera
        slope = _REACH_PIXELS * 2 * np.tan(camera.fov / 2) / max(camera.image_height, 1)
        ray = Ray(np.array(event.ray_origin), np.array(event.ray_direction), float(slope))
        found = self._scene.pick(ray, self._shown)
        if found is not None:
            self.mark(found)

    def mark(self, found: Mark | None) -> None:
        """Show a mark on both shapes, or none."""
        with self._lock:
            scene, places = self._server.scene, {} if found is None else self._scene.places(found)
            for side in SIDES:
                scene.remove_by_name(f"/{side}/mark")
                if side in places:
                    name, place = f"/{side}/mark", tuple(places[side])
                    scene.add_icosphere(name, _MARK_RADIUS, color=_MARK, position=place, cast_shadow=False)
            said = "Click a point to mark its counterpart." if found is None else _mark_table(found, self._scene)
            self._told.content = _paragraph(said)
            self._clear.visible = found is not None


@contextmanager
def _silence() -> Iterator[None]:
    """The server tells of its start and end on stdout, which belongs to the address alone."""
    with redirect_stdout(io.StringIO()):
        yield


def _normals(body: Body) -> Float[np.ndarray, "n 3"]:
    normals: np.ndarray = trimesh.Trimesh(body.points, body.faces, process=False).vertex_normals
    return normals


def _coloured_mesh(body: Body, normals: Float[np.ndarray, "n 3"], colours: UInt8[np.ndarray, "n 3"]) -> bytes:
    """A smooth mesh, seen from both sides, as glTF. That has linear colours, where all others here are a screen's."""
    linear = np.round(255 * (colours / 255.0) ** _GAMMA).astype(np.uint8)
    # The library's annotations mislead the type checker here.
    library: Any = trimesh
    visual = library.visual.TextureVisuals(material=library.visual.material.PBRMaterial(**_MATERIAL))
    visual.vertex_attributes["color"] = np.pad(linear, ((0, 0), (0, 1)), constant_values=255)
    mesh = library.Trimesh(body.points, body.faces, vertex_normals=normals, process=False, visual=visual)
    exported: bytes = mesh.export(file_type="glb", include_normals=True)
    return exported


def _paragraph(content: str) -> str:
    return f'<div style="padding: 0 0.75em; font-size: 0.875em; line-height: 1.5">{content}</div>'


def _legend(layer: Layer) -> str:
    return _paragraph(("" if layer.ramp is None else _bar(layer.ramp)) + html.escape(layer.note))


def _bar(ramp: Ramp) -> str:
    stops = ", ".join(f"rgb{stop}" for stop in ramp.stops)
    return (
        f'<div style="height: 0.75em; background: linear-gradient(to right, {stops})"></div>'
        '<div style="display: flex; justify-content: space-between">'
        f"<span>{ramp.low:g}</span><span>{html.escape(f'{ramp.high:.2g} {ramp.unit}')}</span></div>"
    )


def _mark_table(found: Mark, scene: Scene) -> str:
    """What is known of a mark, a row each."""
    rows = "".join(f"<tr><td>{name}&emsp;</td><td>{html.escape(text)}</td></tr>" for name, text in scene.told(found))
    return f"<table>{rows}</table>"
