"""How far a collection's registered points are from the truth, and what that does to its shape model.

    homolog collection FAUST_r/off/tr_reg_080.off FAUST_r/off/tr_reg_0[89]?.off -o people
    python benchmarks/collected.py FAUST_r people

Where a dataset's ground truth is its numbering, register shapes whose points are shuffled, which this writes first::

    python benchmarks/collected.py LUNGS lungs_shuffled --dataset lungs --shuffle
    homolog collection lungs_shuffled/LLL-case0576.xyz lungs_shuffled/*.xyz -o lungs
    python benchmarks/collected.py LUNGS lungs --dataset lungs
    python benchmarks/collected.py LUNGS lungs --dataset lungs --nearest     # instead of the collection's own points

Distances are Euclidean, between a registered point and its true position. Both ends of a template correspondence are
vertices, so that some half of the distance between these stays in every error. Edges are those of the template, where
it has faces: their lengths between registered points, over those between true positions. Models are made of the points
whose true position is known on all shapes.
"""

from __future__ import annotations

import argparse
import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from homolog.datasets import ShapeFolder
from homolog.geometry import surface_area
from homolog.matching import Match
from homolog.shapes import Shape, write_shape
from homolog.statistics import compactness, generalisation, generalised_procrustes, principal_modes, specificity
from homolog.transfer import surface_map

_MODES = (1, 5, 10)


@dataclass(frozen=True)
class Collected:
    """The template's points as registered to shapes, and their true positions (NaN where these are not known)."""

    base: str
    template: Shape
    names: list[str]
    shapes: list[Shape]
    registered: Float[np.ndarray, "s n 3"]
    true: Float[np.ndarray, "s n 3"]

    @property
    def known(self) -> Bool[np.ndarray, " n"]:
        """Which points are known on all shapes."""
        return np.asarray(np.isfinite(self.true).all(axis=(0, 2)))


def read(folder: ShapeFolder, root: Path, *, nearest: bool) -> Collected:
    """Read a collection, or register its template to its shapes by nearest points after centring."""
    report = json.loads((root / "report.json").read_text(encoding="utf-8"))
    base, names = Path(report["inputs"]["template"]).stem, report["shapes"]
    template, shapes = folder.shape(base), [folder.shape(name) for name in names]
    by_name = {base: template, **dict(zip(names, shapes, strict=True))}
    truth = folder.ground_truth(by_name.__getitem__)
    true = np.full((len(names), template.n_points, 3), np.nan)
    for row, name in enumerate(names):
        known = truth.between(base, name)
        true[row, known.source] = by_name[name].points[known.target]
    by_points = [by_nearest(template, shape) for shape in shapes] if nearest else None
    registered = np.load(root / "points.npy") if by_points is None else np.stack(by_points)
    return Collected(base, template, names, shapes, registered, true)


def by_nearest(template: Shape, shape: Shape) -> Float[np.ndarray, "n 3"]:
    """The template registered to a shape by nearest points both ways, after centring."""
    points, others = (one.points - one.points.mean(axis=0) for one in (template, shape))
    forth, back = KDTree(others).query(points)[1], KDTree(points).query(others)[1]
    found = Match(template, shape, forth, back)
    return surface_map(template, shape, found).positions


def edges_of(faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "e 2"]:
    """Each edge once."""
    return np.asarray(np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0))


def lengths(points: Float[np.ndarray, "s n 3"], edges: Int[np.ndarray, "e 2"]) -> Float[np.ndarray, "s e"]:
    """Of edges on every shape."""
    return np.asarray(np.linalg.norm(points[:, edges[:, 0]] - points[:, edges[:, 1]], axis=2))


def tell_errors(found: Collected, unit: str) -> None:
    """Distances from the truth, in the files' unit and in shares of the shapes' sizes; edges; flipped triangles."""
    away = np.linalg.norm(found.registered - found.true, axis=2)
    sizes = np.sqrt([surface_area(shape) for shape in found.shapes])[:, None]
    own = [row for row, name in enumerate(found.names) if name == found.base]
    others = np.delete(np.arange(len(found.names)), own)
    n_known = np.isfinite(found.true[others, :, 0]).sum(axis=1).mean()
    print(f"{len(others)} shapes beside the template, {n_known:.0f} known points")
    for name, values in ((unit, away), ("x100 sqrt(area)", 100 * away / sizes)):
        chosen = values[others]
        print(f"distance, {name}: mean {np.nanmean(chosen):.4g}, median {np.nanmedian(chosen):.4g}, ", end="")
        means = np.nanmean(chosen, axis=1)
        print(f"of a shape {means.min():.3g} to {means.max():.3g}")
    if found.template.faces is None:
        return
    edges = edges_of(found.template.faces)
    now, own_lengths = lengths(found.registered[others], edges), lengths(found.template.points[None], edges)
    with np.errstate(divide="ignore", invalid="ignore"):
        for name, ratio in (("truth", now / lengths(found.true[others], edges)), ("template", now / own_lengths)):
            low, middle, high = np.nanpercentile(np.where(np.isfinite(ratio), ratio, np.nan), [5, 50, 95])
            print(f"edges' lengths over those of the {name}: median {middle:.3f}, 5 % {low:.2f}, 95 % {high:.2f}")


def tell_model(name: str, points: Float[np.ndarray, "s n 3"]) -> None:
    """The figures of the model of some points."""
    aligned = generalised_procrustes(points).points
    model = principal_modes(aligned)
    curves = {
        "compactness": 100 * compactness(model),
        "generalisation": generalisation(aligned).mean,
        "specificity": specificity(model, aligned).mean,
    }
    total = np.sqrt(model.variances.sum() / points.shape[1])
    print(f"{name}: {total:.4g} from the mean; ", end="")
    told = [f"{kind} {', '.join(f'{values[modes - 1]:.3g}' for modes in _MODES)}" for kind, values in curves.items()]
    print("; ".join(told), f"({', '.join(map(str, _MODES))} modes)")


def tell_flips(root: Path, template: str) -> None:
    """The mean share of flipped triangles over the shapes beside the template."""
    with (root / "quality.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["name"] != template]
    shares = [100 * float(row["flipped_triangles"]) for row in rows if row["flipped_triangles"]]
    if shares:
        print(f"flipped triangles, %: mean {np.mean(shares):.2f}, of a shape {min(shares):.2f} to {max(shares):.2f}")


def main() -> None:
    """Write shuffled shapes, or score a collection."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data")
    parser.add_argument("collection", type=Path)
    parser.add_argument("--dataset", metavar="NAME", help="by default a folder of your own")
    parser.add_argument("--shuffle", action="store_true", help="write the dataset's shapes, as they are to be matched")
    parser.add_argument("--nearest", action="store_true", help="score nearest points instead")
    given = parser.parse_args()
    folder = ShapeFolder.open(given.data, *([given.dataset] if given.dataset else []))
    if given.shuffle:
        given.collection.mkdir(parents=True, exist_ok=True)
        for name in folder.names:
            write_shape(given.collection / f"{name}.xyz", folder.shape(name).as_cloud())
        return
    found = read(folder, given.collection, nearest=given.nearest)
    tell_errors(found, folder.description.unit or "the files' unit")
    if not given.nearest:
        tell_flips(given.collection, found.base)
    tell_model("model of the registered points", found.registered[:, found.known])
    tell_model("model of their true positions", found.true[:, found.known])


if __name__ == "__main__":
    main()
