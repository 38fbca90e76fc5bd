"""The command that shows what is in files."""

import json

import pytest
import trimesh
import typer
from typer.testing import CliRunner

from homolog.cli.info import info
from homolog.shapes import Shape, write_shape


@pytest.fixture
def run():
    app = typer.Typer()
    app.command()(info)

    def call(*arguments):
        return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "200"})

    return call


@pytest.fixture
def files(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    write_shape(tmp_path / "ball.ply", Shape([*ball.vertices, [9, 9, 9]], ball.faces))
    write_shape(tmp_path / "dots.xyz", Shape(ball.vertices))
    (tmp_path / "bad[red].off").write_text("rubbish")
    return tmp_path / "ball.ply", tmp_path / "bad[red].off", tmp_path / "dots.xyz"


def test_tables(run, files):
    done = run(files[0], files[2])
    assert done.exit_code == 0
    for words in (
        "PLY",
        "mesh",
        "43, 42 after repair",
        "80",
        "boundary loops",
        "1 unreferenced points",
        "XYZ",
        "cloud",
    ):
        assert words in done.stdout


def test_a_bad_file_is_one_line_and_the_others_still_show(run, files):
    done = run(*files)
    assert done.exit_code == 2
    assert len(done.stderr.splitlines()) == 1
    assert "bad[red].off" in done.stderr
    assert "PLY" in done.stdout
    assert "XYZ" in done.stdout


def test_json(run, files):
    done = run("--json", "-", *files)
    assert done.exit_code == 2
    ball, bad, dots = json.loads(done.stdout)
    assert (ball["format"], ball["modality"], ball["n_clean_points"], ball["n_boundary_loops"]) == (
        "PLY",
        "mesh",
        42,
        0,
    )
    assert ball["area"] == pytest.approx(trimesh.creation.icosphere(subdivisions=1).area)
    assert "could not be read as OFF" in bad["error"]
    assert dots["area"] is None


def test_help_has_examples(run):
    assert "homolog info horse.ply" in run("--help").stdout
