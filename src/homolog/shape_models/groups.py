"""Named groups of a collection's shapes: their means, and two of them compared point by point."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from homolog.core.errors import ArgumentError, DataError, bad_choice
from homolog.core.files import expanded, read_text, write_csv, write_json, written_together
from homolog.core.progress import Progress, ignore
from homolog.core.reasons import reason_of
from homolog.core.versions import versions
from homolog.geometry import Surface
from homolog.shape_models.stored_model import StoredModel
from homolog.shapes import Shape, write_shape
from homolog.statistics import PERMUTATIONS, GroupComparison, compare_groups
from homolog.viewing import heat_layer

COMPARISON, POINTS, REPORT = "comparison.ply", "points.csv", "comparison.json"
COMPARISON_FILES = (COMPARISON, POINTS, REPORT)
"""What a comparison writes into its folder, beside ``mean-GROUP.ply`` for each group."""
# Of corrected p below which points count as different in the summary.
_LEVEL = 0.05


@dataclass(frozen=True, eq=False)
class ComparedGroups:
    """Two groups of a collection, compared.

    Args:
        groups: the names of both.
        members: the shapes of each.
        means: the mean shape of each group, aligned alike, with the template's faces.
        comparison: the statistics, of the second group less the first.
        along_normals: the difference along the normals of the mean of both, positive where the second is outward; NaN
            for clouds (n,).
    """

    groups: tuple[str, str]
    members: tuple[tuple[str, ...], tuple[str, ...]]
    means: tuple[Shape, Shape]
    comparison: GroupComparison
    along_normals: Float[np.ndarray, " n"]

    @property
    def mean(self) -> Shape:
        """Midway between both means."""
        return Shape((self.means[0].points + self.means[1].points) / 2, self.means[0].faces)

    def numbers(self) -> dict[str, Float[np.ndarray, " n"]]:
        """Of each point, by the name that files have for it."""
        found = self.comparison
        return {
            "difference": np.linalg.norm(found.difference, axis=1),
            "along_normal": self.along_normals,
            "t_squared": found.t_squared,
            "p": found.p,
            "p_corrected": found.p_corrected,
            "q": found.q,
        }

    def figures(self) -> dict[str, Any]:
        """For JSON."""
        found = self.comparison
        return {
            "groups": {name: list(members) for name, members in zip(self.groups, self.members, strict=True)},
            "permutations": found.permutations,
            "is_exact": found.is_exact,
            "p_overall": found.p_overall,
            "level": _LEVEL,
            "points": int(np.isfinite(found.p).sum()),
            "points_below_level_corrected": int((found.p_corrected <= _LEVEL).sum()),
            "points_below_level_of_false_discoveries": int((found.q <= _LEVEL).sum()),
            "largest_difference": float(np.nanmax(np.linalg.norm(found.difference, axis=1))),
        }


def read_groups(path: str | Path, names: Sequence[str]) -> dict[str, list[str]]:
    """The shapes of each group, from a table with a row per shape.

    Args:
        path: a CSV with the columns ``name`` and ``group``; a name may have its file's suffix.
        names: the shapes that there are. Those that the table does not name, or gives no group, are left out.

    Raises:
        DataError: if it cannot be read, has no such columns, names other shapes, or one shape twice.

    Examples:
        >>> read_groups("groups.csv", ["anna", "ben"])  # doctest: +SKIP
        {'patients': ['anna'], 'controls': ['ben']}
    """
    try:
        rows = list(csv.DictReader(read_text(expanded(path)).splitlines(), strict=True))
        given = [((row["name"] or "").strip(), (row["group"] or "").strip()) for row in rows]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path} cannot be read ({reason_of(error)}); give a table of names and groups") from None
    except (KeyError, AttributeError):
        raise DataError(f"{path} must be a table with the columns name and group; its first row must say so") from None
    known = {name: name for name in names} | {PurePath(name).stem: name for name in names}
    groups: dict[str, list[str]] = {}
    for name, group in given:
        shape = known.get(name) or known.get(PurePath(name).stem)
        if shape is None:
            raise DataError(f"{path} names {name!r}, but the collection has no such shape; it has {', '.join(names)}")
        if group:
            groups.setdefault(group, []).append(shape)
    counts = Counter(shape for members in groups.values() for shape in members)
    for shape, count in counts.items():
        if count > 1:
            raise DataError(f"{path} names {shape} {count} times; give each shape once")
    return groups


def compared_groups(
    stored: StoredModel,
    groups: dict[str, list[str]],
    between: Sequence[str] | None = None,
    *,
    permutations: int = PERMUTATIONS,
    seed: int = 0,
    progress: Progress = ignore,
) -> ComparedGroups:
    """Compare two groups of a collection's shapes point by point; see ``homolog.statistics.compare_groups``.

    All shapes of both are aligned together, with their sizes removed where the collection was made so.

    Args:
        stored: the collection's model.
        groups: the shapes of each group, as ``read_groups`` gives them.
        between: the names of two groups; not needed where there are two.
        permutations: relabellings of the shapes.
        seed: of what is drawn.
        progress: called with relabellings that are done.

    Raises:
        ArgumentError: if there are not two such groups, or they have too few shapes.
        DataError: if the collection's points are damaged.
    """
    chosen = tuple(between or groups)
    for name in chosen:
        if name not in groups:
            raise bad_choice("group", name, list(groups))
    if len(chosen) != 2 or chosen[0] == chosen[1]:
        raise ArgumentError(
            f"two groups are compared, but there are {len(chosen)}: {', '.join(chosen)}; say which two by between"
        )
    first, second = (tuple(groups[name]) for name in chosen)
    rows = [stored.names.index(name) for name in (*first, *second)]
    aligned, is_second = stored.aligned(rows), np.arange(len(rows)) >= len(first)
    found = compare_groups(aligned[:, stored.kept], is_second, permutations=permutations, seed=seed, progress=progress)
    found = _with_others(found, stored.kept)
    faces = stored.mean.faces
    means = Shape(aligned[~is_second].mean(axis=0), faces), Shape(aligned[is_second].mean(axis=0), faces)
    along = np.full(stored.mean.n_points, np.nan)
    if faces is not None:
        middle = Surface((means[0].points + means[1].points) / 2, faces)
        along = np.einsum("nk,nk->n", found.difference, middle.vertex_normals)
    return ComparedGroups((chosen[0], chosen[1]), (first, second), means, found, along)


def _with_others(found: GroupComparison, kept: Bool[np.ndarray, " n"]) -> GroupComparison:
    """The comparison with NaN at points that take no part."""

    def every(own: Float[np.ndarray, "k ..."]) -> Float[np.ndarray, "n ..."]:
        values = np.full((len(kept), *own.shape[1:]), np.nan)
        values[kept] = own
        return values

    return replace(
        found,
        difference=every(found.difference),
        t_squared=every(found.t_squared),
        p=every(found.p),
        p_corrected=every(found.p_corrected),
        q=every(found.q),
    )


def mean_file(group: str) -> str:
    """The name of the file of a group's mean.

    Raises:
        ArgumentError: if the group's name cannot be part of a file's.
    """
    if PurePath(group).name != group or "\\" in group or group.startswith("."):
        raise ArgumentError(f"group {group!r} cannot be part of a file's name; rename it")
    return f"mean-{group}.ply"


def write_comparison(folder: str | Path, found: ComparedGroups, *, files: Sequence[str | Path] = ()) -> list[Path]:
    """Write a comparison into a folder, whole or not at all.

    ``comparison.ply`` is the mean of both groups with the numbers of ``ComparedGroups.numbers`` at each point, in a
    heat map of the corrected p: dark where it is small. ``points.csv`` has the same as a table, and ``mean-GROUP.ply``
    the mean of each group, which may be the template of another collection.

    Args:
        folder: where to.
        found: what to write.
        files: inputs, which are not to be replaced.

    Returns:
        The files that were written.

    Raises:
        ArgumentError: if the folder cannot be written to, or a file in it is an input.
    """
    names = (COMPARISON, POINTS, *map(mean_file, found.groups), REPORT)
    numbers = found.numbers()
    heat = heat_layer("", "", {"source": -np.log10(numbers["p_corrected"])}, "")
    with written_together(folder, names, files) as paths:
        write_shape(paths[0], found.mean, colours=heat.colours["source"], numbers=numbers)
        columns = np.column_stack([*numbers.values()]).tolist()
        rows = [(point, *(value if np.isfinite(value) else None for value in row)) for point, row in enumerate(columns)]
        write_csv(paths[1], [("point", *numbers), *rows])
        for path, mean in zip(paths[2:4], found.means, strict=True):
            write_shape(path, mean)
        write_json(paths[4], {**found.figures(), "versions": versions()})
    return paths
