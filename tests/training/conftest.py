"""A folder of small meshes to train on, and a recipe that is done in seconds."""

import numpy as np
import pytest

from homolog.shapes import Shape, write_shape
from homolog.training.recipes import recipe_from

NAMES = ("ape", "bee", "cat", "dog")


def bodies(make):
    """Four differently stretched and relabelled surfaces without symmetry, 642 points each."""
    blob = make.blob(3)
    for number, name in enumerate(NAMES):
        order = np.random.default_rng(number).permutation(blob.n_points)
        shape = make.relabelled(blob, order)
        yield name, Shape(shape.points * [1 + 0.1 * number, 1, 1 - 0.05 * number], shape.faces), order


@pytest.fixture(scope="session")
def meshes(tmp_path_factory, make):
    """``off/`` and ``corres/`` of four shapes."""
    root = tmp_path_factory.mktemp("meshes")
    (root / "off").mkdir()
    (root / "corres").mkdir()
    for name, shape, order in bodies(make):
        write_shape(root / "off" / f"{name}.off", shape)
        (root / "corres" / f"{name}.vts").write_text("\n".join(map(str, np.argsort(order)[:100] + 1)))
    return root


@pytest.fixture(scope="session")
def clouds(tmp_path_factory, make):
    """Three clouds of differently stretched and relabelled surfaces."""
    root, blob = tmp_path_factory.mktemp("clouds"), make.blob(3)
    for number, name in enumerate(("ape", "bee", "cat")):
        order = np.random.default_rng(number).permutation(blob.n_points)
        write_shape(root / f"{name}.ply", Shape(blob.points[order] * [1 + 0.2 * number, 1, 1 - 0.1 * number]))
    return root


SMALL = {
    "name": "small",
    "licence": "CC0-1.0",
    "seed": 3,
    "data": {"split": "all"},
    "samples": {"points": 150, "subsets": 2},
    "network": {"width": 16, "blocks": 2, "out_channels": 16},
    "operators": {"n_eigenpairs": 24},
    "loss": {"map_eigenpairs": 12},
    "training": {"steps": 6, "checkpoint_minutes": 0},
    "orienter": {"steps": 0},
    "validation": {"shapes": 0, "pairs": 2, "every": 3},
}


@pytest.fixture(scope="session")
def small():
    """``small(section={key: value}, ...)``: the small recipe with some keys changed."""

    def build(**changes):
        table = {key: dict(value) if isinstance(value, dict) else value for key, value in SMALL.items()}
        for key, value in changes.items():
            table[key] = {**table.get(key, {}), **value} if isinstance(value, dict) else value
        return recipe_from(table, "small")

    return build


@pytest.fixture(scope="session")
def as_toml():
    """A recipe's tables as the text of a file."""

    def text(**changes):
        tables = {key: value for key, value in SMALL.items() if not isinstance(value, dict)}
        lines = [f"{key} = {value!r}" for key, value in tables.items()]
        for key in SMALL.keys() | changes.keys():
            section = SMALL.get(key, {})
            if isinstance(section, dict):
                lines += [f"[{key}]", *(f"{k} = {v!r}" for k, v in {**section, **changes.get(key, {})}.items())]
        return "\n".join(lines).replace("'", '"')

    return text
