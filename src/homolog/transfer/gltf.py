"""Textures and colours of GLB and glTF files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from homolog.shapes.formats.gltf import Gltf, Part, parts


@dataclass(frozen=True)
class GltfMaterial:
    """What a material of glTF says of colour.

    Args:
        image: the file of its texture, or the content of such a file; None if it has none.
        colour: red, green and blue from 0 to 1, which its texture is multiplied with.
    """

    image: bytes | Path | None
    colour: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class GltfLook:
    """What a glTF file says of the colours of the shape that ``read_shape`` reads from it.

    Args:
        coordinates: for each corner of each triangle its place in the image, from the upper left (m, 3, 2).
        material_of: the material of each triangle (m,).
        materials: one for each part of the scene.
        colours: red, green and blue of each point from 0 to 1, NaN where there is none (n, 3).
    """

    coordinates: Float[np.ndarray, "m 3 2"]
    material_of: Int[np.ndarray, " m"]
    materials: tuple[GltfMaterial, ...]
    colours: Float[np.ndarray, "n 3"]


def read_gltf_look(path: Path) -> GltfLook:
    """Read materials, texture coordinates and the colours of points, part by part in the order of the shape."""
    file = Gltf(path)
    found = list(parts(file))
    coordinates = [_corners(file, part) for part in found]
    numbers = [np.full(len(part.faces), number) for number, part in enumerate(found)]
    colours = np.full((sum(len(part.points) for part in found), 3), np.nan)
    for part in found:
        if "COLOR_0" in part.primitive["attributes"]:
            own = file.accessor(part.primitive["attributes"]["COLOR_0"], "VEC3", "VEC4")[:, :3]
            colours[part.first : part.first + len(own)] = own
    materials = tuple(_material(file, part.primitive) for part in found)
    return GltfLook(np.concatenate(coordinates), np.concatenate(numbers), materials, colours)


def _corners(file: Gltf, part: Part) -> Float[np.ndarray, "m 3 2"]:
    """The texture coordinates of a part's triangles; zeros without any."""
    texture = _colours_of(file, part.primitive)[0]
    moved = texture.get("extensions", {}).get("KHR_texture_transform", {})
    name = f"TEXCOORD_{moved.get('texCoord', texture.get('texCoord', 0))}"
    if name not in part.primitive["attributes"]:
        return np.zeros((len(part.faces), 3, 2))
    corners: np.ndarray = file.accessor(part.primitive["attributes"][name], "VEC2").astype(np.float64)[part.faces]
    angle = moved.get("rotation", 0.0)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    moved_corners: np.ndarray = (corners * moved.get("scale", (1.0, 1.0))) @ turn.T + moved.get("offset", (0.0, 0.0))
    return moved_corners


def srgb(linear: Float[np.ndarray, ...]) -> Float[np.ndarray, ...]:
    """Colours as images hold them, of those in linear light, as glTF has factors of colour; both from 0 to 1."""
    dark, bright = 12.92 * linear, 1.055 * np.maximum(linear, 0.0) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, dark, bright)


def linear(srgb: Float[np.ndarray, ...]) -> Float[np.ndarray, ...]:
    """Colours in linear light of those that images hold; both from 0 to 1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


# What materials and meshes have that a transfer does not carry, and how it is called.
_NOT_CARRIED = {
    "normalTexture": "normal maps",
    "occlusionTexture": "occlusion maps",
    "emissiveTexture": "emission",
    "emissiveFactor": "emission",
    "metallicRoughnessTexture": "metal and roughness",
}


def looks_left_out(path: Path) -> set[str]:
    """What a glTF says of its look beside the colours that ``read_gltf_look`` reads."""
    materials = Gltf(path).header.get("materials", [])
    keys = {key for material in materials for key in (*material, *material.get("pbrMetallicRoughness", {}))}
    left_out = {called for key, called in _NOT_CARRIED.items() if key in keys}
    return left_out | {"transparency" for material in materials if material.get("alphaMode", "OPAQUE") != "OPAQUE"}


def _colours_of(file: Gltf, primitive: dict[str, Any]) -> tuple[dict[str, Any], list[float]]:
    """The texture of a primitive's material, {} if it has none, and the factor of its colour."""
    if "material" not in primitive:
        return {}, [1.0, 1.0, 1.0]
    material = file.header["materials"][primitive["material"]]
    older = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
    if older is not None:
        return older.get("diffuseTexture", {}), older.get("diffuseFactor", [1.0, 1.0, 1.0])
    usual = material.get("pbrMetallicRoughness", {})
    return usual.get("baseColorTexture", {}), usual.get("baseColorFactor", [1.0, 1.0, 1.0])


def _material(file: Gltf, primitive: dict[str, Any]) -> GltfMaterial:
    texture, factor = _colours_of(file, primitive)
    red, green, blue = map(float, factor[:3])
    if not texture:
        return GltfMaterial(None, (red, green, blue))
    entry = file.header["textures"][texture["index"]]
    source = entry.get("source", entry.get("extensions", {}).get("EXT_texture_webp", {}).get("source"))
    return GltfMaterial(None if source is None else file.image(source), (red, green, blue))
