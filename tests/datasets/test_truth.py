"""Ground truth of each kind, against what the made-up sets were made from, and what can be wrong with it."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from homolog.core.errors import DataError
from homolog.datasets import DatasetDescription, ShapeFolder, read_description
from homolog.datasets import truth as truth_module
from homolog.datasets.truth import read_vertices
from homolog.shapes import Shape, read_shape, write_shape


def message(call):
    with pytest.raises(DataError) as caught:
        call()
    assert "\n" not in str(caught.value)
    return str(caught.value)


# ---- places in triangles


def test_parts_lie_at_the_nearest_corner_of_their_triangle(parts_set):
    root, known = parts_set
    folder = ShapeFolder.open(root, "shrec16_cuts")
    assert folder.names == tuple(sorted(known)) and folder.full == ("cat", "dog")
    assert set(folder.pairs("test")) == {(partner, name) for name, (partner, *_) in known.items()}
    for name, (partner, triangles, weights) in known.items():
        found = folder.ground_truth().between(partner, name)
        faces = read_shape(root / "null" / f"{partner}.off").faces
        expected = [faces[t][np.argmax(w)] for t, w in zip(triangles, weights, strict=True)]
        assert found.source.tolist() == expected
        assert found.target.tolist() == list(range(len(triangles)))


def test_counterparts_are_within_a_mean_edge(parts_set):
    root, known = parts_set
    folder = ShapeFolder.open(root, "shrec16_cuts")
    for name, (partner, triangles, weights) in known.items():
        whole = read_shape(root / "null" / f"{partner}.off")
        edges = [np.linalg.norm(whole.points[f[i]] - whole.points[f[i - 1]]) for f in whole.faces for i in range(3)]
        places = [w @ whole.points[whole.faces[t]] for t, w in zip(triangles, weights, strict=True)]
        expected = [min(np.linalg.norm(point - place) for place in places) <= np.mean(edges) for point in whole.points]
        found = folder.ground_truth().counterparts(partner, name)
        assert found.points.tolist() == list(range(whole.n_points))
        assert found.present.tolist() == expected
        assert 0 < sum(expected) < len(expected)


def test_truth_does_not_change_when_shapes_are_stood_upright(parts_set):
    root, _ = parts_set
    lying, standing = (ShapeFolder.open(root, "shrec16_cuts", up=up) for up in ("z", "y"))
    pair = "dog", "cuts_dog_2"
    np.testing.assert_array_equal(
        lying.ground_truth().between(*pair).source, standing.ground_truth().between(*pair).source
    )
    np.testing.assert_array_equal(*(one.ground_truth().counterparts(*pair).present for one in (lying, standing)))
    assert not np.allclose(lying.shape("dog").points, standing.shape("dog").points)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda rows: rows[:-1], "has 39 lines, but cuts_dog_2 has 40 points"),
        (lambda rows: ["321 1 0 0", *rows[1:]], "names triangle 321, but dog.off has 320"),
        (lambda rows: ["0 1 0 0", *rows[1:]], "triangles counted from 1"),
        (lambda rows: ["1.5 1 0 0", *rows[1:]], "triangles counted from 1"),
        (lambda rows: ["1 1 0.5 0", *rows[1:]], "the weights not negative and of sum one"),
        (lambda rows: ["1 1.5 -0.5 0", *rows[1:]], "the weights not negative and of sum one"),
        (lambda rows: ["1 nan 0 0", *rows[1:]], "must hold a triangle and three weights a line"),
        (lambda rows: [row.rsplit(" ", 1)[0] for row in rows], "must hold a triangle and three weights a line"),
        (lambda rows: ["one", *rows[1:]], "must hold a triangle and three weights a line"),
        (lambda rows: [], "must hold a triangle and three weights a line"),
    ],
)
def test_places_that_do_not_fit_are_one_line(parts_set, change, said):
    root, _ = parts_set
    path = root / "cuts" / "cuts_dog_2.baryc_gt"
    path.write_text("\n".join(change(path.read_text().splitlines())))
    found = message(lambda: ShapeFolder.open(root, "shrec16_cuts").ground_truth().between("dog", "cuts_dog_2"))
    assert said in found and str(path) in found


def test_parts_without_truth_or_partner(parts_set):
    root, _ = parts_set
    (root / "cuts" / "cuts_dog_2.baryc_gt").rename(root / "kept")
    found = message(lambda: ShapeFolder.open(root, "shrec16_cuts"))
    assert "1 of 3 shapes have no ground truth" in found and str(root / "cuts" / "cuts_dog_2.baryc_gt") in found
    (root / "kept").rename(root / "cuts" / "cuts_dog_2.baryc_gt")
    (root / "null" / "dog.off").rename(root / "null" / "horse.off")
    assert "cuts_dog_2: no full shape" in message(lambda: ShapeFolder.open(root, "shrec16_cuts").pairs("test"))
    (root / "null" / "cuts_dog_2.off").touch()
    assert "'cuts_dog_2' names a full shape and a partial one" in message(
        lambda: ShapeFolder.open(root, "shrec16_cuts")
    )


def test_a_set_of_parts_without_complete_shapes(parts_set):
    root, _ = parts_set
    for file in (root / "null").iterdir():
        file.unlink()
    assert f"put them at {root / 'null' / 'NAME.off'}" in message(lambda: ShapeFolder.open(root, "shrec16_cuts"))


# ---- the same numbering


def rows_by_place(folder, clouds, name):
    """Which row of its file each point of a cloud is, by where it lies."""
    points = ShapeFolder.open(folder.root, replace(folder.description, shuffled=False)).shape(name).points
    found = folder.shape(name).points
    return [int(np.argmin(np.linalg.norm(points - point, axis=1))) for point in found]


def test_rows_are_shuffled_by_seed_and_file_and_the_truth_with_them(clouds_set):
    root, clouds = clouds_set
    orders = {}
    for seed in (0, 1):
        folder = replace(ShapeFolder.open(root, "lungs"), seed=seed)
        for name in clouds:
            orders[name, seed] = rows_by_place(folder, clouds, name)
            assert sorted(orders[name, seed]) == list(range(50))
        for source, target in itertools.product(clouds, repeat=2):
            truth = folder.ground_truth().between(source, target)
            rows = [
                (orders[target, seed][t], orders[source, seed][s])
                for t, s in zip(truth.target, truth.source, strict=True)
            ]
            assert sorted(rows) == [(row, row) for row in range(50)]
    for one, other in itertools.combinations(orders.values(), 2):
        assert sum(a == b for a, b in zip(one, other, strict=True)) < 10


def test_the_same_seed_shuffles_alike(clouds_set):
    root, _ = clouds_set
    first, second = (ShapeFolder.open(root, "lungs").shape("B").points for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_meshes_with_the_same_numbering_may_be_shuffled(tmp_path, make):
    """Faces follow their points."""
    blob = make.blob(2)
    (tmp_path / "off").mkdir()
    write_shape(tmp_path / "off" / "a.off", blob)
    described = DatasetDescription(truth="same-numbering", shuffled=True)
    found = ShapeFolder.open(tmp_path, described).shape("a")
    assert not np.allclose(found.points, blob.points)
    np.testing.assert_allclose(found.points[found.faces], blob.points[blob.faces], atol=1e-6)


def test_numbers_of_rows_that_differ(clouds_set):
    root, _ = clouds_set
    with (root / "landmarksC.csv").open("a") as file:
        file.write("1,2,3\n")
    truth = ShapeFolder.open(root, "lungs").ground_truth()
    assert "A has 50 points and C 51; row i must be the same point" in message(lambda: truth.between("A", "C"))
    with (root / "landmarksB.csv").open("a") as file:
        file.write("nan,2,3\n")
    assert "landmarksB.csv has points that are NaN" in message(lambda: truth.between("A", "B"))


# ---- a map for each pair


@pytest.fixture
def maps_set(tmp_path, make):
    """Three relabelled copies of a blob, one of them larger, and a map from a to b and from c_1 to a."""
    root, rng, blob = tmp_path / "maps", np.random.default_rng(3), make.blob(2)
    (root / "off").mkdir(parents=True)
    (root / "corres").mkdir()
    orders = {}
    for name in ("a", "b", "c_1"):
        orders[name] = rng.permutation(blob.n_points)
        write_shape(root / "off" / f"{name}.off", make.relabelled(blob, orders[name]))
    for source, target in (("a", "b"), ("c_1", "a")):
        places = np.argsort(orders[target])[orders[source]]
        (root / "corres" / f"{source}_{target}.map").write_text("".join(f"{place + 1}\n" for place in places))
    return root, orders


def test_maps_say_where_each_point_of_the_source_is(maps_set):
    root, orders = maps_set
    folder = ShapeFolder.open(root, "shrec19_maps")
    assert folder.pairs("test") == (("a", "b"), ("c_1", "a"))
    for source, target in folder.pairs("test"):
        truth = folder.ground_truth().between(source, target)
        np.testing.assert_array_equal(orders[source][truth.source], orders[target][truth.target])
        assert sorted(truth.source) == list(range(162))
    assert folder.ground_truth().counterparts("a", "b") is None


def test_maps_with_gaps_and_maps_that_do_not_fit(maps_set):
    root, _ = maps_set
    path = root / "corres" / "a_b.map"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(["-1", *lines[1:]]))
    truth = ShapeFolder.open(root, "shrec19_maps").ground_truth()
    assert truth.between("a", "b").source.tolist() == list(range(1, 162))
    path.write_text("\n".join(lines[1:]))
    assert "a_b.map has 161 lines, but a has 162 points" in message(lambda: truth.between("a", "b"))
    path.write_text("\n".join(["163", *lines[1:]]))
    assert "a_b.map names vertex 163, but the shape has 162" in message(lambda: truth.between("a", "b"))
    assert "b_a.map must hold a vertex number a line" in message(lambda: truth.between("b", "a"))


def test_pairs_of_a_shape_that_is_left_out(maps_set):
    root, _ = maps_set
    described = replace(read_description("shrec19_maps"), left_out=("c_1",), name="", names=())
    folder = ShapeFolder.open(root, described)
    assert folder.pairs("test") == (("a", "b"),)
    assert folder.pairs("all") == (("a", "b"), ("c_1", "a"))
    assert ShapeFolder.open(root, replace(described, split="either")).pairs("train") == (("a", "b"), ("c_1", "a"))


# ---- template correspondence


def test_template_points_that_either_lacks_are_not_asked_for(tmp_path, make):
    (tmp_path / "off").mkdir()
    (tmp_path / "corres").mkdir()
    for name, lines in (("a", "5 6 -1 8 9"), ("b", "1 -1 3 4 2")):
        write_shape(tmp_path / "off" / f"{name}.off", make.sphere(1))
        (tmp_path / "corres" / f"{name}.vts").write_text(lines.replace(" ", "\n"))
    truth = ShapeFolder.open(tmp_path).ground_truth()
    found = truth.between("a", "b")
    assert (found.source.tolist(), found.target.tolist()) == ([4, 7, 8], [0, 3, 1])
    known = truth.counterparts("a", "b")
    assert (known.points.tolist(), known.present.tolist()) == ([4, 5, 7, 8], [True, False, True, True])


def test_files_of_truth_are_read_once(tmp_path, make, monkeypatch):
    (tmp_path / "off").mkdir()
    (tmp_path / "corres").mkdir()
    for name in "ab":
        write_shape(tmp_path / "off" / f"{name}.off", make.sphere(1))
        (tmp_path / "corres" / f"{name}.vts").write_text("5\n6\n")
    read = []
    monkeypatch.setattr(truth_module, "read_vertices", lambda path: read.append(path.name) or read_vertices(path))
    truth = ShapeFolder.open(tmp_path).ground_truth()
    for pair in itertools.product("ab", repeat=2):
        truth.between(*pair)
    assert sorted(read) == ["a.vts", "b.vts"]


# ---- classes, none


def test_pairs_within_classes_alone(tmp_path):
    for name in ("cat0", "cat10", "cat3", "wolf_1", "wolf_2"):
        for place in (tmp_path / "off" / f"{name}.off", tmp_path / "corres" / f"{name}.vts"):
            place.parent.mkdir(exist_ok=True)
            place.touch()
    pairs = ShapeFolder.open(tmp_path, "tosca").pairs("test")
    cats, wolves = ("cat0", "cat10", "cat3"), ("wolf_1", "wolf_2")
    assert set(pairs) == {*itertools.product(cats, repeat=2), *itertools.product(wolves, repeat=2)}


def test_no_truth_is_no_score(tmp_path, make):
    (tmp_path / "off").mkdir()
    write_shape(tmp_path / "off" / "a.off", Shape(make.sphere(1).points))
    truth = ShapeFolder.open(tmp_path, DatasetDescription(truth="none")).ground_truth()
    assert "this dataset has no ground truth" in message(lambda: truth.between("a", "a"))
