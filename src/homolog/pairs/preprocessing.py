"""Preprocessing one shape for matching: repair, operators, features."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, get_args

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike
from torch import Tensor

from homolog.core.arguments import check_choice, check_kind
from homolog.core.choices import KeepClutter, Orient, Side, UseProxy
from homolog.core.errors import ArgumentError, ShapeError, bad_value
from homolog.core.progress import Timings
from homolog.core.reprs import named_function
from homolog.core.unchanged import left_unchanged
from homolog.features import FeatureExtractor, Orientation, checked_features, computed_features
from homolog.geometry import (
    MASKED,
    ClutterSettings,
    Operators,
    OperatorSettings,
    Surface,
    compute_operators,
    outward,
    restricted,
    set_apart,
    unit_frame,
)
from homolog.maps import normalised, rotation_angle
from homolog.pairs.masks import Mask
from homolog.pairs.options import PairOptions
from homolog.pairs.proxy import with_proxy
from homolog.pairs.settings import OrientationSettings, ProxySettings
from homolog.shapes import Finding, Modality, Repaired, Shape, Up, mirrored, repair, stand_upright

OperatorSource = Callable[..., Operators]
"""A function like ``compute_operators``: the operators of a clean shape, from wherever they come."""

_log = logging.getLogger(__name__)

# Shapes of so many points are said to need memory, in bytes: of the process itself, and of each point. Measured.
_MANY, _OF_ITSELF, _PER_POINT = 500_000, 0.5 * 2**30, 1400

# Where faces use fewer of a shape's points, they do not say how large the cloud of all of them is.
_SHARE_WITH_FACES = 0.95


@dataclass(frozen=True, eq=False)
class PreprocessedShape:
    """A shape that was repaired, with its operators and features; it can be matched any number of times.

    Args:
        given: the shape as it was given, whose indices and coordinates users see.
        repaired: the clean shape, upright, and the way back to the points as given.
        operators: of the clean shape.
        features: per clean point (n, d); None for methods that need none.
        up: the axis of the shape as given that was turned to +y.
        orientations: ways to turn the shape from there that its features' orienter found, the best first.
        rotation: the one that the operators' positions were turned by (3, 3).
        mask: how much its points as given count; None where all count alike.
        channels: what landmarks add to features of unit norm (n, c), of one norm everywhere; None without landmarks.
    """

    given: Shape
    repaired: Repaired
    operators: Operators
    features: Float[Tensor, "n d"] | None = None
    up: Up = "y"
    orientations: tuple[Orientation, ...] = ()
    rotation: Float[Tensor, "3 3"] = field(default_factory=lambda: torch.eye(3))
    channels: Float[Tensor, "n c"] | None = None
    mask: Mask | None = None

    @property
    def name(self) -> str:
        """How messages call the shape."""
        return self.given.name

    @property
    def n_left_out(self) -> int:
        """How many points of the shape as given repair left out, so that nothing was asked of them."""
        return int((self.repaired.clean_index < 0).sum())

    @property
    def modality(self) -> Modality:
        """``"mesh"`` or ``"cloud"``."""
        return self.repaired.shape.modality

    @property
    def point_weights(self) -> Float[Tensor, " n"] | None:
        """How much each clean point counts; None where all count alike."""
        if self.mask is None or not self.mask.is_graded:
            return None
        return torch.from_numpy(self.mask.weights[self.repaired.kept]).to(self.operators.points)

    @property
    def points_as_given(self) -> Float[Tensor, "n 3"]:
        """The operators' positions before anything turned them (n, 3): those of the file, upright and normalised."""
        return self.operators.points @ self.rotation.to(self.operators.points)

    @cached_property
    def surface(self) -> Surface | None:
        """The triangles at the operators' positions, in their precision; None for a cloud."""
        faces = self.repaired.shape.faces
        return None if faces is None else Surface(self.operators.points.cpu().numpy(), faces)

    def check_made_for(self, options: PairOptions, side: Side) -> None:
        """Refuse options of a pair that this shape, as its source or target, was not preprocessed for.

        Raises:
            ArgumentError: naming the option, and what to give to ``Matcher.preprocess``.
        """
        if options.is_cloud(side) and self.modality == "mesh":
            raise ArgumentError(
                f"as_cloud is {options.as_cloud!r}, but the {side} was preprocessed as a mesh; "
                "give as_cloud=True to Matcher.preprocess"
            )
        if options.up(side) not in (PairOptions().up(side), self.up):
            raise ArgumentError(
                f"{side}_up is {options.up(side)!r}, but the {side} was preprocessed with {self.up!r} up; "
                f"give up={options.up(side)!r} to Matcher.preprocess"
            )
        if options.mask(side) is not None and self.mask is None:
            raise ArgumentError(
                f"{side}_mask is given, but the {side} was preprocessed without; give mask=Mask(...) to "
                "Matcher.preprocess"
            )

    def tensors(self) -> dict[str, Tensor]:
        """All tensors that methods are lent, by their names."""
        own = {"features": self.features, "landmark channels": self.channels}
        return {**self.operators.tensors(), **{name: tensor for name, tensor in own.items() if tensor is not None}}

    def needed_features(self) -> Float[Tensor, "n d"]:
        """The features, where a method cannot do without them; with landmarks their channels, in the size of features.

        Raises:
            ArgumentError: if there are none.
        """
        if self.features is None:
            raise ArgumentError(f"{self.name} has no features, but the method needs them; give weights or features")
        if self.channels is None:
            return self.features
        size = self.features.square().sum(dim=1).mean().sqrt()
        return torch.cat([self.features, size * self.channels], dim=1)

    def unit_features(self) -> Float[Tensor, "n d"]:
        """Features of unit norm, with the channels of landmarks behind them.

        Where there are no features, what is the same everywhere and tells no points apart.
        """
        found = self.operators.points.new_zeros(self.operators.n_points, 1)
        if self.features is not None:
            found = normalised(self.features)
        return found if self.channels is None else torch.cat([found, self.channels], dim=1)

    def turned(self, rotation: Float[Tensor, "3 3"], extractor: FeatureExtractor | None) -> PreprocessedShape:
        """The shape turned by another rotation than it is now, with the features of that pose.

        Args:
            rotation: from the upright shape (3, 3).
            extractor: computes features; None where there are none.
        """
        if torch.equal(rotation, self.rotation):
            return self
        operators = self.operators.turned(rotation @ self.rotation.T)
        features = Preprocessor(extractor=extractor).features(operators, shape=self.name)
        return replace(self, operators=operators, features=features, rotation=rotation)

    def as_given(self, extractor: FeatureExtractor | None) -> PreprocessedShape:
        """The shape in the pose in which it was given, whatever its features' orienter found; see ``turned``."""
        return replace(self.turned(torch.eye(3), extractor), orientations=())

    def to_dict(self) -> dict[str, Any]:
        """What was found in the shape, what was done about it, and how its eigenpairs were found, for JSON."""
        eigenpairs = {"number": self.operators.n_eigenpairs, "method": self.operators.method}
        masked = {} if self.mask is None else {"mask": self.mask.name}
        return {**self.repaired.report.to_dict(), "eigenpairs": eigenpairs, **masked}

    def __repr__(self) -> str:
        clean = f"{self.operators.n_points} of {self.given.n_points} points"
        width = "no" if self.features is None else self.features.shape[1]
        return f"PreprocessedShape({self.name!r}: {self.modality}, {clean}, {width} features)"


