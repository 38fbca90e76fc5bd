"""A partial shape is aligned where its features fit those of the full shape."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from homolog.features import DiffusionNet, FeatureInfo
from homolog.geometry import compute_operators, some_points, unit_frame
from homolog.geometry.tangent import normals_of
from homolog.maps import best_rotation
from homolog.matching import Matcher, align_partial, best_alignment, unit_warnings
from homolog.pairs import AlignmentSettings, MatcherSettings
from homolog.shapes import Shape


class Trained(DiffusionNet):
    """An idea of a trained network: it knows each point, but where that lies has a say in its features, too."""

    def __init__(self, *known):
        super().__init__()
        self.known = {len(points): torch.as_tensor(points).float() for points in known}

    def forward(self, inputs, operators):
        del operators
        waves = torch.randn(3, 32, generator=torch.Generator().manual_seed(0))
        return torch.cat([torch.sin(2 * self.known[len(inputs)] @ waves), 0.7 * torch.sin(2 * inputs @ waves)], dim=1)


@pytest.fixture(scope="module")
def upper(coarse_body):
    """A body, what of it lies above the hips, and the indices of that in it."""
    body = coarse_body(4800)
    height = body.points[:, 1]
    faces = body.faces[(height[body.faces] > np.median(height)).all(axis=1)]
    kept = np.unique(faces)
    place = np.full(body.n_points, -1)
    place[kept] = np.arange(len(kept))
    return body, Shape(body.points[kept], place[faces], name="part"), kept


@pytest.fixture(scope="module")
def matcher_of(upper):
    body, _, kept = upper
    known = unit_frame(body).to_unit(body.points)

    def build(**settings):
        some = some_points(len(kept), AlignmentSettings().partial_samples).numpy()
        return Matcher(Trained(known, known[kept], known[kept][some]), settings=MatcherSettings(**settings))

    return build


def displaced(upper, pre_aligned, matcher, degrees=25.0, away=0.1, as_cloud=None):
    """Where the points of a rotated and moved partial shape come to lie, and the full shape's points that they are."""
    body, part, kept = upper
    scale = unit_frame(body).scale
    turn = Rotation.from_rotvec(np.deg2rad(degrees) * np.array([0.6, 0.0, 0.8])).as_matrix()
    middle = part.points.mean(axis=0)
    turned = Shape((part.points - middle) @ turn.T + middle + away * scale, part.faces)
    pair, _ = matcher.pair(body, turned, partial="target", pre_aligned=pre_aligned, as_cloud=as_cloud)
    return align_partial(pair).y, pair.y, pair.x.operators.points[kept]


@pytest.mark.parametrize("pre_aligned", [False, True])
def test_a_partial_shape_is_rotated_and_moved_to_where_it_belongs(upper, matcher_of, pre_aligned):
    matcher = matcher_of()
    found, given, places = displaced(upper, pre_aligned, matcher)
    assert (given.operators.points - places).norm(dim=1).mean() > 0.1
    assert (found.operators.points - places).norm(dim=1).mean() < 0.01
    torch.testing.assert_close(found.features, matcher.extractor.network(found.operators.points, None))
    lengths = [torch.pdist(each.operators.points[:200]) for each in (found, given)]
    torch.testing.assert_close(*lengths, atol=1e-4, rtol=0)


def test_the_sides_of_a_cloud_follow_its_alignment_and_a_mesh_keeps_its_own(upper, matcher_of):
    matcher = matcher_of()
    mesh, mesh_before, _ = displaced(upper, True, matcher)
    assert not torch.equal(mesh.operators.points, mesh_before.operators.points)
    assert torch.equal(mesh.operators.gradient_x.values(), mesh_before.operators.gradient_x.values())
    cloud, before, _ = displaced(upper, True, matcher, as_cloud="target")
    # Of a cloud, the sign of a normal follows from its direction, and with it the first tangent direction.
    normals = [normals_of(shape.operators.scatter.numpy()) for shape in (before, cloud)]
    rotation = best_rotation(before.operators.points, cloud.operators.points).double().numpy()
    signs = np.sign(np.einsum("nk,nk->n", normals[0] @ rotation.T, normals[1]))
    assert 0 < (signs < 0).sum() < len(signs)
    rows = before.operators.gradient_x.crow_indices().diff()
    expected = before.operators.gradient_x.values() * torch.from_numpy(signs).float().repeat_interleave(rows)
    assert torch.equal(cloud.operators.gradient_x.values(), expected)


