"""A dataset of partial views on disk: pairs of a full shape and a view of another one, for training and testing.

D. Cao and F. Bernard (CVPR 2023) train and test on such a dataset, 5,000 views of synthetic people.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, get_args

import numpy as np
from jaxtyping import Int
from typing_extensions import TypedDict

from homolog.core.arguments import check_count, is_count, is_real
from homolog.core.cluster import Processes
from homolog.core.errors import ArgumentError, DataError, bad_value
from homolog.core.files import all_or_nothing, atomic_path, expanded, open_text, write_json
from homolog.core.folders import MANIFEST, prepare_folder
from homolog.core.progress import Progress, ignore
from homolog.core.records import read_record, record, stored_record
from homolog.core.tasks import check_processes, run_tasks
from homolog.datasets import ShapeFolder
from homolog.shapes import read_shape, repair, write_shape
from homolog.synthesis.view_plan import TEST_EVERY, DatasetSplit, FullShapes, PlannedView, planned_pair, planned_view
from homolog.synthesis.views import View, ViewSettings, view

# A version, increased whenever the same settings give other views.
_MAKING = 1
_MOST_VIEWS = 1_000_000
_FOLDERS = ("off", "clouds", "truth")


@record
class _Record(TypedDict):
    """Of a view."""

    name: str


def write_view_dataset(
    source: str | Path,
    output: str | Path,
    *,
    views: int,
    seed: int,
    settings: ViewSettings | None = None,
    apart: float | None = None,
    two_shapes: bool = False,
    processes: Processes = 1,
    progress: Progress | None = None,
) -> None:
    """Write a dataset of views of the full meshes in a folder; docs/conventions.md lists its files.

    A view is paired with a full shape or, where ``apart`` is given, with another view: ``view_000000_a`` and
    ``view_000000_b``.

    Four of five views are for training, the others for testing, and so are four of five full shapes, unless the source
    has its own ``train.txt`` and ``test.txt``. The shapes of a split are viewed in turn, in a random order. A view does
    not depend on the number of views. Existing views are kept.

    Args:
        source: a folder with ``off/NAME.off``, and perhaps ``corres/``, or any folder of meshes, all +y up.
        output: a new folder, or one that an earlier call with the same source, seed and settings began.
        views: number of views, or of pairs of views; at least 5, so that one is for testing.
        seed: of all random choices; the same source, seed and settings give the same bytes.
        settings: distribution of cameras, resolution and noise.
        apart: degrees between the directions of sight of the two cameras of a pair of views, above 0 and up to 180.
        two_shapes: the second camera of a pair looks at another shape.
        processes: number of worker processes, or a cluster.
        progress: called with the number of finished files, their total and the current file's name.

    Raises:
        ArgumentError: if ``output`` holds anything else, ``views`` or ``apart`` is out of range, or ``two_shapes`` is
            set without ``apart``.
        DataError: if the source has fewer than two meshes, or names that lists cannot hold.
        ShapeError: if a mesh cannot be repaired, or next to nothing of it is visible.

    Examples:
        >>> write_view_dataset("people", "people_views", views=5000, seed=1)  # doctest: +SKIP
    """
    if not (is_count(views, least=TEST_EVERY) and views <= _MOST_VIEWS):
        raise bad_value("views", views, f"a whole number from {TEST_EVERY} to {_MOST_VIEWS}")
    check_count("seed", seed, least=0)
    check_processes(processes)
    if apart is not None and not (is_real(apart) and 0 < apart <= 180):
        raise bad_value("apart", apart, "a number of degrees above 0 and up to 180")
    if two_shapes and apart is None:
        raise ArgumentError("two_shapes is True, but is about pairs of views; give apart as well, or leave it out")
    shapes, root, settings = FullShapes.open(source, seed=seed), expanded(output), settings or ViewSettings()
    pairing: dict[str, Any] = {} if apart is None else {"apart": apart, "two_shapes": two_shapes}
    manifest = _manifest(shapes, seed, settings, pairing)
    prepare_folder(root, manifest, [*_FOLDERS, *(["corres"] if shapes.truth_root is not None else [])])
    partners: dict[str, PlannedView]
    if apart is None:
        planned = [planned_view(shapes, number, seed=seed) for number in range(views)]
        pairs, partners = [(one.full, one.name) for one in planned], {}
    else:
        both = [planned_pair(shapes, number, seed=seed, **pairing) for number in range(views)]
        planned, pairs = list(chain.from_iterable(both)), [(one.name, other.name) for one, other in both]
        partners = {other.name: one for one, other in both}
    used = sorted({name for one in planned for name in (one.viewed, one.full)})
    write_shapes = [(name, partial(_write_full_shape, shapes.files[name], shapes.truth_root, root)) for name in used]
    write_views = [(one.name, partial(_write_view, one, root, settings, partners.get(one.name))) for one in planned]
    phases, read = [write_shapes, write_views], {file.parent for file in shapes.files.values()}
    run_tasks(phases, processes=processes, progress=progress or ignore, reads=sorted(read), writes=root)
    _write_lists(root, planned, pairs)
    records = [read_record(_record_file(root, one.name), _Record, instead="remove it") for one in planned]
    write_json(root / MANIFEST, {**manifest, "views": records})


def _manifest(shapes: FullShapes, seed: int, settings: ViewSettings, pairing: Mapping[str, Any]) -> dict[str, Any]:
    """The manifest before any view is written, with JSON's types only, so that it can be compared with the file."""
    as_lists = {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(settings).items()}
    making = {"way": _MAKING, "seed": seed, **as_lists, **pairing, "bodies": shapes.described()}
    return {"what": "partial views with ground truth, made by homolog synth views", "making": making, "views": []}


