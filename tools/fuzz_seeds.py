"""Small valid files of every kind that Homolog reads: what ``tools/fuzz.py`` damages.

They come from Homolog itself and from other libraries, so that dialects differ. A file whose reader needs others beside
it lies in a folder of its own.
"""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyvista
import scipy.io
import SimpleITK
import torch
import trimesh
from PIL import Image

import homolog
from homolog import Match, OperatorCache, Shape
from homolog.features import DiffusionNet, FeatureInfo, NetworkSettings, save_weights
from homolog.geometry import OperatorSettings
from homolog.shapes.formats.gltf import GlbWriter

OPERATORS = OperatorSettings(n_eigenpairs=8)
_RECIPE = """name = "tiny"
seed = 3
[samples]
points = 100
subsets = 1
[network]
width = 8
blocks = 1
out_channels = 8
[operators]
n_eigenpairs = 16
[clouds]
noise = [0.01]
[optimiser]
betas = [0.9, 0.99]
[training]
steps = 2
[data]
leave_out = ["a*"]
"""
_DESCRIPTION = """title = "Teeth"
citation = "Authors, Title, Journal year"
source = "https://example.org"
terms = "CC BY 4.0"
shapes = "scans/tooth_*.ply"
truth_files = "points/tooth_*.vts"
up = "z"
split = "last"
n_test = 10
pairs = "every"
"""


class Seed(NamedTuple):
    """A valid file and how it is read.

    Args:
        file: in a folder of its own with what its reader needs beside it.
        reader: one of ``tools/fuzz.py``.
        often: how often it is drawn, compared with others.
    """

    file: Path
    reader: str
    often: int = 1


