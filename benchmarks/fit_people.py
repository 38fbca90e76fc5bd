"""Fit the body model to synthetic bodies, from their own remeshed surfaces; every second one is turned at random.

Prints for each the mean distance of the fitted vertices from the true ones, and of the map's points alone::

    python benchmarks/fit_people.py --seed 977 --first 1 --last 50
    python benchmarks/fit_people.py --seed 977 --first 1 --last 6 --views

With ``--views`` each is seen by one depth camera, as a mesh; points that are seen are then those within 1 cm of it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import homolog
from homolog.fitting import PeopleModel, fit_body
from homolog.shapes import Shape
from homolog.synthesis import BodyModel, BodySettings, People, make_body, view
from homolog.synthesis.template import sample_evenly


def main() -> None:
    """Make each body, fit, and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=977)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--last", type=int, default=50)
    parser.add_argument("--views", action="store_true")
    parser.add_argument("--output", type=Path, help="folder for the fits")
    options = parser.parse_args()
    body_model = BodyModel()
    model, people = PeopleModel(body_model), People(body_model)
    points = sample_evenly(people.template.rest, 500)
    errors = list[float]()
    for index in range(options.first, options.last + 1):
        body = make_body(people, points, BodySettings(seed=options.seed), index)
        turn = Rotation.random(random_state=index).as_matrix() if index % 2 else np.eye(3)
        truth = people.surface(body.character).vertices @ turn.T
        mesh = body.meshed.mesh
        scan = Shape(mesh.vertices @ turn.T, mesh.faces, name=f"person_{index:05d}")
        if options.views:
            seen = view(Shape(mesh.vertices, mesh.faces), seed=index).mesh.shape
            scan = Shape(seen.points @ turn.T, seen.faces, name=scan.name)
        words: dict[str, Any] = {"weights": "views", "partial": "target"} if options.views else {"weights": "people"}
        found = fit_body(scan, model=model, **words)
        away = 1000 * np.linalg.norm(found.registered.points - truth, axis=1)
        near = cKDTree(scan.points).query(truth)[0] < 0.01
        there = found.match.source_to_target >= 0
        mapped = 1000 * np.linalg.norm(scan.points[found.match.source_to_target] - truth, axis=1)[there]
        errors.append(float(away.mean()))
        print(f"{scan.name} {body.character.family}: {away.mean():.2f} mm, the map {mapped.mean():.1f} mm", end="")
        each = f"; seen {away[near].mean():.2f}, unseen {away[~near].mean():.2f} mm"
        print(each if options.views else "", flush=True)
        if options.output is not None:
            homolog.fitting.write_fit(options.output / scan.name, found)
    print(f"mean of {len(errors)} bodies: {np.mean(errors):.2f} mm, median {np.median(errors):.2f} mm")


if __name__ == "__main__":
    main()
