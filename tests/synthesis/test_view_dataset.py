"""A set of views on disk: who is paired with whom, what leads back to whom, and that it can be gone on with."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from homolog.core.errors import ArgumentError, DataError
from homolog.datasets import ShapeFolder
from homolog.shapes import Shape, read_shape, write_shape
from homolog.synthesis import ViewSettings, view, view_dataset, write_view_dataset
from homolog.training.data import TrainingSet
from homolog.training.recipes import read_recipe

SMALL = ViewSettings(pixels=(30, 40))
N_BODIES, N_VIEWS = 6, 15


@pytest.fixture(scope="module")
def source(tmp_path_factory, make):
    """Relabelled and stretched copies of one blob, with ground truth for half of its points."""
    root, blob = tmp_path_factory.mktemp("complete"), make.blob(2)
    (root / "off").mkdir()
    (root / "corres").mkdir()
    for seed in range(N_BODIES):
        order = np.random.default_rng(seed).permutation(blob.n_points)
        copy = make.relabelled(blob, order)
        write_shape(root / "off" / f"body{seed}.off", Shape(copy.points * [1, 1 + seed / 10, 1], copy.faces))
        (root / "corres" / f"body{seed}.vts").write_text("\n".join(map(str, np.argsort(order)[:81] + 1)))
    return root


@pytest.fixture(scope="module")
def written(source, tmp_path_factory):
    place = tmp_path_factory.mktemp("sets") / "views"
    write_view_dataset(source, place, views=N_VIEWS, seed=3, settings=SMALL)
    return place


def contents(place):
    return {str(path.relative_to(place)): path.read_bytes() for path in sorted(place.rglob("*")) if path.is_file()}


def manifest(place):
    return json.loads((place / "manifest.json").read_text())


def truth(place, name):
    with np.load(place / "truth" / f"{name}.npz") as stored:
        return dict(stored)


def test_bodies_of_the_test_are_not_trained_on(written):
    entries = manifest(written)["views"]
    assert [entry["name"] for entry in entries] == [f"view_{number:06d}" for number in range(N_VIEWS)]
    bodies = {"train": set(), "test": set()}
    for entry in entries:
        bodies[entry["split"]] |= {entry["viewed"], entry["full"]}
    assert not bodies["train"] & bodies["test"]
    assert sum(entry["split"] == "test" for entry in entries) == N_VIEWS / 5
    assert {entry["viewed"] for entry in entries if entry["split"] == "train"} == bodies["train"]
    assert any(entry["viewed"] != entry["full"] for entry in entries)
    split = {name: body["split"] for name, body in manifest(written)["making"]["bodies"].items()}
    assert sorted(split.values()) == ["test"] + ["train"] * (N_BODIES - 1)
    assert all(split[entry["viewed"]] == split[entry["full"]] == entry["split"] for entry in entries)
    folder = ShapeFolder.open(written)
    for which in ("train", "test"):
        pairs = [(entry["full"], entry["name"]) for entry in entries if entry["split"] == which]
        assert list(folder.pairs(which)) == pairs
        assert set(folder.split(which)) == bodies[which] | {name for _, name in pairs}


def test_views_lead_back_to_their_own_shape(written):
    for entry in manifest(written)["views"]:
        own = read_shape(written / "off" / f"{entry['viewed']}.off")
        mesh = read_shape(written / "off" / f"{entry['name']}.off")
        cloud = read_shape(written / "clouds" / f"{entry['name']}.ply")
        maps = truth(written, entry["name"])
        assert np.array_equal(mesh.points, own.points[maps["mesh_to_viewed"]])
        corners = own.points[own.faces[maps["cloud_triangles"]]]
        assert cloud.points == pytest.approx(np.einsum("nk,nkd->nd", maps["cloud_weights"], corners), abs=1e-12)
        assert cloud.faces is None and (entry["mesh_points"], entry["cloud_points"]) == (mesh.n_points, cloud.n_points)
        assert 0 < entry["visible_share"] < 1
        again = view(own, SMALL, seed=entry["seed"])
        assert again.visible_share == entry["visible_share"]
        assert entry["camera"]["position"] == list(again.camera.position)


def test_views_lead_to_the_shape_that_they_are_paired_with(written, make):
    """All bodies are copies of one, so that a point's place in that one tells whether the pair's truth is right."""
    orders = {f"body{seed}": np.random.default_rng(seed).permutation(make.blob(2).n_points) for seed in range(N_BODIES)}
    for entry in manifest(written)["views"]:
        maps, own, complete = truth(written, entry["name"]), orders[entry["viewed"]], orders[entry["full"]]
        for kind in ("mesh", "cloud"):
            original = own[maps[f"{kind}_to_viewed"]]
            expected = np.argsort(complete)[original]
            if entry["viewed"] != entry["full"]:
                expected = np.where(original < 81, expected, -1)
            assert maps[f"{kind}_to_full"].tolist() == expected.tolist()


def test_template_points_of_views(written):
    folder = ShapeFolder.open(written)
    for entry in manifest(written)["views"]:
        own, seen = folder.template_correspondence(entry["viewed"]), folder.template_correspondence(entry["name"])
        index = truth(written, entry["name"])["mesh_to_viewed"]
        assert np.array_equal(index[seen[seen >= 0]], own[seen >= 0])
        assert not np.isin(own[seen < 0], index).any()
        assert (seen >= 0).any() and (seen < 0).any()


def test_a_training_takes_the_set_as_it_is(written):
    recipe = read_recipe("views")
    found = TrainingSet.open(written, replace(recipe, validation=replace(recipe.validation, shapes=0)))
    entries = [entry for entry in manifest(written)["views"] if entry["split"] == "train"]
    assert found.pairs == tuple((entry["full"], entry["name"]) for entry in entries)


@pytest.mark.process
def test_the_same_seed_gives_the_same_bytes_in_several_processes(source, written, tmp_path):
    write_view_dataset(source, tmp_path / "again", views=N_VIEWS, seed=3, settings=SMALL, processes=2)
    assert contents(tmp_path / "again") == contents(written)


def test_a_smaller_set_is_the_beginning_of_a_larger_one(source, written, tmp_path):
    told = []
    write_view_dataset(source, tmp_path, views=5, seed=3, settings=SMALL, progress=lambda *state: told.append(state))
    larger = contents(written)
    lists = ("manifest.json", "pairs.txt", "train.txt", "test.txt")
    assert all(larger[name] == content for name, content in contents(tmp_path).items() if name not in lists)
    assert told[0][:1] == (0,) and told[-1][0] == told[-1][1] == len(told) - 1
    write_view_dataset(source, tmp_path, views=N_VIEWS, seed=3, settings=SMALL)
    assert contents(tmp_path) == larger


def test_what_was_interrupted_is_gone_on_with(source, written, tmp_path, monkeypatch):
    looked, place = [], tmp_path / "views"

    def look(*arguments, **options):
        looked.append(options["seed"])
        if len(looked) == 7:
            raise KeyboardInterrupt
        return view(*arguments, **options)

    monkeypatch.setattr(view_dataset, "view", look)
    with pytest.raises(KeyboardInterrupt):
        write_view_dataset(source, place, views=N_VIEWS, seed=3, settings=SMALL)
    assert manifest(place)["views"] == []
    assert not [name for name in contents(place) if Path(name).name.startswith(".")]
    write_view_dataset(source, place, views=N_VIEWS, seed=3, settings=SMALL)
    assert contents(place) == contents(written)
    assert len(looked) == N_VIEWS + 1


@pytest.mark.parametrize("folder", ["off", "clouds", "truth", "corres"])
@pytest.mark.parametrize("lost", [True, False])
def test_what_is_lost_or_empty_is_made_again(source, written, tmp_path, folder, lost):
    place = shutil.copytree(written, tmp_path / "views")
    for file in (place / folder).iterdir():
        file.unlink()
        if not lost:
            file.touch()
    write_view_dataset(source, place, views=N_VIEWS, seed=3, settings=SMALL)
    assert contents(place) == contents(written)


def test_another_seed_gives_other_views(source, written, tmp_path):
    write_view_dataset(source, tmp_path, views=5, seed=4, settings=SMALL)
    assert manifest(tmp_path)["views"][0]["camera"] != manifest(written)["views"][0]["camera"]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"seed": 4}, "seed 3, not 4"),
        ({"settings": ViewSettings(pixels=(31, 40))}, r"\(pixels \[30, 40\], not \[31, 40\]\)"),
    ],
)
def test_a_folder_holds_one_set(source, written, change, told):
    before = contents(written)
    with pytest.raises(ArgumentError, match=told):
        write_view_dataset(source, written, **{"views": 5, "seed": 3, "settings": SMALL, **change})
    assert contents(written) == before


@pytest.mark.parametrize("content", ["", "[]", "no JSON", "{}"])
def test_a_manifest_of_something_else(source, tmp_path, content):
    (tmp_path / "manifest.json").write_text(content)
    with pytest.raises(ArgumentError, match="give another folder"):
        write_view_dataset(source, tmp_path, views=5, seed=0)
    assert contents(tmp_path) == {"manifest.json": content.encode()}


def test_a_folder_with_other_things_is_left_alone(source):
    before = contents(source)
    with pytest.raises(ArgumentError, match="holds other things; give another folder"):
        write_view_dataset(source, source, views=5, seed=0)
    assert contents(source) == before


def test_a_set_that_has_its_own_split_keeps_it(source, tmp_path):
    for name, content in contents(source).items():
        (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "in" / name).write_bytes(content)
    (tmp_path / "in" / "train.txt").write_text("body1\nbody4\n")
    (tmp_path / "in" / "test.txt").write_text("body0\nbody5\n")
    write_view_dataset(tmp_path / "in", tmp_path / "out", views=10, seed=0, settings=SMALL)
    for entry in manifest(tmp_path / "out")["views"]:
        assert {entry["viewed"], entry["full"]} <= set(
            {"train": ("body1", "body4"), "test": ("body0", "body5")}[entry["split"]]
        )
    assert not (tmp_path / "out" / "off" / "body2.off").exists()
    (tmp_path / "in" / "test.txt").write_text("body4\n")
    with pytest.raises(DataError, match=r"'body4' is in train\.txt and in test\.txt"):
        write_view_dataset(tmp_path / "in", tmp_path / "other", views=5, seed=0)


def test_meshes_without_ground_truth_and_in_need_of_repair(make, tmp_path):
    """Only the way back to a view's own shape is known then, and it leads to the repaired shape that is written."""
    (tmp_path / "in").mkdir()
    sphere = make.sphere(2)
    for name in ("a", "b", "c"):
        write_shape(
            tmp_path / "in" / f"{name}.ply", Shape(np.concatenate([[[9, 9, 9]], sphere.points]), sphere.faces + 1)
        )
    write_view_dataset(tmp_path / "in", tmp_path / "out", views=8, seed=1, settings=SMALL)
    assert not (tmp_path / "out" / "corres").exists()
    for entry in manifest(tmp_path / "out")["views"]:
        maps = truth(tmp_path / "out", entry["name"])
        assert ("mesh_to_full" in maps) == (entry["viewed"] == entry["full"])
        own = read_shape(tmp_path / "out" / "off" / f"{entry['viewed']}.off")
        assert own.n_points == sphere.n_points
        mesh = read_shape(tmp_path / "out" / "off" / f"{entry['name']}.off")
        assert np.array_equal(mesh.points, own.points[maps["mesh_to_viewed"]])