@dataclass(frozen=True, kw_only=True, eq=False)
class Preprocessor:
    """How shapes are preprocessed: by which operators, on which device, with which features.

    Args:
        extractor: computes features; None for methods that need none.
        settings: what operators to compute.
        device: where.
        source: where operators come from; an ``OperatorCache``'s ``operators`` keeps them on disk.
        orientation: how a shape is turned that the features' orienter finds to stand another way.
        clutter: where the bounds of what does not belong to a shape lie.
        proxies: when a surface around a mesh is matched in its place, and how it is made.
    """

    extractor: FeatureExtractor | None = None
    orientation: OrientationSettings = field(default_factory=OrientationSettings)
    clutter: ClutterSettings = field(default_factory=ClutterSettings)
    proxies: ProxySettings = field(default_factory=ProxySettings)
    settings: OperatorSettings = field(default_factory=OperatorSettings)
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    source: OperatorSource = compute_operators

    def __post_init__(self) -> None:
        if not callable(self.source):
            raise ArgumentError(
                f"operators is {type(self.source).__name__}, but must be a function like homolog.compute_operators, "
                "such as an OperatorCache's operators"
            )

    def __call__(
        self,
        shape: Shape,
        *,
        as_cloud: bool = False,
        up: Up = "y",
        scale: float | None = None,
        centre: ArrayLike | None = None,
        features: ArrayLike | None = None,
        orient: Orient = "auto",
        partial: bool = False,
        mirror: bool = False,
        clutter: KeepClutter = "remove",
        proxy: UseProxy = "auto",
        mask: Mask | None = None,
        strict: bool = False,
        timings: Timings | None = None,
        label: str = "shape",
    ) -> PreprocessedShape:
        """Repair a shape and compute its operators and features.

        Args:
            shape: as it was read.
            as_cloud: leave the faces out, but keep the scale that they give.
            up: which of its axes points up.
            scale: what one unit of the normalised coordinates is in the file's; by default sqrt(surface area).
            centre: the origin of the normalised coordinates, in those of the upright shape (3,); by default the mean of
                its points.
            features: of each point of the shape as given (n, d), in place of the extractor's.
            orient: ``"auto"`` turns the shape as the features' orienter, if they have one, finds it to stand.
            partial: the shape is partial: only features that know partial shapes tell how it stands.
            mirror: reflect the shape first; points keep their numbers.
            clutter: ``"remove"`` sets apart what does not belong to the shape, see ``homolog.geometry.find_clutter``.
            proxy: ``"auto"`` matches a surface around a mesh in loose shells in its place, see ``ProxySettings``.
            mask: how much each point as given counts; those with 0 are left out.
            strict: refuse a shape that needs repair.
            timings: collects time and memory of each step.
            label: what the steps call the shape.

        Raises:
            ArgumentError: if it is no shape, ``up`` no axis, or there are not as many features as points.
            ShapeError: if the shape cannot be used, or is refused.
        """
        check_kind(label, shape, Shape)
        check_choice("orient", orient, get_args(Orient))
        check_choice("clutter", clutter, get_args(KeepClutter))
        check_choice("proxy", proxy, get_args(UseProxy))
        if mask is not None:
            mask.check_fits(shape)
        timings = timings or Timings()
        if shape.n_points >= _MANY and proxy != "never":
            needs = (_OF_ITSELF + _PER_POINT * shape.n_points) / 2**30
            _log.warning("the %s has %d points: matching it needs some %.0f GB of memory", label, shape.n_points, needs)
        with timings.measure(f"repair {label}"):
            upright = stand_upright(shape, up)
            repaired, as_cloud = _repaired(mirrored(upright) if mirror else upright, as_cloud=as_cloud)
            repaired = repaired if mask is None else masked(repaired, mask)
            if clutter == "remove":
                repaired = set_apart(repaired, self.clutter, partial=partial)
            severe = next((each for each in repaired.report.findings if each.severity != "note"), None)
            if strict and severe is not None:
                raise ShapeError(f"{repaired.shape.name}: {severe} (refused as strict)")
            repaired = replace(repaired, shape=_facing_outward(repaired.shape))
        with timings.measure(f"proxy of {label}"):
            is_open = partial or mask is not None
            repaired = with_proxy(repaired, proxy, self.proxies, as_cloud=as_cloud, partial=is_open)
        with timings.measure(f"operators of {label}"):
            operators = self.operators(repaired.shape, as_cloud=as_cloud, scale=scale)
            operators = operators if centre is None else operators.around(_position("centre", centre))
        with timings.measure(f"orientation of {label}"):
            turns = orient == "auto" and features is None and centre is None
            orientations = self.orientations(operators, partial=partial) if turns else ()
            rotation = _best_rotation(orientations)
            operators = operators.turned(rotation)
        with timings.measure(f"features of {label}"):
            if features is None:
                found = self.features(operators, shape=label)
            else:
                given = checked_features(repr(shape.name), features, operators.points, shape.n_points)
                found = given[torch.from_numpy(repaired.kept).to(given.device)]
        if as_cloud:
            repaired = replace(repaired, shape=repaired.shape.as_cloud())
        return PreprocessedShape(shape, repaired, operators, found, up, orientations, rotation, mask=mask)

    @torch.no_grad()
    def again(self, shape: PreprocessedShape, *, orient: Orient = "auto", partial: bool = False) -> PreprocessedShape:
        """A shape with the features of this preprocessor in place of another's, as their orienter finds it to stand.

        Args:
            shape: preprocessed with other features, by the same operators.
            orient: as in ``__call__``.
            partial: likewise.
        """
        upright = shape.operators.turned(shape.rotation.T)
        orientations = () if orient == "given" else self.orientations(upright, partial=partial)
        rotation = _best_rotation(orientations)
        turned = upright.turned(rotation)
        features = self.features(turned, shape=shape.name)
        return replace(shape, operators=turned, features=features, orientations=orientations, rotation=rotation)

    def operators(self, shape: Shape, *, as_cloud: bool = False, scale: float | None = None) -> Operators:
        """The operators of a clean shape, on the device."""
        check_kind("shape", shape, Shape)
        if as_cloud:
            scale = scale or unit_frame(shape).scale
            shape = shape.as_cloud()
        return self.source(shape, settings=self.settings, scale=scale).to(self.device)

    def orientations(self, operators: Operators, *, partial: bool = False) -> tuple[Orientation, ...]:
        """Ways to turn a shape that the features' orienter finds, the best first; none where they have no orienter."""
        orienter = getattr(self.extractor, "orienter", None)
        if self.extractor is None or orienter is None or (partial and not self.extractor.info.partial):
            return ()
        found = [_kept_if_near(orientation, self.orientation.least_degrees) for orientation in orienter(operators)]
        likely = found[0].misfit + self.orientation.given_margin
        as_given = (each for each in found if each.misfit < likely and torch.equal(each.rotation, torch.eye(3)))
        given = next(as_given, None)
        return tuple(found) if given is None else (given,)

    @torch.no_grad()
    def without(self, shape: PreprocessedShape, left: Bool[np.ndarray, " n"], finding: Finding) -> PreprocessedShape:
        """A shape with some of its clean points alone, turned as it is, at its own scale.

        Args:
            shape: without a proxy.
            left: which of its clean points stay (n,).
            finding: what to say of the others.

        Raises:
            ShapeError: if what stays is no shape.
        """
        repaired = restricted(shape.repaired, left, [finding])
        mass = shape.operators.mass.double().cpu().numpy()
        scale = shape.operators.scale * float(np.sqrt(mass[left].sum() / mass.sum()))
        operators = self.operators(repaired.shape, scale=scale).turned(shape.rotation)
        found = self.features(operators, shape=shape.name)
        return replace(shape, repaired=repaired, operators=operators, features=found, channels=None)

    @torch.no_grad()
    def features(self, operators: Operators, *, shape: str = "") -> Float[Tensor, "n d"] | None:
        """Features per point (n, d); zero on small components, of which operators know the position alone.

        Args:
            operators: of the shape.
            shape: what messages call it.

        Raises:
            ArgumentError: if the extractor fails, or does not give one finite row per point.
        """
        check_kind("operators", operators, Operators)
        if self.extractor is None:
            return None
        name = named_function(self.extractor.info.name, self.extractor)
        try:
            with left_unchanged(f"what computes the features {name}", operators.tensors()):
                values = computed_features(self.extractor, operators)
            found = checked_features(name, values, operators.points, operators.n_points)
        except ArgumentError as error:
            raise ArgumentError(f"{shape}: {error}" if shape else str(error)) from (error.__cause__ or error)
        return found * operators.in_main_component[:, None]


