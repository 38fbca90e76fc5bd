"""``homolog match``."""

import hashlib
import json
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from homolog import shapes
from homolog.core.errors import ShapeError
from homolog.datasets import demo_folder
from homolog.matching import Matcher, map_misfit
from homolog.matching import warnings as warnings_module
from homolog.pairs import MatcherSettings
from homolog.shapes import Shape, read_shape, rotation_about, write_shape
from homolog.shapes import reading as reading_module
from homolog.training import AdaptationSettings, adapt_to_pair

NAMES = ["correspondence.npz", "source.ply", "target.ply", "report.json"]


def maps(folder):
    with np.load(folder / "correspondence.npz") as stored:
        return {name: stored[name] for name in stored.files}


def report(folder):
    return json.loads((folder / "report.json").read_text(encoding="utf-8"))


def test_four_files(homolog, files, tmp_path):
    out = tmp_path / "deep" / "result"
    ended = homolog("match", files.mesh, files.other, "-o", out, "--method", "axiomatic")
    assert ended.code == 0
    assert ended.out.splitlines() == [str(out / name) for name in NAMES]
    assert sorted(path.name for path in out.iterdir()) == sorted(NAMES)
    assert "Matched by axiomatic" in ended.err
    assert "source 162 points, all matched, mean confidence" in ended.err
    assert ended.err.count("\n") == 1
    found = maps(out)
    assert np.mean(files.order[found["source_to_target"]] == np.arange(162)) > 0.9
    assert np.mean(found["target_to_source"] == files.order) > 0.9
    for name, file in (("source.ply", files.mesh), ("target.ply", files.other)):
        written, given = read_shape(out / name), read_shape(file)
        np.testing.assert_array_equal(written.points, given.points)
        np.testing.assert_array_equal(written.faces, given.faces)


def test_the_settings_of_a_report_give_the_same_map_again(homolog, files, tmp_path):
    (tmp_path / "own.toml").write_text(
        'method = "axiomatic"\n[axiomatic]\nn_eigenpairs = 12\n[refinement]\nk_init = 15\n'
    )
    first = ("match", files.mesh, files.other, "-o", tmp_path / "first")
    assert homolog(*first, "--settings", tmp_path / "own.toml").code == 0
    told = report(tmp_path / "first")["settings"]
    assert (told["method"], told["axiomatic"]["n_eigenpairs"], told["refinement"]["k_init"]) == ("axiomatic", 12, 15)
    assert json.loads(json.dumps(MatcherSettings.from_dict(told).to_dict())) == told
    again = (
        "match",
        files.mesh,
        files.other,
        "-o",
        tmp_path / "again",
        "--settings",
        tmp_path / "first" / "report.json",
    )
    assert homolog(*again).code == 0
    assert report(tmp_path / "again")["settings"] == told
    for name, values in maps(tmp_path / "first").items():
        np.testing.assert_array_equal(maps(tmp_path / "again")[name], values)
    assert homolog(*again, "--method", "registration").code == 0
    found = report(tmp_path / "again")
    assert found["method"] == "registration" and found["settings"] == {**told, "method": "registration"}


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.toml", "refinment = 3", "--settings has an unknown key 'refinment'; did you mean 'refinement'?"),
        (
            "a.toml",
            "[refinement]\nk_int = 3",
            "[refinement] has an unknown key 'k_int'; did you mean 'k_init'?",
        ),
        ("a.toml", "method = 'of nobody'", "method is 'of nobody', but must be one of auto"),
        ("a.json", "{}", "give the report.json of a result, or a TOML file"),
    ],
)
def test_settings_that_cannot_be_used_are_one_line(homolog, files, tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path / "out", "--settings", tmp_path / name)
    assert ended.is_one_line_of_complaint() and said in ended.err, ended


@pytest.mark.parametrize(
    "options", [{}, {"as_cloud": "both"}, {"as_cloud": "source"}, {"partial": "target"}, {"partial": "source"}]
)
def test_the_same_as_in_python(homolog, files, tmp_path, options):
    words = [word for name, value in options.items() for word in (f"--{name.replace('_', '-')}", value)]
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path, "--weights", files.weights, *words)
    assert ended.code == 0
    matcher = Matcher.from_weights(files.weights, settings=MatcherSettings())
    found = matcher.match(read_shape(files.mesh), read_shape(files.other), **options)
    for name, array in maps(tmp_path).items():
        np.testing.assert_array_equal(array, getattr(found, name))


def test_default_folder(homolog, files, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert homolog("match", files.mesh, files.mesh, "--method", "axiomatic").code == 0
    assert sorted(path.name for path in (tmp_path / "match").iterdir()) == sorted(NAMES)


def test_quiet_is_silent(homolog, files, tmp_path):
    ended = homolog("match", files.dirty, files.cloud, "-o", tmp_path / "out", "--quiet", "--method", "axiomatic")
    assert (ended.code, ended.out, ended.err) == (0, "", "")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(NAMES)


def test_verbose_tells_each_step(homolog, files, tmp_path):
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path, "--verbose", "--method", "axiomatic")
    for step in ("read source", "operators of target", "map", "write"):
        assert f"{step} ..." in ended.err
    assert ended.err.count(" MB") >= 10


