"""Make the quadruped of the package: one closed skin with a skeleton, from the skinned dog of dm_control.

Run from the root of the checkout::

    pip download --no-deps dm_control==1.0.50
    pip download --no-deps --python-version 3.11 --only-binary :all: infinigen==1.15.5
    python tools/make_quadruped.py dm_control-1.0.50-*.whl infinigen-1.15.5-*.whl

Both wheels are read as archives; nothing of them is installed. The same versions of the packages give the same bytes.
"""

from __future__ import annotations

import argparse
import io
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyvista
from scipy import ndimage
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from skimage.measure import marching_cubes
from vtkmodules.vtkImagingStencil import vtkImageStencilToImage, vtkPolyDataToImageStencil

from homolog.geometry import edge_graph
from homolog.geometry.surface import ReferenceSurface, Surface
from homolog.synthesis.remeshing import MeshSettings, is_one_closed_surface, remesh

_SKIN = "dm_control/locomotion/walkers/assets/dog_v2/dog_skin.skn"
_FORMS = "infinigen/assets/objects/creatures/parts/nurbs_data/"
_HEADS = (
    "carnivore_wolf",
    "carnivore_tiger",
    "herbivore_cow",
    "herbivore_giraffe",
    "herbivore_goat",
    "herbivore_llama",
)
_BODIES = (
    *("feline_wolf", "feline_cheetah", "feline_housecat", "feline_tiger", "feline_tiger_2"),
    *("herbivore_cow", "herbivore_giraffe", "herbivore_goat", "herbivore_llama"),
)
_OUTPUT = Path(__file__).parents[1] / "src" / "homolog" / "synthesis" / "animal_data" / "quadruped.npz"

# The dog is +z up and faces +x; Homolog's shapes are +y up and face +z. All lengths are in metres.
_TO_UPRIGHT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
# The jaw is turned about this point, which closes the mouth; what is left open is closed by a ball of this radius,
# below this height and in front of this depth.
_JAW_DEGREES, _JAW_HINGE = -30.0, np.array([0.0, 0.655, 0.335])
_MOUTH_RADIUS, _MOUTH_BELOW, _MOUTH_FROM = 0.0075, 0.69, 0.36
_VOXEL, _MARGIN = 0.0015, 8
# Vertices this near to the dog's own skin move onto it.
_NEAR = 0.003
_VERTICES = 13000
# Edge lengths relative to the trunk's, by the prefix of the bone's name.
_FINER = {"skull": 0.6, "foot": 0.65, "toe": 0.5, "hand": 0.6, "finger": 0.5, "C_1": 0.8, "Ca_": 0.35, "lower": 0.7}
# Horns grow out of a patch around this point of the left side, which is meshed finely.
_HORN, _HORN_RADIUS, _HORN_DETAIL = np.array([0.024, 0.746, 0.335]), 0.018, 0.16
# The balls that contain the left ear, and the left corner of the mouth, where the jaw was turned.
_EAR, _EAR_RADIUS, _EAR_DETAIL = np.array([0.064, 0.757, 0.292]), 0.042, 0.4
_MOUTH_CORNER, _MOUTH_CORNER_RADIUS = np.array([0.025, 0.655, 0.385]), 0.03
# An ear reaches this far from its tip along the skin, and ends smoothly over this length.
_EAR_LENGTH, _EAR_RIM = 0.105, 0.03
_WEIGHTS = 6
_WEIGHT_ROUNDS, _TOE_ROUNDS = 12, 60
# How wide and how long hooves are, relative to toes.
_HOOF = np.array([0.9, 0.72])
# Rounds and steps of smoothing without shrinkage, of all but faces and toes.
_SKIN_ROUNDS, _SKIN_STEPS = 25, (0.5, -0.53)


@dataclass(frozen=True)
class Skinned:
    """A mesh whose vertices follow bones.

    Args:
        surface: the mesh.
        weights: of each vertex (rows) and bone.
        bones: their names.
        joints: the origin of each bone.
    """

    surface: Surface
    weights: np.ndarray
    bones: tuple[str, ...]
    joints: np.ndarray

    def of(self, start: str) -> np.ndarray:
        """The weight at each vertex of all bones whose names begin so."""
        return np.asarray(self.weights[:, [bone.startswith(start) for bone in self.bones]].sum(axis=1))


