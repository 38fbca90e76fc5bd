"""The result of a match: point maps both ways, in the indices of the shapes as they were given."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix
from scipy.spatial import KDTree
from torch import Tensor

from homolog.core.arguments import check_choice, check_count, check_kind
from homolog.core.errors import ArgumentError, DataError, bad_value
from homolog.core.files import expanded
from homolog.core.versions import versions
from homolog.geometry import Operators, OperatorSettings, compute_operators
from homolog.maps import confidence, overlap, rotation_angle
from homolog.matching import result_files
from homolog.matching.parts import overlap_of_parts
from homolog.matching.quality import MapQuality, quality
from homolog.pairs import SIDES, Pair, PointMaps, Side
from homolog.shapes import Shape, repair

if TYPE_CHECKING:
    from PIL.Image import Image

# What shows a match stands above it, so that it is loaded by its name, and only when it is asked for: users and
# notebooks look for a picture at the match itself.
_VIEWING = "homolog.viewing"
# The entries of a report that speak of source and target. Inputs do as well, but hold names of files, which stay.
_SIDED = ("quality", "options", "orientation", "overlap", "matched", "timings", "warnings")
# In a text: what is quoted, but for the sides themselves; words, in which paths and names of files are one; and those
# that speak of the sides, such as "source", "--target-up" and "source_to_target".
_QUOTED = r"(?<!\w)(?P<quote>['\"])(?!(?:source|target)(?P=quote)).*?(?P=quote)(?!\w)"
_WORD = r"(?P<word>[\w./\\~@+-]*\w)"
_TERM = r"--(?:source|target)(?:-\w+)*|(?:\w+_)*(?:source|target)(?:_\w+)*"


@dataclass(frozen=True, eq=False, repr=False)
class Match:
    """Point maps both ways between two shapes, in the indices of the shapes as they were given.

    Args:
        source: one shape, as it was given.
        target: the other.
        source_to_target: for each source point its target point's index (n_source,), int64; -1 = no counterpart.
        target_to_source: for each target point its source point's index (n_target,), int64; -1 = no counterpart.
        source_confidence: trust in each entry of ``source_to_target``, from 0 to 1; 0 where that is -1. By default 1
            for every point with a counterpart.
        target_confidence: likewise for ``target_to_source``.
        method: how the maps were found.
        warnings: what the user should know, a line each.
        quality: figures of the maps as a whole, where they were found here.
        report: inputs, options, settings, and what was repaired, for JSON.

    Raises:
        ArgumentError: if something given is of another kind, an array is not of the length that its shape asks for, an
            index is that of no point, or a confidence is not from 0 to 1.

    Examples:
        >>> import homolog
        >>> source, target = homolog.demo_shapes()
        >>> match = homolog.match(source, target, method="axiomatic")
        >>> match.source_to_target.shape == (source.n_points,)
        True
        >>> match.inverse().source is target
        True
    """

    source: Shape
    target: Shape
    source_to_target: Int[np.ndarray, " n_source"]
    target_to_source: Int[np.ndarray, " n_target"]
    source_confidence: Float[np.ndarray, " n_source"] = None  # type: ignore[assignment]
    target_confidence: Float[np.ndarray, " n_target"] = None  # type: ignore[assignment]
    method: str = "given"
    warnings: tuple[str, ...] = ()
    quality: MapQuality | None = None
    report: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for side in SIDES:
            check_kind(side, getattr(self, side), Shape)
        if not (isinstance(self.warnings, list | tuple) and all(isinstance(warning, str) for warning in self.warnings)):
            raise bad_value("warnings", self.warnings, "a list of texts, a line each")
        object.__setattr__(self, "warnings", tuple(self.warnings))
        if not isinstance(self.report, Mapping):
            raise bad_value("report", self.report, "a table, such as {}")
        for side, shape, other in (("source", self.source, self.target), ("target", self.target, self.source)):
            name = "source_to_target" if side == "source" else "target_to_source"
            indices = check_point_map(name, getattr(self, name), n_points=shape.n_points, n_others=other.n_points)
            object.__setattr__(self, name, indices)
            trust = getattr(self, f"{side}_confidence")
            trust = (indices >= 0) if trust is None else trust
            object.__setattr__(self, f"{side}_confidence", _checked_confidence(side, trust, len(indices)))

    @classmethod
    def of(cls, pair: Pair, maps: PointMaps, *, judged: PointMaps | None = None) -> Match:
        """The match that point maps between the repaired shapes of a pair make.

        Adds confidences, the points of a full shape that have no counterpart on a partial one, figures of quality and a
        report, and goes back to the indices of the shapes as they were given.

        Args:
            pair: two preprocessed shapes.
            maps: between their operators' points.
            judged: whose confidences and quality are told in place of theirs: two maps that were found in one say
                nothing of each other.

        Raises:
            ArgumentError: if the maps do not fit the pair.
        """
        x, y, settings = pair.x, pair.y, pair.settings.confidence
        at_x, at_y = x.operators.points, y.operators.points
        x_to_y, y_to_x = _followed(pair, maps)
        there, back = (x_to_y, y_to_x) if judged is None or judged is maps else _followed(pair, judged)
        x_trust = confidence(at_x, at_y, there, back, settings=settings)
        y_trust = confidence(at_y, at_x, back, there, settings=settings)
        figures: MapQuality | None = None
        if not pair.are_parts:  # most of what either part lacks would be counted, too
            of_x = None if pair.is_partial else quality(x, y, there, back, x_trust)
            figures = MapQuality(of_x, quality(y, x, back, there, y_trust))
        if pair.is_partial:
            found = overlap(x.operators, y.operators, y_to_x, settings=settings)
            x_to_y, x_trust = torch.where(found, x_to_y, -1), torch.where(found, x_trust, 0.0)
        if pair.are_parts:
            on_x, on_y = overlap_of_parts(pair, x_to_y, y_to_x)
            x_to_y, x_trust = torch.where(on_x, x_to_y, -1), torch.where(on_x, x_trust, 0.0)
            y_to_x, y_trust = torch.where(on_y, y_to_x, -1), torch.where(on_y, y_trust, 0.0)
        match = cls(
            source=x.given,
            target=y.given,
            source_to_target=x.repaired.original_map(x_to_y.cpu().numpy(), y.repaired),
            target_to_source=y.repaired.original_map(y_to_x.cpu().numpy(), x.repaired),
            source_confidence=x.repaired.to_original(x_trust.cpu().numpy(), fill=0),
            target_confidence=y.repaired.to_original(y_trust.cpu().numpy(), fill=0),
            method=pair.method.name,
            quality=figures,
        )
        match = match if x is pair.source else match.inverse()
        return replace(match, report=_report(pair, match))

    def inverse(self) -> Match:
        """The same maps with source and target exchanged, in warnings and report too."""
        return replace(
            self,
            source=self.target,
            target=self.source,
            source_to_target=self.target_to_source,
            target_to_source=self.source_to_target,
            source_confidence=self.target_confidence,
            target_confidence=self.source_confidence,
            warnings=_exchanged(self.warnings, self._names),
            quality=None if self.quality is None else self.quality.inverse(),
            report=_exchanged_report(self.report, self._names),
        )

    @property
    def _names(self) -> tuple[str, ...]:
        """What messages may call the shapes and their files: words in them say nothing of source and target."""
        inputs = self.report.get("inputs", {})
        known = (inputs.get(side, {}) for side in SIDES)
        told = (str(shape[key]) for shape in known for key in ("file", "name") if key in shape)
        return tuple({self.source.name, self.target.name, *told} - {"", *SIDES})

    def compose(self, other: Match) -> Match:
        """The match from this one's source to the other's target, by way of the shape in between.

        A point has no counterpart where either map has none. Confidences are multiplied.

        Args:
            other: whose source has the points of this match's target.

        Raises:
            ArgumentError: if it is no match, or the shape in between has another number of points in it.
        """
        check_kind("other", other, Match)
        if other.source.n_points != self.target.n_points:
            raise ArgumentError(
                f"the other match begins at {other.source.name} with {other.source.n_points} points, but must begin at "
                f"{self.target.name} with {self.target.n_points}"
            )
        forth, forth_trust = _composed(
            self.source_to_target, self.source_confidence, other.source_to_target, other.source_confidence
        )
        back, back_trust = _composed(
            other.target_to_source, other.target_confidence, self.target_to_source, self.target_confidence
        )
        ends = {"source": self, "target": other}
        inputs = {side: match.report.get("inputs", {}).get(side, {}) for side, match in ends.items()}
        return Match(
            self.source, other.target, forth, back, forth_trust, back_trust, "composed", report={"inputs": inputs}
        )

    def to_matrix(self) -> csr_matrix:
        """The map as a sparse matrix (n_target, n_source) that takes functions on the source to the target.

        Row i has a one at the source point of target point i, and is empty where that has no counterpart.
        """
        (rows,) = np.nonzero(self.target_to_source >= 0)
        columns = self.target_to_source[rows]
        return csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(self.target.n_points, self.source.n_points))

    def functional_map(self, k: int = 50) -> Float[np.ndarray, "k k"]:
        """The functional map C = Phi_target^+ Pi Phi_source of the map, in the lowest k eigenfunctions of both shapes.

        Ovsjanikov et al., "Functional maps: a flexible representation of maps between shapes", SIGGRAPH 2012. Operators
        are computed anew; target points without a counterpart take no part.

        Args:
            k: how many eigenfunctions.

        Raises:
            ArgumentError: if ``k`` is no whole number of at least 1, or more than there are eigenfunctions or target
                points with a counterpart.
        """
        check_count("k", k)
        clean = repair(self.source), repair(self.target)
        for side, each in zip(SIDES, clean, strict=True):
            if each.shape.n_points < k:
                raise _too_many(k, self, side, f"{each.shape.n_points} points once repaired")
        found = self.target_to_source[clean[1].kept]
        mapped = np.where(found >= 0, clean[0].clean_index[found], -1)
        (known,) = np.nonzero(mapped >= 0)
        if len(known) < k:
            raise ArgumentError(
                f"k is {k}, but only {len(known)} points of the target, {self.target.name}, have a counterpart; "
                "give at most as many"
            )
        source, target = (compute_operators(each.shape, settings=OperatorSettings(n_eigenpairs=k)) for each in clean)
        for side, operators in zip(SIDES, (source, target), strict=True):
            if operators.n_eigenpairs < k:
                raise _too_many(k, self, side, f"{operators.n_eigenpairs} eigenfunctions")
        weight = target.mass[known].double().sqrt()[:, None]
        phi_target = weight * target.eigenvectors[known].double()
        carried = weight * source.eigenvectors[torch.from_numpy(mapped[known])].double()
        found_map: np.ndarray = torch.linalg.lstsq(phi_target, carried).solution.numpy()
        return found_map

    def save(
        self,
        path: str | Path,
        *,
        base: int | None = None,
        direction: str = "target_to_source",
        name: str | None = None,
    ) -> list[Path]:
        """Write the match: a result folder, or one file.

        A path without a suffix is a folder, with ``correspondence.npz``, ``source.ply`` and ``target.ply`` (coloured
        alike) and ``report.json``, as ``homolog match`` writes it. A file is a point map by its suffix:

        ========  =====================================================================  ============
        suffix    what it holds                                                          indices from
        ========  =====================================================================  ============
        ``.npz``  both maps and confidences                                              0
        ``.mat``  both maps and confidences, for MATLAB                                  1
        ``.txt``  one map: a line per point with the index of its counterpart            0
        ``.vts``  one map, likewise                                                      1
        ``.map``  one map, likewise                                                      1
        ========  =====================================================================  ============

        A point without a counterpart has the index before the first one: -1, or 0 where indices count from 1.

        Args:
            path: where to.
            base: the first index of a file, 0 or 1; by default that of the table.
            name: for ``.mat`` and ``.npz``: hold one map alone, of ``direction``, under this name, as other programs
                read it: ``p2p`` or ``T12``.
            direction: which map a file of one map holds: ``"target_to_source"``, for each target point its source
                point, as the field's tables score it, or ``"source_to_target"``.

        Returns:
            The files that were written.

        Raises:
            ArgumentError: if there is no such format, the path cannot be written to, or one of the options is given for
                a folder, which always holds both maps with indices from 0.
        """
        if expanded(path).suffix and not expanded(path).is_dir():
            return [result_files.write_maps(path, self, base=base, direction=direction, name=name)]
        if base is not None or name is not None or direction != "target_to_source":
            raise ArgumentError(
                f"base, direction and name are for files of point maps, but {path} is a folder; leave them out, or "
                "give a file's name, such as map.vts"
            )
        return result_files.write_folder(path, self)

    @classmethod
    def load(cls, folder: str | Path) -> Match:
        """Read a match from a folder that ``save`` or ``homolog match`` wrote.

        A single file that ``save`` wrote holds maps, but neither shapes nor report: ``homolog.matching.read_point_map``
        reads a map of it, and ``Match(source, target, source_to_target, target_to_source)`` makes a match of two.

        Raises:
            DataError: if there is no such folder, or one of its files is missing, damaged, or does not fit the others.
            ShapeError: if a shape cannot be read.
        """
        if not expanded(folder).is_dir():
            raise DataError(_no_folder(folder))
        stored = result_files.read_folder(folder)
        try:
            return cls(**stored)
        except ArgumentError as error:
            raise DataError(f"{folder}: correspondence.npz does not fit the shapes ({error}); match again") from None

    def plot(self, path: str | Path | None = None) -> Image:
        """A picture of both shapes side by side, in which the same colour marks the same point; shown by notebooks.

        Args:
            path: a ``.png`` to write it to, too.

        Raises:
            MissingExtraError: if the extra ``picture`` is not installed.
        """
        viewing = import_module(_VIEWING)
        image: Image = viewing.plot(viewing.scene_of(self), path)
        return image

    def _repr_html_(self) -> str:
        """Picture and figures, for notebooks."""
        viewing = import_module(_VIEWING)
        figures = {} if self.quality is None else asdict(self.quality.mean)
        shown = {name: f"{value:.3g}" for name, value in figures.items() if value is not None}
        html: str = viewing.notebook_html(viewing.scene_of(self), {**shown, "warnings": len(self.warnings)})
        return html

    def matched(self, side: Side) -> dict[str, int | float]:
        """What became of the points of a shape.

        Raises:
            ArgumentError: if ``side`` is neither ``"source"`` nor ``"target"``.
        """
        check_choice("side", side, SIDES)
        indices = self.source_to_target if side == "source" else self.target_to_source
        trust = self.source_confidence if side == "source" else self.target_confidence
        unmatched = int((indices < 0).sum())
        # A map that was changed since may have counterparts for them.
        left_out = min(self.report.get("inputs", {}).get(side, {}).get("points_left_out", 0), unmatched)
        return {
            "points": len(indices),
            "points_left_out": left_out,
            "points_without_counterpart": unmatched - left_out,
            "mean_confidence": float(trust.mean()),
        }

    def __repr__(self) -> str:
        doubt = f", {len(self.warnings)} warnings" if self.warnings else ""
        trust = f"confidence {self.source_confidence.mean():.2f} and {self.target_confidence.mean():.2f}"
        return f"Match({self.source.name!r} -> {self.target.name!r} by {self.method}, {trust}{doubt})"


def _too_many(k: int, match: Match, side: Side, there_are: str) -> ArgumentError:
    """The error of a functional map that is larger than a shape allows."""
    shape = getattr(match, side)
    return ArgumentError(f"k is {k}, but the {side}, {shape.name}, has {there_are}; give at most as many")


def _no_folder(path: str | Path) -> str:
    """What to say of a path that is no result folder."""
    instead = "give a folder that homolog match or Match.save wrote"
    if not expanded(path).exists():
        return f"there is no folder {path}; {instead}"
    if expanded(path).suffix.lower() in result_files.MAP_SUFFIXES:
        return (
            f"{path} is a file of point maps, which holds no shapes; read its maps with "
            f"homolog.matching.read_point_map, or {instead}"
        )
    return f"{path} is a file; {instead}"


def check_point_map(name: str, indices: Any, *, n_points: int, n_others: int) -> Int[np.ndarray, " n"]:
    """A point map as int64, checked to have an entry per point, each an index of the other shape or -1.

    Raises:
        ArgumentError: naming what was found.
    """
    try:
        indices = np.asarray(indices.detach().cpu() if isinstance(indices, Tensor) else indices)
    except (TypeError, ValueError, RuntimeError):  # of lists of several lengths, or of several maps
        kind = type(indices).__name__
        raise ArgumentError(
            f"{name} is a {kind} that is no array, but must be one map, with one entry per point, ({n_points},)"
        ) from None
    if indices.dtype.kind not in "iu":
        raise ArgumentError(f"{name} holds {indices.dtype}, but must hold whole numbers, indices of points from 0")
    if indices.shape != (n_points,):
        raise ArgumentError(
            f"{name} has shape {indices.shape}, but must have one entry per point of the shape as given, ({n_points},)"
        )
    if n_points and not -1 <= indices.min() <= indices.max() < n_others:
        wrong = indices.max() if indices.max() >= n_others else indices.min()
        raise ArgumentError(
            f"{name} holds {wrong}, but must hold indices of the other shape, 0 to {n_others - 1}, or -1 for none"
        )
    found: np.ndarray = indices.astype(np.int64, copy=False)
    return found


def _checked_confidence(side: str, given: Any, n_points: int) -> Float[np.ndarray, " n"]:
    trust = np.asarray(given.detach().cpu() if isinstance(given, Tensor) else given)
    if trust.dtype.kind not in "biuf":
        raise ArgumentError(f"{side}_confidence holds {trust.dtype}, but must hold numbers from 0 to 1")
    if trust.shape != (n_points,):
        raise ArgumentError(
            f"{side}_confidence has shape {trust.shape}, but must have one entry per point, ({n_points},)"
        )
    outside = trust[~((trust >= 0) & (trust <= 1))]
    if len(outside):
        raise ArgumentError(f"{side}_confidence holds {outside[0]}, but must hold numbers from 0 to 1")
    return trust if trust.dtype in (np.float32, np.float64) else trust.astype(float)


def checked_maps(pair: Pair, maps: Any) -> PointMaps:
    """What a method gave as tensors of int64 on the pair's device, checked to fit the repaired shapes.

    Raises:
        ArgumentError: naming the method and what was found.
    """
    method = pair.method.name
    if not isinstance(maps, PointMaps):
        raise ArgumentError(
            f"method {method!r} gave a {type(maps).__name__}, but must give homolog.pairs.PointMaps(x_to_y, y_to_x)"
        )
    n_x, n_y = pair.x.operators.n_points, pair.y.operators.n_points
    device = pair.x.operators.points.device
    return PointMaps(
        x_to_y=_checked_map(f"x_to_y of method {method!r}", maps.x_to_y, n_x, n_y).to(device),
        y_to_x=_checked_map(f"y_to_x of method {method!r}", maps.y_to_x, n_y, n_x).to(device),
    )


def _checked_map(name: str, given: Any, n_points: int, n_others: int) -> Int[Tensor, " n"]:
    """One of the maps of a method, which may be a tensor, an array or a list."""
    try:
        indices = given.detach() if isinstance(given, Tensor) else torch.from_numpy(_whole_numbers(given))
    except (TypeError, ValueError, RuntimeError):
        indices = None
    whole = indices is not None and not (indices.is_floating_point() or indices.is_complex())
    if indices is None or not whole or indices.dtype == torch.bool or indices.shape != (n_points,):
        kind = type(given).__name__
        found = f"a {kind}"
        if indices is not None:
            found += f" of {str(indices.dtype).removeprefix('torch.')}, {tuple(indices.shape)}"
        raise ArgumentError(f"{name} is {found}, but must be a tensor or array of whole numbers, ({n_points},)")
    low, high = int(indices.min()), int(indices.max())
    if low < 0 or high >= n_others:
        raise ArgumentError(
            f"{name} holds {low} to {high}, but must hold indices of the repaired shape's points, 0 to {n_others - 1}"
        )
    return indices.long()


def _whole_numbers(given: Any) -> np.ndarray:
    """An array that tensors can be made of: of int64 where it holds whole numbers of any kind."""
    array = np.asarray(given)
    return array.astype(np.int64) if array.dtype.kind in "iu" else array.copy()


def _followed(pair: Pair, maps: PointMaps) -> tuple[Int[Tensor, " n_x"], Int[Tensor, " n_y"]]:
    """Both maps of a pair where loose bits follow the main component."""
    maps = checked_maps(pair, maps)
    return (
        following_main_component(maps.x_to_y, pair.x.operators),
        following_main_component(maps.y_to_x, pair.y.operators),
    )


def following_main_component(point_map: Int[Tensor, " n"], operators: Operators) -> Int[Tensor, " n"]:
    """The map with points of small components going where the nearest point of the main component goes."""
    if operators.in_main_component.all():
        return point_map
    inside, points = operators.in_main_component.cpu(), operators.points.cpu().numpy()
    (main,) = torch.nonzero(inside, as_tuple=True)
    nearest = main[torch.from_numpy(KDTree(points[main]).query(points)[1])]
    return point_map[nearest.to(point_map.device)]


def _composed(
    first: Int[np.ndarray, " n"],
    first_trust: Float[np.ndarray, " n"],
    second: Int[np.ndarray, " m"],
    second_trust: Float[np.ndarray, " m"],
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    there = np.where(first >= 0, second[first], -1)
    return there, np.where(there >= 0, first_trust * second_trust[first], 0.0)


def _orientation(pair: Pair) -> dict[str, Any] | None:
    """The rotations that were found, from the shapes with their given axis up, and how sure they are."""
    if pair.orientation is None and not (pair.source.orientations or pair.target.orientations):
        return None
    rotations: dict[str, Any] = {
        side: {"rotation": shape.rotation.tolist(), "degrees": round(float(rotation_angle(shape.rotation)), 1)}
        for side, shape in zip(SIDES, (pair.source, pair.target), strict=True)
    }
    # Of a partial pair, the orienter told how the full shape stands, and nothing else was looked for.
    return {**rotations, **({} if pair.orientation is None else asdict(pair.orientation))}


def _alignment(pair: Pair) -> dict[str, Any] | None:
    """How the partial shape was turned onto the full one, and what its lengths were multiplied by."""
    if pair.alignment is None:
        return None
    rotation = pair.alignment.rotation
    degrees = round(float(rotation_angle(rotation)), 1)
    return {"rotation": rotation.tolist(), "degrees": degrees, "scale": pair.alignment.scale}


def _overlap(pair: Pair, match: Match) -> dict[str, Any]:
    """The share of the area of either part that has a counterpart on the other, and how well both fit."""
    maps = {"source": match.source_to_target, "target": match.target_to_source}
    shapes = {"source": pair.source, "target": pair.target}
    shares = {}
    for side, shape in shapes.items():
        mass = shape.operators.mass.cpu().double().numpy()
        shares[f"{side}_share"] = float(mass[maps[side][shape.repaired.kept] >= 0].sum() / mass.sum())
    return {**shares, "fit": None if pair.fit is None else asdict(pair.fit)}


def _report(pair: Pair, match: Match) -> dict[str, Any]:
    """What is known of a match, for JSON."""
    features = None if pair.extractor is None else asdict(pair.extractor.info)
    if features is not None and (file := getattr(pair.extractor, "file", "")):
        features["file"] = file
    inputs = {
        side: {
            "name": shape.name,
            **shape.to_dict(),
            "points_left_out": shape.n_left_out,
            "space": shape.given.space,
        }
        for side, shape in zip(SIDES, (pair.source, pair.target), strict=True)
    }
    described = replace(match, report={"inputs": inputs})
    return {
        "inputs": inputs,
        "method": match.method,
        "quality": None if match.quality is None else match.quality.to_dict(),
        "options": pair.options.to_dict(),
        "choice": [asdict(candidate) for candidate in pair.choice],
        "adaptation": None if pair.adaptation is None else asdict(pair.adaptation),
        "orientation": _orientation(pair),
        "alignment": _alignment(pair),
        **({"overlap": _overlap(pair, match)} if pair.are_parts else {}),
        "features": features,
        "settings": pair.settings.to_dict(),
        "device": str(pair.source.operators.points.device),
        "matched": {f"{side}_{name}": n for side in SIDES for name, n in described.matched(side).items()},
        "versions": versions(),
    }


def _exchanged_report(report: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """A report with source and target exchanged."""
    told = {name: _exchanged(entry, names) if name in _SIDED else entry for name, entry in report.items()}
    if "inputs" in report:
        told["inputs"] = {_exchanged(side): shape for side, shape in report["inputs"].items()}
    options = report.get("options") or {}
    if options.get("landmarks"):  # whose names are a user's
        told["options"]["landmarks"] = _exchanged_landmarks(options["landmarks"])
    if options.get("partial") == "both":  # the target's lengths are multiplied then, and it is moved onto the source
        told["options"]["partial_scale"] = 1 / options["partial_scale"]
        told["alignment"] = _inverse_alignment(report.get("alignment"))
    return told


def _exchanged_landmarks(landmarks: Mapping[str, Any]) -> dict[str, Any]:
    """Pairs of landmarks, whose uncertainties stay in the units of what was the target, with their sides exchanged."""
    exchanged = {"source": landmarks["target"], "target": landmarks["source"], "axes": landmarks["axes"][::-1]}
    return {**landmarks, **exchanged}


def _inverse_alignment(alignment: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """What took one part onto the other, the other way."""
    if alignment is None:
        return None
    return {**alignment, "rotation": np.transpose(alignment["rotation"]).tolist(), "scale": 1 / alignment["scale"]}


def _exchanged(entry: Any, names: Sequence[str] = ()) -> Any:
    """An entry of a report with the words source and target exchanged, in terms such as ``source_up`` as well.

    Names that are given, quotations and paths stay as they are.
    """
    if isinstance(entry, str):
        kept = "".join(rf"(?<!\w){re.escape(name)}(?!\w)|" for name in sorted(names, key=len, reverse=True))
        return re.sub(f"{kept}{_QUOTED}|{_WORD}", _exchanged_word, entry)
    if isinstance(entry, Mapping):
        return {_exchanged(name, names): _exchanged(value, names) for name, value in entry.items()}
    if isinstance(entry, list | tuple):
        return type(entry)(_exchanged(each, names) for each in entry)
    return entry


def _exchanged_word(found: re.Match[str]) -> str:
    word = found["word"]
    if word is None or not re.fullmatch(_TERM, word):
        return found[0]
    return re.sub("source|target", lambda side: "target" if side[0] == "source" else "source", word)
