"""Placing a template's points on many shapes: where they come to lie, what is kept, what fails, what is noticed."""

import os
import shutil

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from homolog.core.errors import ArgumentError, DataError, ShapeError
from homolog.geometry import CLUTTER_RULES
from homolog.matching import Matcher
from homolog.pairs import PROXY_RULES, ChoiceSettings, MatcherSettings
from homolog.shape_models import (
    Figures,
    ShapeModelFolder,
    ShapeModelSettings,
    Template,
    check_template,
    register_all,
    settings_record,
    subjects_of,
)
from homolog.shape_models import batch as batch_module
from homolog.shape_models import registration as registration_module
from homolog.shapes import Shape, read_shape, write_shape
from homolog.transfer import SurfaceMap, SurfaceProjector


def state(place):
    return {str(path.relative_to(place)): path.stat().st_mtime_ns for path in place.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def module_place(tmp_path_factory):
    return tmp_path_factory.mktemp("collections")


def on_triangles(points, triangles):
    """Which points lie on any of some triangles, by trying all."""
    a, sides = triangles[:, 0], (triangles[:, 1:] - triangles[:, :1]).transpose(0, 2, 1)
    weights = np.einsum("mij,nmj->nmi", np.linalg.pinv(sides), points[:, None] - a)
    away = np.linalg.norm(np.einsum("mji,nmi->nmj", sides, weights) + a - points[:, None], axis=2)
    inside = (weights > -1e-9).all(axis=2) & (weights.sum(axis=2) < 1 + 1e-9)
    return (inside & (away < 1e-9)).any(axis=1)


def test_points_lie_where_they_belong_and_on_the_surface(family, gathered, tmp_path):
    template, files, true = family
    folder, outcomes = gathered(template, files, tmp_path / "out")
    assert [outcome.subject.name for outcome in outcomes] == [file.stem for file in files]
    assert all(outcome.figures is not None and not outcome.error for outcome in outcomes)
    placed, spacing = folder.points([file.stem for file in files], 162), 0.2
    away = np.linalg.norm(placed - true, axis=2)
    assert away.mean() < 0.5 * spacing
    faces = read_shape(template).faces
    for file, points in zip(files, placed, strict=True):
        written = read_shape(folder.shape_file(file.stem))
        np.testing.assert_array_equal(written.faces, faces)
        subject = read_shape(file)
        mesh = trimesh.Trimesh(subject.points, subject.faces, process=False)
        assert on_triangles(points, subject.points[subject.faces]).all()
        # Placed on triangles, not put to their corners.
        to_vertices = np.linalg.norm(points[:, None] - subject.points, axis=2).min(axis=1)
        assert np.median(to_vertices) > 1e-4
        assert trimesh.Trimesh(points, faces, process=False).volume == pytest.approx(mesh.volume, rel=0.03)


def test_the_misfit_of_a_map_has_the_weights_of_the_settings(family):
    """By hand: with those of the cycle error and of flipped triangles at 0, the logarithm of the Dirichlet energy."""
    template = read_shape(family[0])
    stretched = Shape(template.points * [1, 1.5, 0.7], template.faces, name="stretched.ply")
    settings = MatcherSettings(method="registration", choice=ChoiceSettings(cycle=0, flipped=0))
    found = Template(template, Matcher(settings=settings)).registered_to(stretched)
    assert found.figures.cycle_error > 0.001
    assert found.figures.map_misfit == pytest.approx(np.log(found.figures.dirichlet_energy), abs=1e-9)


@pytest.mark.slow
def test_clutter_and_proxies_are_as_the_settings_say(family, gathered, make, tmp_path):
    """What is beside a shape is set apart, or kept; a surface around a mesh is matched in its place, or never."""
    template, files, _ = family
    floor = make.grid(12, width=8.0)
    floor = Shape(np.roll(floor.points, 1, axis=1) - [3, 3.5, 3], floor.faces)
    write_shape(tmp_path / "beside.ply", make.joined([read_shape(files[0]), floor]))
    for settings, rules in (
        (ShapeModelSettings(proxy="never"), {"source": set(), "target": {"clutter"}}),
        (ShapeModelSettings(clutter="keep", proxy="never"), {"source": set(), "target": set()}),
        (ShapeModelSettings(proxy="always"), {"source": {"proxy"}, "target": {"clutter", "proxy"}}),
    ):
        place = tmp_path / f"{settings.clutter} {settings.proxy}"
        folder, outcomes = gathered(template, [tmp_path / "beside.ply"], place, settings)
        assert not outcomes[0].error
        report = folder.match("beside").report
        assert (report["options"]["clutter"], report["options"]["proxy"]) == (settings.clutter, settings.proxy)
        kinds = {"clutter": CLUTTER_RULES, "proxy": PROXY_RULES}
        for side, expected in rules.items():
            told = {finding["rule"] for finding in report["inputs"][side]["findings"]}
            assert {kind for kind, names in kinds.items() if told & {*names}} == expected, (side, told)


def test_figures_of_good_matches(family, gathered, tmp_path):
    template, files, _ = family
    _, outcomes = gathered(template, [template, *files], tmp_path / "out")
    own, *others = (outcome.figures for outcome in outcomes)
    assert own.confidence > 0.99 and own.flipped_triangles == 0
    assert own.edges_5 == pytest.approx(1, abs=1e-3) and own.edges_95 == pytest.approx(1, abs=1e-3)
    for figures in others:
        assert 0.5 < figures.confidence <= 1 and 0.9 < figures.coverage <= 1
        assert figures.flipped_triangles < 0.02
        assert 0.5 < figures.edges_5 < 1 < figures.edges_95 < 1.6


def test_it_goes_on_where_it_was_stopped(family, gathered, tmp_path, monkeypatch):
    template, files, _ = family
    told, whole = [], gathered(template, files, tmp_path / "whole")[0]
    before = contents(whole)
    place = tmp_path / "out"

    class Stopped(BaseException):
        pass

    def stop(outcome):
        told.append(outcome.subject.name)
        if len(told) == 2:
            raise Stopped

    with pytest.raises(Stopped):
        gathered(template, files, place, listener=stop)
    assert len(list((place / "shapes").iterdir())) == 2
    kept = state(place)
    progress = []
    folder, outcomes = gathered(
        template,
        files,
        place,
        listener=lambda o: told.append(o.subject.name),
        progress=lambda *told: progress.append(told),
    )
    assert told == [file.stem for file in files]  # each once
    assert progress[0][:2] == (2, 3) and progress[-1][:2] == (3, 3)
    assert {name: time for name, time in state(place).items() if name in kept} == kept
    assert contents(folder) == before
    assert all(outcome.figures is not None for outcome in outcomes)


def contents(folder):
    return {path.name: path.read_bytes() for path in (folder.root / "shapes").iterdir()}


@pytest.mark.process
def test_several_processes_give_the_same(family, gathered, tmp_path):
    template, files, _ = family
    alone, _ = gathered(template, files[:2], tmp_path / "alone")
    told = []
    shared, outcomes = gathered(
        template, files[:2], tmp_path / "shared", processes=2, listener=lambda o: told.append(o.subject.name)
    )
    names = [file.stem for file in files[:2]]
    assert told == names and [outcome.subject.name for outcome in outcomes] == names
    np.testing.assert_allclose(shared.points(names, 162), alone.points(names, 162), atol=1e-6)


def test_a_bad_shape_is_told_and_the_others_are_placed(family, gathered, tmp_path):
    template, files, _ = family
    bad = tmp_path / "bad.ply"
    bad.write_text("ply\nformat ascii 1.0\nelement vertex 3\nend_header\n")
    told = []
    folder, outcomes = gathered(template, [bad, files[0]], tmp_path / "out", listener=told.append)
    assert outcomes == told
    assert outcomes[0].figures is None and str(bad) in outcomes[0].error and "\n" not in outcomes[0].error
    assert outcomes[1].figures is not None
    assert [path.name for path in (folder.root / "shapes").iterdir()] == ["copy0.ply"]
    # It is tried again, and counts once it is mended.
    shutil.copy(files[1], bad)
    again = []
    _, outcomes = gathered(template, [bad, files[0]], tmp_path / "out", listener=again.append)
    assert [outcome.subject.name for outcome in again] == ["bad"]
    assert outcomes[0].figures is not None


def test_a_shape_that_is_away_fails_alone_and_what_was_made_of_it_waits(family, gathered, tmp_path):
    template, files, _ = family
    mine = tmp_path / "mine.ply"
    shutil.copy(files[0], mine)
    place = tmp_path / "out"
    folder, _ = gathered(template, [mine], place)
    before = contents(folder)
    mine.rename(tmp_path / "elsewhere")
    _, (away, other) = gathered(template, [mine, files[1]], place)
    assert away.figures is None and f"{mine} does not exist" in away.error
    assert other.figures is not None
    assert contents(folder).items() > before.items()
    (tmp_path / "elsewhere").rename(mine)
    again = []
    _, (back,) = gathered(template, [mine], place, listener=again.append)
    assert back.figures is not None and again == []


def test_what_a_killed_process_leaves_does_not_count(family, gathered, tmp_path):
    template, files, _ = family
    folder, outcomes = gathered(template, files[:1], tmp_path / "out")
    shutil.copy(folder.shape_file("copy0"), folder.root / "shapes" / ".0123456789ab.ply")
    (folder.root / "records" / ".ba9876543210.json").write_text("{")
    shutil.copy(folder.shape_file("copy0"), folder.shape_file("recordless"))
    assert folder.others([outcomes[0].subject]) == []
    assert folder.others([]) == ["copy0"]


def test_no_folder_is_left_in_which_nothing_was_made(tmp_path, make):
    new, mine = tmp_path / "new" / "out", tmp_path / "mine"
    mine.mkdir()
    for place in (new, mine):
        with pytest.raises(ZeroDivisionError), ShapeModelFolder.opened(place, {"template": {}}):
            assert (place / "shapes").is_dir()
            1 / 0  # noqa: B018
    assert not new.parent.exists() and not list(mine.iterdir())
    with pytest.raises(ZeroDivisionError), ShapeModelFolder.opened(new, {"template": {}}) as folder:
        write_shape(folder.shape_file("one"), make.blob(1))
        1 / 0  # noqa: B018
    with pytest.raises(ZeroDivisionError), ShapeModelFolder.opened(new, {"template": {}}):
        1 / 0  # noqa: B018
    assert sorted(path.name for path in new.iterdir()) == ["manifest.json", "matches", "records", "shapes"]


@pytest.mark.parametrize("faces", [True, False])
def test_points_in_clumps_are_told(faces, make):
    """Between shapes that lie on each other: a map that takes four of five points to one of two, and the right one."""
    blob = make.blob(3)
    base = blob if faces else blob.as_cloud()
    right = np.arange(blob.n_points)
    ends = blob.points[:, 1].argmin(), blob.points[:, 1].argmax()
    clumped = np.where(right % 5 == 0, right, np.where(blob.points[:, 1] > 0, ends[1], ends[0]))
    evenness = []
    for mapped in (right, clumped):
        projector = SurfaceProjector(base)
        smooth = SurfaceMap(projector, SurfaceProjector(blob), blob.points[mapped])
        low, high = registration_module._edge_spread(smooth)
        evenness.append(Figures(1.0, 1.0, 0.0, 1.0, 0.0 if faces else None, low, high))
    assert evenness[0].unevenness == pytest.approx(1, abs=1e-6) and evenness[0].low_confidence_warnings() == ()
    assert np.isfinite([evenness[1].edges_5, evenness[1].edges_95]).all()  # which JSON needs
    assert evenness[1].unevenness > 5
    told = evenness[1].low_confidence_warnings()
    if faces:
        assert len(told) == 1 and told[0].startswith("the match has low confidence: its points come in clumps and gaps")
    else:  # on clouds of organs neighbours are as uneven between true places
        assert told == ()


def test_doubts_of_the_placed_points_are_told_and_refused_as_strict(family, gathered, tmp_path, monkeypatch):
    template, files, _ = family
    monkeypatch.setattr(registration_module, "_edge_spread", lambda smooth: (0.2, 1.8))
    _, (outcome,) = gathered(template, files[:1], tmp_path / "out")
    assert (
        outcome.warnings == Figures(1.0, 1.0, 0.0, 1.0, 0.0, 0.2, 1.8).low_confidence_warnings()
        and len(outcome.warnings) == 1
    )
    _, (refused,) = gathered(template, files[:1], tmp_path / "strict", ShapeModelSettings(strict=True))
    assert refused.figures is None and "refused as strict" in refused.error


def test_an_unforeseen_failure_is_a_line_as_well(family, gathered, tmp_path, monkeypatch):
    template, files, _ = family
    monkeypatch.setattr(Template, "registered_to", lambda *args, **kwargs: 1 / 0)
    _, (outcome,) = gathered(template, files[:1], tmp_path / "out")
    assert outcome.error == f"{files[0]} could not be matched (ZeroDivisionError: division by zero)"


def test_changes_are_noticed(family, gathered, tmp_path):
    template, files, _ = family
    mine = tmp_path / "mine.ply"
    shutil.copy(files[0], mine)
    place = tmp_path / "out"
    again = []

    def run():
        again.clear()
        return gathered(template, [mine], place, listener=lambda o: again.append(o.subject.name))

    folder, _ = run()
    assert again == ["mine"]
    first = folder.points(["mine"], 162)
    os.utime(mine, (1, 1))  # the same bytes at another time
    run()
    assert again == []
    write_shape(mine, read_shape(files[2]))
    run()
    assert again == ["mine"] and np.abs(folder.points(["mine"], 162) - first).max() > 0.1
    folder.shape_file("mine").write_text("mangled")
    run()
    assert again == ["mine"]
    mine.write_text("no longer a shape")
    _, (outcome,) = run()
    assert again == ["mine"] and outcome.error
    assert not folder.shape_file("mine").exists()  # what is there is of files that are


def test_a_folder_holds_one_collection(family, gathered, tmp_path, make):
    template, files, _ = family
    gathered(template, files[:1], tmp_path / "out")
    with pytest.raises(ArgumentError, match=r"holds a collection made in another way \(template\)"):
        gathered(files[1], files[:1], tmp_path / "out")
    with pytest.raises(ArgumentError, match=r"made in another way \(matching\)"):
        gathered(template, files[:1], tmp_path / "out", ShapeModelSettings(shapes_up="z"))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thing").write_text("")
    with pytest.raises(ArgumentError, match="holds other things"):
        gathered(template, files[:1], tmp_path / "other")


def test_shapes_that_are_turned(family, gathered, tmp_path, make):
    """Points come back in the file's coordinates, whichever axis points up in it."""
    template, files, true = family
    shape = read_shape(files[1])
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    write_shape(tmp_path / "lying.ply", Shape(shape.points @ turn.T, shape.faces))
    folder, (outcome,) = gathered(
        template, [tmp_path / "lying.ply"], tmp_path / "out", ShapeModelSettings(shapes_up="z")
    )
    assert outcome.warnings == ()
    assert np.linalg.norm(folder.points(["lying"], 162)[0] - true[1] @ turn.T, axis=1).mean() < 0.1


@pytest.mark.parametrize("seed", [0, 1])
def test_shapes_that_are_turned_at_random(family, tmp_path, seed):
    """By registration, which compares positions: points lie on each shape where it is in its own file."""
    template, files, true = family
    turns = Rotation.random(len(files) + 1, random_state=seed).as_matrix()
    stretch, mine = np.diag([1, 1.6, 0.6]), [tmp_path / file.name for file in (*files, template)]
    for file, written, turn in zip((*files, template), mine, turns, strict=True):
        shape = read_shape(file)
        write_shape(written, Shape(shape.points @ stretch @ turn.T, shape.faces))
    matcher, names = Matcher(settings=MatcherSettings(method="registration")), [file.stem for file in files]
    expected, errors = true @ stretch @ turns[:-1].transpose(0, 2, 1), {}
    for orient in ("auto", "given"):
        settings = ShapeModelSettings(orient=orient)
        folder = ShapeModelFolder.prepare(tmp_path / orient, settings_record("", matcher, settings))
        register_all(read_shape(mine[-1]), subjects_of(mine[:-1]), folder, lambda: matcher, settings)
        errors[orient] = np.linalg.norm(folder.points(names, 162) - expected, axis=2).mean(axis=1)
    assert errors["auto"].max() < 0.1 and errors["given"].mean() > 0.5
    for file in mine[:-1]:
        shape, registered = read_shape(file), read_shape(tmp_path / "auto" / "shapes" / f"{file.stem}.ply")
        assert on_triangles(registered.points, shape.points[shape.faces]).all()


def test_an_ambiguous_orientation_is_told(tmp_path):
    """Of a box, which looks alike from several sides: in the figures, and in words that collections have."""
    box = trimesh.creation.box((1.0, 2.0, 0.5)).subdivide().subdivide().subdivide()
    shape = Shape(box.vertices, box.faces, name="box")
    template = Template(shape, Matcher(settings=MatcherSettings(method="registration")))
    found = template.registered_to(Shape(shape.points @ Rotation.random(random_state=0).as_matrix(), shape.faces))
    assert found.figures.ambiguous_orientation
    (told,) = (warning for warning in found.warnings if "ambiguous" in warning)
    assert "another registration" in told and "(orient='given')" in told and "alternatives" not in told


@pytest.mark.parametrize(("template_faces", "shape_faces"), [(True, False), (False, True), (False, False)])
def test_clouds(family, gathered, tmp_path, template_faces, shape_faces, make):
    blob = make.blob(3)
    order = np.random.default_rng(0).permutation(blob.n_points)
    other = make.relabelled(Shape(blob.points * [1, 1.1, 1], blob.faces), order)
    for name, shape, faces in (("template", blob, template_faces), ("other", other, shape_faces)):
        write_shape(tmp_path / f"{name}.ply", shape if faces else shape.as_cloud())
    folder, (outcome,) = gathered(tmp_path / "template.ply", [tmp_path / "other.ply"], tmp_path / "out")
    assert outcome.figures is not None and outcome.figures.flipped_triangles is None
    assert 0.3 < outcome.figures.edges_5 < 1 < outcome.figures.edges_95 < 2 and outcome.warnings == ()
    written = read_shape(folder.shape_file("other"))
    assert (written.faces is not None) == template_faces
    assert np.linalg.norm(written.points - blob.points * [1, 1.1, 1], axis=1).mean() < 0.15


def test_strict(family, gathered, tmp_path, make):
    template, files, _ = family
    shape = read_shape(files[0])
    write_shape(tmp_path / "dirty.ply", Shape(np.concatenate([shape.points, [[9, 9, 9]]]), shape.faces))
    settings = ShapeModelSettings(strict=True)
    _, (outcome,) = gathered(template, [tmp_path / "dirty.ply"], tmp_path / "out", settings)
    assert "refused as strict" in outcome.error


def test_units_that_differ_are_told(family, gathered, tmp_path):
    template, files, _ = family
    shape = read_shape(files[0])
    write_shape(tmp_path / "large.ply", Shape(1000 * shape.points, shape.faces))
    folder, (outcome,) = gathered(template, [tmp_path / "large.ply"], tmp_path / "out")
    (told,) = outcome.warnings
    assert "times as large as the template" in told and 900 < float(told.split()[2]) < 1100
    assert folder.points(["large"], 162).max() > 1000
    _, (refused,) = gathered(template, [tmp_path / "large.ply"], tmp_path / "strict", ShapeModelSettings(strict=True))
    assert refused.figures is None and "refused as strict" in refused.error


def test_names(family, tmp_path):
    _, files, _ = family
    assert [subject.name for subject in subjects_of(files)] == ["copy0", "copy1", "copy2"]
    (tmp_path / "COPY0.obj").write_text("")
    for wrong, said in (
        ([], "no shapes are given"),
        ([files[0], tmp_path / "COPY0.obj"], "would both be called"),
        ([files[0], files[0]], "would both be called"),
    ):
        with pytest.raises(ArgumentError, match=said):
            subjects_of(wrong)


def test_templates_that_cannot_be_carried(make):
    blob = make.blob(1)
    with pytest.raises(ShapeError, match=r"points that can have no counterpart.*: 1 "):
        check_template(Shape(np.concatenate([blob.points, [[9, 9, 9]]]), blob.faces, name="blob"))
    check_template(Shape(np.concatenate([blob.points, blob.points[:1]]), np.concatenate([blob.faces, [[42, 0, 1]]])))


def test_files_that_do_not_fit_each_other(family, gathered, tmp_path, make):
    template, files, _ = family
    folder, _ = gathered(template, files[:2], tmp_path / "out")
    write_shape(folder.shape_file("copy1"), make.blob(1))
    with pytest.raises(DataError, match="has 42 points, but the template has 162"):
        folder.points(["copy0", "copy1"], 162)
    assert isinstance(folder, ShapeModelFolder)


def test_the_template_is_made_ready_once(family, gathered, tmp_path, calls):
    template, files, _ = family
    batch_module._prepared_template.cache_clear()
    made = calls(Template, "__init__")
    gathered(template, files[:3], tmp_path / "out")
    assert made == ["__init__"]