def test_sources_that_make_no_set(make, tmp_path):
    with pytest.raises(DataError, match="no such folder"):
        write_view_dataset(tmp_path / "nowhere", tmp_path / "out", views=5, seed=0)
    write_shape(tmp_path / "one.off", make.sphere(1))
    with pytest.raises(DataError, match="it takes 2"):
        write_view_dataset(tmp_path, tmp_path / "out", views=5, seed=0)
    for name in ("two words", "two,words", "view_000001"):
        write_shape(tmp_path / f"{name}.off", make.sphere(1))
        with pytest.raises(DataError, match="rename the file"):
            write_view_dataset(tmp_path, tmp_path / "out", views=5, seed=0)
        (tmp_path / f"{name}.off").unlink()
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("wrong", [{"views": 4}, {"views": 10**7}, {"seed": -1}, {"processes": 0}])
def test_numbers_that_cannot_be(source, tmp_path, wrong):
    with pytest.raises(ArgumentError, match=next(iter(wrong))):
        write_view_dataset(source, tmp_path / "out", **{"views": 5, "seed": 0, **wrong})
    assert not (tmp_path / "out").exists()


def test_ground_truth_beyond_the_shape(make, tmp_path):
    (tmp_path / "in" / "off").mkdir(parents=True)
    (tmp_path / "in" / "corres").mkdir()
    for name in ("a", "b"):
        write_shape(tmp_path / "in" / "off" / f"{name}.off", make.sphere(1))
        (tmp_path / "in" / "corres" / f"{name}.vts").write_text("43\n")
    with pytest.raises(DataError, match="names vertex 43"):
        write_view_dataset(tmp_path / "in", tmp_path / "out", views=5, seed=0)