def test_report(homolog, files, tmp_path):
    options = ["--weights", files.weights, "--as-cloud", "target", "--partial", "target", "--up", "z"]
    ended = homolog("match", files.dirty, files.other, "-o", tmp_path, *options, "--target-up", "y")
    assert ended.code == 0
    found, arrays = report(tmp_path), maps(tmp_path)
    for side, file in (("source", files.dirty), ("target", files.other)):
        assert found["inputs"][side]["file"] == str(file)
        assert found["inputs"][side]["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
        assert found["inputs"][side]["n_clean_points"] == 162
    findings = {entry["rule"]: entry["count"] for entry in found["inputs"]["source"]["findings"]}
    assert findings["duplicate points"] == 2
    assert findings["unreferenced points"] == 1
    assert findings["duplicate faces"] == 1
    assert found["inputs"]["source"]["n_points"] == 165
    assert [entry["severity"] for entry in found["inputs"]["target"]["findings"]] in ([], ["note"])
    assert found["method"] == "nearest-features"
    assert all("doubtful" in warning for warning in found["warnings"])
    assert found["options"] == {
        "as_cloud": "target",
        "clutter": "remove",
        "proxy": "auto",
        "landmarks": None,
        "partial": "target",
        "partial_scale": 1.0,
        "orient": "auto",
        "mirror": None,
        "pre_aligned": False,
        "source_up": "z",
        "target_up": "y",
        "strict": False,
    }
    assert found["adapt"] == 0 and found["adaptation"] is None
    assert found["features"]["sha256"] == hashlib.sha256(files.weights.read_bytes()).hexdigest()
    assert found["features"]["file"] == str(files.weights)
    assert (found["features"]["name"], found["features"]["licence"]) == ("untrained", "none")
    assert found["settings"]["method"] == "auto"
    assert found["settings"]["operators"] == {"n_eigenpairs": 128, "laplacian": "robust", "n_neighbours": 14}
    for side in ("source", "target"):
        assert found["inputs"][side]["eigenpairs"]["number"] == 128
        assert found["inputs"][side]["eigenpairs"]["method"]
    assert found["features"]["n_eigenpairs"] == 128
    assert found["features"]["map_eigenpairs"] == 20
    steps = [step["name"] for step in found["timings"]]
    assert steps[:2] == ["read source", "read target"]
    assert steps[-3:] == ["features of target", "map", "write"]
    assert len(steps) == 14
    for step in found["timings"]:
        assert 0 <= step["seconds"] < 600
        assert 10 < step["process_peak_mb"] < 1e6
    assert {"python", "homolog", "torch", "numpy", "scipy", "robust-laplacian"} <= set(found["versions"])
    assert found["versions"]["torch"] == torch.__version__
    matched = found["matched"]
    assert matched["source_points"] == 165
    assert matched["source_points_left_out"] == 1  # used by no face; the two duplicates get what they repeat
    assert matched["source_points_without_counterpart"] == np.sum(arrays["source_to_target"] < 0) - 1
    assert matched["target_points_left_out"] == matched["target_points_without_counterpart"] == 0
    assert np.sum(arrays["target_to_source"] < 0) == 0
    assert matched["source_mean_confidence"] == pytest.approx(arrays["source_confidence"].mean())
    assert matched["target_mean_confidence"] == pytest.approx(arrays["target_confidence"].mean())
    assert found["quality"]["source"] is None  # its other shape is a part
    assert found["quality"]["target"]["confidence"] == pytest.approx(arrays["target_confidence"].mean())
    assert found["quality"]["target"]["flipped_triangles"] is None


def test_points_left_out_are_told_from_those_without_a_counterpart(homolog, files, tmp_path):
    weights = ("--weights", files.weights)
    ended = homolog("match", files.dirty, files.other, "-o", tmp_path / "whole", *weights)
    assert "source 165 points, 1 left out by repair, mean confidence" in ended.err
    assert "target 162 points, all matched, mean confidence" in ended.err
    clean = read_shape(files.mesh)
    upper = clean.faces[(clean.points[clean.faces, 1] > 0).all(axis=1)]
    write_shape(tmp_path / "upper.ply", Shape(clean.points, upper))
    ended = homolog("match", files.dirty, tmp_path / "upper.ply", "-o", tmp_path, "--partial", "target", *weights)
    matched = report(tmp_path)["matched"]
    missing = matched["source_points_without_counterpart"]
    assert missing == np.sum(maps(tmp_path)["source_to_target"] < 0) - 1 > 10
    assert f"source 165 points, 1 left out by repair, {missing} without a counterpart, mean confidence" in ended.err
    assert matched["target_points_left_out"] == 162 - len(np.unique(upper))


def test_a_pre_aligned_partial_shape_is_matched_as_such(homolog, files, tmp_path, monkeypatch):
    asked = []
    pair = Matcher.pair

    def spy(self, source, target, options, **others):
        asked.append(options.pre_aligned)
        return pair(self, source, target, options, **others)

    monkeypatch.setattr(Matcher, "pair", spy)
    common = (files.mesh, files.other, "--weights", files.weights, "--partial", "target", "-q")
    for number, options in enumerate(((), ("--pre-aligned",))):
        assert homolog("match", *common, "-o", tmp_path / str(number), *options).code == 0
        assert report(tmp_path / str(number))["options"]["pre_aligned"] is bool(number)
    assert asked == [False, True]


def test_part_scale(homolog, files, tmp_path):
    """A part in other units than the whole: warned of, refused as strict, and put right by the factor."""
    clean = read_shape(files.other)
    upper = clean.faces[(clean.points[clean.faces, 1] > 0).all(axis=1)]
    write_shape(tmp_path / "part.ply", Shape(clean.points, upper))
    write_shape(tmp_path / "part_mm.ply", Shape(1000 * clean.points, upper))
    weights = ["--weights", files.weights, "--method", "nearest-features"]
    same, other = [
        ("match", files.mesh, tmp_path / name, "--partial", "target", *weights) for name in ("part.ply", "part_mm.ply")
    ]
    assert "units" not in homolog(*same, "-o", tmp_path / "same").err
    ended = homolog(*other, "-o", tmp_path / "wrong")
    (warning,) = (line for line in ended.err.splitlines() if "units" in line)
    assert warning.startswith("Warning: the partial shape's area is ")
    assert "--partial-scale" in warning
    said = warning.removeprefix("Warning: ").replace("--partial-scale", "partial_scale")
    assert report(tmp_path / "wrong")["warnings"][0] == said
    assert homolog(*other, "-o", tmp_path / "strict", "--strict").code == 2
    ended = homolog(*other, "--partial-scale", "0.001", "-o", tmp_path / "right")
    assert "units" not in ended.err
    assert report(tmp_path / "right")["options"]["partial_scale"] == 0.001
    for name in ("source_to_target", "target_to_source"):
        right, expected = (maps(tmp_path / folder)[name] for folder in ("right", "same"))
        assert np.mean(right == expected) > 0.99


def test_a_match_that_fails_for_its_units_says_so(homolog, files, tmp_path, monkeypatch):
    """And not what came of them; a match in the same units fails with its own reason."""
    clean = read_shape(files.other)
    write_shape(tmp_path / "large.ply", Shape(1000 * clean.points, clean.faces))
    monkeypatch.setattr(Matcher, "find", raising(ShapeError("it falls into pieces")))
    options = ("--partial", "target", "-o", tmp_path / "out", "--weights", files.weights)
    ended = homolog("match", files.mesh, tmp_path / "large.ply", *options)
    assert ended.is_one_line_of_complaint()
    assert "their units seem to differ; its size is estimated; give --partial-scale, by how much" in ended.err
    ended = homolog("match", files.mesh, files.other, *options)
    assert ended.err == "Error: it falls into pieces\n"


@pytest.mark.parametrize("options", [["0"], ["-1"], ["nan"], ["inf"], ["2"]])
def test_part_scales_that_cannot_be(homolog, files, tmp_path, options):
    partial = [] if options == ["2"] else ["--partial", "target"]
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path / "out", "--partial-scale", *options, *partial)
    assert ended.is_one_line_of_complaint(), ended
    assert "--partial-scale is " in ended.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            ["--partial-scale", "2"],
            "--partial-scale is 2.0, but neither shape is partial; say which one is by --partial ",
        ),
        (["--pre-aligned"], "--pre-aligned is True, but neither shape is partial"),
        (["--partial", "source", "--method", "registration"], "--partial is 'source', but the method 'registration'"),
    ],
)
def test_mistakes_are_told_by_the_options(homolog, files, tmp_path, options, said):
    """And not by the arguments of the Python call, which a user of the command never sees."""
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path / "out", *options)
    assert ended.is_one_line_of_complaint() and ended.err.startswith(f"Error: {said}")


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("give partial_scale, or partial='source'", "give --partial-scale, or --partial source"),
        ("/a/partial_scale.ply: no, as source_up/x or target_up.off", None),
        ("neither shape is partial; up is left out", None),
        ("up is 'w', but must be one of x, y", "--up is 'w', but must be one of x, y"),
    ],
)
def test_words_of_files_and_of_sentences_are_no_options(homolog, files, tmp_path, monkeypatch, said, told):
    monkeypatch.setattr(Matcher, "pair", raising(ShapeError(said)))
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path / "out")
    assert ended.err == f"Error: {told or said}\n"


