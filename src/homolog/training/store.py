"""The shapes of a training: operators at full resolution, computed once, and samples of their bases in memory."""

from __future__ import annotations

import threading
import zlib
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np
import scipy.sparse as sparse
import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.core.cluster import Processes
from homolog.core.errors import ArgumentError, DataError, ShapeError
from homolog.core.files import made_folder
from homolog.core.progress import Progress
from homolog.core.tasks import run_tasks
from homolog.geometry import Basis, Frame, OperatorCache, Operators, unit_frame
from homolog.pairs import OperatorSource
from homolog.shapes import Shape, repair
from homolog.training.clouds import Cloud, cloud_variants, make_cloud
from homolog.training.data import TrainingSet
from homolog.training.losses import NEED_TRUTH
from homolog.training.pairing import interpolation, nearest_columns, nearest_rows
from homolog.training.quantities import TrainingShape
from homolog.training.samples import Samples, at_subsets, subsets
from homolog.training.sampling import SampledShape
from homolog.training.settings import Recipe

MESH = -1
"""Stands for the mesh where others are numbers of cloud variants."""


def unit_mesh(shapes: TrainingSet, name: str) -> tuple[Shape, Frame]:
    """A clean shape, centred and of unit area, and its frame in the coordinates of its file."""
    shape = repair(shapes.shape(name)).shape
    frame = unit_frame(shape)
    return Shape(frame.to_unit(shape.points), shape.faces, name=shape.name), frame


class _Memory:
    """Samples that are kept for as long as they are used more lately than others that fill the memory."""

    def __init__(self, most_bytes: float) -> None:
        self._most_bytes, self._bytes = most_bytes, 0
        self._kept: OrderedDict[tuple[str, int], Samples] = OrderedDict()
        self._lock = threading.Lock()

    @property
    def is_full(self) -> bool:
        return self._bytes >= self._most_bytes

    def get(self, key: tuple[str, int]) -> Samples | None:
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def keep(self, key: tuple[str, int], samples: Samples) -> None:
        with self._lock:
            if key in self._kept:  # another thread was faster
                return
            self._kept[key] = samples
            self._bytes += samples.n_bytes
            while self._bytes > self._most_bytes and len(self._kept) > 1:
                self._bytes -= self._kept.popitem(last=False)[1].n_bytes


