"""Masks: points that are left out of a match, and points that count more than others."""

import json

import numpy as np
import pytest
import torch
import trimesh

import homolog
from homolog.core.errors import ArgumentError, DataError, ShapeError
from homolog.geometry import MASKED
from homolog.maps import normalised, zoomout
from homolog.pairs import Mask, MatcherSettings, read_mask


@pytest.fixture(scope="module")
def bean():
    """A closed shape without symmetry."""
    sphere = trimesh.creation.icosphere(subdivisions=3)
    x, y, z = sphere.vertices.T
    bumps = 0.4 * np.exp(-((x - 0.8) ** 2 + y**2) / 0.2) + 0.3 * np.exp(-((y - 0.9) ** 2 + (z - 0.3) ** 2) / 0.1)
    return homolog.Shape(sphere.vertices * (1 + bumps + 0.2 * z)[:, None] * [1, 1.5, 0.8], sphere.faces, name="bean")


@pytest.fixture(scope="module")
def shuffled(bean):
    """The bean in another order of points on a plate, which is no part of it; and the places of its points."""
    order = np.random.default_rng(3).permutation(bean.n_points)
    place = np.argsort(order)
    plate = trimesh.creation.box(extents=[3, 0.1, 3]).subdivide().subdivide().subdivide()
    below = plate.vertices + np.array([0, bean.points[:, 1].min() - 0.02, 0])
    points = np.concatenate([bean.points[order], below])
    faces = np.concatenate([place[bean.faces], plate.faces + bean.n_points])
    return homolog.Shape(points, faces, name="bean on a plate"), place


@pytest.mark.parametrize("method", ["registration", "axiomatic"])
def test_what_a_mask_leaves_out_has_no_counterpart_and_the_rest_is_right(bean, shuffled, method):
    scan, place = shuffled
    mask = np.arange(scan.n_points) < bean.n_points
    found = homolog.match(bean, scan, method=method, clutter="keep", target_mask=mask)
    assert (found.target_to_source[~mask] == -1).all() and (found.target_confidence[~mask] == 0).all()
    assert mask[found.source_to_target].all()
    assert np.mean(found.source_to_target == place) > 0.98
    assert np.mean(found.target_to_source[place] == np.arange(bean.n_points)) > 0.98


@pytest.mark.slow
def test_without_the_mask_the_plate_misleads(bean, shuffled):
    scan, place = shuffled
    found = homolog.match(bean, scan, method="registration", clutter="keep")
    assert np.mean(found.source_to_target == place) < 0.5


def test_parts_that_are_left_out_of_both_shapes_are_matched_with_nothing(bean):
    top = bean.points[:, 1] > 0.9
    turned = homolog.Shape(bean.points[:, [2, 0, 1]], bean.faces)
    found = homolog.match(bean, turned, method="registration", source_mask=~top, target_mask=~top)
    for indices in (found.source_to_target, found.target_to_source):
        assert (indices[top] == -1).all() and not top[indices[indices >= 0]].any()
        assert np.mean(indices[~top] == np.flatnonzero(~top)) > 0.95


def test_a_cloud_has_masks_as_well(bean):
    top = bean.points[:, 1] > 0.9
    found = homolog.match(bean, bean.as_cloud(), method="registration", source_mask=~top, target_mask=~top)
    assert (found.target_to_source[top] == -1).all()
    assert np.mean(found.target_to_source[~top] == np.flatnonzero(~top)) > 0.95


def test_points_at_one_place_are_left_out_together_and_numbers_stay_those_of_the_file(bean):
    twice = homolog.Shape(np.concatenate([[[np.nan] * 3], bean.points, bean.points[5:6]]), bean.faces + 1)
    mask = np.ones(twice.n_points)
    mask[-1] = 0
    found = homolog.match(twice, bean, method="registration", source_mask=mask)
    assert found.source_to_target[[0, 6, -1]].tolist() == [-1, -1, -1]
    assert not np.isin(found.target_to_source, [0, 6, len(mask) - 1]).any()
    kept = np.delete(np.arange(bean.n_points), 5)
    assert np.mean(found.source_to_target[kept + 1] == kept) > 0.98


@pytest.mark.long
def test_a_mask_that_keeps_all_points_changes_nothing(bean):
    other = homolog.Shape(bean.points * [1, 1.1, 1] + 3, bean.faces)
    for method in ("registration", "axiomatic"):
        plain = homolog.match(bean, other, method=method)
        masked = homolog.match(bean, other, method=method, source_mask=np.full(bean.n_points, 2), target_mask=[1] * 642)
        assert (plain.source_to_target == masked.source_to_target).all()
        assert (plain.target_to_source == masked.target_to_source).all()