def _write_full_shape(file: Path, truth_root: Path | None, root: Path) -> None:
    """Write a full shape, repaired, and its template correspondence."""
    name = file.stem
    mesh_file, truth_file = root / "off" / f"{name}.off", root / "corres" / f"{name}.vts"
    if _all_written([mesh_file, *([truth_file] if truth_root is not None else [])]):
        return
    repaired = repair(read_shape(file))
    with all_or_nothing():
        if truth_root is not None:
            vertices = ShapeFolder(truth_root, ()).template_correspondence(name)
            if vertices.max() >= len(repaired.clean_index):
                raise DataError(f"{truth_root}/corres/{name}.vts names vertex {vertices.max() + 1}, which {file} lacks")
            _write_vertices(root, name, np.append(repaired.clean_index, -1)[vertices])
        write_shape(mesh_file, repaired.shape)


def _write_view(planned: PlannedView, root: Path, settings: ViewSettings, partner: PlannedView | None = None) -> None:
    """Write a view as a mesh and as a cloud, its ground truth and, last, its record.

    Args:
        planned: the view.
        root: the folder of the dataset.
        settings: distribution of cameras, resolution and noise.
        partner: another view that it is paired with; None of one that is paired with a full shape.
    """
    record_file = _record_file(root, planned.name)
    folders = {"off": ".off", "clouds": ".ply", "truth": ".npz", "corres": ".vts"}
    files = [
        root / folder / f"{planned.name}{suffix}" for folder, suffix in folders.items() if (root / folder).is_dir()
    ]
    if _all_written(files) and stored_record(record_file, _Record) is not None:
        return
    found = _seen(planned, root, settings)
    with all_or_nothing():
        write_shape(root / "off" / f"{planned.name}.off", found.mesh.shape)
        write_shape(root / "clouds" / f"{planned.name}.ply", found.cloud.shape)
        folder = ShapeFolder(root, ()) if (root / "corres").is_dir() else None
        if folder is not None:
            vertices = folder.template_correspondence(planned.viewed)
            _write_vertices(root, planned.name, _positions(found.mesh.full_index, vertices))
        truth = _truth(planned, found, folder)
        if partner is not None:  # correspondences to the other view, in place of those to the full shape
            seen = _seen(partner, root, settings).mesh.full_index
            truth |= {name: _positions(seen, at) for name, at in truth.items() if name.endswith("_to_full")}
        with atomic_path(root / "truth" / f"{planned.name}.npz") as temporary:
            np.savez_compressed(temporary, allow_pickle=False, **truth)
        counts = {"mesh_points": found.mesh.shape.n_points, "cloud_points": found.cloud.shape.n_points}
        figures = {"visible_share": found.visible_share, **counts, "camera": asdict(found.camera)}
        described = {name: value for name, value in asdict(planned).items() if name != "apart" or value}
        write_json(record_file, {**described, **figures})


