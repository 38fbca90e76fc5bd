"""Files on which readers once failed, beside the checkout: what is right is written here."""

import os
from pathlib import Path

import numpy as np
import pytest

from homolog.core.errors import DataError, ShapeError
from homolog.shapes import check, read_shape
from homolog.transfer import read_appearance, read_landmarks

pytestmark = pytest.mark.reference


@pytest.fixture(scope="module")
def cases():
    """The folder of files: ``HOMOLOG_CASES``, or ``../shared/cases/files`` beside the checkout."""
    folder = Path(os.environ.get("HOMOLOG_CASES", Path(__file__).resolve().parents[3] / "shared" / "cases" / "files"))
    if not (folder / "cube_tet10.vtu").is_file():
        pytest.skip(f"no files at {folder}; set HOMOLOG_CASES")
    return folder


@pytest.mark.parametrize(
    ("name", "area"),
    [
        ("cube_tet10.vtu", 24),
        ("cube_tet4.vtu", 24),
        ("pts/concave_L.obj", 30),
        *((f"gltf/{name}.gltf", 13.8478) for name in ("plain", "quantized_norm", "lines_and_triangles", "orphan_node")),
        *((f"gltf/{name}.gltf", 13.8478) for name in ("skin_node_scale100", "skin_joint_turn", "two_scenes")),
        ("gltf/scene1_active.gltf", 13.8478),
        ("gltf/gpu_instancing.gltf", 2 * 13.8478),
        ("gltf/fan_and_triangles.gltf", 13.8478 + 3.1214),
        *((f"pts/{name}", 14.046) for name in ("4off.off", "wrapped.off", "one_line.off", "noff.off", "noheader.off")),
        *((f"pts/{name}.npz", 14.046) for name in ("tri", "vf", "verts", "uint")),
        *((f"pts/{name}.ply", 14.046) for name in ("crlf_bin", "cr", "facefirst_be", "upper", "weird")),
        *((name, 14.046) for name in ("trailing.stl", "trailing_solid.stl", "count0.stl", "solid_bin.stl")),
    ],
)
def test_areas(cases, name, area):
    assert check(read_shape(cases / name)).area == pytest.approx(area, rel=1e-4)


@pytest.mark.parametrize("name", ["quantized_norm", "skin_node_scale100", "skin_joint_turn"])
def test_extents_of_gltf(cases, name):
    assert check(read_shape(cases / "gltf" / f"{name}.gltf")).extent == pytest.approx(3.79, abs=0.01)


def test_what_moves_points_of_gltf(cases):
    plain, moved, risen = (
        read_shape(cases / "gltf" / f"{name}.gltf").points for name in ("plain", "sparse_some", "morph_default1")
    )
    assert np.any(plain != moved, axis=1).sum() == 40
    turned = read_shape(cases / "gltf" / "skin_joint_turn.gltf").points
    np.testing.assert_allclose(turned, plain[:, [0, 2, 1]] * [1, 1, -1], atol=1e-6)
    rest = read_shape(cases / "gltf" / "skin_joint_turn.gltf", pose="rest").points
    np.testing.assert_array_equal(rest, plain)
    assert np.ptp(risen - plain, axis=0) == pytest.approx([0, 2, 0], abs=1e-6)


@pytest.mark.parametrize("name", ["draco_required", "draco_notrequired"])
def test_draco(cases, name):
    with pytest.raises(ShapeError, match="compressed with KHR_draco_mesh_compression"):
        read_shape(cases / "gltf" / f"{name}.gltf")


@pytest.mark.parametrize(
    "name",
    ["openmvs_dense.ply", "count_first.xyz", "chem.xyz", "index_first.csv", "pandas.csv", "utf16.txt", "splat.ply"],
)
def test_clouds(cases, name):
    shape = read_shape(cases / "pts" / name)
    assert shape.n_points == 642 and shape.faces is None
    expected = read_shape(cases / "pts" / "normals.xyz").points
    # One of them lies around the origin.
    np.testing.assert_allclose(shape.points - shape.points[0], expected - expected[0], atol=1e-4)


@pytest.mark.parametrize(("name", "reason"), [("hoff.off", "HOFF"), ("binary.off", "binary OFF")])
def test_reasons(cases, name, reason):
    with pytest.raises(ShapeError, match=reason):
        read_shape(cases / "pts" / name)


@pytest.mark.parametrize(
    ("name", "colours"),
    [
        ("hash", [(255, 0, 0), (0, 0, 255)]),
        ("twolibs", [(255, 0, 0), (0, 0, 255)]),
        *((name, [(255, 0, 0)]) for name in ("lower", "case", "spectral")),
        *((name, [(0, 255, 0)]) for name in ("spaces", "opts")),
    ],
)
def test_textures(cases, name, colours):
    path = cases / "tex" / f"{name}.obj"
    texture = read_appearance(path, read_shape(path)).texture
    assert [tuple(image[0, 0].tolist()) for image in texture.images] == colours
    assert set(np.unique(texture.image_of)) == set(range(len(colours)))


@pytest.mark.parametrize(
    ("name", "system", "count"),
    [
        *((f"{name}.mrk.json", "LPS", 3) for name in ("ok", "nosystem", "missing_status")),
        ("number_system.mrk.json", "RAS", 3),
        ("v410.fcsv", "RAS", 3),
        ("v411.fcsv", "LPS", 3),
        ("comma_label.fcsv", "LPS", 3),
        ("names.csv", None, 2),
    ],
)
def test_landmarks(cases, name, system, count):
    found = read_landmarks(cases / "lm" / name)
    assert (found.system, len(found.points)) == (system, count)


@pytest.mark.parametrize(("name", "reason"), [("two.mrk.json", "are LPS, RAS"), ("ijk.fcsv", "coordinate system is 2")])
def test_landmarks_that_are_refused(cases, name, reason):
    with pytest.raises(DataError, match=reason):
        read_landmarks(cases / "lm" / name)
