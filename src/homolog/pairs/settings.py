"""How maps are made: everything that moves accuracy, so that it can be set, reported and ablated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Annotated, Any, get_args

import numpy as np
import torch
from annotated_types import Ge, Le

from homolog.core.arguments import check_choice
from homolog.core.choices import Device
from homolog.core.errors import ArgumentError, bad_choice, bad_value
from homolog.core.method_names import AUTO, method_names
from homolog.core.reprs import function_name
from homolog.core.settings import Count, NotNegative, Positive, Settings, Share, read_settings
from homolog.geometry import ClutterSettings, OperatorSettings
from homolog.maps import CoarseMapSettings, ConfidenceSettings, RefinementSettings, RegistrationSettings

# A temperature or a size that the features decide, where none is given.
_CountOrNone = Annotated[Count, "or None"] | None
_PositiveOrNone = Annotated[Positive, "or None"] | None


@dataclass(frozen=True, kw_only=True)
class FunctionalMapSettings(Settings):
    """The functional map that fits features (Ren et al., "Structured regularization of functional map computations").

    Args:
        n_eigenpairs: its size; by default what the features were trained with (``FeatureInfo.map_eigenpairs``).
        n_eigenpairs_partial: the same where one shape is partial; by default 50 for features of full shapes alone.
        regularisation: weight of the resolvent mask, from 0; 100 as in the paper.
    """

    n_eigenpairs: _CountOrNone = None
    n_eigenpairs_partial: _CountOrNone = None
    regularisation: NotNegative = 100.0


@dataclass(frozen=True, kw_only=True)
class SoftMapSettings(Settings):
    """The soft map between features.

    Args:
        temperature: of the softmax; by default what the features were trained with (``FeatureInfo.temperature``).
        iterations: of Sinkhorn's algorithm.
        normalise: compare features of unit norm. Raw products are only safe between two clouds, and reproduce the code
            that the paper's authors published.
    """

    temperature: _PositiveOrNone = None
    iterations: Count = 10
    normalise: bool = True


@dataclass(frozen=True, kw_only=True)
class AxiomaticSettings(Settings):
    """The axiomatic method: wave kernel signatures and smoothed positions. Chosen on training pairs of upright people.

    Args:
        n_eigenpairs: size of the first functional map: small, as the descriptors are only roughly right.
        regularisation: weight of its resolvent mask: stiff, for the same reason.
        position_weight: of the three coordinates against each channel of the signature, all of unit norm.
    """

    n_eigenpairs: Count = 15
    regularisation: NotNegative = 1000.0
    position_weight: NotNegative = 30.0


@dataclass(frozen=True, kw_only=True)
class AlignmentSettings(Settings):
    """The similarity alignment of a partial shape with the full one. New here.

    Args:
        steps: how many positions are looked at from each start, the start included.
        partial_samples: points of the partial shape that are compared; a basis at samples needs some twice as many as
            it has eigenvectors.
        full_samples: points of the full shape.
        similar: mean cosine between features from which on the partial shape is aligned, and no other start is tried.
        followed: how many starts are followed.
        orientations: of how many ways that the features' orienter finds the partial shape to stand there are starts.
        margin: by how much another size or rotation must be more similar than the given one; what nearly is as similar
            may be its mirror image.
        scales: sizes to start from, where the given one does not fit.
        rotations: axis (0 to 2) and degrees of the rotations to start from; the first is none.
        shares: of the full shape's area, to start from where a partial shape is in unknown units.
        size_steps: factors by which its size is then refined, as long as features become more similar.
    """

    steps: Count = 4
    partial_samples: Count = 1000
    full_samples: Count = 2500
    similar: Annotated[float, Ge(-1), Le(1)] = 0.94
    followed: Count = 2
    orientations: Count = 3
    margin: NotNegative = 0.01
    scales: tuple[Positive, ...] = (0.8, 1.25, 0.63, 1.6, 0.5, 2.0, 0.4, 2.5, 0.32, 3.2)
    rotations: tuple[tuple[Annotated[int, Ge(0), Le(2)], float], ...] = (
        (1, 0),
        (1, 180),
        (1, 270),
        (1, 90),
        (0, 60),
        (0, -60),
        (2, 60),
        (2, -60),
    )
    shares: tuple[Positive, ...] = (0.08, 0.11, 0.15, 0.2, 0.27, 0.35, 0.45, 0.57, 0.7, 0.85)
    size_steps: tuple[Positive, ...] = (1.06, 1.02)

    def check(self) -> None:
        """Refuse to start from nowhere."""
        for name in ("scales", "rotations"):
            if not getattr(self, name):
                raise ArgumentError(f"{name} is empty, but must hold at least one; alignment=None aligns nothing")


@dataclass(frozen=True, kw_only=True)
class PlacedMapSettings(Settings):
    """What speaks against the map of a partial shape at a place. New here; see ``PlacementSettings`` for its choice.

    Its misfit is a sum: ``torn`` times the logarithm of the map's Dirichlet energy, ``cycle`` times the mean cycle
    error, ``flipped`` times the share of triangles turned over, ``coverage`` times the share of the partial shape that
    the map back does not hit, ``handedness`` times how far it mixes left and right, ``size`` times the logarithm of
    what lengths were multiplied by, and ``closest_points`` if it is a map by closest points.

    Args:
        torn: weight of the logarithm of the Dirichlet energy. Noise tears maps of clouds as well.
        cycle: weight of the cycle error.
        flipped: weight of the share of flipped triangles.
        coverage: weight of 1 minus the coverage.
        handedness: weight of 1 minus the handedness of the map.
        radius: of the neighbourhoods in which that is told.
        size: weight of the size; it counts nothing in unknown units.
        closest_points: what a map by closest points must be better by: it is smooth in a wrong place, too.
        sure: misfit of the map by the best alignment up to which no other is looked at.
        margin: by how much another map's misfit must be less than the first one's.
    """

    torn: NotNegative = 1.0
    cycle: NotNegative = 50.0
    flipped: NotNegative = 20.0
    coverage: NotNegative = 10.0
    handedness: NotNegative = 2.0
    radius: Positive = 0.25
    size: NotNegative = 2.0
    closest_points: NotNegative = 0.0
    sure: float = 2.0
    margin: NotNegative = 0.5


_PLACED_CLOUDS = PlacedMapSettings(
    torn=0.3, cycle=100.0, flipped=0.0, handedness=1.0, radius=0.15, closest_points=1.0, sure=2.5, margin=1.0
)


@dataclass(frozen=True, kw_only=True)
class PlacementSettings(Settings):
    """Where a partial shape lies on the full one, told by the maps that several alignments lead to. New here.

    Features may be as similar in a wrong place. The map there tears, though. The values were chosen on parts of
    SHREC'16 that no network was trained on and no table has, those of clouds also on views of synthetic people.

    Args:
        followed: how many starts of other alignments are followed.
        apart: mean distance from which on two alignments are two.
        mapped: of how many, those that bring most of the partial shape onto the full one, maps are made.
        full_samples: points of the full shape to which others are moved at first.
        rigid: share of the partial shape that lies on the full one from which on closest points make a map; of bent
            parts theirs is smooth, and wrong.
        enough: share of the partial shape that lies on the full one from which on no further one is moved.
        handed_samples: points of the partial shape at which the map's handedness is told.
        given: what is taken off the misfit where a pre-aligned part was given: somebody has put it there.
        meshes: misfit of maps between meshes.
        clouds: of maps from or to clouds.
    """

    followed: Count = 20
    apart: NotNegative = 0.15
    mapped: Count = 3
    full_samples: Count = 2500
    rigid: Share = 0.5
    enough: Share = 0.9
    handed_samples: Count = 1000
    given: NotNegative = 1.0
    meshes: PlacedMapSettings = field(default_factory=PlacedMapSettings)
    clouds: PlacedMapSettings = _PLACED_CLOUDS


@dataclass(frozen=True, kw_only=True)
class ExtraPartSettings(Settings):
    """What only one of two full shapes has: a held object, a hat, a base. New here.

    One shape is deformed onto the other along the map. What it leaves uncovered, in one piece, may have no counterpart.
    It is set apart if the shapes are matched better without it, and the other shape is then covered: a limb that was
    missed has its counterpart there, and leaves that uncovered. Chosen on training shapes of FAUST_r and SMAL_r, with
    things added. Lengths are in units of sqrt(area).

    Args:
        sure_mesh: misfit of the map between two meshes, see ``homolog.matching.map_misfit``, up to which nothing is
            looked for.
        sure_cloud: the same where one is a cloud, so that no flipped triangles count.
        patches: how many patches a shape is deformed in.
        far: distance from the deformed shape from which on points may begin a part.
        near: the same from which on its other points belong to it.
        least: share of the area that points beyond ``far`` have at least, in one piece.
        taken: area that the map of the other shape takes to such a piece, relative to its own, at most: a limb that was
            missed has as much there.
        gain: by how much the misfit of the map is less without the part, at least.
        most_misfit: of the map without the part, at most.
        uncovered: area of the other shape farther than ``far`` from the rest of this one, relative to the part's, at
            most. Where the map is then sure, what was missed with the part as well does not count.
        uncovered_there: share of what the map took to the part that is as far, at most.
    """

    sure_mesh: float = 1.5
    sure_cloud: float = 1.0
    patches: Count = 400
    far: Positive = 0.04
    near: Positive = 0.03
    least: Share = 0.015
    taken: NotNegative = 0.75
    gain: NotNegative = 0.2
    most_misfit: float = 1.9
    uncovered: NotNegative = 0.2
    uncovered_there: Share = 0.12


@dataclass(frozen=True, kw_only=True)
class PartsSettings(Settings):
    """How two parts that overlap are aligned with each other. New here; chosen on views of people for training.

    Each part is placed on the upright shape by its features' orienter. The target is then moved by counterparts among
    positions, features and normals at once, and by closest points where it is a rigid body. Lengths are in units of the
    sqrt(area) of the upright shape.

    Args:
        samples: points of each part that are compared at first.
        starts: of how many combinations of both parts' orientations the search begins.
        followed: how many of these are followed to the end, until one fits as a rigid body.
        same_units: by what factor the sizes may differ that the orienter finds, for both parts to be of one scale.
        reaches: distances that weigh as much as a difference of one in what else is compared, one after the other.
        features: weight of features of unit norm.
        normals: weight of normals.
        least_home: a counterpart counts that leads home within half the reach, or within this.
        turn: degrees by which the target is turned about each axis, where closest points begin anew.
        closest: the last reaches of closest points, in spacings of the points.
        overlap: a point of a mesh lies on another mesh that is within so many spacings of its surface.
        overlap_of_clouds: the same where either is a cloud, whose points may be noisy.
        agreeing: it does so rightly that is within this distance of its counterpart by features.
        least_rigid: share of each part that does from which on both are taken for parts of one rigid body.
        bent_reach: distance that weighs as much as a difference of one in weighted features in the maps of others.
        bent_smoothing: width over which the mass is smoothed that tells the overlap of others, in spacings.
    """

    samples: Count = 1200
    starts: Count = 6
    followed: Count = 3
    same_units: Annotated[float, Ge(1)] = 1.4
    reaches: tuple[Positive, ...] = (0.3, 0.2, 0.12, 0.08, 0.05, 0.03)
    features: NotNegative = 6.0
    normals: NotNegative = 0.5
    least_home: NotNegative = 0.03
    turn: NotNegative = 25.0
    closest: tuple[Positive, ...] = (4.0, 3.0, 2.0, 2.0, 1.5, 1.5, 1.0, 1.0)
    overlap: Positive = 0.5
    overlap_of_clouds: Positive = 1.0
    agreeing: Positive = 0.1
    least_rigid: Share = 0.2
    bent_reach: Positive = 0.15
    bent_smoothing: Positive = 4.0


@dataclass(frozen=True, kw_only=True)
class OrientationSettings(Settings):
    """The search for the way round of two full shapes. New here; the weights were chosen on pairs of training shapes.

    Hypotheses are rotations. Each gives a coarse map of samples, and the one of least misfit is taken: that of the map,
    plus ``orienter`` times the misfit of what the features' orienter found.

    Args:
        samples: points of each shape that a coarse map is made of.
        hypotheses: how many rotations get one.
        map_eigenpairs: eigenfunctions that coarse maps are refined with.
        refinement: of coarse maps: few rounds, as they are to be told apart and no more.
        turned: misfit of coarse maps by features where the source is turned to the target as a rigid body: a person's
            front then fits his back, and what the map does to the surface decides.
        rigid: the same of maps by closest points.
        upright: the same between ways in which an orienter may see a shape.
        doubtful_handedness: where the best map's is below, the shape that the orienter knows less well is also tried
            turned by a quarter about each axis. Right maps of people have 0.65 to 1, of noisy clouds 0.2 to 0.9.
        sure_handedness: what that of another pose must be, to be taken; where left and right are exchanged, it is below
            0.75.
        pose_margin: by how much the Dirichlet energy of that map must also be below the other's. Where the first pose
            is wrong, it is by 0.07 to 0.9; where it is right, that of another is higher.
        orienter: weight of the orienter's misfit.
        orienter_margin: what the orienter finds worse by more than this is not looked at any further.
        unsure: where the orienter's misfit of a shape is above, as of people in much noise, the shapes are also tried
            as standing alike, and kept so unless another way is better by ``alike_margin``.
        alike_margin: of pairs that face apart, the right way is better by 0.07 to 0.15; of pairs that stand alike, a
            wrong one by up to 0.05.
        margin: what is better by less than this is not told apart: the given way round is then kept, and the pair is
            said to be ambiguous.
        turned_margin: the same without an orienter, where maps are by features: people look alike from both sides to
            the closest points that hypotheses come from.
        given_margin: the way in which a shape is given is taken where the orienter finds another better by less than
            this: files are right more often than not. Without features, a small turn is, and a pair whose ways round
            differ by less is ambiguous: of 15 right ones, bones and lungs, all differ by 0.033 or more, of seven wrong
            ones by up to 0.018.
        least_degrees: a shape that the orienter would turn by less stays as it is given.
        small_turn: a turn of less than 45 degrees is left to methods that find it themselves, unless the mean squared
            distance of closest points is then below so many times what it is between samples of one surface.
    """

    samples: Count = 500
    hypotheses: Count = 6
    map_eigenpairs: Count = 50
    refinement: RefinementSettings = field(default_factory=lambda: RefinementSettings(k_init=15, k_step=12))
    turned: CoarseMapSettings = field(default_factory=CoarseMapSettings)
    rigid: CoarseMapSettings = field(
        default_factory=lambda: CoarseMapSettings(cycle=1.0, handedness=0.1, radius=0.25, surface_handedness=0.0)
    )
    upright: CoarseMapSettings = field(
        default_factory=lambda: CoarseMapSettings(cycle=1.0, handedness=0.3, radius=0.25, surface_handedness=0.0)
    )
    doubtful_handedness: Annotated[float, Ge(-1), Le(1)] = 0.7
    sure_handedness: Annotated[float, Ge(-1), Le(1)] = 0.8
    pose_margin: NotNegative = 0.05
    orienter: NotNegative = 1.0
    orienter_margin: NotNegative = 0.05
    unsure: NotNegative = 0.1
    alike_margin: NotNegative = 0.05
    margin: NotNegative = 0.01
    turned_margin: NotNegative = 0.15
    given_margin: NotNegative = 0.03
    least_degrees: NotNegative = 30.0
    small_turn: NotNegative = 1.4


@dataclass(frozen=True, kw_only=True)
class ChoiceSettings(Settings):
    """The choice among features of several kinds of shapes, and of none. New here; chosen on pairs of training shapes.

    Features know a pair as well as their orienter knows the shape that it knows less well: by the misfit of the best
    orientation, see ``homolog.features.Orientation``. Where no features know either shape, nearly rigid copies
    (``homolog.maps.RegistrationStart``) are registered. Of others the maps that come into question are made, and that
    of least ``homolog.matching.map_misfit`` is taken.

    Args:
        known: misfit up to which the usual features know a pair: nothing else is looked at. People have 0.04 to 0.1 by
            the weights for people, animals 0.11 and more. Where no features know both shapes, those are taken that know
            one of the two up to this misfit, if ``FeatureInfo.most_misfit`` is not less: animals have 0.05 to 0.1 by
            those for animals, but one fox of 49 has 0.37. No bone has less than 0.1 by any.
        known_best: misfit up to which those that know a pair best are taken without a look at any map, if
            ``FeatureInfo.most_misfit`` is not less. Animals have 0.04 to 0.12 by the weights for animals, hands and
            heads 0.04 to 0.05 by those of their own. Tibiae have 0.11 by the usual ones: above ``known``, nearly rigid
            copies are registered.
        registered: map's misfit up to which a registration is taken without a look at other maps. Of lungs, whose maps
            by eigenfunctions are as smooth and mostly wrong, it is 0.6 to 0.9, of animals and people in two poses 1.3
            and more.
        plausible: misfit up to which maps by features are made; that of bones is some 0.4.
        doubtful: map's misfit above which a pair that no features know is said to be doubtful. Of 28 maps by
            ``axiomatic`` one of 21 with an error below 4 % of sqrt(area) has more, and so have the seven others.
        cycle: weight of the mean cycle error in a map's misfit, beside the logarithm of its Dirichlet energy.
        flipped: weight of the share of triangles that it turns over.
    """

    known: NotNegative = 0.1
    known_best: NotNegative = 0.12
    registered: float = 1.0
    plausible: NotNegative = 0.3
    doubtful: NotNegative = 3.0
    cycle: NotNegative = 50.0
    flipped: NotNegative = 20.0


@dataclass(frozen=True, kw_only=True)
class GuidanceSettings(Settings):
    """How landmarks guide a match. New here; chosen on training pairs of animals. Without landmarks it does nothing.

    Args:
        channels: weight of the distances from all landmarks along the surface against features of unit norm.
        rows: of the rows of landmarks in the functional maps of the refinement, as a share of all rows.
        orientation: weight of the mean distance by which a way round misses the landmarks, in its misfit.
        choice: the same in the misfit of a map, where features are chosen.
        pull: of a landmark on the deformed shape, as a share of the weight of all its points.
        stiffness: of the deformed shape, in spacings of its points: what is smaller keeps its form.
        points: weight of the point maps in the deformation.
        normals: distance, in units of sqrt(area), that weighs as much as a difference of one in unit normals where
            points of the deformed shape look for their counterparts.
        trusted: maps of methods that are not refined are smooth by themselves: nothing is deformed where they miss
            landmarks by less than this on average, in units of sqrt(area). Chosen on vertebrae.
        reach: of the last pull towards a landmark, in units of sqrt(area).
    """

    channels: NotNegative = 9.0
    rows: NotNegative = 0.1
    orientation: NotNegative = 2.0
    choice: NotNegative = 20.0
    pull: Positive = 0.02
    stiffness: Positive = 5.0
    points: Positive = 0.5
    normals: NotNegative = 0.1
    trusted: NotNegative = 0.1
    reach: Positive = 0.1


@dataclass(frozen=True, kw_only=True)
class SmoothingSettings(Settings):
    """The deformations that refined maps are led by. New here; chosen on pairs of full training shapes.

    Args:
        deformations: of one shape onto the other, of two full shapes in turn.
        rounds: of each, at least 2; in the first one point maps alone pull.
        first_stiffness: of the shape in the first deformation, in spacings of its points: what is smaller keeps its
            form.
        last_stiffness: in the last one; in between it goes from one to the other by one factor.
        points_mesh: weight of each of the point maps beside the surface that the deformed shape is drawn to.
        points_cloud: the same where a cloud takes part: noise moves what it is drawn to.
        normals: distance, in units of sqrt(area), that weighs as much as a difference of one in unit normals where
            points look for their counterparts.

    Examples:
        >>> [round(stiffness, 2) for stiffness in SmoothingSettings(deformations=3).schedule()]
        [4.0, 2.45, 1.5]
    """

    deformations: Count = 12
    rounds: Annotated[int, Ge(2)] = 2
    first_stiffness: Positive = 4.0
    last_stiffness: Positive = 1.5
    points_mesh: Positive = 0.5
    points_cloud: Positive = 2.0
    normals: NotNegative = 0.1

    def schedule(self) -> list[float]:
        """The stiffness of each deformation."""
        return [float(each) for each in np.geomspace(self.first_stiffness, self.last_stiffness, self.deformations)]


@dataclass(frozen=True, kw_only=True)
class WarningSettings(Settings):
    """When a match is said to be doubtful.

    Args:
        least_confidence: mean confidence below which it is. Good matches of bodies have 0.7 to 0.9, hopeless ones under
            0.2.
        most_dirichlet_energy: mean Dirichlet energy of the maps, without the hundredth of the edges that add most,
            above which it is. Of 50 maps of people and animals with an error below 4 % of sqrt(area) one has more, of
            19 with an error above 8 % eight have.
    """

    least_confidence: Annotated[float, Ge(0), Le(1)] = 0.35
    most_dirichlet_energy: NotNegative = 2.0


@dataclass(frozen=True, kw_only=True)
class ProxySettings(Settings):
    """When a proxy is matched in place of a shape, and how it is made; ``PairOptions.proxy`` says whether it may be.

    Args:
        most_outside: share of the area beyond the largest component from which on a mesh has a proxy. Of 371 meshes of
            FAUST, SCAPE, SMAL, SHREC'16, SHREC'19 and bones, none has one.
        most_broken: share of edges that do not join two faces from which on it has one.
        points: approximate number of points of the proxy.
        resolution: voxels along the longest side; at least 64.
        reach: how far from the proxy a point may be to have a counterpart, in units of sqrt(area).
        least_covered: share of the area within reach that a proxy must have; else the mesh has none.
        largest: number of points beyond which fewer points are matched, of a simplified mesh or a part of a cloud; None
            for no limit.
    """

    most_outside: Share = 0.25
    most_broken: Share = 0.2
    points: Annotated[int, Ge(100)] = 8000
    resolution: Annotated[int, Ge(64)] = 256
    reach: Positive = 0.1
    least_covered: Share = 0.8
    largest: _CountOrNone = 20_000


@dataclass(frozen=True, kw_only=True)
class MatcherSettings(Settings):
    """How maps are made from features.

    Args:
        method: name of a method (``homolog.methods.method_names()``), a method of one's own, or ``"auto"``:
            ``functional-map`` for two meshes of near-isometric kind, ``nearest-features`` otherwise, and ``axiomatic``
            without features. The maps of a bare function are not refined; see ``homolog.methods.as_method``.
        functional_map: the functional map that fits features.
        soft_map: the soft map between features.
        axiomatic: the method of that name.
        registration: the method of that name.
        choice: among features of several kinds of shapes, and of none.
        clutter: what does not belong to a shape; ``PairOptions.clutter`` says whether it is set apart.
        proxy: when a surface around a mesh, or a simpler shape, is matched in its place.
        orientation: the search for the way round of full shapes; ``PairOptions.orient`` says whether there is one.
        alignment: of a partial shape with the full one before matching; None for none.
        placement: of a partial shape where the best alignment leads to no good map; None to look for no other.
        parts: of two parts with each other; None for none.
        extra_parts: what only one of two full shapes has; None to give everything a counterpart.
        refinement: of the point maps, by ZoomOut; None for none, as the paper has it. Features for shapes that are not
            nearly isometric are never refined.
        smoothing: of refined maps, by deformations of full shapes onto each other or of a part onto its whole; None for
            none.
        guidance: by landmarks, where there are any.
        confidence: of the point maps, and the overlap of a full shape with a partial one.
        warnings: when a match is said to be doubtful.
        operators: what operators to compute; by default those that the features were trained with.

    Raises:
        ArgumentError: if one of them is of another kind, or there is no such method.

    Examples:
        >>> import homolog
        >>> homolog.MatcherSettings(method="functional-map", refinement=None).functional_map.regularisation
        100.0
    """

    method: Any = AUTO
    functional_map: FunctionalMapSettings = field(default_factory=FunctionalMapSettings)
    soft_map: SoftMapSettings = field(default_factory=SoftMapSettings)
    axiomatic: AxiomaticSettings = field(default_factory=AxiomaticSettings)
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    choice: ChoiceSettings = field(default_factory=ChoiceSettings)
    clutter: ClutterSettings = field(default_factory=ClutterSettings)
    proxy: ProxySettings = field(default_factory=ProxySettings)
    orientation: OrientationSettings = field(default_factory=OrientationSettings)
    alignment: Annotated[AlignmentSettings, "or None"] | None = field(default_factory=AlignmentSettings)
    placement: Annotated[PlacementSettings, "or None"] | None = field(default_factory=PlacementSettings)
    parts: Annotated[PartsSettings, "or None"] | None = field(default_factory=PartsSettings)
    extra_parts: Annotated[ExtraPartSettings, "or None"] | None = field(default_factory=ExtraPartSettings)
    refinement: Annotated[RefinementSettings, "or None"] | None = field(default_factory=RefinementSettings)
    smoothing: Annotated[SmoothingSettings, "or None"] | None = field(default_factory=SmoothingSettings)
    guidance: GuidanceSettings = field(default_factory=GuidanceSettings)
    confidence: ConfidenceSettings = field(default_factory=ConfidenceSettings)
    warnings: WarningSettings = field(default_factory=WarningSettings)
    operators: Annotated[OperatorSettings, "or None"] | None = None

    def check(self) -> None:
        """Refuse a method that is no name of one and cannot be called."""
        if isinstance(self.method, str) and self.method not in method_names():
            raise bad_choice("method", self.method, method_names())
        if not (isinstance(self.method, str) or callable(self.method)):
            raise bad_value("method", self.method, "the name of a method, or a function of a homolog.pairs.Pair")

    def to_dict(self) -> dict[str, Any]:
        """All of them for JSON; a method of one's own by its name."""
        named = isinstance(self.method, str)
        name = self.method if named else getattr(self.method, "name", function_name(self.method))
        return {**asdict(replace(self, method=AUTO)), "method": name}

    @classmethod
    def from_dict(cls, table: Mapping[str, Any], *, where: str = "settings") -> MatcherSettings:
        """Settings from what ``to_dict`` gives, such as the ``settings`` of a report; what is left out is as usual.

        A method of one's own is found again only if it is an installed one: a report has its name alone.

        Args:
            table: values by the names of the fields; those of parts, such as ``refinement``, in tables of their own.
            where: what messages call it.

        Raises:
            ArgumentError: if there is no such field or method, or a value is not as it should be.

        Examples:
            >>> from homolog import MatcherSettings
            >>> MatcherSettings.from_dict({"refinement": None, "soft_map": {"iterations": 5}})
            MatcherSettings(soft_map=SoftMapSettings(iterations=5), refinement=None)
        """
        if not isinstance(table, Mapping):
            raise bad_value(where, table, "a table of values by name, as MatcherSettings.to_dict gives it")
        return read_settings(cls, table, where)

    def __repr__(self) -> str:
        return _changes(self)


def _changes(settings: Settings) -> str:
    """Settings with those fields alone that differ from the default ones: there are too many to look through."""
    usual = type(settings)()
    values = {each.name: getattr(settings, each.name) for each in fields(settings)}
    shown = (
        f"{name}={_changes(value) if isinstance(value, Settings) else repr(value)}"
        for name, value in values.items()
        if value != getattr(usual, name)
    )
    return f"{type(settings).__name__}({', '.join(shown)})"


def choose_device(device: Device | torch.device) -> torch.device:
    """The torch device for ``"auto"``, ``"cpu"`` or ``"cuda"``; a torch device of these types is taken as it is.

    Raises:
        ArgumentError: if there is no such device.
    """
    kind = device.type if isinstance(device, torch.device) else device
    if isinstance(kind, str) and kind == "gpu":
        raise ArgumentError("device is 'gpu', but must be one of auto, cpu, cuda; a graphics card is 'cuda'")
    check_choice("device", kind, get_args(Device))
    if kind == "cuda" and not torch.cuda.is_available():
        raise ArgumentError(f"device is '{device}', but PyTorch finds no CUDA device; use 'cpu' or 'auto'")
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(device)