class ShapeStore:
    """Gives shapes to train on, from memory as far as they fit there, else from the operators on disk.

    Safe to use from several threads.

    Args:
        shapes: which there are.
        recipe: how they are sampled, and which clouds there are.
        operators: where operators come from; an ``OperatorCache``'s, or every miss computes them anew.
        device: where bases are kept.
        rotations: by which shapes are turned as they are read, each (3, 3), by name; see ``alignment``.
    """

    def __init__(
        self,
        shapes: TrainingSet,
        recipe: Recipe,
        operators: OperatorSource,
        device: torch.device | str = "cpu",
        *,
        rotations: Mapping[str, Float[np.ndarray, "3 3"]] | None = None,
    ) -> None:
        self.shapes, self.recipe, self.operators, self.device = shapes, recipe, operators, device
        self.variants = cloud_variants(recipe.clouds)
        self._seed, self._settings, self._operator_settings = recipe.seed, recipe.samples, recipe.operators
        self._workers = recipe.data.workers
        self._mesh = lru_cache(maxsize=2 * self._workers)(self._read_mesh)
        self._template = lru_cache(maxsize=None)(shapes.template)
        self._is_supervised = any(recipe.loss.weights[name] > 0 for name in NEED_TRUTH)
        self._knows_true_maps = recipe.loss.weights["true_maps"] > 0
        self._template_eigenvectors = lru_cache(maxsize=None)(self._eigenvectors_at_template)
        self.rotations = rotations or {}
        self._frames: dict[str, Frame] = {}
        self._memory = _Memory(recipe.data.memory_gb * 2**30)

    def prepare(self, names: Sequence[str], progress: Progress) -> None:
        """Compute the operators of shapes and all their clouds, so that they are in the cache, and fill the memory.

        Raises:
            ShapeError: if a shape cannot be used.
        """
        pool = ThreadPoolExecutor(self._workers)
        try:
            for done, name in enumerate(pool.map(self._prepare, names), 1):
                progress(done, len(names), f"operators of {name}")
        finally:
            pool.shutdown(cancel_futures=True)

    def keep_operators(self, name: str) -> None:
        """Compute the operators of a shape and all its clouds, so that they are in the cache."""
        for variant in (MESH, *range(len(self.variants))):
            self._operators_of(self._cloud(name, variant).shape)

    def mesh_operators(self, name: str) -> Operators:
        """The operators of a shape itself, at all its points; of unit area, and turned."""
        return self._operators_of(self._mesh(name))

    def shape(self, sampled: SampledShape, *, cloud_on_mesh: bool = False) -> TrainingShape:
        """One shape with one of its clouds, at one of its subsets of points.

        Args:
            sampled: which.
            cloud_on_mesh: leave the cloud where it lies on the mesh, instead of centring it on itself.
        """
        clouds = self.samples(sampled.name, sampled.variant)
        cloud = clouds.bases[sampled.subset]
        if cloud_on_mesh:
            cloud = cloud.moved(clouds.centre)
        meshes = clouds.meshes or self.samples(sampled.name, MESH).bases
        pairing = clouds.pairings[sampled.subset] if clouds.pairings else None
        is_partial = self.variants[sampled.variant].is_partial
        rows = None
        if self._is_supervised:
            indices = clouds.mesh_indices or self.samples(sampled.name, MESH).indices
            rows = self._template_rows(sampled.name, indices[sampled.subset])
        at_template = self._template_eigenvectors(sampled.name) if self._knows_true_maps else None
        return TrainingShape(sampled.name, meshes[sampled.subset], cloud, pairing, is_partial, rows, at_template)

    def _eigenvectors_at_template(self, name: str) -> Float[Tensor, "t k"]:
        """A mesh's eigenvectors at each point of the template, NaN where it has none; as many as maps are of."""
        vertices = torch.from_numpy(self._template(name))
        eigenvectors = self.mesh_operators(name).eigenvectors[:, : self.recipe.loss.map_eigenpairs]
        found = torch.where((vertices >= 0)[:, None], eigenvectors[vertices], torch.nan)
        return found.to(self.device)

    def _template_rows(self, name: str, indices: Int[np.ndarray, " s"]) -> Int[Tensor, " t"]:
        """Where among some points of a mesh each point of the template lies, or -1."""
        vertices = self._template(name)
        rows = np.full(max(vertices.max(initial=-1), indices.max()) + 2, -1)  # the last one is that of -1
        rows[indices] = np.arange(len(indices))
        return torch.from_numpy(rows[vertices]).to(self.device)

    def frame(self, name: str) -> Frame:
        """Centre and scale of a shape, in the coordinates of its file."""
        if name not in self._frames:
            self._mesh(name)
        return self._frames[name]

    def samples(self, name: str, variant: int) -> Samples:
        """The subsets of one of a shape's clouds."""
        samples = self._memory.get((name, variant))
        if samples is None:
            samples = self._sample(name, variant)
            self._memory.keep((name, variant), samples)
        return samples

    def _prepare(self, name: str) -> str:
        for variant in (MESH, *range(len(self.variants))):
            if self._memory.is_full:
                self._operators_of(self._cloud(name, variant).shape)
            else:
                self.samples(name, variant)
        return name

    def _sample(self, name: str, variant: int) -> Samples:
        cloud = self._cloud(name, variant)
        operators = self._operators_of(cloud.shape)
        if cloud.weights is not None:
            return self._sample_apart(name, operators, cloud.weights, is_partial=self.variants[variant].is_partial)
        basis = operators.basis
        indices = subsets(basis, self._settings) if variant == MESH else self.samples(name, MESH).indices
        bases, centre = at_subsets(basis, indices, self.device), torch.zeros(3, device=self.device)
        return Samples(indices, bases, points=basis.points.to(self.device), centre=centre)

    def _sample_apart(self, name: str, cloud: Operators, weights: sparse.csr_array, *, is_partial: bool) -> Samples:
        """Subsets of a cloud whose points are not the mesh's, each with the points of the mesh that belong to them.

        Those are the ones that lie nearest. Of a partial cloud it is the other way round: it has those of the mesh's
        samples that lie on it, beside all of them, as coefficients on the mesh need samples everywhere.
        """
        meshes: tuple[Basis, ...] = ()
        if is_partial:
            columns = self.samples(name, MESH).indices
            rows = tuple(nearest_rows(weights, subset) for subset in columns)
        else:
            rows = subsets(cloud.basis, self._settings)
            if self._settings.points:
                columns = tuple(nearest_columns(weights[subset]) for subset in rows)
            else:
                columns = (np.arange(weights.shape[1]),) * len(rows)
            meshes = at_subsets(self.mesh_operators(name).basis, columns, self.device)
        pairings = (interpolation(weights[i][:, j]).to(self.device) for i, j in zip(rows, columns, strict=True))
        return Samples(
            rows,
            at_subsets(cloud.basis, rows, self.device),
            meshes,
            tuple(pairings),
            columns if meshes else (),
            cloud.points.to(self.device),
            cloud.centre.float().to(self.device),
        )

    def _cloud(self, name: str, variant: int) -> Cloud:
        """One of a shape's clouds, or the mesh itself."""
        mesh = self._mesh(name)
        if variant == MESH:
            return Cloud(mesh, None)
        seed = zlib.crc32(f"{self._seed} {name} {variant}".encode(errors="surrogateescape"))
        try:
            return make_cloud(mesh, self.variants[variant], seed=seed)
        except (ArgumentError, ShapeError) as error:
            raise DataError(f"[clouds] {self.variants[variant]} cannot be made of {name}: {error}") from None

    def _read_mesh(self, name: str) -> Shape:
        """A clean mesh of unit area, turned: what its clouds are made with is in these units."""
        shape, self._frames[name] = unit_mesh(self.shapes, name)
        rotation = self.rotations.get(name)
        return shape if rotation is None else Shape(shape.points @ rotation.T, shape.faces, name=shape.name)

    def _operators_of(self, shape: Shape) -> Operators:
        return self.operators(shape, settings=self._operator_settings, scale=1.0)


