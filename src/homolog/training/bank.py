"""The shapes of a training made ready: operators at full resolution, computed once, and samples of their bases."""

from __future__ import annotations

import threading
import zlib
from collections import OrderedDict, deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import TypeVar

import numpy as np
import scipy.sparse as sparse
import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.core.errors import ArgumentError, DataError, ShapeError
from homolog.core.progress import Progress
from homolog.datasets import Pair
from homolog.geometry import Basis, Frame, Operators, unit_frame
from homolog.maps import registered_positions
from homolog.pairs import OperatorSource
from homolog.shapes import Shape, repair
from homolog.training.clouds import Cloud, cloud_variants, make_cloud
from homolog.training.data import TrainingSet
from homolog.training.objective import TrainingShape
from homolog.training.plan import Draw, Member
from homolog.training.recipe import Recipe
from homolog.training.samples import at_points, subsets

T = TypeVar("T")

# Pairs whose clouds drawn onto each other are kept: of 6,000 points they take 150 MB.
_MOST_SKINS = 1000
# Stands for the mesh where others are numbers of cloud variants.
_MESH = -1
_STEPS_AHEAD = 4


@dataclass(frozen=True, eq=False)
class TrainingPair:
    """A pair as a step trains on it.

    Args:
        draw: what was drawn.
        x: one shape.
        y: the other.
        registration_targets: where y's cloud lies once it is registered to x's, both with all of their points (n_y, 3);
            None where no loss asks for it.
    """

    draw: Draw
    x: TrainingShape
    y: TrainingShape
    registration_targets: Float[Tensor, "n_y 3"] | None = None


@dataclass(frozen=True, eq=False)
class _Samples:
    """Subsets of a mesh, or of one of its clouds.

    Args:
        kept: indices of the points of each subset.
        bases: there.
        meshes: the bases of the mesh that belong to them, where they are not those of the mesh's own subsets.
        pairings: the interpolation from those to the cloud's points.
        whole: all points, in the coordinates of the bases (n, 3).
        centre: of the points that the bases are centred at, in the mesh's inner coordinates (3,).
    """

    kept: tuple[Int[np.ndarray, " s"], ...]
    bases: tuple[Basis, ...]
    meshes: tuple[Basis, ...] = ()
    pairings: tuple[Tensor, ...] = ()
    whole: Float[Tensor, "n 3"] = field(default_factory=lambda: torch.zeros(0, 3))
    centre: Float[Tensor, " 3"] = field(default_factory=lambda: torch.zeros(3))

    @property
    def n_bytes(self) -> int:
        return self.whole.nbytes + sum(_bytes(basis) for basis in (*self.bases, *self.meshes))