def body() -> Shape:
    """The shape in nearly all of the files, 42 points and 80 faces."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    points = ball.vertices * [1.0, 1.6, 0.7]
    return Shape(points + 0.15 * np.sin(2 * points[:, [1, 2, 0]]), ball.faces, name="body")


def make_seeds(folder: Path) -> list[Seed]:
    """Write all seeds below a folder."""
    shape, seeds = body(), list[Seed]()

    def place(name: str) -> Path:
        path = folder / str(len(list(folder.iterdir()))) / name
        path.parent.mkdir(parents=True)
        return path

    folder.mkdir(parents=True, exist_ok=True)
    seeds += _shapes(place, shape)
    seeds += _polygons_and_tables(place, shape)
    seeds += _looks(place, shape)
    seeds += _volumes(place)
    seeds += _networks(place, shape)
    seeds += _arrays(place, shape)
    seeds += _texts(place)
    return seeds + _results(place, shape)


def _shapes(place: Any, shape: Shape) -> list[Seed]:
    """Every format that is written, by Homolog and by others."""
    found = list[Path]()
    for suffix in homolog.shapes.writable_suffixes():
        found.append(place(f"own{suffix}"))
        cloud = suffix in (".xyz", ".txt", ".csv", ".npy", ".pcd")
        homolog.write_shape(found[-1], shape.as_cloud() if cloud else shape)
    mesh = trimesh.Trimesh(shape.points, shape.faces, process=False)
    for kind, suffix in (("off", "off"), ("obj", "obj"), ("glb", "glb"), ("stl_ascii", "stl"), ("ply", "ply")):
        found.append(place(f"trimesh.{suffix}"))
        mesh.export(found[-1], file_type=kind)
    found.append(place("text.ply"))
    found[-1].write_bytes(trimesh.exchange.ply.export_ply(mesh, encoding="ascii"))
    poly = pyvista.wrap(mesh)
    grid = poly.cast_to_unstructured_grid()
    for data, suffix in ((poly, ".vtk"), (poly, ".vtp"), (grid, ".vtk"), (grid, ".vtu"), (poly.strip(), ".vtp")):
        found.append(place(f"text{suffix}"))
        data.save(found[-1], binary=False)
    return [Seed(path, "shape", 1 if path.suffix.startswith(".vt") else 3) for path in found]


def _polygons_and_tables(place: Any, shape: Shape) -> list[Seed]:
    assert shape.faces is not None
    pairs = [place("mixed.ply"), place("named.csv"), place("chemists.xyz"), place("mixed.off"), place("text.pcd")]
    xyz = "".join(f"property double {axis}\n" for axis in "xyz")
    head = f"ply\nformat binary_big_endian 1.0\nelement vertex {shape.n_points}\n{xyz}property list uchar float extra\n"
    head += f"element face {shape.n_faces}\nproperty uchar flag\nproperty list ushort uint vertex_index\nend_header\n"
    rows = b"".join(row.astype(">f8").tobytes() + b"\1" + bytes(4) for row in shape.points)
    corners = [face.tolist() + [int(face[0])] * (number % 2) for number, face in enumerate(shape.faces)]
    polygons = [b"\0" + np.array([len(face)], ">u2").tobytes() + np.array(face, ">u4").tobytes() for face in corners]
    pairs[0].write_bytes(head.encode() + rows + b"".join(polygons))
    lines = [" ".join(f"{value:.6f}" for value in row) for row in shape.points]
    pairs[1].write_text("id;x;y;z\n" + "\n".join(f"{i};{line.replace(' ', ';')}" for i, line in enumerate(lines)))
    pairs[2].write_text(f"{len(lines)}\na comment\n" + "\n".join(f"C {line}" for line in lines))
    faces = [f"{len(face)} {' '.join(map(str, face))}" for face in corners]
    pairs[3].write_text("\n".join([f"OFF\n{shape.n_points} {shape.n_faces} 0", *lines, *faces]))
    head = f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(lines)}\nHEIGHT 1\n"
    head += f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(lines)}\nDATA ascii\n"
    pairs[4].write_text(head + "\n".join(lines))
    return [Seed(path, "shape", 3) for path in pairs]


def _looks(place: Any, shape: Shape) -> list[Seed]:
    """A textured OBJ with its files, a glTF with a buffer beside it and one inside, and a skinned GLB."""
    obj, inside, beside, skinned = place("textured.obj"), place("inside.gltf"), place("beside.gltf"), place("skin.glb")
    assert shape.faces is not None
    image, library = obj.with_name("skin.png"), obj.with_name("textured.mtl")
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (8, 8, 3), dtype=np.uint8)).save(image)
    library.write_text("newmtl one\nKd 0.5 0.5 0.5\nmap_Kd skin.png\n")
    lines = [f"v {x} {y} {z} 0.1 0.2 0.3" for x, y, z in shape.points] + ["vt 0 0", "vt 1 0", "vt 0 1", "usemtl one"]
    lines += [f"f {a + 1}/1 {b + 1}/2 {c + 1}/3" for a, b, c in shape.faces]
    obj.write_text("\n".join(["mtllib textured.mtl", *lines]) + "\n")
    homolog.write_shape(inside.with_suffix(".glb"), shape)
    content = inside.with_suffix(".glb").read_bytes()
    inside.with_suffix(".glb").unlink()
    end = 20 + int.from_bytes(content[12:16], "little")
    header, buffer = json.loads(content[20:end]), content[end + 8 :]
    header["buffers"][0]["uri"] = f"data:;base64,{base64.b64encode(buffer).decode()}"
    inside.write_text(json.dumps(header))
    header["buffers"][0]["uri"] = "beside.bin"
    beside.write_text(json.dumps(header))
    beside.with_suffix(".bin").write_bytes(buffer)
    _write_skinned(skinned, shape)
    of_obj = [Seed(path, "look", 2) for path in (obj, image, library)]
    return [*of_obj, *(Seed(path, "shape", 3) for path in (obj, inside, beside)), Seed(skinned, "skin", 4)]


def _write_skinned(path: Path, shape: Shape) -> None:
    assert shape.faces is not None
    glb, n_points = GlbWriter(), shape.n_points
    joints, weights = np.tile(np.array([0, 1, 0, 0], "u1"), (n_points, 1)), np.zeros((n_points, 4), "<f4")
    weights[:, :2] = 0.25, 0.75
    attributes = {"POSITION": glb.accessor(shape.points.astype("<f4"), bounds=True)}
    attributes |= {"JOINTS_0": glb.accessor(joints), "WEIGHTS_0": glb.accessor(weights)}
    indices = glb.accessor(shape.faces.ravel().astype("<u4"), indices=True)
    inverse = glb.accessor(np.tile(np.eye(4, dtype="<f4").ravel(), (2, 1)), vertices=False)
    glb.add("meshes", {"primitives": [{"attributes": attributes, "indices": indices}]})
    for node in ({"mesh": 0, "skin": 0}, {"name": "root", "children": [2]}, {"name": "arm", "translation": [0, 1, 0]}):
        glb.add("nodes", node)
    glb.add("skins", {"joints": [1, 2], "inverseBindMatrices": inverse})
    glb.add("scenes", {"nodes": [0, 1]})
    path.write_bytes(glb.content())


def _volumes(place: Any) -> list[Seed]:
    mask = np.zeros((9, 10, 11), np.uint8)
    mask[2:6, 3:7, 2:8] = 1
    image = SimpleITK.GetImageFromArray(mask)
    names = ("v.mhd", "v.mha", "v.nii", "v.nii.gz", "v.nrrd", "v.nhdr", "packed.mha", "packed.nrrd", "packed.mhd")
    found = [place(name) for name in names]
    for path in found:
        SimpleITK.WriteImage(image, str(path), useCompression=path.name.startswith("packed"))
    return [Seed(path, "volume", 3) for path in found]


def _networks(place: Any, shape: Shape) -> list[Seed]:
    """Weights of ours, of another project's layout, and an entry of the cache."""
    torch.manual_seed(0)
    network = DiffusionNet(NetworkSettings(width=8, blocks=1, out_channels=8))
    own, published, cache = place("tiny.safetensors"), place("tiny.pth"), place("cache")
    save_weights(own, network, FeatureInfo(n_eigenpairs=16, map_eigenpairs=8))
    theirs = {"first.": "first_linear.", "last.": "last_linear.", "times": "diffusion.diffusion_time"}
    theirs |= {"real": "gradient_features.A_re", "imaginary": "gradient_features.A_im"}
    theirs |= {"perceptron.": "mlp.miniMLP_linear_00"}
    tensors = {}
    for name, tensor in network.state_dict().items():
        for ours, other in theirs.items():
            name = name.replace(ours, other, 1)
        tensors[name] = tensor
    torch.save({"networks": {"feature_extractor": tensors}}, published)
    OperatorCache(cache).operators(shape, settings=OPERATORS)
    (entry,) = cache.iterdir()
    return [Seed(own, "weights", 4), Seed(published, "weights", 4), Seed(entry, "cache", 4)]