def test_weights_that_the_method_does_not_use_are_said_and_leave_no_trace(homolog, files, tmp_path):
    """On the screen, unless ``--quiet`` is given, and in the report."""
    options = ["--method", "axiomatic", "--weights", files.weights]
    said = "the weights or features 'untrained' are left aside, as the method 'axiomatic' does not use any"
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path / "with", *options)
    assert ended.err.count(f"Warning: {said}") == 1
    (told,) = report(tmp_path / "with")["warnings"]
    assert told.startswith(said)
    assert report(tmp_path / "with")["features"]["name"] == "axiomatic"
    homolog("match", files.mesh, files.other, "-o", tmp_path / "without", "--method", "axiomatic")
    for name, array in maps(tmp_path / "without").items():
        np.testing.assert_array_equal(maps(tmp_path / "with")[name], array)
    assert report(tmp_path / "without")["warnings"] == []
    assert homolog("match", files.mesh, files.other, "-o", tmp_path / "with", *options, "--quiet").err == ""
    assert report(tmp_path / "with")["warnings"] == [told]
    assert homolog("match", files.mesh, files.other, "-o", tmp_path / "no", *options, "--strict").code == 2


def test_the_map_is_that_of_the_adapted_network_where_it_contradicts_itself_less(homolog, files, tmp_path):
    before = files.weights.read_bytes()
    options = "--weights", files.weights, "--method", "nearest-features", "--adapt", 3
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path, *options)
    assert ended.code == 0
    matcher = Matcher.from_weights(files.weights, settings=MatcherSettings(method="nearest-features"))
    pair, _ = matcher.pair(files.mesh, files.other)
    adapted, after = adapt_to_pair(matcher, pair, AdaptationSettings(steps=3))
    plain, other = matcher.find(pair), adapted.find(after)
    misfits = map_misfit(plain), map_misfit(other)
    kept = misfits[1] < misfits[0]
    expected, found, told = (other if kept else plain), maps(tmp_path), report(tmp_path)
    assert np.array_equal(found["source_to_target"], expected.source_to_target)
    assert np.array_equal(found["source_confidence"], expected.source_confidence)
    assert told["adapt"] == 3
    assert told["adaptation"] == {
        "steps": 3,
        "map_misfit": misfits[0],
        "adapted_map_misfit": misfits[1],
        "kept": kept,
    }
    figures = f"{misfits[1]:.2f} with it and {misfits[0]:.2f} without"
    assert f"Adaptation {'kept' if kept else 'not kept'}: the map's misfit is {figures}." in ended.err
    assert "adapt" in [step["name"] for step in told["timings"]]
    assert files.weights.read_bytes() == before


