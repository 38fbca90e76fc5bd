"""Matching two shapes: shape -> operators -> features -> map, by the route their modalities ask for."""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import NoneType
from typing import get_args

import torch
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from scipy.spatial import KDTree
from torch import Tensor

from homolog.core.arguments import check_kind
from homolog.core.errors import ArgumentError, ShapeError, bad_choice
from homolog.core.progress import Timings
from homolog.features import DEFAULT_WEIGHTS, DiffusionNet, WeightsInfo, load_weights
from homolog.geometry import Operators, OperatorSettings, compute_operators, unit_frame
from homolog.maps import (
    confidence,
    most_similar,
    nearest_neighbour,
    normalised,
    overlap,
    point_map_from_functional_map,
    registered_positions,
    sinkhorn_matches,
    zoomout,
    zoomout_partial,
)
from homolog.matching.axiomatic import axiomatic_descriptors, axiomatic_problem
from homolog.matching.checks import (
    blaming,
    check_method,
    check_part,
    check_word,
    doubts,
    refuse_repairs,
    units_that_differ,
)
from homolog.matching.correspondence import Correspondence, Route
from homolog.matching.map_problem import MapProblem
from homolog.matching.orientation import axiomatic_warnings, orientation_warnings
from homolog.matching.placement import placed
from homolog.matching.prepared import PointMaps, Prepared
from homolog.matching.quality import MapQuality, quality
from homolog.matching.settings import NEED_NO_WEIGHTS, AsCloud, Device, MatcherSettings, Side, choose_device
from homolog.shapes import Modality, Repaired, Shape, Up, repair, stand_upright

_log = logging.getLogger(__name__)

# Where faces use fewer of a shape's points, they do not say how large the cloud of all of them is.
_SHARE_WITH_FACES = 0.95
# Eigenpairs of the functional map to a part, with weights that were trained on complete shapes.
_PARTIAL_SIZE = 50

OperatorSource = Callable[..., Operators]
"""A function like ``compute_operators``: the operators of a clean shape, from wherever they come."""


