"""Findings against shapes of known topology, and against plain loops over random ones."""

import json
from collections import Counter, defaultdict

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from homolog.shapes import Shape, check
from homolog.shapes.topology import components, cross_products, half_edges, mesh_components, topology


def shape_of(mesh, **name):
    return Shape(mesh.vertices, mesh.faces, **name)


def found(shape):
    return {f.rule: f.count for f in check(shape).findings}


def sphere():
    return shape_of(trimesh.creation.icosphere(subdivisions=2))


def upper_half(ball):
    """The faces of a sphere that lie above the middle: a surface with one rim."""
    above = ball.triangles_center[:, 2] > 0
    return trimesh.Trimesh(ball.vertices, ball.faces[above])


def with_points(shape, *more):
    return Shape(np.concatenate([shape.points, np.reshape(more, (-1, 3))]), shape.faces)


def with_faces(shape, *more):
    return Shape(shape.points, np.concatenate([shape.faces, np.reshape(more, (-1, 3))]), allow_broken=True)


def test_clean_sphere():
    report = check(sphere())
    assert report.findings == ()
    assert report.is_clean
    assert report.usable
    assert (report.n_components, report.n_boundary_loops) == (1, 0)
    assert report.extent == pytest.approx(np.linalg.norm(np.ptp(sphere().points, axis=0)))
    assert report.area == pytest.approx(trimesh.creation.icosphere(subdivisions=2).area)


@pytest.mark.parametrize(
    ("mesh", "components", "loops"),
    [
        (trimesh.creation.torus(2, 1), 1, 0),
        (upper_half(trimesh.creation.icosphere(subdivisions=2)), 1, 1),
        (trimesh.creation.box() + trimesh.creation.box(bounds=[[5, 5, 5], [6, 6, 6]]), 2, 0),
    ],
)
def test_known_topology(mesh, components, loops):
    report = check(shape_of(mesh))
    assert (report.n_components, report.n_boundary_loops) == (components, loops)


def test_holes_that_touch_at_a_point_have_one_rim():
    """Where the point is parted into its two fans, the holes become one."""
    ball = sphere()
    ring = ball.faces[np.any(ball.faces == 0, axis=1)]
    opposite = next(f for f in ring if len(set(f) & set(ring[0])) == 1)
    keep = [set(face) != set(ring[0]) and set(face) != set(opposite) for face in ball.faces]
    assert found(Shape(ball.points, ball.faces[keep])) == {"boundary loops": 1, "non-manifold points": 1}


def test_holes_apart_have_a_rim_each():
    ball = sphere()
    apart = next(f for f in ball.faces[::-1] if not set(f) & set(ball.faces[0]))
    keep = [set(face) != set(ball.faces[0]) and set(face) != set(apart) for face in ball.faces]
    assert found(Shape(ball.points, ball.faces[keep])) == {"boundary loops": 2}


def test_each_rule_counts_what_it_says():
    ball = sphere()
    n = ball.n_points
    assert found(with_points(ball, [9, 9, 9], [8, 8, 8])) == {"unreferenced points": 2}
    assert found(with_points(ball, [np.nan, 0, 0], [0, np.inf, 0])) == {"NaN or infinite points": 2}
    assert found(with_points(ball, ball.points[[3, 3, 7]])) == {"duplicate points": 3}
    assert found(with_faces(ball, ball.faces[4], ball.faces[5][[1, 0, 2]])) == {"duplicate faces": 2}
    assert found(with_faces(ball, [0, 0, 1], [2, 2, 2])) == {"faces with a repeated corner": 2}
    assert found(with_faces(ball, [0, 1, n], [-1, 2, 3])) == {"faces out of range": 2}
    broken = with_faces(with_points(ball, [np.nan] * 3), [0, 1, n])
    assert found(broken) == {"NaN or infinite points": 1, "faces at NaN or infinite points": 1}
    assert found(with_points(ball.as_cloud(), ball.points[:5])) == {"duplicate points": 5}


