"""``homolog evaluate``, ``info``, ``doctor``, ``demo``, and help."""

import hashlib
import json
import os
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import homolog as homolog_package
from homolog.cli import doctor as doctor_module
from homolog.cli.options import check_file
from homolog.core.errors import ArgumentError, DataError
from homolog.matching import Match, Matcher
from homolog.pairs import Preprocessor
from homolog.shapes import Shape, read_shape, upright_rotation, write_shape
from homolog.training import adapt_if_better

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

COMMANDS = ["match", "view", "transfer", "train", "evaluate", "reconstruct", "info", "doctor", "demo"]


@pytest.fixture
def data(tmp_path, make):
    """Two relabelled copies of one blob with ground truth for 50 points."""
    blob, root = make.blob(2), tmp_path / "data"
    (root / "off").mkdir(parents=True)
    (root / "corres").mkdir()
    for seed, name in enumerate(("one", "two")):
        order = np.random.default_rng(seed).permutation(blob.n_points)
        write_shape(root / "off" / f"{name}.off", make.relabelled(blob, order))
        (root / "corres" / f"{name}.vts").write_text("\n".join(map(str, np.argsort(order)[:50] + 1)))
    return root


def strictly(text):
    """JSON without NaN and the like, which other languages refuse."""

    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


def test_evaluate(homolog, data, tmp_path):
    json = ["--json", str(tmp_path / "score.json")]
    ended = homolog("evaluate", data, "--method", "axiomatic", *json)
    assert ended.code == 0
    assert ended.err == ""
    assert "mean geodesic error x100" in ended.out
    assert re.search(r"pairs exchanged left-right, turned over +. +0, 0 of 4", ended.out)
    found = strictly((tmp_path / "score.json").read_text())
    promised = ["mean_geodesic_error", "median_geodesic_error", "pck_auc", "pck_threshold", "pck", "pairs", "seconds"]
    for key in [*promised, "protocol", "features", "versions", "command", "data", "settings", "device", "method"]:
        assert key in found
    assert found["mean_geodesic_error"] < 1
    different = [pair["mean_geodesic_error"] for pair in found["pairs"] if pair["source"] != pair["target"]]
    assert found["mean_geodesic_error_without_self_pairs"] == pytest.approx(sum(different) / 2)
    assert re.search("without pairs of a shape with itself", ended.out)
    assert found["pck_auc"] > 0.9
    assert len(found["pairs"]) == 4
    assert [pair["points"] for pair in found["pairs"]] == [50] * 4
    assert len(found["pck"]["thresholds"]) == len(found["pck"]["shares"])
    assert found["protocol"] == {
        "modality": "mesh",
        "split": "test",
        "pairs_file": None,
        "n_pairs": None,
        "partial": False,
        "part_units": 1.0,
        "pre_aligned": False,
        "noise": 0.0,
        "outliers": 0.0,
        "outlier_kind": "box",
        "background": "none",
        "clutter": "remove",
        "proxy": "auto",
        "turn": "none",
        "orient": "auto",
        "landmarks": 0,
        "seed": 0,
    }
    assert found["features"]["name"] == "axiomatic"
    assert found["command"] == ["homolog", "evaluate", str(data), "--method", "axiomatic", *json]
    assert found["versions"]["homolog"]
    assert f"{found['mean_geodesic_error']:.2f}" in ended.out


def test_evaluate_shapes_that_lie(homolog, data, files, tmp_path):
    """With weights, which know upright shapes alone, ``--up`` gives the score of the shapes as they stood."""
    two = read_shape(data / "off" / "two.off")
    write_shape(data / "off" / "two.off", replace(two, points=two.points * [1.0, 1.5, 0.7]))
    shutil.copytree(data, tmp_path / "lying")
    for file in (tmp_path / "lying" / "off").iterdir():
        shape = read_shape(file)
        write_shape(file, replace(shape, points=shape.points @ upright_rotation("z")))
    scores = []
    for folder, up in ((data, "y"), (tmp_path / "lying", "z"), (tmp_path / "lying", "y")):
        options = ["--weights", files.weights, "--up", up, "--json", tmp_path / "score.json"]
        assert homolog("evaluate", folder, *options).code == 0
        scores.append(json.loads((tmp_path / "score.json").read_text())["mean_geodesic_error"])
    assert scores[1] == pytest.approx(scores[0], abs=1e-6) and scores[2] != pytest.approx(scores[0], abs=1e-6)