def _seen(planned: PlannedView, root: Path, settings: ViewSettings) -> View:
    full = read_shape(root / "off" / f"{planned.viewed}.off")
    return view(full, settings, seed=planned.seed, apart=planned.apart)


def _truth(planned: PlannedView, found: View, folder: ShapeFolder | None) -> dict[str, np.ndarray]:
    """Correspondences of a view to the viewed shape and, where known, to the full shape that it is paired with."""
    arrays = {"mesh_to_viewed": found.mesh.full_index, "cloud_to_viewed": found.cloud.full_index}
    assert found.cloud.triangles is not None and found.cloud.weights is not None
    arrays |= {"cloud_triangles": found.cloud.triangles, "cloud_weights": found.cloud.weights}
    if planned.viewed == planned.full:
        arrays |= {"mesh_to_full": found.mesh.full_index, "cloud_to_full": found.cloud.full_index}
    elif folder is not None:
        viewed, full = (folder.template_correspondence(name) for name in (planned.viewed, planned.full))
        if len(viewed) != len(full):
            found_lines = f"{planned.viewed} has {len(viewed)} template points and {planned.full} {len(full)}"
            raise DataError(f"corres/: {found_lines}; every .vts file must have the same number of lines")
        arrays |= {f"{kind}_to_full": _via(viewed, full, arrays[f"{kind}_to_viewed"]) for kind in ("mesh", "cloud")}
    return arrays


def _positions(index: Int[np.ndarray, " n"], numbers: Int[np.ndarray, " p"]) -> Int[np.ndarray, " p"]:
    """The position of each number in an ascending index; -1 where it does not occur."""
    positions = np.minimum(np.searchsorted(index, numbers), len(index) - 1)
    return np.where(index[positions] == numbers, positions, -1)


def _via(
    viewed: Int[np.ndarray, " p"], full: Int[np.ndarray, " p"], points: Int[np.ndarray, " n"]
) -> Int[np.ndarray, " n"]:
    """The full shape's point for each of some points of the viewed shape, by the first template point there; or -1."""
    both = (viewed >= 0) & (full >= 0)
    known, first = np.unique(viewed[both], return_index=True)
    positions = _positions(known, points) if len(known) else np.full(len(points), -1)
    found: np.ndarray = np.append(full[both][first], -1)[positions]
    return found


def _write_lists(root: Path, planned: Sequence[PlannedView], pairs: Sequence[tuple[str, str]]) -> None:
    for split in get_args(DatasetSplit):
        views = [one for one in planned if one.split == split]
        full = sorted({name for one in views for name in (one.viewed, one.full)})
        _write_lines(root / f"{split}.txt", [*full, *(one.name for one in views)])
    _write_lines(root / "pairs.txt", [",".join(pair) for pair in pairs])


def _write_vertices(root: Path, name: str, vertices: Int[np.ndarray, " p"]) -> None:
    lines = [str(vertex + 1 if vertex >= 0 else -1) for vertex in vertices.tolist()]
    _write_lines(root / "corres" / f"{name}.vts", lines)


def _write_lines(path: Path, lines: Sequence[str]) -> None:
    with atomic_path(path) as temporary, open_text(temporary) as file:
        file.write("\n".join(lines) + "\n")


def _all_written(files: Sequence[Path]) -> bool:
    """Whether all files exist and none is empty."""
    return all(file.is_file() and file.stat().st_size for file in files)


def _record_file(root: Path, name: str) -> Path:
    return root / "truth" / f"{name}.json"