class ShapeBank:
    """Gives shapes to train on, from memory as far as they fit there, else from the operators on disk.

    Safe to use from several threads.

    Args:
        shapes: which there are.
        recipe: how they are sampled, and which clouds there are.
        operators: where operators come from; an ``OperatorCache``'s, or every miss computes them anew.
        device: where bases are kept.
    """

    def __init__(
        self, shapes: TrainingSet, recipe: Recipe, operators: OperatorSource, device: torch.device | str = "cpu"
    ) -> None:
        self.shapes, self.recipe, self.device = shapes, recipe, device
        self.variants = cloud_variants(recipe.clouds)
        self.operators = operators
        self._mesh = lru_cache(maxsize=2 * recipe.data.workers)(self._read_mesh)
        self._drawn = lru_cache(maxsize=_MOST_SKINS)(self._draw_onto_each_other)
        self._frames: dict[str, Frame] = {}
        self._kept: OrderedDict[tuple[str, int], _Samples] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def prepare(self, names: Sequence[str], progress: Progress) -> None:
        """Compute the operators of shapes and all their clouds, so that they are in the cache, and fill the memory.

        Raises:
            ShapeError: if a shape cannot be used.
        """
        pool = ThreadPoolExecutor(self.recipe.data.workers)
        try:
            for done, name in enumerate(pool.map(self._prepare, names), 1):
                progress(done, len(names), f"operators of {name}")
        finally:
            pool.shutdown(cancel_futures=True)

    def pairs(self, draws: Sequence[Draw]) -> list[TrainingPair]:
        """The pairs that were drawn; partial ones with the complete shape first, and both at its scale."""
        return [self._pair(draw) for draw in draws]

    def whole_first(self, pair: Pair) -> Pair:
        """A pair of shapes in the order that a step takes them in: where one may be a part, the larger one first."""
        if self.recipe.partial is None:
            return pair
        first, second = (self._frame(name).scale for name in pair)
        return pair if first >= second else (pair[1], pair[0])

    def _frame(self, name: str) -> Frame:
        if name not in self._frames:
            self._mesh(name)
        return self._frames[name]

    def shape(self, member: Member) -> TrainingShape:
        """One shape with one of its clouds, at one of its subsets of points."""
        clouds = self._samples(member.name, member.variant)
        cloud, is_part = clouds.bases[member.subset], self.variants[member.variant].is_part
        if self._in_place:
            cloud = cloud.moved(clouds.centre)
        meshes = clouds.meshes or self._samples(member.name, _MESH).bases
        pairing = clouds.pairings[member.subset] if clouds.pairings else None
        return TrainingShape(member.name, meshes[member.subset], cloud, pairing, is_part)

    def _pair(self, draw: Draw) -> TrainingPair:
        x, y = self.shape(draw.x), self.shape(draw.y)
        if self.recipe.partial is None:
            return TrainingPair(draw, x, y, self._registration_targets(draw.x, draw.y))
        first, _ = self.whole_first((draw.x.name, draw.y.name))
        if first != draw.x.name:
            draw, x, y = replace(draw, x=draw.y, y=draw.x), y, x
        whole, part = self._frames[draw.x.name], self._frames[draw.y.name]
        y = _changed(y, lambda basis: basis.scaled(part.scale / whole.scale))
        if self._in_place:
            away = torch.from_numpy(whole.to_unit(part.centre)).float().to(self.device)
            y = _changed(y, lambda basis: basis.moved(away))
        return TrainingPair(draw, x, y)

    def _registration_targets(self, x: Member, y: Member) -> Float[Tensor, "n_y 3"] | None:
        if not self.recipe.loss.registration or any(self.variants[member.variant].is_part for member in (x, y)):
            return None
        first, second = sorted([(x.name, x.variant), (y.name, y.variant)])
        on_second, on_first = self._drawn(first, second)
        on_x = on_first if first == (x.name, x.variant) else on_second
        kept = self._samples(y.name, y.variant).kept[y.subset]
        return on_x[torch.from_numpy(kept).to(on_x.device)]

    def _draw_onto_each_other(
        self, first: tuple[str, int], second: tuple[str, int]
    ) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "m 3"]]:
        return registered_positions(self._samples(*first).whole, self._samples(*second).whole)

    @property
    def _in_place(self) -> bool:
        return self.recipe.partial is not None and bool(self.recipe.partial.pre_aligned)

    def _prepare(self, name: str) -> str:
        for variant in (_MESH, *range(len(self.variants))):
            if self._bytes < self._most_bytes:
                self._samples(name, variant)
            else:
                self._operators_of(self._source(name, variant).shape)
        return name

    @property
    def _most_bytes(self) -> float:
        return self.recipe.data.memory_gb * 2**30

    def _samples(self, name: str, variant: int) -> _Samples:
        with self._lock:
            if (name, variant) in self._kept:
                self._kept.move_to_end((name, variant))
                return self._kept[name, variant]
        samples = self._sample(name, variant)
        with self._lock:
            self._keep((name, variant), samples)
        return samples

    def _keep(self, key: tuple[str, int], samples: _Samples) -> None:
        if key in self._kept:  # another thread was faster
            return
        self._kept[key] = samples
        self._bytes += samples.n_bytes
        while self._bytes > self._most_bytes and len(self._kept) > 1:
            self._bytes -= self._kept.popitem(last=False)[1].n_bytes

    def _sample(self, name: str, variant: int) -> _Samples:
        source = self._source(name, variant)
        operators = self._operators_of(source.shape)
        if source.weights is not None:
            return self._sample_apart(name, operators, source.weights, is_part=self.variants[variant].is_part)
        basis = operators.basis
        kept = subsets(basis, self.recipe.samples) if variant == _MESH else self._samples(name, _MESH).kept
        return _Samples(kept, self._at_all(basis, kept), whole=basis.points.to(self.device))

    def _sample_apart(self, name: str, cloud: Operators, weights: sparse.csr_array, *, is_part: bool) -> _Samples:
        """Subsets of a cloud whose points are not the mesh's, each with the points of the mesh that belong to them.

        Those are the ones that lie nearest. Of a part it is the other way round: it has those of the mesh's samples
        that lie on it, beside all of them, as coefficients on the mesh need samples everywhere.
        """
        kept: tuple[Int[np.ndarray, " s"], ...]
        meshes: tuple[Basis, ...] = ()
        if is_part:
            near = self._samples(name, _MESH).kept
            kept = tuple(_nearest_rows(weights, subset) for subset in near)
        else:
            kept = subsets(cloud.basis, self.recipe.samples)
            near = tuple(self._near(weights[subset]) for subset in kept)
            meshes = self._at_all(self._operators_of(self._mesh(name)).basis, near)
        pairings = (_pairing(weights[rows][:, columns]) for rows, columns in zip(kept, near, strict=True))
        return _Samples(
            kept,
            self._at_all(cloud.basis, kept),
            meshes,
            tuple(pairing.to(self.device) for pairing in pairings),
            cloud.points.to(self.device),
            cloud.centre.float().to(self.device),
        )

    def _source(self, name: str, variant: int) -> Cloud:
        mesh = self._mesh(name)
        if variant == _MESH:
            return Cloud(mesh, None)
        seed = zlib.crc32(f"{self.recipe.seed} {name} {variant}".encode())
        try:
            return make_cloud(mesh, self.variants[variant], seed=seed)
        except (ArgumentError, ShapeError) as error:
            raise DataError(f"[clouds] {self.variants[variant]} cannot be made of {name}: {error}") from None

    def _read_mesh(self, name: str) -> Shape:
        """A clean mesh of unit area: what its clouds are made with is in these units."""
        shape = repair(self.shapes.shape(name)).shape
        frame = unit_frame(shape)
        self._frames[name] = frame
        return Shape(frame.to_unit(shape.points), shape.faces, name=shape.name)

    def _operators_of(self, shape: Shape) -> Operators:
        return self.operators(shape, settings=self.recipe.operators, scale=1.0)

    def _near(self, weights: sparse.csr_array) -> Int[np.ndarray, " s"]:
        """For each point of a cloud the point of the mesh with the largest weight; or all, where all are wanted."""
        if self.recipe.samples.points == 0:
            return np.arange(weights.shape[1])
        nearest: np.ndarray = np.unique(weights.argmax(axis=1))
        return nearest

    def _at_all(self, basis: Basis, subsets: Sequence[Int[np.ndarray, " s"]]) -> tuple[Basis, ...]:
        """A basis at each of several subsets of its points."""
        return tuple(at_points(basis, kept).to(self.device) for kept in subsets)