def test_evaluate_with_weights_and_all_options(homolog, data, files, tmp_path):
    (tmp_path / "pairs.txt").write_text("two,one\n")
    options = ["--modality", "cloud", "--noise", "0.1", "--seed", "3", "--pairs", tmp_path / "pairs.txt", "--quiet"]
    for name in ("first", "second"):
        ended = homolog("evaluate", data, "-q", "--weights", files.weights, *options, "--json", tmp_path / name)
        assert (ended.code, ended.out, ended.err) == (0, "", "")
    first, second = (strictly((tmp_path / name).read_text()) for name in ("first", "second"))
    assert first["features"]["sha256"] == hashlib.sha256(files.weights.read_bytes()).hexdigest()
    assert first["protocol"]["noise"] == 0.1
    assert first["protocol"]["seed"] == 3
    assert [(pair["source"], pair["target"]) for pair in first["pairs"]] == [("two", "one")]
    assert first["method"] == "nearest-features"
    assert first["mean_geodesic_error"] == second["mean_geodesic_error"] > 0


@pytest.mark.slow
def test_evaluate_with_settings_and_options_that_win(homolog, data, tmp_path):
    (tmp_path / "own.toml").write_text('method = "axiomatic"\n[axiomatic]\nn_eigenpairs = 12\n')
    scores = [tmp_path / "first.json", tmp_path / "again.json", tmp_path / "refined.json"]
    own = ["--settings", tmp_path / "own.toml", "--no-refinement"]
    for options, score in ((own, 0), (["--settings", scores[0]], 1), (["--settings", scores[0], "--refinement"], 2)):
        assert homolog("evaluate", data, "-q", *options, "--json", scores[score]).code == 0
    first, again, refined = (strictly(score.read_text())["settings"] for score in scores)
    assert first == again and (first["axiomatic"]["n_eigenpairs"], first["refinement"]) == (12, None)
    assert refined["refinement"] is not None and {**refined, "refinement": None} == first


def test_evaluate_adapts_to_each_pair(homolog, data, files, tmp_path, monkeypatch):
    adapted = []

    def noted(matcher, pair, settings):
        adapted.append((matcher.extractor.info.name, settings.steps, pair.options.partial))
        return adapt_if_better(matcher, pair, settings)

    monkeypatch.setattr(homolog_package.training, "adapt_if_better", noted)
    options = "-q", "--weights", files.weights, "--adapt", 2, "--json", tmp_path / "adapted.json"
    assert homolog("evaluate", data, *options).code == 0
    assert adapted == [("untrained", 2, None)] * 4
    figures = json.loads((tmp_path / "adapted.json").read_text())
    told = [pair["adaptation"] for pair in figures["pairs"]]
    assert figures["adapt"] == 2 and figures["adapted_pairs"] == sum(each["kept"] for each in told)
    assert all(each["kept"] == (each["adapted_map_misfit"] < each["map_misfit"]) for each in told)
    assert homolog("evaluate", data, "--partial", *options).code == 0
    assert adapted[4:] == [("untrained", 2, "target")] * 4


@pytest.mark.slow
def test_evaluate_on_pairs_drawn_at_random(homolog, data, tmp_path):
    for name in ("first", "second"):
        ended = homolog("evaluate", data, "--n-pairs", 1, "--seed", 4, "--json", tmp_path / name)
        assert ended.code == 0
    first, second = (strictly((tmp_path / name).read_text()) for name in ("first", "second"))
    assert first["pairs"] == second["pairs"]
    assert (first["protocol"]["n_pairs"], first["protocol"]["seed"]) == (1, 4)
    assert {first["pairs"][0]["source"], first["pairs"][0]["target"]} == {"one", "two"}


def with_long_truth(data):
    (data / "corres" / "one.vts").write_text("163\n" * 50)
    return data


def with_split(data, text):
    (data / "test.txt").write_text(text)
    return data


def without_faces(data):
    (data / "off" / "one.off").write_text("OFF\n5 0 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 1 1\n")
    (data / "corres" / "one.vts").write_text("5\n" * 50)
    return data