def test_adapting_needs_weights(homolog, files, tmp_path):
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path / "out", "--adapt", 3, "--method", "axiomatic")
    assert ended.is_one_line_of_complaint()
    assert "--adapt is given, but there is no network; give weights" in ended.err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_people_are_matched_by_the_weights_for_people_by_default(homolog, tmp_path):
    ended = homolog("match", *(demo_folder().file(name) for name in demo_folder().names[:2]), "-o", tmp_path)
    features = report(tmp_path)["features"]
    assert (features["name"], features["licence"]) == ("people", "CC0-1.0")
    assert report(tmp_path)["method"] == "functional-map"
    assert [candidate["name"] for candidate in report(tmp_path)["choice"]] == ["people"]
    assert "Matched by functional-map with the weights people in" in ended.err


def test_weights_that_are_given_are_named_at_the_end(homolog, files, tmp_path):
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path, "--weights", "people")
    assert f"Matched by {report(tmp_path)['method']} with the weights people in" in ended.err
    assert "s (reading, matching and writing): source" in ended.err


def test_what_no_weights_know_is_matched_without_any(homolog, files, tmp_path):
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path)
    assert report(tmp_path)["method"] in ("axiomatic", "registration")
    assert f"Matched by {report(tmp_path)['method']} in" in ended.err


def test_report_without_weights(homolog, files, tmp_path):
    homolog("match", files.mesh, files.cloud, "-o", tmp_path, "--no-cache", "--method", "axiomatic")
    assert report(tmp_path)["features"]["name"] == "axiomatic"
    assert report(tmp_path)["features"]["sha256"] == ""
    assert report(tmp_path)["method"] == "axiomatic"
    assert report(tmp_path)["inputs"]["target"]["modality"] == "cloud"
    assert report(tmp_path)["device"] in ("cpu", "cuda")


@pytest.mark.parametrize(
    ("options", "method"),
    [
        ([], "functional-map"),
        (["--as-cloud", "both"], "nearest-features"),
        (["--method", "nearest-features"], "nearest-features"),
        (["--method", "axiomatic"], "axiomatic"),
    ],
)
def test_methods(homolog, files, tmp_path, options, method):
    homolog("match", files.mesh, files.other, "-o", tmp_path, "--weights", files.weights, *options)
    assert report(tmp_path)["method"] == method