def test_the_better_of_two_beginnings_is_kept(upper, matcher_of):
    """A part that says to lie in its whole's coordinates, and lies far away, begins anew from its middle."""
    found, given, places = displaced(upper, True, matcher_of(), away=60.0)
    assert (given.operators.points - places).norm(dim=1).mean() > 60
    assert (found.operators.points - places).norm(dim=1).mean() < 0.01


def test_maps_are_those_of_the_alignment(upper, matcher_of):
    body, part, kept = upper
    turned = Shape(part.points @ Rotation.from_euler("x", 30, degrees=True).as_matrix().T, part.faces)
    error = {}
    for aligned in (True, False):
        alignment = AlignmentSettings() if aligned else None
        matcher = matcher_of(alignment=alignment, method="nearest-features", refinement=None)
        found = matcher.match(body, turned, partial="target").target_to_source
        error[aligned] = np.linalg.norm(body.points[found] - body.points[kept], axis=1).mean()
        mirrored = matcher.match(turned, body, partial="source").source_to_target
        np.testing.assert_array_equal(mirrored, found)
    assert error[True] < 0.2 * error[False]


def test_nothing_moves_that_need_not(upper, matcher_of):
    body, part, _ = upper
    matcher = matcher_of()
    pair, _ = matcher.pair(body, part, partial="target", pre_aligned=True)
    whole, prepared = pair.x, pair.y
    found = align_partial(pair).y
    assert (found.operators.points - prepared.operators.points).norm(dim=1).max() < 1e-3
    pair, _ = matcher_of(alignment=None).pair(body, part, partial="target", pre_aligned=True)
    assert align_partial(pair) is pair
    full, _ = matcher.pair(body, body)
    assert align_partial(full) is full
    given = compute_operators(part, scale=whole.operators.scale).points
    torch.testing.assert_close(
        prepared.operators.points - prepared.operators.points.mean(dim=0), given, atol=1e-5, rtol=0
    )


@pytest.mark.parametrize(("degrees", "axis"), [(175, "y"), (65, "x"), (-55, "z")])
def test_turned_beginnings_where_the_given_one_leads_nowhere(upper, degrees, axis):
    """A network that knows the points of parts that stand about rightly, and only sees where others lie."""
    body, part, kept = upper
    whole = torch.from_numpy(unit_frame(body).to_unit(body.points)).float()
    turn = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    basis = compute_operators(Shape(part.points @ turn.T, part.faces), scale=unit_frame(body).scale).basis
    places = whole[kept][some_points(len(kept), AlignmentSettings().partial_samples)]

    def embedded(points):
        waves = torch.randn(3, 32, generator=torch.Generator().manual_seed(0))
        return torch.cat([torch.sin(2 * points @ waves), torch.cos(2 * points @ waves)], dim=1)

    def apart(points, others):
        return ((points - points.mean(dim=0)) - (others - others.mean(dim=0))).norm(dim=1).mean()

    def features_of(samples):
        return embedded(places if apart(samples.points, places) < 0.1 else samples.points + 9.0)

    assert apart(basis.points, whole[kept]) > 0.15
    found = {one: best_alignment(basis, features_of, whole, embedded(whole), search=one) for one in (True, False)}
    assert apart(found[True].points, whole[kept]) < 0.1 < apart(found[False].points, whole[kept])
    assert found[True].scale == found[False].scale == 1


