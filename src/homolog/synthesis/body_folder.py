"""A dataset of synthetic bodies on disk, which can be resumed and extended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import TypedDict

from homolog.core.files import all_or_nothing, atomic_path, expanded, made_folder, sha256, write_json
from homolog.core.folders import MANIFEST, prepare_folder
from homolog.core.records import record, stored_record
from homolog.core.versions import version_of, versions
from homolog.geometry.surface import BarycentricPoints, Surface
from homolog.shapes import Shape, write_shape
from homolog.synthesis.bodies import MOST_CROSSING, Body, BodySettings, Kind, MeshedBody

_FOLDERS = ("off", "corres", "barycentric", "records", "template")
# Coordinates are rounded to micrometres.
_DIGITS = 6


@record
class _Record(TypedDict):
    """Of a body: the hashes of its files."""

    sha256: dict[str, str]


@dataclass(frozen=True)
class BodyFolder:
    """The files of a dataset of bodies.

    ``off/NAME.off`` is a body's mesh; ``corres/NAME.vts`` its vertex at each template point, counted from 1;
    ``barycentric/NAME.npz`` for each vertex its triangle on the template, counted from 0, and its barycentric
    coordinates there; ``records/NAME.json`` how it was made. ``template/template.off`` is the template, as the mean
    body in the rest pose, and ``template/points.npz`` the template points in barycentric coordinates.

    Args:
        root: the folder.
        stem: with which the names of bodies begin.
    """

    root: Path
    stem: str

    @classmethod
    def prepare(cls, root: str | Path, kind: Kind, settings: BodySettings) -> BodyFolder:
        """Create the folder, or resume one that was made with the same settings.

        Raises:
            ArgumentError: if it holds something else, or bodies that were made in another way, or cannot be written to.
        """
        folder = cls(expanded(root), kind.stem)
        prepare_folder(folder.root, folder._manifest(kind, settings, ()), _FOLDERS)
        return folder

    def name(self, index: int) -> str:
        """The name of body number ``index``; names sort by number."""
        return f"{self.stem}_{index:05d}"

    def files(self, name: str) -> dict[str, Path]:
        """The files of a body whose hashes are in its record."""
        paths = (f"off/{name}.off", f"corres/{name}.vts", f"barycentric/{name}.npz")
        return {path: self.root / path for path in paths}

    def has_all_files(self, name: str) -> bool:
        """Whether all files of a body exist and are unchanged."""
        stored = self.record(name)
        if stored is None:
            return False
        return all(
            path.is_file() and sha256(path) == stored["sha256"].get(relative)
            for relative, path in self.files(name).items()
        )

    def record(self, name: str) -> dict[str, Any] | None:
        """How a body was made; None if that is unknown."""
        return stored_record(self.root / "records" / f"{name}.json", _Record)

    def write_body(self, name: str, body: Body) -> None:
        """Write all files of a body; the record comes last, and without it the other files do not count."""
        write_shape_files(self.root, name, body.meshed)
        _write_barycentric(self.root / "barycentric" / f"{name}.npz", body.meshed.barycentric)
        hashes = {relative: sha256(path) for relative, path in self.files(name).items()}
        write_json(self.root / "records" / f"{name}.json", {**_described(body), "sha256": hashes})

    def has_template(self) -> bool:
        """Whether the template and its points are there."""
        return all((self.root / "template" / name).is_file() for name in ("template.off", "points.npz"))

    def write_template(self, rest: Surface, points: BarycentricPoints) -> None:
        """Write the template, and the template points that ``corres/`` refers to."""
        with all_or_nothing():
            _write_mesh(self.root / "template" / "template.off", rest)
            _write_barycentric(self.root / "template" / "points.npz", points)

    def write_manifest(self, kind: Kind, settings: BodySettings, names: Sequence[str]) -> None:
        """Write settings, licences, versions and a description of each body."""
        write_json(self.root / MANIFEST, self._manifest(kind, settings, names))

    def _manifest(self, kind: Kind, settings: BodySettings, names: Sequence[str]) -> dict[str, Any]:
        return {
            "what": f"synthetic {kind.name} with ground truth, made by homolog synth {kind.name}",
            "making": {**kind.making, "seed": settings.seed, **asdict(settings.mesh)},
            "most_crossing": MOST_CROSSING,
            # With the version that each names, or that is installed.
            "assets": [{**a, "version": a.get("version") or version_of(a["package"])} for a in kind.assets],
            "versions": versions(),
            "n": len(names),
            "bodies": {name: self.record(name) for name in names},
        }


def write_shape_files(root: Path, name: str, body: MeshedBody) -> None:
    """Write ``off/NAME.off`` and ``corres/NAME.vts`` into a folder, which is created if needed."""
    for folder in ("off", "corres"):
        made_folder(root / folder)
    with all_or_nothing():
        _write_mesh(root / "off" / f"{name}.off", body.mesh)
        with atomic_path(root / "corres" / f"{name}.vts") as temporary:
            np.savetxt(temporary, body.at_points + 1, fmt="%d", newline="\n")


def _described(body: Body) -> dict[str, Any]:
    character, meshed = body.character, body.meshed
    return {
        "build": dict(character.build),
        "family": character.family,
        "pose_share": character.pose_share,
        "angles": dict(character.angles),
        "vertices": len(meshed.mesh.vertices),
        "faces": len(meshed.mesh.faces),
        "height": round(float(np.ptp(meshed.mesh.vertices[:, 1])), 4),
        "crossing_share": round(meshed.self_intersection, 6),
    }


def _write_mesh(path: Path, mesh: Surface) -> None:
    # Adding 0 makes -0.0 of small negative numbers a plain zero.
    write_shape(path, Shape(mesh.vertices.round(_DIGITS) + 0.0, mesh.faces))


def _write_barycentric(path: Path, points: BarycentricPoints) -> None:
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        triangles, weights = points.triangles.astype(np.int32), points.weights.astype(np.float32)
        np.savez_compressed(file, allow_pickle=False, triangles=triangles, weights=weights)