@pytest.mark.parametrize(("up", "turn"), [("z", rotation_about(0, 90)), ("x", rotation_about(2, -90))])
def test_up(homolog, files, tmp_path, up, turn):
    """A turned source matches like the upright one if told so, and comes back as it was given."""
    turned = Shape(files.upright.points @ turn.T, files.upright.faces)
    write_shape(tmp_path / "turned.off", turned)
    highest = files.upright.points[:, 1].argmax()
    assert turned.points[highest, "xyz".index(up)] == files.upright.points[highest, 1]
    turned_file, features = tmp_path / "turned.off", ["--weights", files.weights, "--method", "nearest-features"]
    features += ["--orient", "given"]
    for name, *arguments in (
        ("plain", files.mesh, files.other),
        ("told", turned_file, files.other, "--source-up", up),
        ("told both", turned_file, files.other, "--up", up, "--target-up", "y"),
        ("swapped", files.other, turned_file, "--target-up", up),
        ("untold", turned_file, files.other),
    ):
        assert homolog("match", *arguments, *features, "-o", tmp_path / name).code == 0
    plain, told, untold, inverse = (maps(tmp_path / name) for name in ("plain", "told", "untold", "swapped"))
    np.testing.assert_array_equal(told["source_to_target"], plain["source_to_target"])
    np.testing.assert_array_equal(maps(tmp_path / "told both")["source_to_target"], plain["source_to_target"])
    assert np.mean(inverse["target_to_source"] == plain["source_to_target"]) > 0.9
    assert np.mean(untold["source_to_target"] == plain["source_to_target"]) < 0.5
    np.testing.assert_array_equal(read_shape(tmp_path / "told" / "source.ply").points, turned.points)


def test_warnings_are_shown_and_kept(homolog, files, tmp_path, monkeypatch):
    monkeypatch.setattr(warnings_module, "orientation_warnings", lambda *args: ("it lies on its side",))
    given = ("match", files.mesh, files.other, "--orient", "given", "--weights", files.weights)
    ended = homolog(*given, "-o", tmp_path)
    assert ended.code == 0
    assert "Warning: it lies on its side\n" in ended.err
    assert report(tmp_path)["warnings"] == ["it lies on its side"]
    assert homolog(*given, "-o", tmp_path, "-q").err == ""
    strict = homolog(*given, "-o", tmp_path / "strict", "--strict")
    assert strict.is_one_line_of_complaint()
    assert "it lies on its side (refused as strict)" in strict.err
    assert not (tmp_path / "strict").exists()


def test_strict_stops_at_a_repair(homolog, files, tmp_path):
    for pair in ((files.dirty, files.mesh), (files.mesh, files.dirty)):
        ended = homolog("match", *pair, "-o", tmp_path / "out", "--strict")
        assert ended.is_one_line_of_complaint()
        assert "dirty.ply" in ended.err
        assert "duplicate points" in ended.err
        assert "refused as strict" in ended.err
        assert not (tmp_path / "out").exists()


def test_strict_lets_clean_shapes_pass(homolog, files, tmp_path):
    given = ("--orient", "given", "--weights", files.weights)
    assert homolog("match", files.mesh, files.other, "-o", tmp_path / "out", "--strict", *given).code == 0


