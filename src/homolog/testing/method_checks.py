"""The common suite of methods: ``check_method`` runs it on one's own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull

from homolog.core.errors import ArgumentError, HomologError
from homolog.geometry import OperatorCache, Operators
from homolog.maps import wave_kernel_signature
from homolog.matching import Match, Matcher, checked_maps
from homolog.methods import Method, as_method, find_method
from homolog.pairs import MatcherSettings, OperatorSource, Pair, PairOptions
from homolog.shapes import Shape

# Points of the shapes that methods are tried on: enough for 100 eigenpairs, few enough for seconds.
_POINTS = 400
_UNUSED = 30
# A map of a shape to itself must take this share of its points to themselves or to a neighbour.
_NEAR = 0.9
_SPACINGS = 2.0


def check_method(method: Any, *, features: Any = None) -> None:
    """Check that a method keeps the promises of a ``Method``.

    It is tried on small shapes: meshes, clouds and mixed pairs, and a partial shape, as far as it supports them. It
    must give maps of the right form, in the indices of the repaired shapes; change nothing; give equal maps for equal
    input, whatever the order of points; map a shape to itself; and run with the default settings, refinement included.
    What it does not support must not reach it. As in a match, the maps of a bare function are not refined unless its
    attribute ``supports`` says so.

    Args:
        method: a ``Method``, the name of one, or a function of a ``Pair``.
        features: what computes features for it, as ``Matcher`` takes it; by default wave kernel signatures and
            positions, where it needs any.

    Raises:
        AssertionError: naming the promise that is broken, and what was found.

    Examples:
        >>> from homolog.testing import check_method
        >>> check_method("registration")
    """
    with _asserted():
        method = as_method(find_method(method) if isinstance(method, str) else method)
    assert isinstance(method.name, str) and method.name, "name: a method must have one"
    with TemporaryDirectory() as folder:
        checked = _Checked(method, features, OperatorCache(Path(folder)).operators)
        for check in _CHECKS:
            check(checked)


@contextmanager
def _asserted(what: str = "") -> Iterator[None]:
    """What is refused as an argument breaks a promise here."""
    try:
        yield
    except HomologError as error:
        raise AssertionError(f"{what}{error}") from None


@dataclass(frozen=True)
class _Checked:
    """A method, and how it is called; the operators of a shape are computed once."""

    method: Method
    features: Any
    operators: OperatorSource

    def matcher(self, *, refined: bool = False) -> Matcher:
        own = getattr(self.method, "features", None)
        needs = self.method.supports.needs_features and own is None
        given = (_positions_and_signatures if self.features is None else self.features) if needs else None
        settings = MatcherSettings(method=self.method)
        settings = settings if refined else replace(settings, refinement=None)
        return Matcher(given, settings=settings, device="cpu", operators=self.operators)

    def pair(self, source: Shape, target: Shape, **options: Any) -> Pair:
        return self.matcher().pair(source, target, PairOptions(**options))[0]

    def match(self, source: Shape, target: Shape, *, by_default: bool = False) -> Match:
        """A match of shapes that stand alike: refined, and with the way round looked for, by default alone."""
        matcher = self.matcher(refined=by_default)
        pair, _ = matcher.pair(source, target, PairOptions(orient="auto" if by_default else "given"))
        with _asserted(f"{source.name} to {target.name}: "):
            return matcher.find(pair)

    def cases(self) -> Iterator[tuple[str, Shape, Shape]]:
        """Pairs of the modalities that the method supports."""
        x, y = _body(seed=1), _body(seed=2, stretch=1.1)
        yield "two meshes", x, y
        if self.method.supports.clouds:
            yield "two clouds", x.as_cloud(), y.as_cloud()
            yield "mesh and cloud", x, y.as_cloud()


def _positions_and_signatures(operators: Operators) -> torch.Tensor:
    signature = wave_kernel_signature(operators.eigenvalues, operators.eigenvectors, n_energies=20)
    return torch.cat([signature / signature.norm(dim=1, keepdim=True), 3 * operators.points], dim=1)


def _form(checked: _Checked) -> None:
    for what, source, target in checked.cases():
        pair = checked.pair(source, target)
        with _asserted(f"form, {what}: "):
            checked_maps(pair, checked.method(pair))


def _nothing_is_changed(checked: _Checked) -> None:
    for what, source, target in checked.cases():
        pair = checked.pair(source, target)
        before = [{name: tensor.clone() for name, tensor in shape.tensors().items()} for shape in (pair.x, pair.y)]
        checked.method(pair)
        for old, shape in zip(before, (pair.x, pair.y), strict=True):
            for name, tensor in shape.tensors().items():
                same = torch.equal(_numbers(old[name]), _numbers(tensor))
                assert same, f"purity, {what}: it changed {name} of the shape given to it; work on a copy"


def _numbers(tensor: torch.Tensor) -> torch.Tensor:
    """What a tensor holds; of a sparse matrix the entries."""
    return tensor if tensor.layout == torch.strided else tensor.values()


def _same_twice(checked: _Checked) -> None:
    for what, source, target in checked.cases():
        first, second = (checked.match(source, target) for _ in range(2))
        for name in ("source_to_target", "target_to_source"):
            equal = np.array_equal(getattr(first, name), getattr(second, name))
            assert equal, f"determinism, {what}: {name} differs between two calls"


def _indices_are_those_of_the_shapes(checked: _Checked) -> None:
    """Points that no face uses come first, so that every index of a repaired shape is another one's in the file."""
    source, target = _body(seed=1), _body(seed=1)
    assert source.faces is not None
    unused = 5 + np.random.default_rng(3).random((_UNUSED, 3))
    littered = Shape(np.concatenate([unused, source.points]), source.faces + _UNUSED, name="with unused points")
    plain, found = checked.match(source, target), checked.match(littered, target)
    assert len(found.source_to_target) == littered.n_points, (
        f"indices: source_to_target has {len(found.source_to_target)} entries for {littered.n_points} points"
    )
    assert (found.source_to_target[:_UNUSED] == -1).all(), "indices: points that repair leaves out have a counterpart"
    share = float(np.mean(found.source_to_target[_UNUSED:] == plain.source_to_target))
    assert share > _NEAR, f"indices: with unused points, {1 - share:.0%} of the map leads elsewhere"


