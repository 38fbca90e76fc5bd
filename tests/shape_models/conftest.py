"""Small families of shapes in files, and their collections."""

from functools import partial

import numpy as np
import pytest
from without_weights import axiomatic

from homolog.shape_models import ShapeModelFolder, ShapeModelSettings, register_all, settings_record, subjects_of
from homolog.shapes import Shape, read_hashed_shape, write_shape

STRETCHES = (0.9, 1.05, 1.2)


@pytest.fixture(autouse=True)
def _sheets_are_small(small_sheets):
    """Of every collection here."""


@pytest.fixture(scope="session")
def family(tmp_path_factory, make):
    """A template and three relabelled, stretched and shifted copies of it; where each template point is on them."""
    root, blob = tmp_path_factory.mktemp("family"), make.blob(2)
    write_shape(root / "template.off", blob)
    files, true = [], []
    for number, stretch in enumerate(STRETCHES):
        points = blob.points * [1, stretch, 1] + number
        order = np.random.default_rng(number).permutation(len(points))
        write_shape(root / f"copy{number}.ply", make.relabelled(Shape(points, blob.faces), order))
        files.append(root / f"copy{number}.ply")
        true.append(points)
    return root / "template.off", files, np.stack(true)


@pytest.fixture
def gathered():
    """``gathered(template, files, place)`` collects, and gives the folder and the outcomes."""

    def run(template, files, place, settings=None, **options):
        settings = settings or ShapeModelSettings()
        base, digest = read_hashed_shape(template)
        folder = ShapeModelFolder.prepare(place, settings_record(digest, axiomatic(), settings))
        return folder, register_all(base, subjects_of(files), folder, partial(axiomatic), settings, **options)

    return run