def _arrays(place: Any, shape: Shape) -> list[Seed]:
    """A value for each point, and maps from point to point."""
    values, packed, matlab, truth = place("array.npy"), place("map.npz"), place("map.mat"), place("map.vts")
    indices = np.arange(shape.n_points)
    np.save(values, indices.astype(float))
    np.savez_compressed(packed, target_to_source=indices, source_to_target=indices)
    scipy.io.savemat(matlab, {"target_to_source": indices + 1, "first_index": 1}, do_compression=True)
    truth.write_text("\n".join(map(str, [*(indices[:40] + 1).tolist(), -1])) + "\n")
    return [Seed(values, "array", 3), *(Seed(path, "map", 3) for path in (packed, matlab, truth)), Seed(truth, "truth")]


def _texts(place: Any) -> list[Seed]:
    fcsv, table, markups = place("marks.fcsv"), place("marks.csv"), place("marks.mrk.json")
    recipe, description = place("recipe.toml"), place("description.toml")
    head = "# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n"
    head += "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
    fcsv.write_text(head + "1,0.1,0.2,0.3,0,0,0,1,1,1,0,F-1,,\n2,1,1,1,0,0,0,1,1,1,0,F-2,,\n")
    table.write_text("name,x,y,z\na,0.1,0.2,0.3\nb,1,1,1\n")
    point = {"id": "1", "label": "F-1", "position": [0.1, 0.2, 0.3], "positionStatus": "defined"}
    tree = {"markups": [{"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": [point]}]}
    markups.write_text(json.dumps(tree, indent=1))
    recipe.write_text(_RECIPE)
    description.write_text(_DESCRIPTION)
    marks = [Seed(path, "landmarks", 2) for path in (fcsv, table, markups)]
    return [*marks, Seed(recipe, "recipe", 4), Seed(description, "description", 3)]


def _results(place: Any, shape: Shape) -> list[Seed]:
    folder, taller = place("match"), Shape(shape.points * [1.0, 1.1, 1.0], shape.faces, name="taller")
    found: Match = homolog.match(shape, taller, method="axiomatic")
    found.save(folder)
    return [Seed(folder / name, "result", 4) for name in ("report.json", "correspondence.npz", "source.ply")]
