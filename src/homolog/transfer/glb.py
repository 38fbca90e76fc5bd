"""Writing a mesh with its texture or vertex colours and its skin as one GLB file."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial.transform import Rotation

from homolog.core.errors import needs_extra
from homolog.core.files import atomic_path
from homolog.geometry import unit
from homolog.shapes import drawable
from homolog.shapes.formats.gltf import GlbWriter
from homolog.transfer.atlas import Atlas
from homolog.transfer.projection import SurfaceProjector
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
    skin: Skin | None = None,
) -> None:
    """Write a mesh with normals, texture or vertex colours, and a skin as GLB; the whole file or none.

    Points keep their indices, unless there is a texture: then the points at its seams are repeated.

    Args:
        path: the file; its folder exists.
        projector: the mesh.
        texture: its atlas, and the image as a PNG file.
        colours: of its points; passed over where there is a texture, which programs would multiply with them.
        skin: skeleton and skinning weights.
    """
    glb = GlbWriter()
    shape = drawable(projector.given)
    assert shape.faces is not None
    point_of = np.arange(shape.n_points) if texture is None else texture[0].point_of
    faces = shape.faces if texture is None else texture[0].faces
    attributes = {"POSITION": glb.accessor(shape.points[point_of].astype("<f4"), bounds=True)}
    attributes["NORMAL"] = glb.accessor(_normals(projector)[point_of].astype("<f4"))
    if texture is not None:
        attributes["TEXCOORD_0"] = glb.accessor(texture[0].uv.astype("<f4"))
    elif colours is not None:
        attributes["COLOR_0"] = _colours(glb, colours)
    if skin is not None:
        attributes |= _influences(glb, skin, point_of)
    material = glb.add("materials", _material(glb, None if texture is None else texture[1]))
    primitive = {"attributes": attributes, "indices": _indices(glb, faces), "material": material}
    node: dict[str, Any] = {"mesh": glb.add("meshes", {"primitives": [primitive]}), "name": path.stem}
    roots = [] if skin is None else _skeleton(glb, skin, node)
    glb.header["scenes"] = [{"nodes": [*roots, glb.add("nodes", node)]}]
    glb.header["scene"] = 0
    with atomic_path(path) as temporary:
        temporary.write_bytes(glb.content())


def _normals(projector: SurfaceProjector) -> Float[np.ndarray, "n 3"]:
    """Unit normals of all points; +y where a point has none, as glTF demands length one."""
    assert projector.surface is not None
    normals = unit(projector.repaired.to_original(projector.surface.vertex_normals, fill=0.0))
    return np.where(normals.any(axis=1, keepdims=True), normals, np.array([0.0, 1.0, 0.0]))


def _indices(glb: GlbWriter, faces: Int[np.ndarray, "m 3"]) -> int:
    return glb.accessor(faces.ravel().astype("<u4"), indices=True)


def _colours(glb: GlbWriter, colours: UInt8[np.ndarray, "n 3"]) -> int:
    opaque = np.concatenate([colours, np.full((len(colours), 1), 255, np.uint8)], axis=1)
    accessor = glb.accessor(opaque)
    glb.header["accessors"][accessor]["normalized"] = True
    return accessor


def _influences(glb: GlbWriter, skin: Skin, point_of: Int[np.ndarray, " v"]) -> dict[str, int]:
    joints, weights = strongest_influences(skin.weights[point_of])
    return {"JOINTS_0": glb.accessor(joints.astype("<u2")), "WEIGHTS_0": glb.accessor(weights.astype("<f4"))}


def _material(glb: GlbWriter, image: bytes | None) -> dict[str, Any]:
    looks: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 0.9}
    if image is not None:
        filters = {"magFilter": _LINEAR, "minFilter": _LINEAR_MIPMAP_LINEAR, "wrapS": _CLAMP, "wrapT": _CLAMP}
        source = glb.add("images", {"bufferView": glb.view(image), "mimeType": "image/png"})
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
