"""Masks of a collection: what is corrupted where a mask leaves it out changes nothing elsewhere."""

import csv
import json
import shutil

import numpy as np
import pytest
from without_weights import axiomatic

from homolog.core.errors import ArgumentError
from homolog.pairs import Mask, read_mask
from homolog.shape_models import (
    ModelFitSettings,
    ModelSettings,
    RegisteredShapes,
    ShapeModelFolder,
    ShapeModelSettings,
    StoredModel,
    build,
    complete,
    register_all,
    settings_record,
    subjects_of,
)
from homolog.shapes import Shape, read_hashed_shape, read_shape, write_shape

pytest.importorskip("h5py")
pytest.importorskip("matplotlib")
pytest.importorskip("PIL.Image")


@pytest.fixture(scope="module")
def damaged(tmp_path_factory, make):
    """Three stretched copies, clean and with a damaged cap; masks of that cap on the template and on each copy."""
    root, blob = tmp_path_factory.mktemp("damaged"), make.blob(2)
    kept = blob.points[:, 1] < 0.7
    write_shape(root / "template.off", blob)
    np.save(root / "kept.npy", kept)
    for number, stretch in enumerate((0.9, 1.05, 1.2)):
        random = np.random.default_rng(number)
        order = random.permutation(blob.n_points)
        clean = blob.points * [1, stretch, 1] + number
        bad = np.where(kept[:, None], clean, clean + [0, 1.5, 0] + 0.2 * random.standard_normal(clean.shape))
        for kind, points in (("clean", clean), ("bad", bad)):
            (root / kind).mkdir(exist_ok=True)
            write_shape(root / kind / f"{number}.ply", make.relabelled(Shape(points, blob.faces), order))
        (root / "masks").mkdir(exist_ok=True)
        (root / "masks" / f"{number}.txt").write_text("\n".join(str(int(each)) for each in kept[order]))
    return root, kept


def files_of(root, kind):
    return [root / kind / f"{number}.ply" for number in range(3)]


def registered(damaged, kind, place, *, masks=True):
    """The registered shapes, as statistics see them."""
    root, kept = damaged
    base, digest = read_hashed_shape(root / "template.off")
    settings = ShapeModelSettings(template_mask=root / "kept.npy" if masks else None)
    folder = ShapeModelFolder.prepare(place, settings_record(digest, axiomatic(), settings))
    subjects = subjects_of(files_of(root, kind), root / "masks" if masks else None)
    outcomes = register_all(base, subjects, folder, axiomatic, settings)
    return RegisteredShapes(folder, base, outcomes, ModelSettings(), kept.astype(float) if masks else None)


@pytest.fixture(scope="module")
def collected(damaged, tmp_path_factory):
    """The collection of the damaged shapes, with masks."""
    root, _ = damaged
    settings = ShapeModelSettings(template_mask=root / "kept.npy")
    place = tmp_path_factory.mktemp("collected") / "bad"
    files = files_of(root, "bad")
    build(root / "template.off", files, place, axiomatic(), settings=settings, masks=root / "masks")
    return place


def test_the_rest_is_as_without_the_damage(damaged, collected, tmp_path):
    _, kept = damaged
    clean = registered(damaged, "clean", tmp_path / "clean")
    np.testing.assert_array_equal(np.load(collected / "points.npy")[:, kept], clean.points[:, kept])
    stored = StoredModel.read(collected).model
    np.testing.assert_allclose(stored.modes[:, kept], clean.model.modes[:, kept], atol=1e-12)
    np.testing.assert_allclose(stored.mean[kept], clean.model.mean[kept], atol=1e-12)
    without = registered(damaged, "bad", tmp_path / "without", masks=False)
    assert np.abs(without.points[:, kept] - clean.points[:, kept]).max() > 0.01


def test_points_that_are_left_out_follow_the_others_and_are_marked(damaged, collected):
    root, kept = damaged
    folder, blob = collected, read_shape(root / "template.off")
    for number, stretch in enumerate((0.9, 1.05, 1.2)):
        file = folder / "shapes" / f"{number}.ply"
        np.testing.assert_array_equal(read_mask(file).weights, kept)
        away = np.linalg.norm(read_shape(file).points - (blob.points * [1, stretch, 1] + number), axis=1)
        assert away[~kept].mean() < 0.3  # the damage is 1.5 away
    report = json.loads((folder / "report.json").read_text())
    assert report["template"]["points_left_out"] == (~kept).sum() and set(report["masks"]) == {"0", "1", "2"}
    with (folder / "quality.csv").open() as file:
        assert all(float(row["edges_95"]) < 3 for row in csv.DictReader(file))


