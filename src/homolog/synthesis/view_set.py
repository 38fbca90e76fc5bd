"""A set of partial views on disk: pairs of a complete shape and a view of another, to train on and to score.

D. Cao and F. Bernard (CVPR 2023) train and test on such a set, 5,000 views of synthetic people.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
from jaxtyping import Int

from homolog.core.arguments import check_count, is_count
from homolog.core.errors import DataError, bad_value
from homolog.core.files import all_or_nothing, atomic_path, expanded, write_json
from homolog.core.folders import MANIFEST, claim
from homolog.core.progress import Progress, no_progress
from homolog.core.tasks import run_tasks
from homolog.datasets import ShapeFolder
from homolog.shapes import read_shape, repair, write_shape
from homolog.synthesis.view_plan import TEST_EVERY, Bodies, PlannedView, SetSplit, planned_view
from homolog.synthesis.views import View, ViewSettings, view

# Changes whenever the same settings come to give other views.
_MAKING = 1
_MOST_VIEWS = 1_000_000
_FOLDERS = ("off", "clouds", "truth")


def write_view_set(
    source: str | Path,
    output: str | Path,
    *,
    views: int,
    seed: int,
    settings: ViewSettings | None = None,
    processes: int = 1,
    progress: Progress | None = None,
) -> None:
    """Write views of the complete meshes in a folder; see docs/conventions.md for what lies where.

    Four of five views are for training, the others for testing, and so are four of five bodies, unless the source has
    its own ``train.txt`` and ``test.txt``. The bodies of a split take turns at being looked at, in an order that is
    drawn. Views do not depend on how many there are. What is there already is not made again.

    Args:
        source: a folder with ``off/NAME.off``, and perhaps ``corres/``, or any folder of meshes, all +y up.
        output: a new folder, or one that an earlier call with the same source, seed and settings began.
        views: how many; at least 5, so that one is for testing.
        seed: of all that is drawn: the same source, seed and settings give the same bytes.
        settings: where cameras may be, their pixels and their noise.
        processes: that share the work.
        progress: told how many files are done.

    Raises:
        ArgumentError: if ``output`` holds anything else, or ``views`` is out of range.
        DataError: if the source has fewer than two meshes, or names that lists cannot hold.
        ShapeError: if a mesh cannot be repaired, or shows next to nothing.
    """
    if not (is_count(views, least=TEST_EVERY) and views <= _MOST_VIEWS):
        raise bad_value("views", views, f"a whole number from {TEST_EVERY} to {_MOST_VIEWS}")
    check_count("seed", seed, least=0)
    check_count("processes", processes)
    bodies, place, settings = Bodies.open(source, seed=seed), expanded(output), settings or ViewSettings()
    manifest = _manifest(bodies, seed, settings)
    claim(place, manifest, [*_FOLDERS, *(["corres"] if bodies.truth_root is not None else [])])
    planned = [planned_view(bodies, number, seed=seed) for number in range(views)]
    used = sorted({name for one in planned for name in (one.own, one.complete)})
    make_bodies = [(name, partial(_write_body, bodies.files[name], bodies.truth_root, place)) for name in used]
    make_views = [(one.name, partial(_write_view, one, place, settings)) for one in planned]
    run_tasks([make_bodies, make_views], processes=processes, progress=progress or no_progress)
    _write_lists(place, planned)
    records = [json.loads(_record(place, one.name).read_text(encoding="utf-8")) for one in planned]
    write_json(place / MANIFEST, {**manifest, "views": records})


def _manifest(bodies: Bodies, seed: int, settings: ViewSettings) -> dict[str, Any]:
    """Of a set without views as yet; in the types that JSON has, to be compared with what is read back."""
    settled = {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(settings).items()}
    making = {"way": _MAKING, "seed": seed, **settled, "bodies": bodies.described()}
    return {"what": "partial views with ground truth, made by homolog synth views", "making": making, "views": []}


def _write_body(file: Path, truth_root: Path | None, place: Path) -> None:
    """A complete shape, repaired, and where its common points are in it then."""
    name = file.stem
    target, common_file = place / "off" / f"{name}.off", place / "corres" / f"{name}.vts"
    if _are_there([target, *([common_file] if truth_root is not None else [])]):
        return
    repaired = repair(read_shape(file))
    with all_or_nothing():
        if truth_root is not None:
            common = ShapeFolder(truth_root, ()).common_points(name)
            if common.max() >= len(repaired.clean_index):
                raise DataError(f"{truth_root}/corres/{name}.vts names vertex {common.max() + 1}, which {file} has not")
            _write_common(place, name, np.append(repaired.clean_index, -1)[common])
        write_shape(target, repaired.shape)


def _write_view(planned: PlannedView, place: Path, settings: ViewSettings) -> None:
    """A view as a mesh and as a cloud, its ground truth, and, last, the record of it."""
    record = _record(place, planned.name)
    folders = {"off": ".off", "clouds": ".ply", "truth": ".npz", "corres": ".vts"}
    files = [
        place / folder / f"{planned.name}{suffix}" for folder, suffix in folders.items() if (place / folder).is_dir()
    ]
    if _are_there([*files, record]):
        return
    found = view(read_shape(place / "off" / f"{planned.own}.off"), settings, seed=planned.seed)
    with all_or_nothing():
        write_shape(place / "off" / f"{planned.name}.off", found.mesh.shape)
        write_shape(place / "clouds" / f"{planned.name}.ply", found.cloud.shape)
        folder = ShapeFolder(place, ()) if (place / "corres").is_dir() else None
        if folder is not None:
            _write_common(place, planned.name, _where(found.mesh.complete_index, folder.common_points(planned.own)))
        with atomic_path(place / "truth" / f"{planned.name}.npz") as temporary:
            np.savez_compressed(temporary, allow_pickle=False, **_truth(planned, found, folder))
        write_json(record, _described(planned, found))


def _truth(planned: PlannedView, found: View, folder: ShapeFolder | None) -> dict[str, np.ndarray]:
    """Where a view's points lie on its own complete shape and, where that is known, on the one it is paired with."""
    arrays = {f"{kind}_to_own": part.complete_index for kind, part in (("mesh", found.mesh), ("cloud", found.cloud))}
    assert found.cloud.triangles is not None and found.cloud.weights is not None
    arrays |= {"cloud_triangles": found.cloud.triangles, "cloud_weights": found.cloud.weights}
    if planned.own == planned.complete:
        arrays |= {"mesh_to_complete": found.mesh.complete_index, "cloud_to_complete": found.cloud.complete_index}
    elif folder is not None:
        own, other = folder.common_points(planned.own), folder.common_points(planned.complete)
        if len(own) != len(other):
            raise DataError(f"corres/: {planned.own} has {len(own)} common points and {planned.complete} {len(other)}")
        arrays |= {f"{kind}_to_complete": _via(own, other, arrays[f"{kind}_to_own"]) for kind in ("mesh", "cloud")}
    return arrays


