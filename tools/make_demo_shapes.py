"""Make two shapes like the demo bodies of the package, and their ground truth.

Run from the root of the checkout::

    pip install '.[synth]'
    python tools/make_demo_shapes.py --out demo

The same versions of the packages give the same bytes. The files in ``src/homolog/demo_data`` were made by an earlier
remesher; this makes the same two people in the same poses, with other vertices.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from homolog.synthesis import BodyModel, MeshSettings, mesh_body, write_shape_files
from homolog.synthesis.template import sample_evenly

Degrees = tuple[float, float, float]

TEMPLATE_POINTS = 5000


@dataclass(frozen=True)
class Model:
    """A body to make: who it is, how it stands, and how finely it is meshed."""

    # The stem of the files.
    name: str
    # About how many vertices the mesh shall have.
    vertices: int
    # anny's body parameters, from 0 to 1 each (gender: 0 male, 1 female; age: 0 baby, 2/3 young, 1 old).
    build: Mapping[str, float]
    # For each turned bone a rotation vector in degrees, about the axes of the standing body: x to its left,
    # y up, z to the front. Children follow their parents.
    turns: Mapping[str, Degrees]


AMBER = Model(
    name="amber",
    vertices=4900,
    build={"gender": 1.0, "age": 0.6, "muscle": 0.55, "weight": 0.3, "height": 0.5, "proportions": 0.7},
    turns={
        "upperarm01.L": (0.0, 0.0, -14.0),
        "upperarm01.R": (0.0, 0.0, 14.0),
        "lowerarm01.L": (12.0, 0.0, 0.0),
        "lowerarm01.R": (12.0, 0.0, 0.0),
        "head": (3.0, 6.0, 0.0),
    },
)

BORIS = Model(
    name="boris",
    vertices=5100,
    build={"gender": 0.0, "age": 0.8, "muscle": 0.4, "weight": 1.0, "height": 0.65, "proportions": 0.4},
    turns={
        "upperleg01.L": (-24.0, 0.0, 0.0),
        "lowerleg01.L": (10.0, 0.0, 0.0),
        "foot.L": (14.0, 0.0, 0.0),
        "upperleg01.R": (18.0, 0.0, 0.0),
        "lowerleg01.R": (20.0, 0.0, 0.0),
        "foot.R": (-5.5, 0.0, 0.0),
        **{f"toe{i}-1.R": (-18.0, 0.0, 0.0) for i in range(1, 6)},
        "spine03": (4.0, 5.0, 0.0),
        "spine01": (0.0, 6.0, 0.0),
        "clavicle.L": (0.0, 0.0, 10.0),
        "shoulder01.L": (0.0, 0.0, 14.0),
        "upperarm01.L": (0.0, 0.0, 68.0),
        "lowerarm01.L": (0.0, 0.0, 25.0),
        "upperarm01.R": (-25.0, 0.0, 5.0),
        "head": (0.0, -8.0, 0.0),
    },
)


def posed(bodies: BodyModel, model: Model) -> np.ndarray:
    """All the body model's vertices."""
    turns = {bone: Rotation.from_rotvec(turn, degrees=True).as_matrix() for bone, turn in model.turns.items()}
    return bodies.vertices(model.build, turns)


def main() -> None:
    """Write the shapes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    out: Path = parser.parse_args().out
    bodies = BodyModel()
    points = sample_evenly(bodies.template.rest, TEMPLATE_POINTS)
    for model in (AMBER, BORIS):
        surface = bodies.template.surface(posed(bodies, model))
        made = mesh_body(bodies.template, points, surface, MeshSettings(model.vertices), np.random.default_rng(0))
        write_shape_files(out, model.name, made)
        print(f"{model.name}: {len(made.mesh.vertices)} vertices, {len(made.mesh.faces)} faces")


if __name__ == "__main__":
    main()
