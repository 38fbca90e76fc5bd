"""Writing a mesh with its texture or vertex colours and its skin as one GLB file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial.transform import Rotation

from homolog.core.errors import needs_extra
from homolog.core.files import atomic_path
from homolog.geometry import Surface, unit
from homolog.geometry.projection import SurfaceProjector
from homolog.shapes import Shape, drawable
from homolog.shapes.cleaning import clean
from homolog.shapes.formats.gltf import GlbWriter
from homolog.transfer.animations import Animation, Track
from homolog.transfer.appearance import Texture
from homolog.transfer.atlas import Atlas
from homolog.transfer.blend_shapes import BlendShapes
from homolog.transfer.gltf import linear
from homolog.transfer.skin import Skin, strongest_influences

Image = UInt8[np.ndarray, "h w 3"]

# How glTF's images are filtered: between texels, and between smaller copies of the image.
_LINEAR, _LINEAR_MIPMAP_LINEAR, _CLAMP = 9729, 9987, 33071


def png(image: Image) -> bytes:
    """An image as a PNG file.

    Raises:
        MissingExtraError: if Pillow is not installed.
    """
    with needs_extra("writing a texture", "transfer"):
        from PIL import Image as Pillow
    content = BytesIO()
    Pillow.fromarray(image).save(content, format="PNG", optimize=True)
    return content.getvalue()


def write_glb(
    path: Path,
    projector: SurfaceProjector,
    *,
    texture: tuple[Atlas, bytes] | None = None,
    colours: UInt8[np.ndarray, "n 3"] | None = None,
    look: Texture | None = None,
    skin: Skin | None = None,
    blend_shapes: BlendShapes | None = None,
) -> None:
    """Write a mesh with normals, texture or vertex colours, skin and blend shapes as GLB; the whole file or none.

    Points keep their indices, unless there is a texture or a look: then the points at seams are repeated.

    Args:
        path: the file; its folder exists.
        projector: the mesh.
        texture: its atlas, and the image as a PNG file.
        colours: of its points; passed over where there is a texture, which programs would multiply with them.
        look: the images of the mesh's own file, in place of ``texture``; those of one texel become colours.
        skin: skeleton and skinning weights.
        blend_shapes: of its points; they become morph targets, and their animations are written with the skin's.
    """
    glb = GlbWriter()
    shape = drawable(projector.given)
    if blend_shapes is not None:
        # Viewers add the shapes at their weights, and then show the mesh as it lies.
        shape = replace(shape, points=shape.points - np.tensordot(blend_shapes.weights, blend_shapes.offsets, 1))
    assert shape.faces is not None
    if texture is not None:
        pieces = [_Piece(texture[0].point_of, texture[0].faces, texture[0].uv, texture[1])]
    elif look is not None:
        pieces = _pieces(projector.given, look)
    else:
        pieces = [_Piece(np.arange(shape.n_points), shape.faces)]
    normals = _normals(projector, shape.points)
    # What each blend shape adds to positions and normals.
    movers = [
        {"POSITION": offsets, "NORMAL": _normals(projector, shape.points + offsets) - normals}
        for offsets in ([] if blend_shapes is None else blend_shapes.offsets)
    ]
    primitives = list[dict[str, Any]]()
    for piece in pieces:
        attributes = _attributes(glb, piece, shape.points, normals, colours, skin)
        material = glb.add("materials", _material(glb, piece, clamped=look is None))
        indices = glb.accessor(piece.faces.ravel().astype("<u4"), indices=True)
        primitive = {"attributes": attributes, "indices": indices, "material": material}
        if movers:
            targets = [{name: glb.sparse(rows[piece.point_of]) for name, rows in mover.items()} for mover in movers]
            primitive["targets"] = targets
        primitives.append(primitive)
    mesh: dict[str, Any] = {"primitives": primitives}
    if blend_shapes is not None:
        mesh |= {"weights": blend_shapes.weights.tolist(), "extras": {"targetNames": list(blend_shapes.names)}}
    node: dict[str, Any] = {"mesh": glb.add("meshes", mesh), "name": path.stem}
    roots = [] if skin is None else _skeleton(glb, skin, node)
    number = glb.add("nodes", node)
    glb.header |= {"scenes": [{"nodes": [*roots, number]}], "scene": 0}
    _add_animations(glb, [each for moved in (skin, blend_shapes) if moved for each in moved.animations], number)
    with atomic_path(path) as temporary:
        temporary.write_bytes(glb.content())


def _attributes(
    glb: GlbWriter,
    piece: _Piece,
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    colours: UInt8[np.ndarray, "n 3"] | None,
    skin: Skin | None,
) -> dict[str, int]:
    """Add what a piece has at its vertices; the numbers of the accessors by glTF's names."""
    attributes = {"POSITION": glb.accessor(points[piece.point_of].astype("<f4"), bounds=True)}
    attributes["NORMAL"] = glb.accessor(normals[piece.point_of].astype("<f4"))
    if piece.uv is not None:
        attributes["TEXCOORD_0"] = glb.accessor(piece.uv.astype("<f4"))
    elif colours is not None:
        attributes["COLOR_0"] = _colours(glb, colours)
    if skin is not None:
        joints, weights = strongest_influences(skin.weights[piece.point_of])
        attributes["JOINTS_0"] = glb.accessor(joints.astype("<u2"))
        attributes["WEIGHTS_0"] = glb.accessor(weights.astype("<f4"))
    return attributes