def _nearest_rows(weights: sparse.csr_array, subset: Int[np.ndarray, " s"]) -> Int[np.ndarray, " r"]:
    """For each of these points of a mesh the point of a part that lies nearest, if any is nearer to no other point."""
    places, largest = weights.argmax(axis=1), weights.max(axis=1).toarray().ravel()
    order = np.lexsort((-largest, places))
    _, first = np.unique(places[order], return_index=True)
    rows: np.ndarray = np.sort(order[first])
    return rows[np.isin(places[rows], subset)]


def _pairing(weights: sparse.csr_array) -> Tensor:
    """Weights of the mesh's points at the cloud's as a sparse tensor, each row of sum one."""
    weights = weights.multiply(1 / weights.sum(axis=1)[:, None]).tocoo()
    places = torch.from_numpy(np.stack([weights.row, weights.col]).astype(np.int64))
    values = torch.from_numpy(weights.data).float()
    return torch.sparse_coo_tensor(places, values, weights.shape, check_invariants=False)


def _changed(shape: TrainingShape, change: Callable[[Basis], Basis]) -> TrainingShape:
    return replace(shape, mesh=change(shape.mesh), cloud=change(shape.cloud))


def _bytes(basis: Basis) -> int:
    tensors = (getattr(basis, field.name) for field in fields(basis))
    return sum(tensor.numel() * tensor.element_size() for tensor in tensors)


def prefetched(load: Callable[[int], T], steps: Sequence[int], *, workers: int) -> Generator[T, None, None]:
    """What ``load`` gives for each step, in order, loaded by threads while the caller works on earlier ones."""
    pool = ThreadPoolExecutor(workers)
    try:
        waiting: deque[Future[T]] = deque()
        for step in steps:
            waiting.append(pool.submit(load, step))
            if len(waiting) > _STEPS_AHEAD:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)