MISTAKES = {
    "no folder": (lambda d, t: [t / "gone"], "there is no folder"),
    "noise on meshes": (lambda d, t: [d, "--noise", "0.01"], "--noise is for clouds, but --modality is 'mesh'"),
    "weights": (lambda d, t: [d, "--weights", "gone.pth"], "there are no weights"),
    "empty split": (lambda d, t: [d, "--split", "train"], "no shapes in split 'train'"),
    "blank split": (lambda d, t: [with_split(d, "\n")], "no shapes in split 'test'"),
    "unknown name": (lambda d, t: [with_split(d, "three")], "names 'three'"),
    "no pairs": (lambda d, t: [d, "--pairs", t / "gone.txt"], "no such list of pairs"),
    "truth": (lambda d, t: [with_long_truth(d)], "names vertex 163"),
    "no faces": (lambda d, t: [without_faces(d)], "one.off has no faces"),
    "too many drawn": (lambda d, t: [d, "--n-pairs", 3], "--n-pairs is 3, but"),
    **{
        f"maps and {words[0]}": (
            lambda d, t, words=words: [d, "--maps", d, *words],
            f"--maps scores maps that are there already, so that {words[0]} has no effect; leave it out",
        )
        for words in (
            ["--method", "axiomatic"],
            ["--weights", "people"],
            ["--adapt", 3],
            ["--turn", "any"],
            ["--orient", "given"],
            ["--noise", 0.1],
            ["--device", "cpu"],
            ["--no-cache"],
            ["--pre-aligned"],
        )
    },
    "base alone": (lambda d, t: [d, "--base", 1], "--base is 1, but is about the files of --maps"),
    "registration of parts": (
        lambda d, t: [d, "--method", "registration", "--partial"],
        "--partial is 'target', but the method 'registration' matches full shapes",
    ),
    "json folder": (lambda d, t: [d, "--json", t / "gone" / "score.json"], "cannot be written"),
    "json is folder": (lambda d, t: [d, "--json", t], "cannot be written"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line(homolog, data, tmp_path, mistake):
    arguments, said = MISTAKES[mistake]
    given = arguments(data, tmp_path)
    place = [] if "--json" in given else ["--json", tmp_path / "score.json"]
    ended = homolog("evaluate", *given, *place)
    assert ended.is_one_line_of_complaint(), ended
    assert said in ended.err
    assert not (tmp_path / "score.json").exists()


def test_a_place_for_the_score_is_asked_for_first(homolog, data, tmp_path, monkeypatch):
    monkeypatch.setattr(Preprocessor, "__call__", None)
    assert homolog("evaluate", data, "--json", tmp_path / "gone" / "x.json").is_one_line_of_complaint()
    ended = homolog("evaluate", data, "--plot", tmp_path / "curve.jpg")
    assert ended.is_one_line_of_complaint(), ended
    assert "has the suffix '.jpg', but a plot must have one of .png, .pdf, .svg" in ended.err
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    ended = homolog("evaluate", data, "--plot", tmp_path / "curve.png")
    assert ended.is_one_line_of_complaint() and "pip install 'homolog[plot]'" in ended.err, ended


def test_the_figures_are_written_before_the_plot(homolog, data, tmp_path, monkeypatch):
    def fails(*given):
        raise ArgumentError("no plot today")

    monkeypatch.setattr(homolog_package.evaluation, "plot_pck", fails)
    pytest.importorskip("matplotlib", reason="matplotlib is missing; pip install 'homolog[plot]'")
    places = ["--json", tmp_path / "score.json", "--plot", tmp_path / "curve.png"]
    ended = homolog("evaluate", data, "--method", "axiomatic", *places)
    assert ended.code == 2 and "no plot today" in ended.err
    assert strictly((tmp_path / "score.json").read_text())["pairs"]


def forbidden(monkeypatch, folder):
    """Let a folder be one that may not be written to, also for the superuser."""
    may = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: not (mode & os.W_OK and path == folder) and may(path, mode))


@pytest.mark.parametrize("place", ["new.json", "old.json", "link.json"])
def test_a_place_that_may_not_be_written_to_is_refused_first(homolog, data, tmp_path, monkeypatch, place):
    monkeypatch.setattr(Preprocessor, "__call__", None)
    kept, linked = tmp_path / "kept", tmp_path / "linked"
    kept.mkdir()
    linked.mkdir()
    (kept / "old.json").write_text("old")
    (linked / "link.json").symlink_to(kept / "new.json")
    forbidden(monkeypatch, kept)
    ended = homolog("evaluate", data, "--json", (linked if place == "link.json" else kept) / place)
    assert ended.is_one_line_of_complaint()
    assert f"{place} cannot be written: {kept} is read-only" in ended.err
    assert [path.name for path in kept.iterdir()] == ["old.json"]
    assert (kept / "old.json").read_text() == "old"


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write everywhere")
def test_a_read_only_folder(homolog, data, tmp_path):
    (tmp_path / "kept").mkdir(mode=0o500)
    ended = homolog("evaluate", data, "--json", tmp_path / "kept" / "x.json")
    assert ended.is_one_line_of_complaint()


def test_places_that_no_file_can_take(homolog, data, tmp_path, monkeypatch):
    monkeypatch.setattr(Preprocessor, "__call__", None)
    os.mkfifo(tmp_path / "pipe")
    for place, said in ((tmp_path / "pipe", "no ordinary file"), (tmp_path / ("long" * 100), "too long")):
        ended = homolog("evaluate", data, "--json", place)
        assert ended.is_one_line_of_complaint()
        assert said in ended.err


def test_asking_for_a_place_leaves_no_trace(data, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    check_file(tmp_path / "new.json")
    (tmp_path / "old.json").write_text("old")
    check_file(tmp_path / "old.json")
    (tmp_path / "old.json").unlink()
    assert sorted(tmp_path.rglob("*")) == before


def test_negative_noise(homolog, data):
    ended = homolog("evaluate", data, "--modality", "cloud", "--noise", "-1")
    assert ended.code == 2
    assert "--noise" in ended.err


# ---- sets by their names


def test_evaluate_parts_as_their_set_has_them(homolog, parts_set, tmp_path, monkeypatch):
    """What the description says is taken where no option says otherwise."""
    root, _ = parts_set
    asked = []

    def noted(matcher, folder, protocol, **options):
        asked.append((folder.up, protocol.partial, protocol.pre_aligned, protocol.modality))
        raise DataError("enough")

    monkeypatch.setattr(homolog_package.evaluation, "evaluate", noted)
    for options in (
        [],
        ["--up", "x"],
        ["--full"],
        ["--not-pre-aligned"],
        ["--modality", "cloud"],
        ["--full", "--partial", "--pre-aligned"],
    ):
        assert homolog("evaluate", root, "--dataset", "shrec16_cuts", *options).is_one_line_of_complaint()
    assert asked == [
        ("z", True, True, "mesh"),
        ("x", True, True, "mesh"),
        ("z", False, False, "mesh"),
        ("z", True, False, "mesh"),
        ("z", True, True, "cloud"),
        ("z", True, True, "mesh"),
    ]
    ended = homolog("evaluate", root, "--dataset", "shrec16_cuts", "--full", "--pre-aligned")
    assert ended.is_one_line_of_complaint() and "--pre-aligned is for parts, but --partial is False" in ended.err
    assert "leave --pre-aligned out" in ended.err


def test_evaluate_parts(homolog, data, tmp_path):
    """The half of a blob against the whole, with the points that have no counterpart."""
    whole = read_shape(data / "off" / "one.off")
    for place in ("null", "cuts"):
        (tmp_path / place).mkdir()
    write_shape(tmp_path / "null" / "blob.off", whole)
    kept = np.flatnonzero(whole.points[:, 0] > -0.2)
    index = np.full(whole.n_points, -1)
    index[kept] = np.arange(len(kept))
    faces = index[whole.faces]
    write_shape(tmp_path / "cuts" / "cuts_blob_1.off", Shape(whole.points[kept], faces[(faces >= 0).all(axis=1)]))
    rows = [
        next((f + 1, *(whole.faces[f] == point)) for f in np.flatnonzero((whole.faces == point).any(axis=1)))
        for point in kept
    ]
    (tmp_path / "cuts" / "cuts_blob_1.baryc_gt").write_text("".join("{} {:d} {:d} {:d}\n".format(*row) for row in rows))
    ended = homolog("evaluate", tmp_path, "--dataset", "shrec16_cuts", "--json", tmp_path / "score.json")
    assert ended.code == 0, ended
    assert "shrec16_cuts, mesh, partial, pre-aligned" in ended.out
    found = strictly((tmp_path / "score.json").read_text())
    assert (found["dataset"], found["up"], found["pairs"][0]["points"]) == ("shrec16_cuts", "z", len(kept))
    figures = found["without_counterpart"]
    assert figures["true"] > 10
    assert f"precision {figures['precision']:.3f}, recall {figures['recall']:.3f}, F1 {figures['f1']:.3f}" in ended.out


def test_evaluate_clouds_in_their_own_unit(homolog, clouds_set, tmp_path, caplog):
    root, _ = clouds_set
    ended = homolog("evaluate", root, "--dataset", "lungs", "--n-pairs", 1, "--json", tmp_path / "score.json")
    assert ended.code == 0, ended
    assert "has 3 shapes, but lungs has 48; homolog data check lungs says which differ." in caplog.text
    found = strictly((tmp_path / "score.json").read_text())
    assert (found["unit"], found["protocol"]["modality"]) == ("mm", "cloud")
    assert f"mean euclidean error in mm │ {found['mean_euclidean_error']:.2f}" in " ".join(ended.out.split())
    assert "geodesic" not in ended.out


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("shrec16", r"set is 'shrec16', but must be one of .*did you mean 'shrec1"),
        ("shrec16_cuts", r"no shapes; put them at .*cuts/NAME\.off"),
        ("luna16", "holds volumes; make surfaces of them with homolog volume surface"),
        ("surreal_5k", "no shapes in split 'test'; use another split, or 'all'"),
    ],
)
def test_sets_that_are_not_there_are_one_line(homolog, data, name, said, caplog):
    ended = homolog("evaluate", data, "--dataset", name, "--quiet")
    assert ended.is_one_line_of_complaint(), ended
    assert re.search(said, ended.err)


