"""Mirror partners, planes and asymmetries of shapes whose truth is known by construction."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from mirror_shapes import bumpy
from scipy.spatial import Delaunay

import homolog
from homolog.core.errors import ArgumentError
from homolog.statistics import MirrorPlane, best_mirror_plane
from homolog.symmetries import Symmetry, local_stretch, write_symmetry


@pytest.fixture(scope="module")
def found(turned):
    return homolog.symmetry(turned.shape, method="registration")


def test_partners_and_plane_of_a_symmetric_shape_are_exact(turned, found):
    assert (found.partner == turned.partner).all()
    assert found.plane.normal == pytest.approx(turned.plane.normal, abs=1e-6)
    assert found.plane.offset == pytest.approx(turned.plane.offset, abs=1e-4)
    assert found.asymmetry.max() < 1e-4 * turned.size
    assert found.stretch == pytest.approx(1, abs=1e-3)


def test_the_mirrored_copy_of_a_symmetric_shape_is_the_shape_in_its_own_numbering(turned, found):
    assert found.mirrored.points == pytest.approx(turned.shape.points, abs=1e-4 * turned.size)
    assert (found.mirrored.faces == turned.shape.faces).all()


@pytest.mark.slow
def test_without_weights_or_method_a_symmetric_shape_has_its_partners(turned):
    found = homolog.symmetry(turned.shape)
    assert np.mean(found.partner == turned.partner) > 0.98
    assert abs(found.plane.normal @ turned.plane.normal) == pytest.approx(1, abs=1e-4)


@pytest.mark.slow
def test_a_bent_person_has_partners_of_the_other_side():
    body = homolog.demo_shapes()[1]
    found = homolog.symmetry(body, weights="people")
    left, right = body.points[:, 0].argmax(), body.points[:, 0].argmin()
    assert np.linalg.norm(body.points[found.partner[left]] - body.points[right]) < 0.1 * found.figures()["size"]
    assert found.figures()["returning"]["mean"] < 0.02 * found.figures()["size"]
    assert found.confidence.mean() > 0.8


@pytest.mark.parametrize("up", ["x", "z"])
def test_another_axis_up_gives_the_same_partners(turned, up):
    found = homolog.symmetry(turned.shape, method="registration", up=up)
    assert np.mean(found.partner == turned.partner) > 0.98


def test_a_bump_on_one_side_has_the_asymmetry_that_it_was_made_with():
    points, faces, partner = bumpy()
    bump = np.exp(-((points - [1.0, 0, 0]) ** 2).sum(axis=1) / 0.1) * (points[:, 0] > 0)
    bumped = points * (1 + 0.15 * bump[:, None])
    true = np.linalg.norm(bumped[partner] * [-1, 1, 1] - bumped, axis=1)
    found = homolog.symmetry(homolog.Shape(bumped, faces), method="registration")
    assert np.mean(found.partner == partner) > 0.98
    assert np.abs(found.plane.normal) == pytest.approx([1, 0, 0], abs=2e-3)
    assert np.corrcoef(found.asymmetry, true)[0, 1] > 0.99
    assert np.abs(found.asymmetry - true).mean() < 0.05 * true[true > 0.01].mean()
    # The mirrored copy has the bump at the partners of its points, which keep their numbers.
    assert np.abs(found.mirrored.points - bumped[partner] * [-1, 1, 1]).mean() < 0.01


def test_a_larger_half_is_seen_in_the_stretch_and_not_bending():
    points, faces, _ = bumpy()
    taller = points * np.where(points[:, :1] > 0, [1.3, 1, 1], [1, 1, 1])
    found = homolog.symmetry(homolog.Shape(taller, faces), method="registration")
    right, left = found.stretch[points[:, 0] > 0.5], found.stretch[points[:, 0] < -0.5]
    assert np.median(right) < 0.97 < 1.03 < np.median(left)
    assert np.median(right) * np.median(left) == pytest.approx(1, abs=0.03)


def test_points_that_are_left_out_have_no_partner_and_all_others_keep_their_numbers():
    points, faces, partner = bumpy()
    stray = np.concatenate([[[np.nan, 0, 0]], points, [[5.0, 5, 5]], points[:1]])
    found = homolog.symmetry(homolog.Shape(stray, faces + 1), method="registration")
    assert found.partner[[0, -2]].tolist() == [-1, -1]
    assert np.isnan(found.asymmetry[[0, -2]]).all() and np.isnan(found.stretch[[0, -2]]).all()
    assert (found.partner[1:-2] == partner + 1).all()
    assert found.figures()["points_without_partner"] == 3 - (found.partner[-1] >= 0)
    json.dumps(found.figures(), allow_nan=False)


def test_what_a_mask_leaves_out_has_no_partner():
    points, faces, partner = bumpy()
    lump = np.exp(-((points - [1.0, 0, 0]) ** 2).sum(axis=1) / 0.05)
    mask = lump < 0.2
    mask[partner[~mask]] = False
    found = homolog.symmetry(homolog.Shape(points * (1 + lump[:, None]), faces), method="registration", mask=mask)
    assert (found.partner[~mask] == -1).all() and np.isnan(found.asymmetry[~mask]).all()
    assert np.mean(found.partner[mask] == partner[mask]) > 0.98
    assert np.abs(found.plane.normal) == pytest.approx([1, 0, 0], abs=1e-3)
    assert np.nanmedian(found.asymmetry) < 1e-3


def test_a_cloud_has_partners():
    points, _, partner = bumpy()
    found = homolog.symmetry(homolog.Shape(points), method="registration")
    assert np.linalg.norm(points[found.partner] - points[partner], axis=1).mean() < 0.02
    assert np.abs(found.plane.normal) == pytest.approx([1, 0, 0], abs=0.01)


def test_stretch_is_that_of_a_linear_map_however_the_surface_is_triangulated():
    random = np.random.default_rng(0)
    steps = np.stack(np.meshgrid(np.arange(40.0), np.arange(40.0)), axis=-1).reshape(-1, 2)
    flat = steps + random.uniform(-0.3, 0.3, steps.shape)
    faces = Delaunay(flat).simplices
    sheet = homolog.Shape(np.pad(flat, ((0, 0), (0, 1))), faces)
    inner = (np.abs(steps - 19.5) < 14).all(axis=1)
    found = local_stretch(sheet, sheet.points * [3, 1, 1])[inner]
    assert found == pytest.approx(np.sqrt((9 + 1) / 2), rel=0.02)
    missing = np.where(np.arange(len(flat))[:, None] == 820, np.nan, sheet.points)
    found = local_stretch(sheet, missing)
    assert np.isnan(found[820]) and np.nanmax(np.abs(found - 1)) < 1e-9


def test_a_plane_is_found_although_a_third_of_the_pairs_is_wrong():
    random = np.random.default_rng(1)
    plane = MirrorPlane(np.array([0.0, 0.6, 0.8]), 2.0)
    points = random.normal(size=(300, 3))
    partners = plane.reflected(points)
    partners[:100] += [1.0, 2, 0]
    found = best_mirror_plane(points, partners)
    assert found.normal == pytest.approx(plane.normal, abs=1e-3) and found.offset == pytest.approx(2, abs=5e-3)


def test_pairs_count_by_their_weights():
    points = np.random.default_rng(2).normal(size=(200, 3))
    planes = MirrorPlane(np.array([1.0, 0, 0]), 1.0), MirrorPlane(np.array([0.0, 1, 0]), -2.0)
    partners = np.concatenate([planes[0].reflected(points[:100]), planes[1].reflected(points[100:])])
    for number, plane in enumerate(planes):
        weights = np.where(np.arange(200) // 100 == number, 1.0, 1e-9)
        found = best_mirror_plane(points, partners, weights)
        assert found.normal == pytest.approx(plane.normal, abs=1e-4)
        assert found.offset == pytest.approx(plane.offset, abs=1e-4)


@pytest.mark.parametrize(
    ("points", "partners", "weights", "message"),
    [
        (np.zeros((2, 3)), np.zeros((2, 3)), None, "at least 3 pairs"),
        (np.ones((5, 3)), np.ones((4, 3)), None, "must both have shape"),
        (np.ones((5, 3)), np.full((5, 3), np.nan), None, "finite"),
        (np.ones((5, 3)), np.ones((5, 3)), np.zeros(5), "not all zero"),
        (np.ones((5, 3)), np.ones((5, 3)), -np.ones(5), "none negative"),
    ],
)
def test_what_gives_no_plane_is_refused(points, partners, weights, message):
    with pytest.raises(ArgumentError, match=message):
        best_mirror_plane(points, partners, weights)


def test_words_and_matches_of_two_shapes_are_refused(turned, found):
    with pytest.raises(ArgumentError, match="partial is given, but a symmetry is of one shape"):
        homolog.symmetry(turned.shape, partial="source")
    with pytest.raises(ArgumentError, match="no match of a shape with its mirror image"):
        Symmetry.of(homolog.Match(turned.shape, turned.shape, turned.partner, turned.partner))
    moved = replace(turned.shape, points=turned.shape.points + 1)
    with pytest.raises(ArgumentError, match="no match of a shape with its mirror image"):
        Symmetry.of(replace(found.match, target=moved))


def test_files_have_a_row_per_point_and_the_mirrored_copy(turned, found, tmp_path):
    paths = write_symmetry(tmp_path / "out", found)
    assert [path.name for path in paths] == [
        "points.csv",
        "asymmetry.ply",
        "stretch.ply",
        "mirrored.ply",
        "symmetry.json",
    ]
    with paths[0].open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["partner"]) for row in rows] == turned.partner.tolist()
    assert [int(row["point"]) for row in rows] == list(range(turned.shape.n_points))
    written = homolog.read_shape(paths[3])
    assert written.points == pytest.approx(found.mirrored.points)
    report = json.loads(paths[4].read_text())
    assert report["plane"]["normal"] == pytest.approx(turned.plane.normal, abs=1e-6)
    assert report["points"] == turned.shape.n_points


def test_a_file_that_was_read_is_not_written_over(turned, tmp_path):
    given = tmp_path / "mirrored.ply"
    homolog.write_shape(given, turned.shape)
    before = given.read_bytes()
    with pytest.raises(ArgumentError, match=r"mirrored\.ply"):
        write_symmetry(tmp_path, homolog.symmetry(given, method="registration"))
    assert given.read_bytes() == before and [path.name for path in tmp_path.iterdir()] == ["mirrored.ply"]