def read_skin(content: bytes) -> Skinned:
    """Read a skin file of MuJoCo; vertices that differ in their texture alone are joined."""
    stream = io.BytesIO(content)

    def numbers(count: int, dtype: str) -> np.ndarray:
        return np.frombuffer(stream.read(4 * count), dtype=dtype)

    n_vertices, n_texture, n_faces, n_bones = numbers(4, "<i4")
    vertices = numbers(3 * n_vertices, "<f4").reshape(-1, 3)
    numbers(2 * n_texture, "<f4")
    faces = numbers(3 * n_faces, "<i4").reshape(-1, 3)
    weights, names, joints = np.zeros((n_vertices, n_bones)), [], []
    for bone in range(n_bones):
        names.append(stream.read(40).split(b"\0")[0].decode())
        joints.append(numbers(7, "<f4")[:3])  # a rotation follows, which is none
        (count,) = numbers(1, "<i4")
        moved = numbers(count, "<i4")
        weights[moved, bone] = numbers(count, "<f4")
    _, first, joined = np.unique(vertices.round(7), axis=0, return_index=True, return_inverse=True)
    surface = Surface(vertices[first].astype(float) @ _TO_UPRIGHT.T, joined.ravel()[faces])
    weights = weights[first] / weights[first].sum(axis=1, keepdims=True)
    return Skinned(surface, weights, tuple(names), np.array(joints, dtype=float) @ _TO_UPRIGHT.T)


def with_closed_mouth(dog: Skinned) -> Skinned:
    """The dog with its jaw turned up."""
    vertices = dog.surface.vertices
    turned = Rotation.from_euler("x", _JAW_DEGREES, degrees=True).apply(vertices - _JAW_HINGE) + _JAW_HINGE
    closed = vertices + dog.of("jaw")[:, None] * (turned - vertices)
    return replace(dog, surface=Surface(closed, dog.surface.faces))


def outer_surface(surface: Surface) -> Surface:
    """The outside of a mesh, by voxels: nothing is left of the mouth's inside, and the lips are joined."""
    low = surface.vertices.min(axis=0) - _MARGIN * _VOXEL
    inside = _voxels(surface, low)
    front = int((_MOUTH_FROM - 2 * _MOUTH_RADIUS - low[2]) / _VOXEL)
    head = inside[:, :, front:]
    grown = ndimage.distance_transform_edt(~head) * _VOXEL <= _MOUTH_RADIUS
    closed = ndimage.distance_transform_edt(grown) * _VOXEL > _MOUTH_RADIUS
    heights, depths = (low[axis] + _VOXEL * np.arange(inside.shape[axis]) for axis in (1, 2))
    mouth = ((heights > 0.5) & (heights < _MOUTH_BELOW))[:, None] & (depths[front:] > _MOUTH_FROM)
    head |= closed & mouth
    whole = ndimage.binary_fill_holes(inside)
    labels, _ = ndimage.label(whole)
    largest = labels == np.bincount(labels.ravel())[1:].argmax() + 1
    smooth = ndimage.gaussian_filter(largest.astype(np.float32), 1.0)
    cubes: Any = marching_cubes
    vertices, faces, _, _ = cubes(smooth, 0.5, spacing=(_VOXEL,) * 3)
    return Surface(vertices.astype(float) + low, faces[:, ::-1].astype(np.int64))


def _voxels(surface: Surface, low: np.ndarray) -> np.ndarray:
    shape = tuple((np.ceil(np.ptp(surface.vertices, axis=0) / _VOXEL).astype(int) + 2 * _MARGIN).tolist())
    stencil: Any = vtkPolyDataToImageStencil()
    stencil.SetInputData(pyvista.PolyData.from_regular_faces(surface.vertices, surface.faces))
    stencil.SetOutputOrigin(*low)
    stencil.SetOutputSpacing(_VOXEL, _VOXEL, _VOXEL)
    stencil.SetOutputWholeExtent(0, shape[0] - 1, 0, shape[1] - 1, 0, shape[2] - 1)
    image: Any = vtkImageStencilToImage()
    image.SetInputConnection(stencil.GetOutputPort())
    image.SetInsideValue(1)
    image.Update()
    voxels: Any = pyvista.wrap(image.GetOutput())
    return np.asarray(voxels.active_scalars).reshape(shape, order="F") > 0