class Matcher:
    """Finds correspondences, with a trained network or without one.

    Every step can be called on its own: ``prepare`` (repair, operators, features), ``functional_maps``,
    ``match_prepared``; ``match`` is all of them.

    Args:
        network: a trained network, or None for the routes that need none, axiomatic and elastic.
        info: what its weights expect.
        settings: how maps are made.
        device: where the network and the maps run.
        operators: where operators come from; pass an ``OperatorCache``'s ``operators`` to keep them on disk.

    Raises:
        ArgumentError: if something given is of another kind, or the method needs a network.
    """

    def __init__(
        self,
        network: DiffusionNet | None = None,
        info: WeightsInfo | None = None,
        *,
        settings: MatcherSettings | None = None,
        device: Device | torch.device = "auto",
        operators: OperatorSource = compute_operators,
    ) -> None:
        check_kind("network", network, DiffusionNet, NoneType)
        check_kind("info", info, WeightsInfo, NoneType)
        check_kind("settings", settings, MatcherSettings, NoneType)
        self.settings = settings or MatcherSettings()
        self.device = choose_device(device)
        self.info = info or WeightsInfo()
        if network is not None and self.settings.method in NEED_NO_WEIGHTS:
            _log.warning(
                "The %s method does not use weights; the given ones, %s, are left aside.",
                self.settings.method,
                self.info.name,
            )
            network, self.info = None, WeightsInfo()
        if not self.info.near_isometric:
            self.settings = replace(self.settings, refine=False)
        self.network = None if network is None else network.to(self.device).eval()
        if not callable(operators):
            raise ArgumentError(
                f"operators is {type(operators).__name__}, but must be a function like homolog.compute_operators, "
                "such as an OperatorCache's operators"
            )
        self._operators = operators
        if network is None and self.settings.method in ("functional-map", "nearest-features"):
            raise ArgumentError(
                f"method {self.settings.method!r} needs weights; give some, or use 'axiomatic' or 'registration'"
            )

    @classmethod
    def from_weights(
        cls,
        weights: str | Path = DEFAULT_WEIGHTS,
        *,
        settings: MatcherSettings | None = None,
        device: Device | torch.device = "auto",
        operators: OperatorSource = compute_operators,
    ) -> Matcher:
        """A matcher with weights from a file, or with weights that ship with the package, by their name.

        By default it has those for people.

        Raises:
            ArgumentError: if something given is of another kind.
            WeightsError: if there are no such weights, or the file does not hold any.
        """
        network, info = load_weights(weights)
        return cls(network, info, settings=settings, device=device, operators=operators)

    def with_network(self, network: DiffusionNet) -> Matcher:
        """A matcher that differs in its network alone."""
        other = copy.copy(self)
        other.network = network.to(self.device).eval()
        return other

    @property
    def operator_settings(self) -> OperatorSettings:
        """What operators are computed: as set, or as the weights were trained with."""
        info = self.info
        return self.settings.operators or OperatorSettings(info.n_eigenpairs, info.laplacian, info.n_neighbours)

    def map_size(self, *, partial: bool) -> int:
        """Eigenpairs of a functional map from the network's features."""
        if not partial:
            return self.settings.map_eigenpairs or self.info.map_eigenpairs
        return self.settings.partial_eigenpairs or (self.info.map_eigenpairs if self.info.partial else _PARTIAL_SIZE)

    def route(self, source: Modality, target: Modality) -> Route:
        """How two shapes of these modalities are matched."""
        if self.settings.method != "auto":
            return self.settings.method
        if self.network is None:
            return "axiomatic"
        return "functional-map" if source == target == "mesh" and self.info.near_isometric else "nearest-features"

    def prepare(
        self,
        shape: Shape,
        *,
        as_cloud: bool = False,
        up: Up = "y",
        scale: float | None = None,
        centre: ArrayLike | None = None,
        strict: bool = False,
        timings: Timings | None = None,
        label: str = "shape",
    ) -> Prepared:
        """Repair a shape and compute its operators and features.

        Args:
            shape: as it was read.
            as_cloud: leave the faces out, but keep the scale that they give.
            up: which of its axes points up.
            scale: the file length of one inner unit; by default sqrt(surface area).
            centre: what lies at the middle of the network's coordinates, in those of the upright shape (3,); by default
                the mean of its points.
            strict: refuse a shape that needs repair.
            timings: collects time and memory of each step.
            label: what the steps call the shape.

        Raises:
            ArgumentError: if it is no shape, or ``up`` no axis.
            ShapeError: if the shape cannot be used, or is refused.
        """
        check_kind(label, shape, Shape)
        timings = timings or Timings()
        with timings.measure(f"repair {label}"):
            repaired, as_cloud = _repaired(stand_upright(shape, up), as_cloud=as_cloud)
            if strict:
                refuse_repairs(repaired)
        with timings.measure(f"operators of {label}"):
            operators = self.operators(repaired.shape, as_cloud=as_cloud, scale=scale)
            operators = operators if centre is None else operators.around(torch.as_tensor(centre))
        with timings.measure(f"features of {label}"):
            features = self.features(operators)
        if as_cloud:
            repaired = replace(repaired, shape=repaired.shape.as_cloud())
        return Prepared(repaired, operators, features, up)

    def operators(self, shape: Shape, *, as_cloud: bool = False, scale: float | None = None) -> Operators:
        """The operators of a clean shape, on this matcher's device."""
        check_kind("shape", shape, Shape)
        if as_cloud:
            scale = scale or unit_frame(shape).scale
            shape = shape.as_cloud()
        return self._operators(shape, settings=self.operator_settings, scale=scale).to(self.device)

    @torch.inference_mode()
    def features(self, operators: Operators) -> Float[Tensor, "n d"]:
        """The network's features per point (n, d), or descriptors where the route is axiomatic."""
        check_kind("operators", operators, Operators)
        if self.network is None:
            return axiomatic_descriptors(operators)
        features: Tensor = self.network(operators.points, operators)
        # Of debris the network knows the position alone: it must not look like anything.
        return features * operators.in_main_component[:, None]

    def match(
        self,
        source: Shape,
        target: Shape,
        *,
        as_cloud: AsCloud | None = None,
        partial: Side | None = None,
        partial_scale: float = 1.0,
        pre_aligned: bool = False,
        source_up: Up = "y",
        target_up: Up = "y",
        strict: bool = False,
        timings: Timings | None = None,
    ) -> Correspondence:
        """Find for every point of each shape its counterpart on the other.

        Args:
            source: a mesh or cloud in any state; never changed.
            target: another.
            as_cloud: which of the two to use without its faces.
            partial: which of the two, if any, is a part of a shape like the other. Points of the complete one that have
                no counterpart then get -1.
            partial_scale: what the partial shape's lengths are multiplied by to be in the full shape's units: 0.001
                for a partial shape in millimetres and a full one in metres.
            pre_aligned: the partial shape is already aligned with the full one; otherwise its pose does not count.
            source_up: which axis of the source points up.
            target_up: which axis of the target.
            strict: stop at anything to repair or to warn of.
            timings: collects time and memory of each step.

        Raises:
            ArgumentError: if something given is not a shape, such a word, or a factor.
            ShapeError: if a shape cannot be used, or ``strict`` forbids it.
        """
        timings = timings or Timings()
        prepared = self.prepare_pair(
            source,
            target,
            as_cloud=as_cloud,
            partial=partial,
            partial_scale=partial_scale,
            pre_aligned=pre_aligned,
            source_up=source_up,
            target_up=target_up,
            strict=strict,
            timings=timings,
        )
        return self.match_checked(*prepared, partial=partial, strict=strict, timings=timings)

    def prepare_pair(
        self,
        source: Shape,
        target: Shape,
        *,
        as_cloud: AsCloud | None = None,
        partial: Side | None = None,
        partial_scale: float = 1.0,
        pre_aligned: bool = False,
        source_up: Up = "y",
        target_up: Up = "y",
        strict: bool = False,
        timings: Timings | None = None,
    ) -> tuple[Prepared, Prepared]:
        """Prepare two shapes for each other: a partial one takes its partner's scale; see ``match``."""
        check_word("as_cloud", as_cloud, get_args(AsCloud))
        check_word("partial", partial, get_args(Side))
        check_method(self.settings.method, partial)
        check_part(partial, partial_scale=partial_scale, pre_aligned=pre_aligned)
        shapes: dict[Side, Shape] = {"source": source, "target": target}
        ups: dict[Side, Up] = {"source": source_up, "target": target_up}
        for side in shapes:
            check_kind(side, shapes[side], Shape)
            if ups[side] not in get_args(Up):
                raise bad_choice(f"{side}_up", str(ups[side]), get_args(Up))
        order: tuple[Side, Side] = ("target", "source") if partial == "source" else ("source", "target")
        prepared: dict[Side, Prepared] = {}
        scale: float | None = None
        centre: Float[Tensor, " 3"] | None = None
        for side in order:
            prepared[side] = self.prepare(
                shapes[side],
                as_cloud=as_cloud in (side, "both"),
                up=ups[side],
                scale=scale,
                centre=centre,
                strict=strict,
                timings=timings,
                label=side,
            )
            whole = prepared[side].operators
            scale = whole.scale / partial_scale if partial else None
            centre = whole.centre / partial_scale if pre_aligned else None
        return prepared["source"], prepared["target"]

    def match_checked(
        self,
        source: Prepared,
        target: Prepared,
        *,
        partial: Side | None = None,
        strict: bool = False,
        timings: Timings | None = None,
    ) -> Correspondence:
        """Match two prepared shapes, and check the result, their units and how they stand; see ``match``."""
        timings = timings or Timings()
        units = units_that_differ(source, target, partial)
        with timings.measure("map"), blaming(units):
            found = self.match_prepared(source, target, partial=partial)
        with timings.measure("check orientation"):
            # Features of a part differ from those of its whole by more than a turn makes.
            turns = () if partial else self.orientation_warnings(source, target)
            warnings = (*units, *turns, *doubts(found))
        if strict and warnings:
            raise ShapeError(f"{warnings[0]} (refused as strict)")
        return replace(found, warnings=warnings)

    @torch.inference_mode()
    def orientation_warnings(self, source: Prepared, target: Prepared) -> tuple[str, ...]:
        """What to tell the user if the shapes do not stand alike, or not as the weights expect."""
        _check_prepared(source, target)
        if self.network is None or self.route(source.modality, target.modality) == "axiomatic":
            return tuple(axiomatic_warnings(source.operators, target.operators, ups=(source.up, target.up)))
        if not self.info.upright:
            return ()
        scales = source.operators.scale, target.operators.scale
        shapes = source.repaired.shape, target.repaired.shape
        ups = source.up, target.up
        return tuple(orientation_warnings(self.network, *shapes, scales=scales, ups=ups, device=self.device))

    @torch.inference_mode()
    def match_prepared(self, source: Prepared, target: Prepared, *, partial: Side | None = None) -> Correspondence:
        """Match two prepared shapes, without any check; see ``match``."""
        check_word("partial", partial, get_args(Side))
        check_method(self.settings.method, partial)
        _check_prepared(source, target)
        if partial == "source":
            return self.match_prepared(target, source, partial="target").inverse()
        route = self.route(source.modality, target.modality)
        if partial == "target":
            target = self.placed(source, target)
        maps = self.point_maps(source, target, partial=partial == "target")
        forth = _small_components_following(maps.source_to_target, source.operators)
        back = _small_components_following(maps.target_to_source, target.operators)
        x, y = source.operators.points, target.operators.points
        source_confidence, target_confidence = confidence(x, y, forth, back), confidence(y, x, back, forth)
        figures = MapQuality(
            None if partial else quality(source, target, forth, back, source_confidence),
            quality(target, source, back, forth, target_confidence),
        )
        if partial == "target":
            found = overlap(source.operators, target.operators, back)
            forth, source_confidence = torch.where(found, forth, -1), torch.where(found, source_confidence, 0.0)
        return Correspondence(
            source_to_target=source.repaired.original_map(forth.cpu().numpy(), target.repaired),
            target_to_source=target.repaired.original_map(back.cpu().numpy(), source.repaired),
            source_confidence=source.repaired.to_original(source_confidence.cpu().numpy(), fill=0),
            target_confidence=target.repaired.to_original(target_confidence.cpu().numpy(), fill=0),
            route=route,
            quality=figures,
        )

    @torch.inference_mode()
    def placed(self, complete: Prepared, part: Prepared) -> Prepared:
        """A part turned, shifted and sized to fit the complete shape's features best, with its features there.

        Its operators' points are then no longer where ``centre`` and ``scale`` put those of its file.
        As it is given, where there is no network or the settings say so.
        """
        _check_prepared(complete, part)
        if self.network is None or not self.settings.place:
            return part
        whole = complete.operators.points
        basis = part.operators.basis
        place = placed(basis, self.network, whole, complete.features, searched=self.info.partial)
        if place.points is basis.points:
            return part
        operators = replace(part.operators.scaled(place.size), points=place.points)
        return replace(part, operators=operators, features=self.features(operators))

    @torch.inference_mode()
    def point_maps(self, source: Prepared, target: Prepared, *, partial: bool = False) -> PointMaps:
        """Point maps between the clean shapes, before any point is found to have no counterpart."""
        _check_prepared(source, target)
        route = self.route(source.modality, target.modality)
        if route == "registration":
            return _registration_maps(source.operators, target.operators)
        if route == "nearest-features":
            maps = self._maps_by_features(source.features, target.features, partial=partial)
        else:
            maps = self._maps_by_functional_maps(source, target, partial=partial)
        if not self.settings.refine:
            return maps
        return _refined_to_part(maps, source, target) if partial else _refined(maps, source, target)

    def _maps_by_functional_maps(self, source: Prepared, target: Prepared, *, partial: bool) -> PointMaps:
        c_st, c_ts = self.functional_maps(source, target, partial=partial)
        phi_s, phi_t = source.operators.eigenvectors, target.operators.eigenvectors
        target_to_source = point_map_from_functional_map(c_st, phi_s, phi_t)
        if partial:
            # The way back lies in the same embedding: the map from the part to the whole has too few rows to trust.
            k_t, k_s = c_st.shape
            source_to_target = nearest_neighbour(phi_s[:, :k_s] @ c_st.T, phi_t[:, :k_t]).index
        else:
            source_to_target = point_map_from_functional_map(c_ts, phi_t, phi_s)
        return PointMaps(source_to_target, target_to_source)

    @torch.inference_mode()
    def functional_maps(
        self, source: Prepared, target: Prepared, *, partial: bool = False
    ) -> tuple[Float[Tensor, "k_t k_s"], Float[Tensor, "k_s k_t"]]:
        """The functional maps from source to target and back, before their refinement."""
        _check_prepared(source, target)
        route = self.route(source.modality, target.modality)
        if route == "axiomatic":
            return self._axiomatic_maps(source, target)
        problem = MapProblem.between(
            source.operators,
            target.operators,
            (source.features, target.features),
            size=self.map_size(partial=partial),
            regularisation=self.settings.regularisation,
        )
        return problem.forth(), problem.back()

    def _axiomatic_maps(
        self, source: Prepared, target: Prepared
    ) -> tuple[Float[Tensor, "k_t k_s"], Float[Tensor, "k_s k_t"]]:
        try:
            problem = axiomatic_problem(source.operators, target.operators, (source.features, target.features))
            return problem.forth(), problem.back()
        except ArgumentError:
            names = f"{source.repaired.shape.name} or {target.repaired.shape.name}"
            raise ShapeError(f"{names} {_why_undetermined(source.operators, target.operators)}") from None

    def _maps_by_features(
        self, source: Float[Tensor, "n_s d"], target: Float[Tensor, "n_t d"], *, partial: bool
    ) -> PointMaps:
        if not self.settings.raw_products:
            source, target = normalised(source), normalised(target)
        if partial:
            # The softmax over the complete shape: its argmax is the most similar point, at any temperature.
            return PointMaps(most_similar(source, target).index, most_similar(target, source).index)
        soft = sinkhorn_matches(
            target, source, temperature=self.settings.temperature, iterations=self.settings.iterations
        )
        return PointMaps(source_to_target=soft.x_to_y, target_to_source=soft.y_to_x)