class _Trap:
    """Runs code when unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


@pytest.fixture
def trap(tmp_path):
    """Where code hidden in weights would leave its mark."""
    mark = tmp_path / "mark"
    pickle.loads(pickle.dumps(_Trap(mark))).close()
    assert mark.exists()
    mark.unlink()
    (tmp_path / "evil.pth").write_bytes(pickle.dumps(_Trap(mark)))
    torch.save({"networks": {"feature_extractor": _Trap(mark)}}, tmp_path / "zipped.pth")
    (tmp_path / "evil.safetensors").write_bytes(pickle.dumps(_Trap(mark)))
    return mark


@pytest.mark.parametrize("name", ["evil.pth", "zipped.pth", "evil.safetensors"])
def test_weights_never_run_code(homolog, files, tmp_path, trap, name):
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path / "out", "--weights", tmp_path / name)
    assert ended.is_one_line_of_complaint()
    assert name in ended.err
    assert not trap.exists()
    assert not (tmp_path / "out").exists()


def cut_short(files, tmp_path):
    path = tmp_path / "short.safetensors"
    path.write_bytes(files.weights.read_bytes()[:1000])
    return path


def unused(tmp_path):
    (tmp_path / "mesh.docx").write_text("hello")
    return tmp_path / "mesh.docx"


def on_a_line(tmp_path):
    np.savetxt(tmp_path / "line.xyz", np.outer(np.arange(9.0), [1, 2, 3]))
    return tmp_path / "line.xyz"


def below(tmp_path, name):
    (tmp_path / name).mkdir()
    return tmp_path / name


def emptied(tmp_path):
    (tmp_path / "empty.obj").touch()
    return tmp_path / "empty.obj"


MISTAKES = {
    "missing file": (lambda f, t: [t / "gone.ply", f.mesh], "gone.ply does not exist"),
    "missing target": (lambda f, t: [f.mesh, t / "gone.ply"], "gone.ply does not exist"),
    "folder": (lambda f, t: [f.mesh, below(t, "a.ply")], "a.ply is a folder"),
    "folder without a suffix": (lambda f, t: [below(t, "scans"), f.mesh], "scans is a folder"),
    "empty": (lambda f, t: [f.mesh, emptied(t)], "empty.obj is empty"),
    "rubbish": (lambda f, t: [f.rubbish, f.mesh], "rubbish.ply could not be read"),
    "unknown suffix": (lambda f, t: [unused(t), f.mesh], "has the suffix '.docx'"),
    "unusable": (lambda f, t: [f.mesh, on_a_line(t)], "line.xyz cannot be used"),
    "no such weights": (lambda f, t: [f.mesh, f.mesh, "--weights", "gone.pth"], "there are no weights 'gone.pth'"),
    "weights in part": (lambda f, t: [f.mesh, f.mesh, "--weights", cut_short(f, t)], "short.safetensors"),
    "mesh as weights": (lambda f, t: [f.mesh, f.mesh, "--weights", f.mesh], "mesh.off"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line(homolog, files, tmp_path, mistake):
    arguments, said = MISTAKES[mistake]
    ended = homolog("match", *arguments(files, tmp_path), "-o", tmp_path / "out")
    assert ended.is_one_line_of_complaint(), ended
    assert said in ended.err
    assert not (tmp_path / "out").exists()


def test_no_cuda(homolog, files, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    ended = homolog("match", files.mesh, files.mesh, "-o", tmp_path / "out", "--device", "cuda")
    assert ended.is_one_line_of_complaint()
    assert "no CUDA device" in ended.err


@pytest.mark.parametrize("below", [False, True])
def test_out_is_a_file(homolog, files, tmp_path, monkeypatch, below):
    """Found before any work is done."""
    out = tmp_path / "out"
    out.write_text("precious")
    monkeypatch.setattr(shapes, "read_hashed_shape", None)
    ended = homolog("match", files.mesh, files.other, "-o", out / "below" if below else out)
    assert ended.is_one_line_of_complaint()
    assert "cannot be made a folder" in ended.err
    assert out.read_text() == "precious"


@pytest.mark.parametrize(
    "arguments",
    [
        ["match", "--colour"],
        ["mach"],
        ["match"],
        ["match", "a.off"],
        ["match", "a.off", "b.off", "--as-cloud", "all"],
        ["match", "a.off", "b.off", "--partial", "all"],
        ["match", "a.off", "b.off", "--device", "tpu"],
        ["match", "a.off", "b.off", "--up", "w"],
        ["match", "a.off", "b.off", "--landmarks", "a.csv"],
        ["--nonsense"],
    ],
)
def test_unknown_words(homolog, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    ended = homolog(*arguments)
    assert ended.code == 2
    assert ended.err.startswith("Error: ")
    assert ended.err.count("\n") == 1
    assert re.search("(see homolog (match )?--help|did you mean 'match'\\?)\n", ended.err)
    assert "Traceback" not in ended.err
    assert ended.out == ""
    assert list(tmp_path.iterdir()) == []


def test_unknown_methods(homolog, files, tmp_path):
    """Those of installed packages are methods too, so that the error names all there are."""
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path / "out", "--method", "nearest-feature")
    assert ended.is_one_line_of_complaint()
    assert "--method is 'nearest-feature', but must be one of auto, axiomatic, functional-map" in ended.err
    assert "did you mean 'nearest-features'?" in ended.err
    assert not (tmp_path / "out").exists()


def too_large(*args, **kwargs):
    """More than any machine has; PyTorch says so in a RuntimeError of many words."""
    return torch.empty(10**15)


def singular(*args, **kwargs):
    return torch.linalg.solve(torch.zeros(2, 2), torch.ones(2))


def raising(error):
    def fail(*args, **kwargs):
        raise error

    return fail


TROUBLES = {
    "memory": (raising(MemoryError()), "not enough memory; use smaller shapes"),
    "PyTorch's memory": (too_large, "not enough memory; use smaller shapes"),
    "memory on a device": (
        raising(torch.OutOfMemoryError("CUDA out of memory.\nTried to allocate 2 GiB.")),
        "not enough memory; use --device cpu",
    ),
    "memory on Windows": (
        raising(RuntimeError("not enough memory: you tried to allocate 9 bytes.")),
        "not enough memory",
    ),
    "PyTorch's solver": (singular, "a linear system has no solution"),
    "NumPy's solver": (lambda *args, **kwargs: np.linalg.inv(np.zeros((2, 2))), "a linear system has no solution"),
    "forbidden": (raising(PermissionError(13, "Permission denied", "here")), "Error: here: Permission denied\n"),
}


@pytest.mark.parametrize("trouble", TROUBLES)
def test_what_the_machine_cannot_do_is_one_line(homolog, files, tmp_path, monkeypatch, trouble):
    fail, said = TROUBLES[trouble]
    monkeypatch.setattr(Matcher, "find", fail)
    ended = homolog("match", files.mesh, files.mesh, "-o", tmp_path / "out", "--method", "axiomatic")
    assert ended.is_one_line_of_complaint(), ended
    assert said in ended.err
    assert not (tmp_path / "out").exists()


def test_a_mistake_of_the_program_itself_is_not_hidden(homolog, files, tmp_path, monkeypatch):
    monkeypatch.setattr(Matcher, "find", raising(RuntimeError("a shape mismatch")))
    with pytest.raises(RuntimeError, match="a shape mismatch"):
        homolog("match", files.mesh, files.mesh, "-o", tmp_path / "out", "--method", "axiomatic")


def test_the_hash_is_that_of_the_bytes_read(homolog, files, tmp_path, monkeypatch):
    """An input that is replaced during the match is reported as it was read."""
    source = tmp_path / "mesh.off"
    source.write_bytes(files.mesh.read_bytes())
    find = Matcher.find

    def meddling(*args, **kwargs):
        source.write_text("another")
        return find(*args, **kwargs)

    monkeypatch.setattr(Matcher, "find", meddling)
    assert homolog("match", source, files.other, "-o", tmp_path / "out", "--method", "axiomatic").code == 0
    assert report(tmp_path / "out")["inputs"]["source"]["sha256"] == hashlib.sha256(files.mesh.read_bytes()).hexdigest()


@pytest.fixture
def gltf(files, tmp_path):
    """A glTF and the two files of its buffers."""
    shape = read_shape(files.mesh)
    mesh = trimesh.Trimesh(shape.points, shape.faces, process=False)
    for name, content in mesh.export(file_type="gltf").items():
        (tmp_path / name).write_bytes(content)
    return [tmp_path / name for name in ("model.gltf", "gltf_buffer_0.bin", "gltf_buffer_1.bin")]


def test_the_hash_of_a_gltf_is_that_of_all_its_files(homolog, files, gltf, tmp_path):
    assert homolog("match", gltf[0], files.other, "-o", tmp_path / "out", "--method", "axiomatic").code == 0
    content = b"".join(file.read_bytes() for file in gltf)
    assert report(tmp_path / "out")["inputs"]["source"]["sha256"] == hashlib.sha256(content).hexdigest()


def test_a_buffer_that_changes_while_it_is_read_is_refused(homolog, files, gltf, tmp_path, monkeypatch):
    def meddling(file):
        shape = read_shape(file)
        gltf[2].write_bytes(gltf[2].read_bytes()[::-1])
        return shape

    monkeypatch.setattr(reading_module, "read_shape", meddling)
    ended = homolog("match", gltf[0], files.other, "-o", tmp_path / "out")
    assert ended.is_one_line_of_complaint()
    assert "model.gltf changed while it was read" in ended.err


def test_a_gltf_without_its_buffer(homolog, files, gltf, tmp_path):
    gltf[1].unlink()
    ended = homolog("match", gltf[0], files.other, "-o", tmp_path / "out")
    assert ended.is_one_line_of_complaint()
    assert "'gltf_buffer_0.bin', which is not beside it" in ended.err


def test_an_input_that_changes_while_it_is_read_is_refused(homolog, files, tmp_path, monkeypatch):
    source = tmp_path / "mesh.off"
    source.write_bytes(files.mesh.read_bytes())

    def meddling(file):
        shape = read_shape(file)
        Path(file).write_text("another")
        return shape

    monkeypatch.setattr(reading_module, "read_shape", meddling)
    ended = homolog("match", source, files.other, "-o", tmp_path / "out")
    assert ended.is_one_line_of_complaint()
    assert "mesh.off changed while it was read" in ended.err


def test_cache_is_used_and_can_be_left_alone(homolog, files, tmp_path, monkeypatch):
    monkeypatch.setenv("HOMOLOG_CACHE", str(tmp_path / "cache"))
    match = ("match", files.mesh, files.other, "--method", "axiomatic", "-o")
    homolog(*match, tmp_path / "first", "--no-cache")
    assert not (tmp_path / "cache").exists()
    homolog(*match, tmp_path / "second")
    assert len(list((tmp_path / "cache").rglob("*.safetensors"))) == 2
    homolog(*match, tmp_path / "third")
    first, second, third = (maps(tmp_path / name) for name in ("first", "second", "third"))
    for name, array in first.items():
        np.testing.assert_array_equal(second[name], array)
        np.testing.assert_array_equal(third[name], array)


@pytest.mark.parametrize("option", ["--html", "--picture"])
def test_no_output_replaces_an_input(homolog, files, tmp_path, option):
    """By the file's identity, links included."""
    link = tmp_path / ("link.png" if option == "--picture" else "link.html")
    link.symlink_to(files.mesh)
    before = files.mesh.read_bytes()
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path / "out", option, link)
    assert ended.is_one_line_of_complaint() and "is an input and would be replaced" in ended.err
    assert files.mesh.read_bytes() == before and not (tmp_path / "out").exists()