def _where(index: Int[np.ndarray, " n"], wanted: Int[np.ndarray, " p"]) -> Int[np.ndarray, " p"]:
    """The place of each wanted number in an ascending index, -1 where it is not there."""
    places = np.minimum(np.searchsorted(index, wanted), len(index) - 1)
    return np.where(index[places] == wanted, places, -1)


def _via(
    own: Int[np.ndarray, " p"], other: Int[np.ndarray, " p"], points: Int[np.ndarray, " n"]
) -> Int[np.ndarray, " n"]:
    """The other shape's point for each of these points of one's own, by the first common point there; -1 for none."""
    both = (own >= 0) & (other >= 0)
    there, first = np.unique(own[both], return_index=True)
    places = _where(there, points) if len(there) else np.full(len(points), -1)
    found: np.ndarray = np.append(other[both][first], -1)[places]
    return found


def _described(planned: PlannedView, found: View) -> dict[str, Any]:
    counts = {"mesh_points": found.mesh.shape.n_points, "cloud_points": found.cloud.shape.n_points}
    return {**asdict(planned), "visible_share": found.visible_share, **counts, "camera": asdict(found.camera)}


def _write_lists(place: Path, planned: Sequence[PlannedView]) -> None:
    for split in get_args(SetSplit):
        views = [one for one in planned if one.split == split]
        complete = sorted({name for one in views for name in (one.own, one.complete)})
        _write_lines(place / f"{split}.txt", [*complete, *(one.name for one in views)])
    _write_lines(place / "pairs.txt", [f"{one.complete},{one.name}" for one in planned])


def _write_common(place: Path, name: str, common: Int[np.ndarray, " p"]) -> None:
    _write_lines(place / "corres" / f"{name}.vts", [str(point + 1 if point >= 0 else -1) for point in common.tolist()])


def _write_lines(path: Path, lines: Sequence[str]) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _are_there(files: Sequence[Path]) -> bool:
    """Whether all files are there, and something in each."""
    return all(file.is_file() and file.stat().st_size for file in files)


def _record(place: Path, name: str) -> Path:
    return place / "truth" / f"{name}.json"