def keep_operators(
    shapes: TrainingSet,
    recipe: Recipe,
    operators: OperatorSource,
    processes: Processes,
    *,
    rotations: Mapping[str, Float[np.ndarray, "3 3"]] | None = None,
    progress: Progress,
) -> None:
    """Compute the operators of all shapes of a training and all their clouds in other processes, into their cache.

    Args:
        shapes: which there are.
        recipe: which clouds there are.
        operators: where operators come from; an ``OperatorCache``'s, in a folder that all processes see.
        processes: number of worker processes, or a cluster.
        rotations: as for ``ShapeStore``.
        progress: told of each shape.

    Raises:
        ArgumentError: if operators come from no cache, or a worker of a cluster cannot see what it needs.
        ShapeError: if a shape cannot be used.
    """
    cache = getattr(operators, "__self__", None)
    if not isinstance(cache, OperatorCache):
        raise ArgumentError("operators come from no cache that a cluster could fill; give an OperatorCache's operators")
    keep = _Keeping(shapes, recipe, operators, rotations or {})
    tasks = [(f"operators of {name}", partial(keep, name)) for name in shapes.used]
    reads = [*{file.parent for file in shapes.files.values()}, made_folder(cache.folder)]
    run_tasks([tasks], processes=processes, progress=progress, reads=reads, writes=cache.folder)


@dataclass(frozen=True, eq=False)
class _Keeping:
    """Computes the operators of a shape and its clouds; picklable, for worker processes."""

    shapes: TrainingSet
    recipe: Recipe
    operators: OperatorSource
    rotations: Mapping[str, Float[np.ndarray, "3 3"]]

    def __call__(self, name: str) -> None:
        self._store.keep_operators(name)

    @cached_property
    def _store(self) -> ShapeStore:
        """Of this process."""
        return ShapeStore(self.shapes, self.recipe, self.operators, rotations=self.rotations)