def test_alternatives_have_figures_of_their_own(homolog, files, tmp_path):
    options = ["--method", "registration", "-o", tmp_path]
    plain = homolog("match", files.mesh, files.other, *options)
    best = maps(tmp_path)
    ended = homolog("match", files.mesh, files.other, *options, "--alternatives", 3)
    assert plain.code == ended.code == 0
    for name, array in best.items():
        np.testing.assert_array_equal(maps(tmp_path)[name], array)
    reports = [report(tmp_path / name) for name in ("", "alternative-2", "alternative-3")]
    assert len({json.dumps(each["orientation"]) for each in reports}) == 3
    for each in reports:
        assert each["inputs"]["source"]["file"] == str(files.mesh)
        steps = [step["name"] for step in each["timings"]]
        assert steps.count("map") == steps.count("write") == steps.count("read source") == 1
        margin = each["orientation"]["runner_up"] - each["orientation"]["misfit"]
        assert each["orientation"]["margin"] == pytest.approx(margin)
    shown = re.findall("Warning: alternative-[23]: ", ended.err)
    assert len(shown) == sum(len(set(each["warnings"]) - set(reports[0]["warnings"])) for each in reports[1:])


def test_landmarks_of_two_files_are_met(homolog, files, tmp_path):
    at = np.array([5, 60, 120])
    np.savetxt(tmp_path / "a.txt", at, fmt="%d")
    wanted = np.argsort(files.order)[at]
    points = read_shape(files.other).points[wanted]
    np.savetxt(tmp_path / "b.csv", points, delimiter=",", header="x,y,z", comments="")
    out = tmp_path / "out"
    guide = ["--landmarks", tmp_path / "a.txt", tmp_path / "b.csv"]
    ended = homolog("match", files.mesh, files.other, "-o", out, "--method", "axiomatic", *guide)
    assert ended.code == 0
    np.testing.assert_array_equal(maps(out)["source_to_target"][at], wanted)
    assert report(out)["options"]["landmarks"]["source"] == at.tolist()
    # A way that has nothing to do with them is not the output's either.
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path / "a.txt", "--method", "axiomatic", *guide)
    assert ended.is_one_line_of_complaint()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--landmark-uncertainty", "1"], "--landmark-uncertainty is 1.0, but is about landmarks"),
        (["--axes", "RAS"], "--axes is RAS, but is about landmarks"),
        (["--landmarks", "gone.csv", "gone.csv"], "gone.csv cannot be read as landmarks"),
        (["--landmarks", "far.csv", "far.csv"], "the landmark '1' of the source is at (99, 99, 99)"),
        (["--landmarks", "many.txt", "many.txt"], "must be one of 0 to 161"),
    ],
)
def test_landmarks_that_cannot_guide_are_one_line(homolog, files, tmp_path, monkeypatch, options, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "far.csv").write_text("x,y,z\n99,99,99\n")
    (tmp_path / "many.txt").write_text("162\n")
    ended = homolog("match", files.mesh, files.other, "-o", "out", "--method", "axiomatic", *options)
    assert ended.is_one_line_of_complaint()
    assert said in ended.err
    assert not (tmp_path / "out").exists()