# ---- info


def test_info(homolog, files):
    ended = homolog("info", files.mesh, files.dirty, files.cloud)
    assert (ended.code, ended.err) == (0, "")
    for words in ("mesh.off", "162", "165, 162 after repair", "2 duplicate points", "cloud.xyz", "surface area"):
        assert words in ended.out


def test_info_names_files_in_full(homolog, files, tmp_path):
    """Paths longer than the table is wide."""
    deep = [tmp_path / ("deep" * 20) / name for name in ("[red]one.off", "two.off")]
    deep[0].parent.mkdir(parents=True)
    for file in deep:
        shutil.copy(files.mesh, file)
    assert [line for line in homolog("info", *deep).out.splitlines() if ".off" in line] == list(map(str, deep))


def test_info_as_json(homolog, files, tmp_path):
    ended = homolog("info", "--json", "-", files.mesh, tmp_path / "gone.ply", files.dirty)
    assert ended.code == 2
    assert ended.err.count("\n") == 1
    mesh, gone, dirty = strictly(ended.out)
    assert mesh["file"] == str(files.mesh)
    assert (mesh["n_points"], mesh["n_faces"], mesh["usable"], mesh["format"]) == (162, 320, True, "OFF")
    assert "does not exist" in gone["error"]
    assert dirty["n_clean_points"] == 162