def test_a_stored_model_knows_what_takes_part(damaged, collected):
    _, kept = damaged
    stored = StoredModel.read(collected)
    np.testing.assert_array_equal(stored.kept, kept)
    lengths = (stored.model.modes[:, kept] ** 2).sum(axis=(1, 2))
    np.testing.assert_allclose(lengths, 1)
    aligned = stored.aligned()
    np.testing.assert_allclose(aligned[:, kept].mean(axis=1), 0, atol=1e-9)
    np.testing.assert_allclose(stored.model.shapes(stored.model.coefficients(aligned)), aligned, atol=1e-6)


def test_a_fragment_is_completed_by_what_takes_part(damaged, collected):
    """Whatever lies where the model was not made of anything is passed over, though it is part of the fragment."""
    _, kept = damaged
    stored = StoredModel.read(collected)
    whole, faces = stored.aligned()[1], stored.mean.faces
    settings = ModelFitSettings(samples=150)
    found = [
        complete(Shape(points, faces), stored, orient="given", settings=settings).shape.points
        for points in (whole, np.where(kept[:, None], whole, whole + np.array([0, 0.6, 0])))
    ]
    away = [np.linalg.norm(points - whole, axis=1)[kept].mean() for points in found]
    assert max(away) < 0.005


@pytest.mark.long
def test_a_fragment_is_matched_with_what_takes_part(damaged, collected):
    """No point of it has a counterpart where the model was not made of anything, and the other way round."""
    _, kept = damaged
    stored = StoredModel.read(collected)
    found = complete(stored.mean, stored, axiomatic(), settings=ModelFitSettings(samples=100))
    assert found.match is not None and (found.match.target_to_source[~kept] == -1).all()
    reached = found.match.source_to_target[found.match.source_to_target >= 0]
    assert len(reached) > 100 and kept[reached].all()


def test_only_shapes_whose_masks_changed_are_done_anew(damaged, collected, tmp_path):
    root, _ = damaged
    shutil.copytree(collected, tmp_path / "out")
    shutil.copytree(root / "masks", tmp_path / "masks")
    base, digest = read_hashed_shape(root / "template.off")
    settings = ShapeModelSettings(template_mask=root / "kept.npy")
    folder = ShapeModelFolder.prepare(tmp_path / "out", settings_record(digest, axiomatic(), settings))

    def done_anew():
        done = []
        subjects = subjects_of(files_of(root, "bad"), tmp_path / "masks")
        listener = lambda outcome: done.append(outcome.subject.name)  # noqa: E731
        register_all(base, subjects, folder, axiomatic, settings, listener=listener)
        return done

    assert done_anew() == []
    (tmp_path / "masks" / "1.txt").write_text("1\n" * 162)
    assert done_anew() == ["1"]
    with pytest.raises(ArgumentError, match=r"made in another way \(template\)"):
        ShapeModelFolder.prepare(tmp_path / "out", settings_record(digest, axiomatic(), ShapeModelSettings()))


def test_masks_that_fit_nothing_are_refused_or_fail_their_shape_alone(damaged, tmp_path):
    root, _ = damaged
    (tmp_path / "masks").mkdir()
    with pytest.raises(ArgumentError, match=r"has no mask of any of the shapes; name each .*, such as 0\.npy"):
        subjects_of([root / "bad" / "0.ply"], tmp_path / "masks")
    (tmp_path / "masks" / "0.txt").write_text("1\n0\n")
    (found,) = subjects_of([root / "bad" / "0.ply"], tmp_path / "masks")
    with pytest.raises(ArgumentError, match=r"0\.txt has 2 numbers, but 0\.ply has 162 points"):
        found.surface()
    (tmp_path / "masks" / "0.csv").write_text("1\n0\n")
    with pytest.raises(ArgumentError, match="are both masks of '0'; remove one"):
        subjects_of([root / "bad" / "0.ply"], tmp_path / "masks")
    with pytest.raises(ArgumentError, match="is no folder"):
        subjects_of([root / "bad" / "0.ply"], tmp_path / "masks" / "0.csv")
    options = {"settings": ShapeModelSettings(template_mask=Mask([1.0, 0.0]))}
    with pytest.raises(ArgumentError, match=r"has 2 numbers, but template.off has 162 points"):
        build(root / "template.off", [root / "bad" / "0.ply"], tmp_path / "out", axiomatic(), **options)