def test_a_growth_that_counts_little_does_not_move_the_rest(bean):
    growth = np.exp(-((bean.points - [-0.9, -0.6, 0]) ** 2).sum(axis=1) / 0.25)
    grown = homolog.Shape(bean.points * (1 + 1.2 * growth[:, None]), bean.faces)
    weights = np.where(growth > 0.1, 0.02, 1.0)
    clouds = bean.as_cloud(), grown.as_cloud()  # of surfaces closest points would find the rest
    plain, weighed = (
        homolog.match(*clouds, method="registration", orient="given", source_mask=mask, target_mask=mask)
        for mask in (None, weights)
    )
    away = np.flatnonzero(growth < 0.05)
    assert np.mean(plain.target_to_source[away] == away) < 0.5
    assert np.mean(weighed.target_to_source[away] == away) > 0.98


@pytest.mark.parametrize("partial", [None, "target"])
def test_graded_masks_reach_zoomout(bean, partial):
    growth = np.exp(-((bean.points - [-0.9, -0.6, 0]) ** 2).sum(axis=1) / 0.25)
    other = homolog.Shape(bean.points * (1 + 1.2 * growth[:, None]), bean.faces)
    weights = np.where(bean.points[:, 0] > 0, 1.0, 0.2)
    settings = MatcherSettings(method="nearest-features", smoothing=None)

    def found(**masks):
        words = {"settings": settings, "features": features, "orient": "given", "partial": partial, **masks}
        return homolog.match(bean, other, **words).target_to_source

    def features(operators):
        return torch.cat([operators.points + 1, operators.points.square()], dim=1)

    assert (found() == found(source_mask=np.full(642, 3.0))).all()
    assert (found() != found(source_mask=weights, target_mask=weights)).any()


def test_a_mask_and_clutter_are_both_told_and_both_left_out(bean):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.2)
    points = np.concatenate([bean.points, ball.vertices + np.array([6, 0, 0])])
    scan = homolog.Shape(points, np.concatenate([bean.faces, ball.faces + bean.n_points]))
    mask = points[:, 1] < 0.9
    found = homolog.match(scan, bean, method="registration", source_mask=mask, target_mask=mask[:642])
    rules = {each["rule"]: each["count"] for each in found.report["inputs"]["source"]["findings"]}
    assert rules[MASKED] == (~mask).sum() and rules["points of other objects"] == len(ball.vertices)
    apart = ~mask | (np.arange(len(points)) >= 642)
    assert (found.source_to_target[apart] == -1).all() and (found.source_to_target[~apart] >= 0).mean() > 0.98


def test_reports_say_how_many_points_were_left_out_and_strict_matches_bear_masks(bean, tmp_path):
    mask = bean.points[:, 1] < 0.9
    found = homolog.match(bean, bean, method="registration", source_mask=mask, target_mask=mask, strict=True)
    findings = found.report["inputs"]["source"]["findings"]
    assert [each["count"] for each in findings if each["rule"] == MASKED] == [int((~mask).sum())]
    assert "source_mask" not in found.report["options"]
    json.dumps(found.report)
    found.save(tmp_path / "result")
    again = homolog.Match.load(tmp_path / "result")
    assert (again.source_to_target == found.source_to_target).all()


def test_pairs_that_count_nearly_nothing_do_not_mislead_zoomout():
    mesh = trimesh.creation.icosphere(subdivisions=3)
    bumpy = mesh.vertices * (1 + 0.3 * mesh.vertices[:, :1] + 0.2 * mesh.vertices[:, 1:2] ** 3)
    operators = homolog.compute_operators(homolog.Shape(bumpy, mesh.faces))
    true = torch.arange(operators.n_points)
    wrong = operators.points[:, 1] > 0
    start = torch.where(wrong, torch.roll(true, 200), true)
    blank = normalised(torch.ones(operators.n_points, 1))
    phi = operators.eigenvectors[:, :60].contiguous()
    weights = torch.where(wrong, 1e-6, 1.0)

    def error(**known):
        found, _ = zoomout(start, start, phi, phi, blank, blank, **known)
        return float((operators.points[found] - operators.points).norm(dim=1).mean())

    assert error(weights_x=weights, weights_y=weights) < 0.5 * error()
    assert error(weights_x=torch.full_like(weights, 3.0)) == error()


def ply(path, names, rows, *, kind="float", text=True):
    """A PLY file of vertices with further properties."""
    lines = ["ply", f"format {'ascii' if text else 'binary_little_endian'} 1.0", f"element vertex {len(rows)}"]
    lines += [f"property {kind if name not in 'xyz' else 'float'} {name}" for name in ("x", "y", "z", *names)]
    head = "\n".join([*lines, "end_header\n"]).encode()
    full = [(0.0, 0.0, 0.0, *row) for row in rows]
    if text:
        path.write_bytes(head + "\n".join(" ".join(map(str, row)) for row in full).encode() + b"\n")
    else:
        sort = {"float": "<f4", "uchar": "u1"}[kind]
        dtype = [(name, "<f4" if name in "xyz" else sort) for name in ("x", "y", "z", *names)]
        path.write_bytes(head + np.array(full, dtype=dtype).tobytes())
    return path


