"""What a match warns of: units, parts and loose pieces, where they are the cause, and nothing where they are not."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from homolog import Matcher, PairOptions, Shape, match, write_shape
from homolog.matching import Match, low_confidence_warnings, part_warnings, unit_warnings
from homolog.matching.warnings import match_warnings
from homolog.methods.protocol import FunctionMethod
from homolog.pairs import MatcherSettings, PointMaps, Supports
from homolog.synthesis import cut, cut_holes, view


@pytest.fixture(scope="module")
def pair():
    matcher = Matcher(settings=MatcherSettings(method="axiomatic"))

    def paired(source, target, **options):
        return matcher.pair(source, target, PairOptions(**options))[0]

    return paired


def half(shape, axis=2):
    """The front half of a mesh, as the faces that lie there."""
    middles = shape.points[shape.faces].mean(axis=1)[:, axis]
    faces = shape.faces[middles > np.median(middles)]
    used, corners = np.unique(faces, return_inverse=True)
    return Shape(shape.points[used], corners.reshape(-1, 3))


@pytest.fixture(scope="module", params=[8.0, 3.0])
def noisy(make, request):
    """A half as a cloud, with a tenth more of points around it, far or less far."""
    points = half(make.blob(4)).points
    around = np.random.default_rng(0).normal(scale=request.param, size=(len(points) // 10, 3))
    return np.concatenate([points, around])


@pytest.mark.parametrize("unit", [1.0, 1000.0, 0.0254])
def test_outliers_are_no_other_unit(pair, make, noisy, unit):
    """They blow up the area of a cloud, but the scale is right."""
    right = pair(Shape(noisy * unit), make.blob(3), partial="source", partial_scale=1 / unit)
    assert right.y.operators.scale and unit_warnings(right) == ()
    exchanged = pair(make.blob(3), Shape(noisy * unit), partial="target", partial_scale=1 / unit)
    assert unit_warnings(exchanged) == ()


@pytest.mark.parametrize("factor", [1000.0, 10.0, 2.54, 0.01])
def test_other_units_are_told_with_outliers_and_without(pair, make, noisy, factor):
    for points in (noisy, half(make.blob(4)).points):
        found = pair(Shape(points * factor), make.blob(3), partial="source")
        assert ["their units seem to differ" in line for line in unit_warnings(found)] == [True]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_half_looks_like_a_part(pair, make, axis):
    for source, target, side in (
        (half(make.blob(3), axis), make.blob(3), "source"),
        (make.blob(3), half(make.blob(3)), "target"),
    ):
        (said,) = part_warnings(pair(source, target))
        assert said.startswith(f"the {side} looks like a part") and said.endswith(f"give partial='{side}'")
    assert part_warnings(pair(half(make.blob(3), axis), make.blob(3), partial="source")) == ()


def test_no_part_is_suspected_where_nearly_all_points_lead_home(pair, make):
    """An open neck is no cut: of a whole that a part is matched with, many points find no counterpart."""
    open_blob, blob = half(make.blob(3)), make.blob(3)
    matched = Match(
        open_blob,
        blob,
        np.zeros(open_blob.n_points, dtype=int),
        np.zeros(blob.n_points, dtype=int),
        np.full(open_blob.n_points, 0.95),
        np.full(blob.n_points, 0.95),
        method="a",
    )
    suspected = [
        [line for line in match_warnings(pair(open_blob, blob), found) if "looks like a part" in line]
        for found in (matched, replace(matched, target_confidence=np.full(blob.n_points, 0.7)))
    ]
    assert [len(lines) for lines in suspected] == [0, 1]


@pytest.mark.slow
def test_views_and_cuts_of_bodies_look_like_parts(pair, demo):
    for part in (*(cut(demo.amber, seed=seed) for seed in (0, 3)), view(demo.amber, seed=3).mesh):
        assert len(part_warnings(pair(part.shape, demo.boris))) == 1


@pytest.mark.slow
def test_full_shapes_do_not_look_like_parts(pair, make, demo):
    """Be they closed, with holes, both open, clouds, turned inside out in places, or in pieces."""
    blob = make.blob(3)
    flipped = np.where(np.arange(blob.n_faces)[:, None] % 3 == 0, blob.faces[:, ::-1], blob.faces)
    two_sided = np.where(blob.points[blob.faces].mean(axis=1)[:, :1] > 0, blob.faces[:, ::-1], blob.faces)
    for source, target in (
        (blob, make.blob(4)),
        (demo.amber, demo.boris),
        (cut_holes(demo.amber, seed=1).shape, demo.boris),
        (half(blob), half(make.blob(4))),
        (half(blob).as_cloud(), blob),
        (half(blob), blob.as_cloud()),
        (Shape(blob.points, flipped), blob),
        (Shape(blob.points, two_sided), blob),
        (in_pieces(blob), blob),
    ):
        assert part_warnings(pair(source, target)) == ()


def in_pieces(shape, count=12):
    """The same faces in patches that share no points, each open."""
    middles = shape.points[shape.faces].mean(axis=1)
    patch = np.argmin(np.linalg.norm(middles[:, None] - middles[:: len(middles) // count], axis=2), axis=1)
    keys, corners = np.unique(np.stack([np.repeat(patch, 3), shape.faces.ravel()]), axis=1, return_inverse=True)
    return Shape(shape.points[keys[1]] + 1e-3 * keys[0][:, None], corners.reshape(-1, 3))


@pytest.mark.slow
def test_loose_pieces_are_the_cause_where_they_are_many(pair, make):
    blob = make.blob(3)
    doubtful = Match(blob, blob, *[np.arange(blob.n_points)] * 2, *[np.full(blob.n_points, 0.1)] * 2, method="a")
    shell, crumbs = (
        in_pieces(blob),
        make.joined([blob, *(replace(make.sphere(1), points=make.sphere(1).points * 0.02 + 3 + i) for i in range(9))]),
    )
    for source, target, which in ((shell, blob, "source"), (blob, shell, "target"), (shell, shell, "both")):
        (said,) = low_confidence_warnings(doubtful, pair=pair(source, target, proxy="never"))
        assert "loose pieces; join them" in said and said.endswith(f"as_cloud='{which}'")
    for source in (blob, crumbs, shell.as_cloud()):
        (said,) = low_confidence_warnings(doubtful, pair=pair(source, blob))
        assert "are the shapes of one kind" in said
    sure = replace(doubtful, source_confidence=np.ones(blob.n_points), target_confidence=np.ones(blob.n_points))
    assert low_confidence_warnings(sure, pair=pair(shell, blob, proxy="never")) == ()
    # A proxy is one piece.
    (said,) = low_confidence_warnings(doubtful, pair=pair(shell, blob))
    assert "are the shapes of one kind" in said


def test_points_that_are_nearly_equal_make_no_match_doubtful(make):
    """Their images lie apart by as much as those of any neighbours, though they themselves do not."""
    blob, rng = make.blob(3), np.random.default_rng(0)
    which = rng.choice(blob.n_faces, 100, replace=False)
    a, b, c = blob.faces[which].T
    new, share = blob.n_points + np.arange(100), 1e-6
    points = blob.points[a] * (1 - 2 * share) + blob.points[b] * share + blob.points[c] * share
    fans = np.concatenate([np.stack(sides, axis=1) for sides in ((a, b, new), (b, c, new), (c, a, new))])
    crowded = Shape(np.concatenate([blob.points, points]), np.concatenate([np.delete(blob.faces, which, axis=0), fans]))

    def shifted(pair):
        near = torch.cdist(pair.x.operators.points.double(), pair.y.operators.points.double())
        there = near.argmin(dim=1)
        there[blob.n_points :] = torch.from_numpy(b)  # a neighbour of the point that each lies at
        return PointMaps(there, near.argmin(dim=0))

    # Nothing is to smooth the map.
    method = FunctionMethod("shifted", shifted, Supports(needs_features=False, refinement=False))
    settings = MatcherSettings(method=method)
    found = Matcher(settings=settings).match(crowded, blob, PairOptions(orient="given"))
    assert found.quality.source.dirichlet_energy < 1.5 and found.warnings == ()


def test_a_match_tells_the_axes_that_its_files_name(make, tmp_path):
    write_shape(tmp_path / "a.ply", make.blob(2))
    content = (tmp_path / "a.ply").read_bytes().replace(b"ply\n", b"ply\ncomment 3D Slicer output. SPACE=RAS\n", 1)
    (tmp_path / "b.ply").write_bytes(content)
    inputs = match(tmp_path / "a.ply", tmp_path / "b.ply", method="axiomatic").report["inputs"]
    assert [inputs[side]["space"] for side in ("source", "target")] == [None, "RAS"]
