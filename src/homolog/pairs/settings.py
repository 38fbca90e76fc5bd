"""How maps are made: everything that moves accuracy, so that it can be set, reported and ablated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any, get_args

import torch

from homolog.core.arguments import is_count, is_real
from homolog.core.choices import Device
from homolog.core.errors import ArgumentError, bad_choice, bad_value
from homolog.core.reprs import function_name
from homolog.geometry import OperatorSettings
from homolog.maps import ConfidenceSettings, RefinementSettings, RegistrationSettings

_Rule = tuple[Callable[[Any], bool], str]
_COUNT: _Rule = (is_count, "a whole number of at least 1")
_COUNT_OR_NONE: _Rule = (lambda value: value is None or is_count(value), "a whole number of at least 1, or None")
_POSITIVE: _Rule = (lambda value: is_real(value) and value > 0, "a finite number above 0")
_POSITIVE_OR_NONE: _Rule = (
    lambda value: value is None or (is_real(value) and value > 0),
    "a finite number above 0, or None",
)
_NOT_NEGATIVE: _Rule = (lambda value: is_real(value) and value >= 0, "a finite number of at least 0")
_FLAG: _Rule = (lambda value: isinstance(value, bool), "True or False")


def _check(settings: object, **rules: _Rule) -> None:
    for name, (holds, allowed) in rules.items():
        value = getattr(settings, name)
        if not holds(value):
            raise bad_value(name, value, allowed)


@dataclass(frozen=True, kw_only=True)
class FunctionalMapSettings:
    """The functional map that fits features (Ren et al., "Structured regularization of functional map computations").

    Args:
        n_eigenpairs: its size; by default what the features were trained with (``FeatureInfo.map_eigenpairs``).
        n_eigenpairs_partial: the same where one shape is partial; by default 50 for features of full shapes alone.
        regularisation: weight of the resolvent mask, from 0; 100 as in the paper.
    """

    n_eigenpairs: int | None = None
    n_eigenpairs_partial: int | None = None
    regularisation: float = 100.0

    def __post_init__(self) -> None:
        _check(self, n_eigenpairs=_COUNT_OR_NONE, n_eigenpairs_partial=_COUNT_OR_NONE, regularisation=_NOT_NEGATIVE)


@dataclass(frozen=True, kw_only=True)
class SoftMapSettings:
    """The soft map between features.

    Args:
        temperature: of the softmax; by default what the features were trained with (``FeatureInfo.temperature``).
        iterations: of Sinkhorn's algorithm.
        normalise: compare features of unit norm. Raw products are only safe between two clouds, and reproduce the code
            that the paper's authors published.
    """

    temperature: float | None = None
    iterations: int = 10
    normalise: bool = True

    def __post_init__(self) -> None:
        _check(self, temperature=_POSITIVE_OR_NONE, iterations=_COUNT, normalise=_FLAG)


@dataclass(frozen=True, kw_only=True)
class AxiomaticSettings:
    """The axiomatic method: wave kernel signatures and smoothed positions. Chosen on training pairs of upright people.

    Args:
        n_eigenpairs: size of the first functional map: small, as the descriptors are only roughly right.
        regularisation: weight of its resolvent mask: stiff, for the same reason.
        position_weight: of the three coordinates against each channel of the signature, all of unit norm.
    """

    n_eigenpairs: int = 15
    regularisation: float = 1000.0
    position_weight: float = 30.0

    def __post_init__(self) -> None:
        _check(self, n_eigenpairs=_COUNT, regularisation=_NOT_NEGATIVE, position_weight=_NOT_NEGATIVE)


@dataclass(frozen=True, kw_only=True)
class AlignmentSettings:
    """The similarity alignment of a partial shape with the full one. New here.

    Args:
        steps: how many positions are looked at from each start, the start included.
        partial_samples: points of the partial shape that are compared; a basis at samples needs some twice as many as
            it has eigenvectors.
        full_samples: points of the full shape.
        similar: mean cosine between features from which on the partial shape is aligned, and no other start is tried.
        followed: how many starts are followed.
        margin: by how much another size or rotation must be more similar than the given one; what nearly is as similar
            may be its mirror image.
        scales: sizes to start from, where the given one does not fit.
        rotations: axis (0 to 2) and degrees of the rotations to start from; the first is none.
    """

    steps: int = 4
    partial_samples: int = 1000
    full_samples: int = 2500
    similar: float = 0.94
    followed: int = 2
    margin: float = 0.01
    scales: tuple[float, ...] = (0.8, 1.25, 0.63, 1.6, 0.5, 2.0, 0.4, 2.5, 0.32, 3.2)
    rotations: tuple[tuple[int, float], ...] = (
        (1, 0),
        (1, 180),
        (1, 270),
        (1, 90),
        (0, 60),
        (0, -60),
        (2, 60),
        (2, -60),
    )

    def __post_init__(self) -> None:
        _check(self, steps=_COUNT, partial_samples=_COUNT, full_samples=_COUNT, followed=_COUNT, margin=_NOT_NEGATIVE)


@dataclass(frozen=True, kw_only=True)
class OrientationSettings:
    """The search for the way round of two full shapes. New here; the weights were chosen on pairs of training shapes.

    Hypotheses are rotations. Each gives a coarse map of samples, and the one of least misfit is taken: the mean
    distance between points and their counterparts once the shapes are turned, plus ``cycle`` times the mean cycle
    error, minus ``handedness`` times how far the map keeps left and right, plus ``orienter`` times the misfit of what
    the features' orienter found. All lengths are in units of sqrt(area).

    Args:
        samples: points of each shape that a coarse map is made of.
        hypotheses: how many rotations get one.
        map_eigenpairs: eigenfunctions that coarse maps are refined with.
        cycle: weight of the cycle error.
        handedness: weight of the handedness.
        orienter: weight of the orienter's misfit.
        orienter_margin: what the orienter finds worse by more than this is not looked at any further.
        margin: what is better by less than this is not told apart: the given way round is then kept, and the pair is
            said to be ambiguous.
        least_degrees: a shape that the orienter would turn by less stays as it is given.
    """

    samples: int = 500
    hypotheses: int = 6
    map_eigenpairs: int = 50
    cycle: float = 1.0
    handedness: float = 0.1
    orienter: float = 1.0
    orienter_margin: float = 0.05
    margin: float = 0.01
    least_degrees: float = 30.0

    def __post_init__(self) -> None:
        _check(
            self,
            samples=_COUNT,
            hypotheses=_COUNT,
            map_eigenpairs=_COUNT,
            cycle=_NOT_NEGATIVE,
            handedness=_NOT_NEGATIVE,
            orienter=_NOT_NEGATIVE,
            orienter_margin=_NOT_NEGATIVE,
            margin=_NOT_NEGATIVE,
            least_degrees=_NOT_NEGATIVE,
        )


@dataclass(frozen=True, kw_only=True)
class WarningSettings:
    """When a match is said to be doubtful.

    Args:
        least_confidence: mean confidence below which it is. Good matches of bodies have 0.7 to 0.9, hopeless ones under
            0.2.
        most_dirichlet_energy: mean Dirichlet energy of the maps above which it is. Of 72 maps of people and animals,
            all above 8 were off by more than 6 % of sqrt(area), and all but one of those below by less than 8 %.
    """

    least_confidence: float = 0.35
    most_dirichlet_energy: float = 8.0


@dataclass(frozen=True, kw_only=True)
class MatcherSettings:
    """How maps are made from features.

    Args:
        method: name of a method (``homolog.methods.method_names()``), a method of one's own, or ``"auto"``:
            ``functional-map`` for two meshes of near-isometric kind, ``nearest-features`` otherwise, and ``axiomatic``
            without features.
        functional_map: the functional map that fits features.
        soft_map: the soft map between features.
        axiomatic: the method of that name.
        registration: the method of that name.
        orientation: the search for the way round of full shapes; ``PairOptions.orient`` says whether there is one.
        alignment: of a partial shape with the full one before matching; None for none.
        refinement: of the point maps, by ZoomOut; None for none, as the paper has it. Features for shapes that are not
            nearly isometric are never refined.
        confidence: of the point maps, and the overlap of a full shape with a partial one.
        warnings: when a match is said to be doubtful.
        operators: what operators to compute; by default those that the features were trained with.

    Raises:
        ArgumentError: if one of them is of another kind or size.

    Examples:
        >>> import homolog
        >>> homolog.MatcherSettings(method="functional-map", refinement=None).functional_map.regularisation
        100.0
    """

    method: Any = "auto"
    functional_map: FunctionalMapSettings = field(default_factory=FunctionalMapSettings)
    soft_map: SoftMapSettings = field(default_factory=SoftMapSettings)
    axiomatic: AxiomaticSettings = field(default_factory=AxiomaticSettings)
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    orientation: OrientationSettings = field(default_factory=OrientationSettings)
    alignment: AlignmentSettings | None = field(default_factory=AlignmentSettings)
    refinement: RefinementSettings | None = field(default_factory=RefinementSettings)
    confidence: ConfidenceSettings = field(default_factory=ConfidenceSettings)
    warnings: WarningSettings = field(default_factory=WarningSettings)
    operators: OperatorSettings | None = None

    def __post_init__(self) -> None:
        for name, kind, optional in _PARTS:
            value = getattr(self, name)
            if not (isinstance(value, kind) or (optional and value is None)):
                raise bad_value(name, value, f"{kind.__name__}{', or None' if optional else ''}")

    def to_dict(self) -> dict[str, Any]:
        """All of them for JSON; a method of one's own by its name."""
        named = isinstance(self.method, str)
        name = self.method if named else getattr(self.method, "name", function_name(self.method))
        return asdict(replace(self, method=name))


_PARTS: tuple[tuple[str, type, bool], ...] = (
    ("functional_map", FunctionalMapSettings, False),
    ("soft_map", SoftMapSettings, False),
    ("axiomatic", AxiomaticSettings, False),
    ("registration", RegistrationSettings, False),
    ("orientation", OrientationSettings, False),
    ("alignment", AlignmentSettings, True),
    ("refinement", RefinementSettings, True),
    ("confidence", ConfidenceSettings, False),
    ("warnings", WarningSettings, False),
    ("operators", OperatorSettings, True),
)


def choose_device(device: Device | torch.device) -> torch.device:
    """The torch device for ``"auto"``, ``"cpu"`` or ``"cuda"``; a torch device of these types is taken as it is.

    Raises:
        ArgumentError: if there is no such device.
    """
    kind = device.type if isinstance(device, torch.device) else device
    if kind not in get_args(Device):
        raise bad_choice("device", str(device), get_args(Device))
    if kind == "cuda" and not torch.cuda.is_available():
        raise ArgumentError(f"device is '{device}', but PyTorch finds no CUDA device; use 'cpu' or 'auto'")
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(device)
