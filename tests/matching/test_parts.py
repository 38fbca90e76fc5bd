"""Two parts of one shape that overlap: where they do, and how they are brought together."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from homolog.core.errors import ArgumentError
from homolog.features import FeatureInfo
from homolog.geometry import compute_operators
from homolog.maps import normalised
from homolog.matching import Match, Matcher, align_parts
from homolog.methods import FunctionMethod, Supports
from homolog.pairs import MatcherSettings, PairOptions, PartsSettings, PointMaps
from homolog.shapes import Shape

TURN = Rotation.from_rotvec(np.deg2rad(35) * np.array([0.6, 0.0, 0.8])).as_matrix()
# Of the blob, from its lower end: what the two parts have.
UPPER, LOWER = (0.35, 1.0), (0.0, 0.7)


@dataclass(frozen=True)
class Parts:
    """Two parts whose points are samples of their own of one surface, and for each point its place on the sphere that
    the surface is a function of."""

    source: Shape
    target: Shape
    source_places: np.ndarray
    target_places: np.ndarray

    def overlaps(self, side):
        """Which points of a part lie on the other: by their height on the sphere."""
        places = self.source_places if side == "source" else self.target_places
        low, high = (UPPER[0] * 2 - 1, LOWER[1] * 2 - 1)
        return (places[:, 1] > low) & (places[:, 1] < high)


def part_of(sphere, faces, points, share):
    """What lies between two shares of the sphere's height."""
    height = (sphere[:, 1] + 1) / 2
    inside = ((height >= share[0]) & (height <= share[1]))[faces].all(axis=1)
    used = np.unique(faces[inside])
    return Shape(points[used], np.searchsorted(used, faces[inside])), sphere[used]


def twisted(points, degrees):
    """Points turned about the vertical by so much over a unit of height."""
    turns = Rotation.from_rotvec(np.deg2rad(degrees) * points[:, 1:2] * [0.0, 1.0, 0.0])
    return turns.apply(points)


@pytest.fixture(scope="module")
def parts_of(samples_of_a_blob):
    def build(twist=0.0):
        (sphere, faces, points), (others, other_faces, same) = map(samples_of_a_blob, (900, 1000))
        source, source_places = part_of(sphere, faces, points, UPPER)
        target, target_places = part_of(others, other_faces, twisted(same, twist) @ TURN.T + 3.0, LOWER)
        return Parts(replace(source, name="upper"), replace(target, name="lower"), source_places, target_places)

    return build


@pytest.fixture(scope="module")
def rigid(parts_of):
    return parts_of()


class Knowing:
    """Features that know the place of each point, wherever the part lies; points are told by their eigenvectors."""

    info = FeatureInfo(name="knowing", licence="none", upright=False)

    def __init__(self, parts):
        self.known = []
        for shape, places in ((parts.source, parts.source_places), (parts.target, parts.target_places)):
            rows = normalised(compute_operators(shape).eigenvectors).numpy()
            self.known.append((KDTree(rows), places))

    def __call__(self, operators):
        rows = normalised(operators.eigenvectors).numpy()
        distances, found = zip(*(tree.query(rows) for tree, _ in self.known), strict=True)
        which = int(np.argmin([one.mean() for one in distances]))
        waves = np.random.default_rng(0).standard_normal((3, 32))
        return torch.from_numpy(np.sin(1.5 * self.known[which][1][found[which]] @ waves)).float()


def iou(found, truth):
    return (found & truth).sum() / (found | truth).sum()


@pytest.fixture(scope="module")
def found(rigid):
    return Matcher(Knowing(rigid)).match(rigid.source, rigid.target, partial="both")


def test_parts_of_one_rigid_body(rigid, found):
    """Sampled apart, turned and moved: counterparts are neighbours, and the overlap is that of the cuts."""
    forth, back = found.source_to_target, found.target_to_source
    assert iou(forth >= 0, rigid.overlaps("source")) > 0.8
    assert iou(back >= 0, rigid.overlaps("target")) > 0.8
    spacing = np.sqrt(4 * np.pi / 900)  # on the sphere
    for there, places, others in (
        (forth, rigid.source_places, rigid.target_places),
        (back, rigid.target_places, rigid.source_places),
    ):
        known = there >= 0
        assert np.linalg.norm(places[known] - others[there[known]], axis=1).mean() < 1.6 * spacing
    assert (found.source_confidence[forth < 0] == 0).all() and (found.target_confidence[back < 0] == 0).all()
    assert found.source_confidence[forth >= 0].mean() > 0.5
    assert found.method == "nearest-features"