@pytest.mark.parametrize("size", [0.5, 1.9])
def test_a_part_of_a_smaller_or_larger_individual_takes_its_whole_s_size(upper, size):
    """A network that knows the points of parts of about the right size, and sees of others only where they lie."""
    body, part, kept = upper
    whole = torch.from_numpy(unit_frame(body).to_unit(body.points)).float()
    basis = compute_operators(Shape(part.points * size, part.faces), scale=unit_frame(body).scale).basis
    places = whole[kept][some_points(len(kept), AlignmentSettings().partial_samples)]

    def embedded(points):
        waves = torch.randn(3, 32, generator=torch.Generator().manual_seed(0))
        return torch.cat([torch.sin(2 * points @ waves), torch.cos(2 * points @ waves)], dim=1)

    def features_of(samples):
        points = samples.points
        extent = [(one - one.mean(dim=0)).norm(dim=1).mean() for one in (points, places)]
        area = (
            samples.mass.sum() / basis.sampled(some_points(len(kept), AlignmentSettings().partial_samples)).mass.sum()
        )
        assert abs(area.sqrt() * size / (extent[0] / extent[1]) - 1) < 1e-3  # operators are of the size that is tried
        return embedded(places if abs(extent[0] / extent[1] - 1) < 0.15 else points + 9.0)

    found = best_alignment(basis, features_of, whole, embedded(whole), search=True)
    assert abs(found.scale * size - 1) < 0.1
    middled = [points - points.mean(dim=0) for points in (found.points, whole[kept])]
    assert (middled[0] - middled[1]).norm(dim=1).mean() < 0.1
    assert best_alignment(basis, features_of, whole, embedded(whole), search=False).scale == 1


def test_what_is_nearly_as_alike_elsewhere_does_not_tempt(upper):
    """Features that tell nothing are as alike everywhere: the part stays as it is given."""
    body, part, _ = upper
    whole = torch.from_numpy(unit_frame(body).to_unit(body.points)).float()
    basis = compute_operators(part, scale=unit_frame(body).scale).basis

    def features_of(samples):
        """A hair more alike where the partial shape has another size."""
        points = samples.points
        spread = (points - points.mean(dim=0)).norm(dim=1).mean()
        one = torch.tensor([1.0, 0.5 - 0.005 * (spread < 0.3)])
        return one.expand(len(points), 2)

    found = best_alignment(basis, features_of, whole, torch.tensor([1.0, 0.0]).expand(len(whole), 2), search=True)
    assert found.scale == 1
    assert torch.equal(found.points, basis.points)


@pytest.mark.parametrize("factor", [0.01, 100.0])
@pytest.mark.parametrize("pre_aligned", [True, False])
def test_a_part_in_unknown_units_is_brought_to_the_size_of_its_whole(upper, factor, pre_aligned):
    """A network that knows the points of parts of about the right size and place, and sees of others where they lie."""
    body, part, kept = upper
    frame = unit_frame(body)
    whole = torch.from_numpy(frame.to_unit(body.points)).float()
    places = whole[kept]
    waves = torch.randn(3, 32, generator=torch.Generator().manual_seed(0))

    class Network(Trained):
        def forward(self, inputs, operators):
            if len(inputs) == body.n_points:
                return torch.cat([torch.sin(2 * inputs @ waves), torch.cos(2 * inputs @ waves)], dim=1)
            known = places if len(inputs) == len(kept) else places[some_points(len(kept), len(inputs))]
            apart = (inputs - inputs.mean(dim=0)).norm(dim=1).mean() / (known - known.mean(dim=0)).norm(dim=1).mean()
            seen = known * apart if abs(apart - 1) < 0.25 else inputs + 9.0
            return torch.cat([torch.sin(2 * seen @ waves), torch.cos(2 * seen @ waves)], dim=1)

    info = FeatureInfo(name="parts", licence="none", upright=False, partial=True)
    matcher = Matcher(Network(), info)
    scaled = Shape(part.points * factor, part.faces)
    pair, _ = matcher.pair(body, scaled, partial="target", pre_aligned=pre_aligned)
    found = align_partial(pair)
    assert found.alignment.scale * factor == pytest.approx(1, abs=0.04)
    middled = [points - points.mean(dim=0) for points in (found.y.operators.points, places)]
    assert (middled[0] - middled[1]).norm(dim=1).mean() < 0.02
    if pre_aligned:
        assert (found.y.operators.points - places).norm(dim=1).mean() < 0.1
    # Operators are those of the right size: gradients are fitted in units that count.
    expected = compute_operators(part, scale=frame.scale)
    ratio = found.y.operators.eigenvalues[1:10] / expected.eigenvalues[1:10]
    assert (ratio - 1).abs().max() < 0.1
    (warning,) = unit_warnings(pair)
    assert "their units seem to differ; its size is estimated; give partial_scale" in warning
    told, _ = matcher.pair(body, scaled, partial="target", pre_aligned=pre_aligned, partial_scale=1 / factor)
    assert unit_warnings(told) == ()