def test_figures_go_to_a_file_or_in_place_of_the_table(homolog, data, files, tmp_path):
    for command in (["info", files.mesh], ["evaluate", data, "--method", "axiomatic"]):
        shown, printed = (homolog(*command, "--json", place) for place in (tmp_path / "figures.json", "-"))
        assert (shown.code, printed.code) == (0, 0)
        assert "│" in shown.out and "│" not in printed.out
        written, on_stdout = strictly((tmp_path / "figures.json").read_text()), strictly(printed.out)
        for figures in (written, on_stdout):
            if isinstance(figures, dict):  # what differs from run to run
                del figures["seconds"], figures["command"]
        assert written == on_stdout
    assert homolog("info", files.mesh, "--json", tmp_path / "gone" / "x.json").is_one_line_of_complaint()


def test_info_on_bad_files_shows_the_good_ones(homolog, files, tmp_path):
    ended = homolog("info", files.rubbish, files.mesh, tmp_path / "gone.obj")
    assert ended.code == 2
    assert "mesh.off" in ended.out
    lines = ended.err.splitlines()
    assert len(lines) == 2
    assert "rubbish.ply" in lines[0]
    assert "gone.obj" in lines[1]
    assert all(line.startswith("Error: ") for line in lines)


def test_info_on_unusable_shapes(homolog, tmp_path):
    write_shape(tmp_path / "line.xyz", Shape(np.outer(np.arange(9.0), [1, 2, 3])))
    ended = homolog("info", tmp_path / "line.xyz")
    assert ended.code == 2
    assert "unusable" in ended.out
    assert "points on one line" in ended.out