def _names_of_points_do_not_matter(checked: _Checked) -> None:
    for what, source, target in checked.cases():
        order = np.random.default_rng(0).permutation(source.n_points)
        renamed = _renamed(source, order)
        plain, found = checked.match(source, target), checked.match(renamed, target)
        distances = _distances(target, plain.source_to_target[order], found.source_to_target)
        _mostly_near(f"order of points, {what}", distances, target)


def _a_shape_is_mapped_to_itself(checked: _Checked) -> None:
    for modality in ("mesh", "cloud") if checked.method.supports.clouds else ("mesh",):
        shape = _body(seed=1) if modality == "mesh" else _body(seed=1).as_cloud()
        found = checked.match(shape, shape)
        distances = _distances(shape, np.arange(shape.n_points), found.source_to_target)
        _mostly_near(f"identity, {modality}", distances, shape)


def _default_settings(checked: _Checked) -> None:
    """The way round is looked for then, and what it finds is refined, unless it says otherwise."""
    for _, source, target in checked.cases():
        checked.match(source, target, by_default=True)


def _what_it_does_not_support_is_refused(checked: _Checked) -> None:
    supports, body = checked.method.supports, _body(seed=1)
    cases: tuple[tuple[bool, str, Shape, dict[str, Any]], ...] = (
        (supports.clouds, "a cloud", body.as_cloud(), {}),
        (supports.clouds, "as_cloud", body, {"as_cloud": "both"}),
        (supports.partial, "a partial shape", body, {"partial": "target"}),
    )
    for supported, what, target, options in cases:
        if supported:
            continue
        try:
            checked.pair(body, target, **options)
        except ArgumentError:
            continue
        raise AssertionError(f"supports: it does not support {what}, but is given one")


def _partial_shapes(checked: _Checked) -> None:
    if not checked.method.supports.partial:
        return
    full = _body(seed=1)
    kept = np.flatnonzero(full.points[:, 1] > np.quantile(full.points[:, 1], 0.3))
    assert full.faces is not None
    renumbered = np.full(full.n_points, -1)
    renumbered[kept] = np.arange(len(kept))
    faces = full.faces[np.isin(full.faces, kept).all(axis=1)]
    partial = Shape(full.points[kept], renumbered[faces], name="partial")
    for side, shapes in (("target", (full, partial)), ("source", (partial, full))):
        pair = checked.pair(*shapes, partial=side, pre_aligned=True)
        with _asserted(f"partial {side}: "):
            checked_maps(pair, checked.method(pair))


_CHECKS: tuple[Callable[[_Checked], None], ...] = (
    _form,
    _nothing_is_changed,
    _same_twice,
    _indices_are_those_of_the_shapes,
    _names_of_points_do_not_matter,
    _a_shape_is_mapped_to_itself,
    _default_settings,
    _what_it_does_not_support_is_refused,
    _partial_shapes,
)


def _mostly_near(what: str, distances: Float[np.ndarray, " n"], shape: Shape) -> None:
    # Of the ellipsoid that has the points' variances, roughly.
    area = 4 * np.pi * 3 * shape.points.var(axis=0).prod() ** (1 / 3)
    spacing = np.sqrt(area / shape.n_points)
    share = float(np.mean(distances < _SPACINGS * spacing))
    assert share > _NEAR, f"{what}: {1 - share:.0%} of the points are mapped farther off than two point spacings"


def _distances(shape: Shape, one: Int[np.ndarray, " n"], other: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return np.asarray(np.linalg.norm(shape.points[one] - shape.points[other], axis=1))


def _body(*, seed: int, stretch: float = 1.0) -> Shape:
    """A closed surface without any symmetry, whose points lie on a spiral around it; seeds shake them."""
    steps = np.arange(_POINTS) + 0.5
    height, turn = 1 - 2 * steps / _POINTS, np.pi * (1 + 5**0.5) * steps
    ring = np.sqrt(1 - height**2)
    sphere = np.stack([np.cos(turn) * ring, height, np.sin(turn) * ring], axis=1)
    sphere += 0.1 * np.random.default_rng(seed).standard_normal(sphere.shape) / np.sqrt(_POINTS)
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    x, y, z = sphere.T
    radius = 1 + 0.25 * x * y + 0.2 * np.sin(2 * z + 0.4) + 0.15 * np.cos(3 * x + y + 0.7) + 0.1 * np.sin(2 * x - z)
    return Shape(sphere * radius[:, None] * [1.0, 1.8 * stretch, 0.8], _hull(sphere), name=f"body {seed}")


def _hull(sphere: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, "m 3"]:
    """The triangles of points on a sphere, outward faces counter-clockwise."""
    faces = ConvexHull(sphere).simplices.astype(np.int64)
    a, b, c = (sphere[faces[:, corner]] for corner in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0
    faces[inward] = faces[inward][:, ::-1]
    return np.asarray(faces)


def _renamed(shape: Shape, order: Int[np.ndarray, " n"]) -> Shape:
    """The same surface with its points in another order."""
    if shape.faces is None:
        return Shape(shape.points[order], name="renamed")
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    return Shape(shape.points[order], number[shape.faces], name="renamed")