def meshed(dog: Skinned) -> Surface:
    """The dog's outside as a mesh of its own, on the dog's skin where that is near."""
    outside = outer_surface(dog.surface)
    _, nearest = cKDTree(dog.surface.vertices).query(outside.vertices)
    finer = [next((length for start, length in _FINER.items() if bone.startswith(start)), 1.0) for bone in dog.bones]
    detail = (dog.weights @ np.array(finer))[nearest]
    apart = np.linalg.norm(_folded(outside.vertices) - _HORN, axis=1)
    detail = np.minimum(detail, np.interp(apart, [_HORN_RADIUS, 3 * _HORN_RADIUS], [_HORN_DETAIL, 1.0]))
    detail = np.minimum(detail, np.where(_at_ear(outside.vertices), _EAR_DETAIL, 1.0))
    mesh = remesh(ReferenceSurface(outside), detail, MeshSettings(_VERTICES), np.random.default_rng(0))
    on_skin = ReferenceSurface(dog.surface).project(mesh.vertices, mesh.vertex_normals, around=4)
    moved = on_skin.positions(dog.surface)
    near = np.linalg.norm(moved - mesh.vertices, axis=1) < _NEAR
    return smoothed(Surface(np.where(near[:, None], moved, mesh.vertices), mesh.faces), dog)


def _folded(points: np.ndarray) -> np.ndarray:
    """Both sides on the left one."""
    return np.column_stack([np.abs(points[:, 0]), points[:, 1:]])


def _at_ear(points: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(_folded(points) - _EAR, axis=1) < _EAR_RADIUS)


def smoothed(mesh: Surface, dog: Skinned) -> Surface:
    """Smooth all but the face and the toes, yet the mouth and the ears, too.

    G. Taubin, "A signal processing approach to fair surface design" (SIGGRAPH 1995).
    """
    _, nearest = cKDTree(dog.surface.vertices).query(mesh.vertices)
    kept = (dog.of("skull") + dog.of("jaw") + dog.of("toe") + dog.of("finger")).clip(0, 1)[nearest]
    mouth = np.linalg.norm(_folded(mesh.vertices) - _MOUTH_CORNER, axis=1) < _MOUTH_CORNER_RADIUS
    kept = np.where(mouth | _at_ear(mesh.vertices), 0.0, kept)
    vertices, means = mesh.vertices, averaging(mesh)
    for _ in range(_SKIN_ROUNDS):
        for step in _SKIN_STEPS:
            vertices = vertices + step * (1 - kept)[:, None] * (means @ vertices - vertices)
    return Surface(vertices, mesh.faces)


def averaging(surface: Surface) -> csr_matrix:
    """The matrix that gives the mean over each vertex's neighbours."""
    adjacent = (edge_graph(surface.vertices, surface.faces) > 0).astype(float)
    return csr_matrix(adjacent.multiply(1.0 / adjacent.sum(axis=1)))


def skinned(dog: Skinned, surface: Surface) -> Skinned:
    """Bones for a mesh near the dog's skin: smooth weights, and bones for the ears."""
    at = ReferenceSurface(dog.surface).project(surface.vertices, surface.vertex_normals, around=4)
    weights = np.einsum("pc,pcb->pb", at.weights, dog.weights[dog.surface.faces[at.triangles]])
    bones = list(dog.bones)
    into = {"jaw": "skull", "foot_anchor_L": "foot_L", "foot_anchor_R": "foot_R"}
    into |= {f"hand_anchor_{side}": f"lower_arm_{side}" for side in "LR"}
    for source, target in into.items():
        weights[:, bones.index(target)] += weights[:, bones.index(source)]
    kept = [bone for bone in bones if bone not in into]
    columns = [bones.index(bone) for bone in kept]
    weights, joints, means = weights[:, columns], dog.joints[columns], averaging(surface)
    for _ in range(_WEIGHT_ROUNDS):
        weights = (weights + means @ weights) / 2
    graph = edge_graph(surface.vertices, surface.faces)
    for side, sign in (("L", 1.0), ("R", -1.0)):
        tip = np.where(sign * surface.vertices[:, 0] > 0.02, surface.vertices[:, 1], 0.0).argmax()
        reach = dijkstra(graph, directed=False, indices=tip)
        share = ((_EAR_LENGTH - reach) / _EAR_RIM).clip(0, 1)
        share = share**2 * (3 - 2 * share)
        rim = np.abs(reach - (_EAR_LENGTH - _EAR_RIM / 3)) < 0.006
        weights = np.column_stack([weights * (1 - share)[:, None], share])
        joints = np.vstack([joints, surface.vertices[rim].mean(axis=0)])
        kept.append(f"ear_{side}")
    return Skinned(surface, weights, tuple(kept), joints)