def _best_rotation(orientations: Sequence[Orientation]) -> Float[Tensor, "3 3"]:
    return orientations[0].rotation if orientations else torch.eye(3)


def _kept_if_near(orientation: Orientation, degrees: float) -> Orientation:
    """As the shape is given, where that is nearly the same: poses differ, and features bear small turns."""
    if rotation_angle(orientation.rotation) > degrees:
        return replace(orientation, rotation=orientation.rotation.cpu())
    return replace(orientation, rotation=torch.eye(3))


def _position(name: str, given: ArrayLike) -> Float[Tensor, " 3"]:
    """A position that a user gave."""
    try:
        values = np.array(given.detach().cpu().numpy() if isinstance(given, Tensor) else given, dtype=float)
    except (TypeError, ValueError):
        values = np.full(3, np.nan)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise bad_value(name, given, "three finite numbers, the coordinates of a point")
    return torch.from_numpy(values)


def _repaired(shape: Shape, *, as_cloud: bool) -> tuple[Repaired, bool]:
    """A repaired shape, and whether its faces are still to be dropped, which only give its scale.

    They do not where they are unusable, or are those of a part alone: a cloud's points need no faces.
    """
    if not as_cloud:
        return repair(shape), False
    try:
        repaired = repair(shape)
    except ShapeError:
        return repair(shape.as_cloud()), False
    n_used = repaired.shape.n_points
    # Points that repair takes out count, too: where few have faces, the cloud as repaired tells how many there were.
    if n_used < _SHARE_WITH_FACES * shape.n_points:
        cloud = repair(shape.as_cloud())
        if n_used < _SHARE_WITH_FACES * cloud.shape.n_points:
            return cloud, False
    return repaired, True


def masked(repaired: Repaired, mask: Mask) -> Repaired:
    """A repaired shape without the points that a mask leaves out; points at one place are left out together.

    Args:
        repaired: a clean shape, and the way back to the one it was made from.
        mask: of the points of that one.

    Raises:
        ShapeError: if what is left is no shape.
    """
    left = np.ones(repaired.shape.n_points, dtype=bool)
    left[repaired.clean_index[~mask.kept & (repaired.clean_index >= 0)]] = False
    if left.all():
        return repaired
    said = Finding(MASKED, int((~mask.kept).sum()), "note", f"set apart, as {mask.name} says")
    try:
        return restricted(repaired, left, [said])
    except ShapeError as error:
        raise ShapeError(f"what {mask.name} leaves of {repaired.shape.name} is too little: {error}") from None


def _facing_outward(shape: Shape) -> Shape:
    """A closed mesh that is inside out with its faces turned round: features know which side is out."""
    if shape.faces is None or outward(Surface(shape.points, shape.faces)) >= 0:
        return shape
    return replace(shape, faces=shape.faces[:, ::-1])