def _check_prepared(source: Prepared, target: Prepared) -> None:
    check_kind("source", source, Prepared)
    check_kind("target", target, Prepared)


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


def _registration_maps(source: Operators, target: Operators) -> PointMaps:
    on_target, on_source = registered_positions(source.points, target.points)
    return PointMaps(
        nearest_neighbour(on_target, target.points).index, nearest_neighbour(on_source, source.points).index
    )


def _refined(maps: PointMaps, source: Prepared, target: Prepared) -> PointMaps:
    target_to_source, source_to_target = zoomout(
        maps.target_to_source,
        maps.source_to_target,
        source.operators.eigenvectors,
        target.operators.eigenvectors,
        normalised(source.features),
        normalised(target.features),
    )
    return PointMaps(source_to_target, target_to_source)


def _refined_to_part(maps: PointMaps, complete: Prepared, part: Prepared) -> PointMaps:
    part_to_complete, complete_to_part = zoomout_partial(
        maps.target_to_source,
        complete.operators.eigenvectors,
        part.operators.eigenvectors,
        complete.operators.eigenvalues,
        part.operators.eigenvalues,
        normalised(complete.features),
        normalised(part.features),
    )
    return PointMaps(complete_to_part, part_to_complete)


def _why_undetermined(*both: Operators) -> str:
    if any(operators.n_pieces > 1 for operators in both):
        return (
            "falls into too many pieces for the axiomatic method; keep the largest piece, use it as a cloud, "
            "or give weights"
        )
    return "is too small or too symmetric for the axiomatic method; use one with more points, or give weights"


def _small_components_following(point_map: Int[Tensor, " n"], operators: Operators) -> Int[Tensor, " n"]:
    """The map with what no eigenfunction reaches going where the nearest point that has some goes."""
    if operators.in_main_component.all():
        return point_map
    in_main_component, points = operators.in_main_component.cpu(), operators.points.cpu().numpy()
    (main,) = torch.nonzero(in_main_component, as_tuple=True)
    nearest = main[torch.from_numpy(KDTree(points[main]).query(points)[1])]
    return point_map[nearest.to(point_map.device)]