def hooves(animal: Skinned) -> np.ndarray:
    """What must be added to the vertices so that the toes become hooves: smooth cones, flat from below."""
    vertices, means = animal.surface.vertices.copy(), averaging(animal.surface)
    for bone in ("finger_L", "finger_R", "toe_L", "toe_R"):
        share = (1.5 * animal.of(bone)).clip(0, 1)[:, None]
        joint = animal.joints[animal.bones.index(bone)]
        middle = vertices[share[:, 0] > 0.9].mean(axis=0)
        size = np.ptp(vertices[share[:, 0] > 0.9], axis=0)
        for _ in range(_TOE_ROUNDS):
            vertices += share * (means @ vertices - vertices)
        shrunk = np.ptp(vertices[share[:, 0] > 0.9], axis=0)
        grown = middle + (vertices - middle) * (0.95 * size / shrunk)
        low = ((joint[1] + 0.01 - grown[:, 1]) / (joint[1] + 0.01)).clip(0, 1)
        grown[:, [0, 2]] = middle[[0, 2]] + (grown - middle)[:, [0, 2]] * (0.8 + 0.3 * low)[:, None] * _HOOF
        grown[:, 1] = np.maximum(grown[:, 1], 0.002)
        vertices += share * (grown - vertices)
    return np.asarray(vertices - animal.surface.vertices)


def write(animal: Skinned, forms: dict[str, np.ndarray]) -> None:
    """Write the file of the package."""
    strongest = np.argsort(-animal.weights, axis=1, kind="stable")[:, :_WEIGHTS]
    weights = np.take_along_axis(animal.weights, strongest, axis=1)
    arrays = {
        "vertices": animal.surface.vertices.astype(np.float32),
        "faces": animal.surface.faces.astype(np.uint16),
        "bones": np.array(animal.bones),
        "joints": animal.joints.astype(np.float32),
        "bone_of": strongest.astype(np.uint8),
        "weight": (weights / weights.sum(axis=1, keepdims=True)).astype(np.float16),
        "hoof": hooves(animal).astype(np.float16),
        **{name: grid.astype(np.float32) for name, grid in forms.items()},
    }
    _OUTPUT.parent.mkdir(exist_ok=True)
    np.savez_compressed(_OUTPUT, allow_pickle=False, **arrays)
    print(f"{_OUTPUT}: {len(animal.surface.vertices)} vertices, {_OUTPUT.stat().st_size // 1024} KiB")


def read_forms(wheel: zipfile.ZipFile) -> dict[str, np.ndarray]:
    """The control grids of bodies and heads."""
    names = [*(f"head_{name}" for name in _HEADS), *(f"body_{name}" for name in _BODIES)]
    return {name: np.load(io.BytesIO(wheel.read(f"{_FORMS}{name}.npy")), allow_pickle=False) for name in names}


def main() -> None:
    """Read the wheels, and write the file."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("dm_control", type=Path, help="wheel")
    parser.add_argument("infinigen", type=Path, help="wheel")
    arguments = parser.parse_args()
    with zipfile.ZipFile(arguments.dm_control) as wheel:
        dog = with_closed_mouth(read_skin(wheel.read(_SKIN)))
    surface = meshed(dog)
    assert is_one_closed_surface(surface)
    with zipfile.ZipFile(arguments.infinigen) as wheel:
        write(skinned(dog, surface), read_forms(wheel))


if __name__ == "__main__":
    main()