def test_info_writes_nothing(homolog, files, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    homolog("info", files.mesh)
    assert list(tmp_path.iterdir()) == []


# ---- doctor, demo, help


def test_version(homolog):
    ended = homolog("--version")
    assert (ended.code, ended.out, ended.err) == (0, f"homolog {homolog_package.__version__}\n", "")


def test_doctor(homolog, tmp_path, monkeypatch):
    assert os.environ["HOMOLOG_CACHE"] in homolog("doctor").out
    monkeypatch.setenv("HOMOLOG_CACHE", str(tmp_path / "elsewhere"))
    monkeypatch.setenv("HOMOLOG_CACHE_GB", "3")
    ended = homolog("doctor")
    assert (ended.code, ended.err) == (0, "")
    assert f"{tmp_path / 'elsewhere'} (HOMOLOG_CACHE): 0 shapes, 0 MB of at most 3072" in ended.out
    for word in ("homolog", "torch", "numpy", "python", "extra 'vtk'", "pretrained weights", "working memory"):
        assert word in ended.out
    assert "CUDA devices" not in ended.out  # PyTorch knows them, and takes long to load
    assert re.search("threads used .*\nCUDA devices ", homolog("doctor", "--torch").out)
    assert not (tmp_path / "elsewhere").exists()


def test_doctor_says_what_is_wrong_with_the_cache(homolog, monkeypatch):
    monkeypatch.setenv("HOMOLOG_CACHE_GB", "much")
    ended = homolog("doctor")
    assert ended.code == 2
    assert ended.err.count("\n") == 1
    assert "HOMOLOG_CACHE_GB is 'much'" in ended.err


@pytest.mark.slow
def test_demo(homolog, tmp_path):
    ended = homolog("demo", "-o", tmp_path / "demo")
    assert ended.code == 0, ended
    row = next(line for line in ended.out.splitlines() if "mean geodesic error" in line)
    assert 0 < float(row.split()[-2]) < 5
    assert "left and right" in ended.out
    assert "mixed up" not in ended.out
    names = {"correspondence.npz", "source.ply", "target.ply", "report.json"}
    assert {path.name for path in (tmp_path / "demo").iterdir()} == names
    assert str(tmp_path / "demo" / "report.json") in ended.out


@pytest.mark.slow
def test_demo_fails_if_the_maps_are_bad(homolog, tmp_path, monkeypatch):
    """Every point to one: the error is far above the bound, and left and right are mixed up."""

    def bad(self, pair):
        return Match(
            pair.source.given, pair.target.given, *(np.zeros(shape.given.n_points, int) for shape in sides_of(pair))
        )

    def sides_of(pair):
        return pair.source, pair.target

    find = Matcher.find
    monkeypatch.setattr(Matcher, "find", lambda *given: replace(bad(*given), report=find(*given).report))
    ended = homolog("demo", "-o", tmp_path / "demo", "--quiet")
    assert ended.code == 1
    assert ended.out == ""
    assert "something is wrong" in ended.err


@pytest.mark.parametrize(
    "command", [*COMMANDS, "synth views", "synth meshings", "synth part", "data list", "data show", "data check"]
)
def test_help_shows_an_example(homolog, command):
    ended = homolog(*command.split(), "--help")
    assert (ended.code, ended.err) == (0, "")
    assert re.search(f"Usage: .*homolog {command}", ended.out)
    assert "Example" in ended.out
    assert ended.out.count(f"homolog {command}") >= 2


def test_help_names_every_command(homolog):
    ended = homolog("--help")
    assert ended.code == 0
    for command in [*COMMANDS, "synth", "data"]:
        assert f" {command} " in ended.out


def test_no_arguments_show_the_help(homolog):
    ended = homolog()
    assert re.search("Usage: .*homolog", ended.out + ended.err)
    assert ended.code in (0, 2)


def test_doctor_knows_every_extra_and_its_packages(homolog):
    """Those of pyproject.toml, without the ones that only gather others."""
    file = Path(__file__).parents[2] / "pyproject.toml"
    if not file.is_file():
        pytest.skip("the project's file is not beside the tests")
    extras = tomllib.loads(file.read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    names = {
        extra: [re.match(r"[\w-]+", line).group() for line in lines]
        for extra, lines in extras.items()
        if not any(line.startswith("homolog[") for line in lines)
    }
    assert {extra: set(packages) for extra, packages in doctor_module._EXTRAS.items()} == {
        extra: set(packages) for extra, packages in names.items()
    }
    said = homolog("doctor").out
    for extra in names:
        assert f"extra '{extra}'" in said