def test_the_report_has_the_overlap_and_the_motion(rigid, found):
    overlap = found.report["overlap"]
    assert overlap["fit"]["rigid"]
    assert overlap["source_share"] == pytest.approx(rigid.overlaps("source").mean(), abs=0.08)
    assert overlap["target_share"] == pytest.approx(rigid.overlaps("target").mean(), abs=0.08)
    alignment = found.report["alignment"]
    missed = Rotation.from_matrix(np.array(alignment["rotation"]) @ TURN).magnitude()
    assert np.degrees(missed) < 6  # points are 7 degrees apart on the sphere
    assert alignment["scale"] == pytest.approx(1, abs=1e-5)
    assert found.quality is None
    back = found.inverse().report["overlap"]
    assert back["source_share"] == overlap["target_share"]
    assert back["fit"]["source"] == overlap["fit"]["target"]


def test_a_result_folder(found, tmp_path):
    found.save(tmp_path / "result")
    again = Match.load(tmp_path / "result")
    assert np.array_equal(again.source_to_target, found.source_to_target)
    assert again.report["overlap"] == found.report["overlap"]


def test_a_mesh_and_a_cloud(rigid):
    knowing = Knowing(replace(rigid, target=rigid.target.as_cloud()))
    found = Matcher(knowing).match(rigid.source, rigid.target, partial="both", as_cloud="target")
    assert iou(found.source_to_target >= 0, rigid.overlaps("source")) > 0.8
    assert iou(found.target_to_source >= 0, rigid.overlaps("target")) > 0.8


def test_bent_parts_are_not_taken_for_rigid_ones(parts_of):
    """Features alone place the points of a part that was twisted; they do so where the parts overlap."""
    bent = parts_of(twist=180.0)
    found = Matcher(Knowing(bent)).match(bent.source, bent.target, partial="both")
    assert not found.report["overlap"]["fit"]["rigid"]
    assert iou(found.source_to_target >= 0, bent.overlaps("source")) > 0.65
    assert iou(found.target_to_source >= 0, bent.overlaps("target")) > 0.65


def test_maps_of_a_method_of_ones_own_stay(rigid):
    """What has no counterpart is told by the maps alone where nothing was aligned."""
    there = KDTree(rigid.target_places).query(rigid.source_places)[1]
    back = KDTree(rigid.source_places).query(rigid.target_places)[1]

    def told(pair):
        assert pair.are_parts and not pair.is_partial
        return PointMaps(torch.from_numpy(there), torch.from_numpy(back))

    method = FunctionMethod("told", told, Supports(parts=True, needs_features=False, refinement=False))
    found = Matcher(settings=MatcherSettings(method=method)).match(rigid.source, rigid.target, partial="both")
    known = found.source_to_target >= 0
    assert np.array_equal(found.source_to_target[known], there[known])
    assert iou(known, rigid.overlaps("source")) > 0.75


def test_nothing_is_aligned_where_the_settings_say_so(rigid):
    matcher = Matcher(Knowing(rigid), settings=MatcherSettings(parts=None))
    pair, _ = matcher.pair(rigid.source, rigid.target, partial="both")
    assert align_parts(pair) is pair


@pytest.mark.parametrize("method", ["functional-map", "axiomatic", "registration"])
def test_methods_that_match_no_two_parts(rigid, method):
    matcher = Matcher(Knowing(rigid), settings=MatcherSettings(method=method))
    with pytest.raises(ArgumentError, match=rf"partial is 'both', but the method '{method}' matches"):
        matcher.match(rigid.source, rigid.target, partial="both")


def test_options_of_two_parts():
    options = PairOptions(partial="both", partial_scale=0.1)
    assert options.is_partial("source") and options.is_partial("target")
    with pytest.raises(ArgumentError, match="partial is 'neither'"):
        PairOptions(partial="neither")
    with pytest.raises(ArgumentError, match=r"same_units is 0\.5"):
        PartsSettings(same_units=0.5)