def test_minus_zero_equals_zero():
    assert found(Shape([[0.0, 0, 0], [-0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])) == {"duplicate points": 1}


def test_fin_makes_a_non_manifold_edge():
    ball = sphere()
    edge = ball.faces[0][:2]
    fin = with_faces(with_points(ball, [9, 9, 9]), [*edge, ball.n_points])
    assert found(fin) == {"non-manifold edges": 1, "boundary loops": 1}


def test_cones_that_touch_make_a_non_manifold_point():
    one = trimesh.creation.icosphere(subdivisions=1)
    two = one.copy()
    two.vertices = 2 * one.vertices[0] - one.vertices
    # Rounding must not part the two tips.
    two.vertices[0] = one.vertices[0]
    points = np.concatenate([one.vertices, two.vertices])
    both = Shape(points, np.concatenate([one.faces, two.faces + len(one.vertices)]))
    assert found(both) == {"duplicate points": 1, "non-manifold points": 1}


def test_sliver_is_kept_so_that_no_hole_opens():
    box = trimesh.creation.box()
    # Split an edge of one face only, at a point exactly on it: a face without area closes the gap.
    a, b, c = box.faces[0]
    faces = np.concatenate([box.faces[1:], [[a, 8, c], [8, b, c], [a, b, 8]]])
    points = np.concatenate([box.vertices, [(box.vertices[a] + box.vertices[b]) / 2]])
    report = check(Shape(points, faces))
    assert {f.rule: f.severity for f in report.findings} == {"zero-area slivers": "note"}
    assert report.n_boundary_loops == 0


def test_fold_closes_where_points_are_merged():
    ball = sphere()
    # Pull a corner of a closed mesh onto the one opposite to it: two neighbours now coincide.
    (a, b, c) = ball.faces[0]
    (other,) = [f for f in ball.faces if {a, b} <= set(f) and c not in f]
    (d,) = set(other) - {a, b}
    points = ball.points.copy()
    points[d] = points[c]
    report = check(Shape(points, ball.faces))
    rules = {f.rule: f.count for f in report.findings}
    assert rules["duplicate points"] == 1
    assert rules["folded faces"] == 2
    assert report.n_boundary_loops == 0


def test_two_sided_sheet_keeps_one_side():
    grid = upper_half(trimesh.creation.icosphere(subdivisions=1))
    n = len(grid.vertices)
    points = np.concatenate([grid.vertices, grid.vertices])
    two_sided = Shape(points, np.concatenate([grid.faces, grid.faces[:, ::-1] + n]))
    report = check(two_sided)
    assert report.n_clean_faces == len(grid.faces)
    assert report.n_boundary_loops == 1


@pytest.mark.parametrize(
    ("points", "faces", "rule"),
    [
        (np.zeros((9, 3)), None, "usable points"),
        (np.full((9, 3), np.nan), None, "usable points"),
        (np.eye(3), None, "usable points"),
        (np.eye(3), [[0, 1, 2]], "usable points"),
        (np.arange(9)[:, None] * [1.0, 2, 3] / 7 + 100, None, "points on one line"),
        (np.eye(5, 3) * 1e200, None, "points too close or too far"),
        (np.eye(5, 3) * 1e-200, None, "points too close or too far"),
        (np.eye(5, 3) * 1e50 + 1e62, None, "points too close or too far"),
        (np.eye(4, 3) * 1.7e308 * [1, -1, 1], None, "points too close or too far"),
        (np.eye(5, 3), [[0, 1, 9]], "usable faces"),
        (np.eye(5, 3), np.zeros((0, 3), int), "usable faces"),
        (np.zeros((0, 3)), None, "usable points"),
    ],
)
def test_unusable(points, faces, rule):
    report = check(Shape(points, faces, allow_broken=True))
    assert not report.usable
    assert [f.rule for f in report.findings if f.severity == "unusable"] == [rule]
    json.dumps(report.to_dict(), allow_nan=False)


@pytest.mark.parametrize("factor", [1e-9, 1e9])
def test_unusual_size_is_noted_and_nothing_moves(factor):
    report = check(Shape(sphere().points * factor, sphere().faces))
    assert [f.severity for f in report.findings] == ["note"]
    assert "double precision" in str(report)
    assert report.is_clean
    assert report.area == pytest.approx(check(sphere()).area * factor**2)


def test_far_from_the_origin_is_noted():
    assert found(Shape(sphere().points + 1e5, sphere().faces)) == {"points far from the origin": 162}


def test_report_in_words_and_numbers():
    report = check(with_points(sphere(), [9, 9, 9]))
    assert str(report).splitlines()[1] == "  repaired: 1 unreferenced points: left out, no face uses them"
    values = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert values["n_points"] == 163
    assert values["n_clean_points"] == 162
    assert values["findings"][0]["rule"] == "unreferenced points"
    assert values["usable"] is True


def slow_topology(faces):
    """Components, loops, edges and points with too many faces, by walking around."""
    edges = defaultdict(list)
    for f, face in enumerate(faces):
        for i in range(3):
            edges[frozenset((face[i], face[(i + 1) % 3]))].append(f)

    def pieces(nodes, links):
        label = {node: node for node in nodes}

        def root(node):
            while label[node] != node:
                node = label[node]
            return node

        for a, b in links:
            label[root(a)] = root(b)
        return {node: root(node) for node in nodes}

    points = {p for face in faces for p in face}
    components = pieces(points, [tuple(edge) for edge in edges])
    corners = [(f, p) for f, face in enumerate(faces) for p in face]
    fan = pieces(corners, [((fs[0], p), (f, p)) for edge, fs in edges.items() for p in edge for f in fs[1:]])
    rims = [[fan[fs[0], p] for p in edge] for edge, fs in edges.items() if len(fs) == 1]
    loops = pieces({end for rim in rims for end in rim}, rims)
    crowded = {p for edge, fs in edges.items() if len(fs) > 2 for p in edge}
    fans = Counter(p for _, p in set(fan.values()))
    return (
        len(set(components.values())),
        len(set(loops.values())),
        sum(len(fs) > 2 for fs in edges.values()),
        sum(count > 1 for p, count in fans.items() if p not in crowded),
    )


@settings(derandomize=True, deadline=None, max_examples=200)
@given(st.sets(st.frozensets(st.integers(0, 8), min_size=3, max_size=3), min_size=1, max_size=14), st.randoms())
def test_topology_against_plain_loops(triples, random):
    faces = [random.sample(sorted(triple), 3) for triple in sorted(triples, key=sorted)]
    _, numbered = np.unique(faces, return_inverse=True)
    numbered = numbered.reshape(-1, 3)
    fast = topology(numbered, int(numbered.max()) + 1)
    slow = slow_topology(numbered.tolist())
    assert (
        fast.n_components,
        fast.n_boundary_loops,
        fast.n_nonmanifold_edges,
        fast.n_nonmanifold_points,
    ) == slow


def test_components_of_a_mesh_with_their_areas_and_its_half_edges():
    big, small = trimesh.creation.box(extents=[2, 2, 2]), trimesh.creation.box(extents=[1, 1, 1])
    faces = np.concatenate([small.faces + 8, big.faces])
    points = np.concatenate([big.vertices, small.vertices + 5, [[9.0, 9, 9]]])  # the last is used by no face
    component, areas = mesh_components(points, faces)
    of_big, of_small = component[0], component[8]
    assert (component[:8] == of_big).all() and (component[8:16] == of_small).all() and len(set(component)) == 3
    assert areas[of_big] == pytest.approx(24) and areas[of_small] == pytest.approx(6) and areas[component[16]] == 0
    assert half_edges(np.array([[4, 7, 2], [7, 4, 1]])).tolist() == [[4, 7], [7, 2], [2, 4], [7, 4], [4, 1], [1, 7]]


@pytest.mark.parametrize(("n", "links"), [(30, 20), (30, 1000), (200, 900), (200, 20_000), (5, 0)])
def test_components_are_those_of_a_walk_and_ascend_by_their_first_nodes(n, links):
    """However many links a node has, of which some are taken first."""
    random = np.random.default_rng(links)
    # Nodes of three classes, of which each links to its own alone.
    ends = 3 * random.integers(0, n // 3, (links, 2)) + random.integers(0, 3, (links, 1))
    label = [*range(n)]
    for a, b in ends.tolist():
        old, new = label[a], label[b]
        label = [new if each == old else each for each in label]
    numbers = {}
    expected = [numbers.setdefault(each, len(numbers)) for each in label]
    assert components(ends[:, 0], ends[:, 1], n).tolist() == expected


def test_cross_products_are_those_of_numpy():
    one, other = np.random.default_rng(0).normal(size=(2, 50, 3))
    assert np.array_equal(cross_products(one, other), np.cross(one, other))