def _normals(projector: SurfaceProjector, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """The normals of a mesh whose points lie elsewhere."""
    assert projector.shape.faces is not None
    moved = Surface(points[projector.repaired.kept], projector.shape.faces)
    normals = unit(projector.repaired.to_original(moved.vertex_normals, fill=0.0))
    normals[~normals.any(axis=1)] = 0.0, 1.0, 0.0  # glTF demands length one of all
    return normals


def _add_animations(glb: GlbWriter, animations: Sequence[Animation], node: int) -> None:
    """Add animations of joints, which are the first nodes, and of a mesh's node; those of one name are one."""
    tracks = dict[str, list[Track]]()
    for animation in animations:
        tracks.setdefault(animation.name, []).extend(animation.tracks)
    for name, own in tracks.items():
        channels, samplers = list[dict[str, Any]](), list[dict[str, Any]]()
        for number, track in enumerate(own):
            times = glb.accessor(track.times.astype("<f4")[:, None], bounds=True, vertices=False)
            rows = track.values.reshape(-1, 1) if track.path == "weights" else track.values
            values = glb.accessor(rows.astype("<f4"), vertices=False)
            samplers.append({"input": times, "output": values, "interpolation": "STEP" if track.steps else "LINEAR"})
            target = {"node": node if track.joint < 0 else track.joint, "path": track.path}
            channels.append({"sampler": number, "target": target})
        glb.add("animations", {"name": name, "channels": channels, "samplers": samplers})


class _Piece(NamedTuple):
    """Triangles of one material.

    Args:
        point_of: for each of its vertices the point of the shape.
        faces: of its vertices.
        uv: texture coordinates of its vertices.
        image: as a PNG file.
        colour: a factor of linear light.
    """

    point_of: Int[np.ndarray, " v"]
    faces: Int[np.ndarray, "m 3"]
    uv: Float[np.ndarray, "v 2"] | None = None
    image: bytes | None = None
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)


def _pieces(given: Shape, look: Texture) -> list[_Piece]:
    """The triangles of each image; vertices are repeated where texture coordinates or images change."""
    kept = clean(given).kept_faces
    assert given.faces is not None and kept is not None
    faces, coordinates, image_of = given.faces[kept], look.coordinates[kept], look.image_of[kept]
    # Parts of a scene that share an image share a material.
    number_of: dict[bytes, int] = {}
    same = np.array(
        [number_of.setdefault(i.tobytes() + bytes(str(i.shape), "ascii"), n) for n, i in enumerate(look.images)]
    )
    found = list[_Piece]()
    for number in np.unique(same[image_of]).tolist():
        which, image = same[image_of] == number, look.images[number]
        rows = np.concatenate([faces[which][..., None], coordinates[which]], axis=2).reshape(-1, 3)
        vertices, vertex_of = np.unique(rows, axis=0, return_inverse=True)
        plain = image.shape[:2] == (1, 1)
        uv = None if plain and not np.ptp(vertices[:, 1:], axis=0).any() else vertices[:, 1:]
        red, green, blue = linear(image[0, 0] / 255.0).tolist() if plain else (1.0, 1.0, 1.0)
        content = None if plain else png(image)
        of_points = vertices[:, 0].astype(np.int64)
        found.append(_Piece(of_points, vertex_of.reshape(-1, 3), uv, content, (red, green, blue)))
    return found


def _colours(glb: GlbWriter, colours: UInt8[np.ndarray, "n 3"]) -> int:
    opaque = np.concatenate([colours, np.full((len(colours), 1), 255, np.uint8)], axis=1)
    accessor = glb.accessor(opaque)
    glb.header["accessors"][accessor]["normalized"] = True
    return accessor


def _material(glb: GlbWriter, piece: _Piece, *, clamped: bool) -> dict[str, Any]:
    looks: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 0.9}
    if piece.colour != (1.0, 1.0, 1.0):
        looks["baseColorFactor"] = [*piece.colour, 1.0]
    if piece.image is not None:
        # An atlas has no neighbours beyond its edge; the images of files repeat.
        wrap = {"wrapS": _CLAMP, "wrapT": _CLAMP} if clamped else {}
        filters = {"magFilter": _LINEAR, "minFilter": _LINEAR_MIPMAP_LINEAR, **wrap}
        source = glb.add("images", {"bufferView": glb.view(piece.image), "mimeType": "image/png"})
        texture = glb.add("textures", {"source": source, "sampler": glb.add("samplers", filters)})
        looks["baseColorTexture"] = {"index": texture}
    return {"pbrMetallicRoughness": looks, "doubleSided": True}


def _skeleton(glb: GlbWriter, skin: Skin, node: dict[str, Any]) -> list[int]:
    """Add the joints, as the first nodes, and give the mesh's node its skin; returns the joints without a parent."""
    inverse = np.linalg.inv(skin.frames)
    for number, (name, parent) in enumerate(zip(skin.names, skin.parents.tolist(), strict=True)):
        local = skin.frames[number] if parent < 0 else inverse[parent] @ skin.frames[number]
        children = np.flatnonzero(skin.parents == number).tolist()
        rotation = Rotation.from_matrix(local[:3, :3]).as_quat().tolist()
        joint = {"name": name, "translation": local[:3, 3].tolist(), "rotation": rotation}
        glb.add("nodes", joint | ({"children": children} if children else {}))
    # In columns, as glTF has its matrices.
    matrices = glb.accessor(inverse.transpose(0, 2, 1).reshape(-1, 16).astype("<f4"), vertices=False)
    joints = list(range(len(skin.names)))
    node["skin"] = glb.add("skins", {"joints": joints, "inverseBindMatrices": matrices})
    return np.flatnonzero(skin.parents < 0).tolist()