def test_masks_are_read_from_every_format(tmp_path):
    wanted = [1.0, 0.0, 0.5, 1.0]
    np.save(tmp_path / "a.npy", wanted)
    np.save(tmp_path / "bool.npy", np.array(wanted) == 1)
    (tmp_path / "a.txt").write_text("1\n0\n0.5\n1\n")
    (tmp_path / "a.csv").write_text("\ufeffmask\n1 # kept\n0\n\n0.5\n1e0\n")
    (tmp_path / "words.txt").write_text("true\nfalse\nTrue\nFALSE\n")
    ply(tmp_path / "mask.ply", ["nx", "mask"], [(9, each) for each in wanted])
    ply(tmp_path / "weight.ply", ["weight"], [(each,) for each in wanted], text=False)
    ply(
        tmp_path / "grey.ply",
        ["red", "green", "blue"],
        [[int(255 * each)] * 3 for each in [1, 0, 0.2, 1]],
        kind="uchar",
    )
    for name in ("a.npy", "a.txt", "a.csv", "mask.ply", "weight.ply"):
        assert read_mask(tmp_path / name).weights.tolist() == wanted, name
    assert read_mask(tmp_path / "bool.npy").weights.tolist() == [1, 0, 0, 1]
    assert read_mask(tmp_path / "words.txt").weights.tolist() == [1, 0, 1, 0]
    assert read_mask(tmp_path / "grey.ply").weights.tolist() == [1, 0, 0.2, 1]
    assert read_mask(tmp_path / "bool.npy").kept.tolist() == [True, False, False, True]


def test_files_that_are_no_masks_are_refused_in_one_line(tmp_path):
    np.save(tmp_path / "two.npy", np.ones((4, 2)))
    (tmp_path / "damaged.npy").write_bytes(b"\x93NUMPY")
    (tmp_path / "words.txt").write_text("1\nyes\n")
    (tmp_path / "pairs.csv").write_text("1\n1,2\n")
    (tmp_path / "nan.csv").write_text("1\nnan\n")
    (tmp_path / "negative.csv").write_text("1\n-2\n")
    (tmp_path / "none.txt").write_text("0\n0\n")
    (tmp_path / "empty.txt").write_text("")
    (tmp_path / "a.png").write_text("")
    ply(tmp_path / "plain.ply", [], [()] * 4)
    ply(tmp_path / "red.ply", ["red", "green", "blue"], [(255, 0, 0)] * 4, kind="uchar")
    for name, said in {
        "two.npy": "shape (4, 2)",
        "damaged.npy": "cannot be read as a mask",
        "words.txt": "the line 'yes' should hold numbers",
        "pairs.csv": "the line '1,2' has 2 values, but a mask has one a line",
        "nan.csv": "holds nan, but must hold finite numbers from 0",
        "negative.csv": "holds -2",
        "none.txt": "leaves every point out",
        "empty.txt": "leaves every point out",
        "a.png": "suffix '.png', but a mask must have one of",
        "missing.npy": "cannot be read as a mask",
        "plain.ply": "neither mask nor colours",
        "red.ply": "no greys",
    }.items():
        with pytest.raises((ArgumentError, DataError)) as error:
            read_mask(tmp_path / name)
        assert said in str(error.value) and name in str(error.value) and "\n" not in str(error.value)


def test_masks_that_do_not_fit_are_refused(bean):
    for mask, said in (
        (np.ones(5), "source_mask has 5 numbers, but bean has 642 points"),
        (np.full(642, np.nan), "source_mask holds nan"),
        (["a"] * 642, "source_mask is"),
        (np.zeros(642), "source_mask leaves every point out"),
    ):
        with pytest.raises(ArgumentError, match=said):
            homolog.match(bean, bean, source_mask=mask, method="registration")
    few = np.arange(642) < 2
    with pytest.raises(ShapeError, match="what source_mask leaves of bean is too little"):
        homolog.match(bean, bean, source_mask=few, method="registration")
    matcher = homolog.Matcher(settings=homolog.MatcherSettings(method="registration"))
    one, other = matcher.preprocess(bean), matcher.preprocess(bean, mask=Mask(few | (bean.points[:, 1] < 1)))
    with pytest.raises(ArgumentError, match="source was preprocessed without"):
        matcher.paired(one, other, homolog.PairOptions(source_mask=np.ones(642)))


def test_landmarks_on_points_that_are_left_out_are_left_out_as_well(bean):
    mask = bean.points[:, 1] < 0.9
    inside, outside = int(np.flatnonzero(mask)[7]), int(np.flatnonzero(~mask)[3])
    known = ([inside, outside], [inside, outside])
    found = homolog.match(bean, bean, method="registration", landmarks=known, source_mask=mask)
    assert found.source_to_target[inside] == inside and found.source_to_target[outside] == -1
    assert any("left out" in warning for warning in found.warnings)