def test_masks_leave_points_out_of_a_match(homolog, files, tmp_path):
    low = read_shape(files.mesh).points[:, 1] < 0.5
    np.save(tmp_path / "mask.npy", low)
    (tmp_path / "mask.txt").write_text("\n".join(str(int(each)) for each in low[files.order]))
    masks = ("--source-mask", tmp_path / "mask.npy", "--target-mask", tmp_path / "mask.txt")
    ended = homolog("match", files.mesh, files.other, "-o", tmp_path / "out", "--method", "registration", *masks)
    assert ended.code == 0, ended.err
    assert (
        f"Note: source: {(~low).sum()} points outside the mask set apart, as {tmp_path / 'mask.npy'} says" in ended.err
    )
    found = maps(tmp_path / "out")
    assert (found["source_to_target"][~low] == -1).all() and low[files.order[found["source_to_target"][low]]].all()
    assert (found["target_to_source"][~low[files.order]] == -1).all()
    assert np.mean(files.order[found["source_to_target"][low]] == np.flatnonzero(low)) > 0.9


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("1\n0\n", "mask.csv has 2 numbers, but"),
        ("one\n1\ntwo\n", "mask.csv cannot be read as a mask: the line 'two' should hold"),
        ("0\n" * 162, "mask.csv leaves every point out"),
        ("-1\n" * 162, "mask.csv holds -1"),
        ("inf\n" * 162, "mask.csv holds inf"),
        (None, "mask.csv cannot be read as a mask"),
    ],
)
def test_masks_that_are_none_are_one_line(homolog, files, tmp_path, content, said):
    if content is not None:
        (tmp_path / "mask.csv").write_text(content)
    options = ("--method", "registration", "--target-mask", tmp_path / "mask.csv", "-o", tmp_path / "out")
    ended = homolog("match", files.mesh, files.other, *options)
    assert ended.is_one_line_of_complaint() and said in ended.err
    assert not (tmp_path / "out").exists()
