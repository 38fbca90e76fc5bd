"""Symmetric and asymmetric components of a collection whose shapes were made of both."""

import csv
import json
import shutil

import numpy as np
import pytest
import trimesh

import homolog
from homolog.core.errors import ArgumentError, DataError
from homolog.shape_models import build
from homolog.symmetries import read_partner_positions, write_symmetry

pytest.importorskip("h5py")
pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Files of a template that x = 0 divides, of two wider copies, and of one with a bump on one side."""
    root = tmp_path_factory.mktemp("files")
    sphere = trimesh.creation.icosphere(subdivisions=3)
    x, y, z = sphere.vertices.T
    points = sphere.vertices * (1 + 0.3 * y + 0.4 * np.exp(-(x**2 + (z - 0.9) ** 2) / 0.2))[:, None] * [1, 1.4, 0.8]
    bump = np.exp(-((points - [0.9, 0, 0]) ** 2).sum(axis=1) / 0.1)[:, None]
    shapes = {
        "template": points,
        "even": points * 1.05,
        "wide": points * [1.15, 1, 1] + 4,
        "bumped": points * (1 + 0.2 * bump),
    }
    for name, positions in shapes.items():
        homolog.write_shape(root / f"{name}.ply", homolog.Shape(positions, sphere.faces))
    write_symmetry(root / "partners", homolog.symmetry(root / "template.ply", method="registration"))
    return root


@pytest.fixture
def collection(files, tmp_path):
    """A copy of the files, with the partners of the template's points."""
    return shutil.copytree(files, tmp_path / "collection")


def built(folder, names, **options):
    matcher = homolog.Matcher(settings=homolog.MatcherSettings(method="registration"))
    return build(
        folder / "template.ply", [folder / f"{name}.ply" for name in names], folder / "out", matcher, **options
    )


@pytest.mark.long
def test_shapes_are_taken_apart_and_the_bumped_one_is_told(collection):
    names = ["even", "wide", "bumped"]
    files = built(collection, names, symmetry=collection / "partners").files
    root = collection / "out" / "symmetry"
    assert root in files
    symmetric, asymmetric = (np.load(root / f"{name}.npy") for name in ("symmetric", "asymmetric"))
    assert symmetric.shape == asymmetric.shape == np.load(collection / "out" / "points.npy").shape
    with (root / "asymmetry.csv").open() as table:
        amounts = {row["name"]: float(row["asymmetry"]) for row in csv.DictReader(table)}
    assert [*amounts] == names
    assert max(amounts["even"], amounts["wide"]) < 0.2 * amounts["bumped"]
    # On either side half of the bump, with the sign of the side.
    away = np.linalg.norm(asymmetric[2], axis=1)
    at = homolog.read_shape(collection / "template.ply").points
    assert (np.abs(at[away > 0.5 * away.max(), 0]) > 0.5).all() and 0.05 < away.max() < 0.12
    report = json.loads((collection / "out" / "report.json").read_text())
    assert report["symmetry"]["variances"]["symmetric"] > report["symmetry"]["variances"]["fluctuating"] > 0
    mean = homolog.read_shape(root / "mean.ply")
    assert mean.points == pytest.approx(symmetric.mean(axis=0), abs=1e-6)


@pytest.mark.slow
def test_files_of_an_earlier_call_that_had_a_symmetry_are_removed(collection):
    built(collection, ["even", "wide"], symmetry=collection / "partners")
    built(collection, ["even", "wide"])
    assert not (collection / "out" / "symmetry").exists()


def test_partners_of_another_shape_are_refused(collection):
    shape = homolog.read_shape(collection / "template.ply")
    table = collection / "partners" / "points.csv"
    rows = table.read_text().splitlines()
    for content, said in (
        ("\n".join(rows[:-1]), "has the partners of 641 points, but template.ply has 642"),
        ("\n".join(["a,b", *rows[1:]]), "no table of mirror partners"),
        (rows[0] + "\n" + "0,1,1,0,1,here,0,0\n", "no table of mirror partners"),
    ):
        table.write_text(content)
        with pytest.raises(DataError, match=said):
            read_partner_positions(collection / "partners", shape)
    with pytest.raises(DataError, match="give a folder of homolog symmetry"):
        read_partner_positions(collection / "nowhere", shape)
    with pytest.raises(ArgumentError, match="lies in"):
        built(collection, ["even"], symmetry=collection / "out" / "partners")


def test_the_command_takes_the_folder_of_homolog_symmetry(collection, monkeypatch):
    from typer.testing import CliRunner

    from homolog.cli.app import app

    monkeypatch.chdir(collection)
    given = ["collection", "template.ply", "even.ply", "wide.ply", "-o", "out", "--symmetry", "partners"]
    ended = CliRunner().invoke(app, [*given, "--method", "registration", "--processes", "1", "--quiet"])
    assert ended.exit_code == 0, ended.exception
    assert (collection / "out" / "symmetry" / "asymmetry.csv").is_file()
