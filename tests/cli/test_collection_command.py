"""``homolog collection``: files to a folder, its lines and exit codes, and what it does when it is stopped."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest

from homolog.cli import collection
from homolog.pairs import Candidate, read_mask
from homolog.shapes import Shape, read_shape, write_shape

pytest.importorskip("h5py")
pytest.importorskip("matplotlib")
pytest.importorskip("PIL")
pytestmark = pytest.mark.usefixtures("small_sheets")
LOOKED_AT = [
    "shapes",
    "matches",
    "points.npy",
    "quality.csv",
    "contact_sheet.png",
    "report.json",
    "model",
    "shapeworks",
    "scalismo",
]
OPTIONS = ("--method", "axiomatic", "--processes", 1)

# A collection that stops in its second shape, says so, and waits to be interrupted.
STUCK = """
import time
from homolog.shape_models import Template

registered_to, calls = Template.registered_to, []

def slow(self, *args, **kwargs):
    calls.append(1)
    if len(calls) > 1:
        print("working", flush=True)
        time.sleep(120)
    return registered_to(self, *args, **kwargs)

Template.registered_to = slow
from homolog.cli.main import main
main()
"""


@pytest.fixture(scope="module")
def shapes(tmp_path_factory, make):
    """A template and two shapes like it."""
    root, blob = tmp_path_factory.mktemp("shapes"), make.blob(2)
    write_shape(root / "template.off", blob)
    for number in (1, 2):
        order = np.random.default_rng(number).permutation(blob.n_points)
        other = make.relabelled(blob, order)
        write_shape(root / f"{number}.ply", Shape(other.points * [1, 1 + number / 10, 1], other.faces))
    return root / "template.off", root / "1.ply", root / "2.ply"


def test_files_to_a_folder_and_on(homolog, shapes, tmp_path):
    out = tmp_path / "new" / "out"
    ended = homolog("collection", *shapes, "-o", out, *OPTIONS)
    assert ended.code == 0, ended.err
    assert ended.out.splitlines() == [str(out / name) for name in LOOKED_AT]
    assert ended.err == "Registered 2 of 2 shapes: 0 failed, 0 with warnings.\n"
    points = np.load(out / "points.npy")
    np.testing.assert_array_equal(read_shape(out / "shapes" / "2.ply").points, points[1])
    report = json.loads((out / "report.json").read_text())
    assert report["shapes"] == ["1", "2"] and report["command"][:2] == ["homolog", "collection"]
    assert report["inputs"]["template"] == str(shapes[0])
    written = (out / "shapes" / "1.ply").stat().st_mtime_ns
    ended = homolog("collection", *shapes[:2], "-o", out, *OPTIONS, "--scale")
    assert ended.code == 0 and (out / "shapes" / "1.ply").stat().st_mtime_ns == written
    assert "Not given this time, and not counted: 1 of the shapes in" in ended.err
    assert np.load(out / "points.npy").shape[0] == 1
    assert homolog("collection", *shapes, "-o", out, *OPTIONS, "-q").err == ""
    for option in (("--orient", "given"), ("--clutter", "keep"), ("--proxy", "always")):
        ended = homolog("collection", *shapes, "-o", out, *OPTIONS, *option)
        assert ended.is_one_line_of_complaint() and "made in another way (matching)" in ended.err


def test_landmarks_and_the_page_of_each_shape(homolog, shapes, tmp_path):
    out, marks, page = tmp_path / "out", tmp_path / "marks.json", tmp_path / "page.html"
    top = read_shape(shapes[0]).points.max(axis=0)
    for first in ([50, 0, 0], (0.99 * top).tolist()):
        marks.write_text(json.dumps([{"id": "low", "coordinates": first}, {"id": "top", "coordinates": top.tolist()}]))
        ended = homolog("collection", *shapes, "-o", out, *OPTIONS, "--landmarks", marks)
        if first[0] == 50:
            assert ended.is_one_line_of_complaint() and not out.exists()
            assert "a landmark of marks.json is 48.9 away from the template's surface; give" in ended.err
    assert ended.code == 0, ended.err
    assert str(out / "landmarks.csv") in ended.out.splitlines()
    assert [each["id"] for each in json.loads((out / "landmarks" / "2.json").read_text())] == ["low", "top"]
    ended = homolog("view", out, "--shape", "2", "--html", page)
    assert (ended.code, ended.out) == (0, f"{page}\n")
    alone = tmp_path / "alone.html"
    assert homolog("view", out / "matches" / "2", "--html", alone).code == 0
    assert alone.read_bytes() == page.read_bytes()
    for arguments, told in (
        ([out], "is a collection; say which of its shapes"),
        ([out, "--shape", "3"], "'3'"),
        ([shapes[0].parent, "--shape", "2"], "is no collection"),
        ([out / "matches" / "2", "--shape", "2"], "is no collection"),
    ):
        ended = homolog("view", *arguments, "--html", page)
        assert ended.is_one_line_of_complaint() and told in ended.err
    ended = homolog("collection", *shapes, "-o", tmp_path / "no", *OPTIONS, "--landmarks", tmp_path / "none.csv")
    assert ended.is_one_line_of_complaint() and "none.csv cannot be read as landmarks" in ended.err
    assert not (tmp_path / "no").exists()


def test_masks_of_the_template_and_of_shapes(homolog, shapes, tmp_path):
    out, low = tmp_path / "out", read_shape(shapes[0]).points[:, 1] < 0.7
    np.save(tmp_path / "low.npy", low)
    (tmp_path / "masks").mkdir()
    np.save(tmp_path / "masks" / "2.npy", np.ones(len(low)))
    masks = ("--template-mask", tmp_path / "low.npy", "--masks", tmp_path / "masks")
    ended = homolog("collection", *shapes, "-o", out, *OPTIONS, *masks)
    assert ended.code == 0, ended.err
    np.testing.assert_array_equal(read_mask(out / "model" / "mean.ply").kept, low)
    report = json.loads((out / "report.json").read_text())
    assert report["template"]["points_left_out"] == (~low).sum()
    assert report["masks"] == {"2": str(tmp_path / "masks" / "2.npy")}
    assert len(np.loadtxt(out / "shapeworks" / "particles" / "1_local.particles")) == low.sum()
    for options, told in (
        (("--template-mask", tmp_path / "none.npy"), "none.npy cannot be read as a mask"),
        (("--masks", tmp_path), "has no mask of any of the shapes"),
    ):
        ended = homolog("collection", *shapes, "-o", tmp_path / "no", *OPTIONS, *options)
        assert ended.is_one_line_of_complaint() and told in ended.err
        assert not (tmp_path / "no").exists()


def test_a_bad_shape_is_a_line_and_the_exit_code(homolog, shapes, files, tmp_path):
    out = tmp_path / "out"
    ended = homolog("collection", *shapes, files.rubbish, "-o", out, *OPTIONS)
    assert ended.code == 2
    first, last = ended.err.splitlines()
    assert first.startswith("Error: ") and str(files.rubbish) in first
    assert last == "Registered 2 of 3 shapes: 1 failed, 0 with warnings."
    assert len(ended.out.splitlines()) == len(LOOKED_AT)
    assert list(json.loads((out / "report.json").read_text())["not_registered"]) == ["rubbish"]
    again = homolog("collection", *shapes, files.rubbish, tmp_path / "none.ply", "-o", out, *OPTIONS)
    assert again.code == 2 and f"Error: {tmp_path / 'none.ply'} does not exist" in again.err
    assert again.err.endswith("Registered 2 of 4 shapes: 2 failed, 0 with warnings.\n")
    only = homolog("collection", shapes[0], files.rubbish, "-o", tmp_path / "none", *OPTIONS)
    assert only.code == 2 and only.err.count("\n") == 2 and "none of the 1 shapes could be registered" in only.err
    assert str(files.rubbish) in (tmp_path / "none" / "quality.csv").read_text()


def test_mistakes_are_one_line(homolog, shapes, files, tmp_path):
    template, one, two = shapes
    out = tmp_path / "out"
    for arguments, told in (
        ([template], "no shapes are given; give at least one file"),
        ([template, one, one], "would both be called '1'"),
        ([tmp_path / "none.ply", one], "does not exist"),
        ([files.rubbish, one], "could not be read"),
        ([files.dirty, one], "points that can have no counterpart"),
        ([template, one, "--weights", tmp_path / "none.safetensors"], "there are no weights"),
        ([template, one, "--method", "magic"], "magic"),
        ([template, one, "--as-cloud", "source"], "source"),
        ([template, one, "--processes", 0], "processes"),
    ):
        ended = homolog("collection", *arguments, "-o", out)
        assert ended.is_one_line_of_complaint() and told in ended.err.lower().replace(str(tmp_path).lower(), ""), (
            ended.err
        )
        assert not out.exists()
    ended = homolog("collection", template, two, "-o", template)
    assert ended.is_one_line_of_complaint() and "is a file" in ended.err
    ended = homolog("collection", template, two, "-o", template.parent)
    assert ended.is_one_line_of_complaint() and "lies in" in ended.err
    (tmp_path / "others").mkdir()
    (tmp_path / "others" / "thing.txt").write_text("")
    ended = homolog("collection", template, two, "-o", tmp_path / "others")
    assert ended.is_one_line_of_complaint() and "holds other things" in ended.err


def test_shapes_in_the_folder_of_the_result_are_refused_and_stay(homolog, shapes, tmp_path):
    output = tmp_path / "out"
    (output / "shapes").mkdir(parents=True)
    inside = output / "shapes" / "mine.ply"
    inside.write_bytes(b"broken, but the user's own")
    ended = homolog("collection", shapes[0], inside, shapes[1], "-o", output)
    assert ended.is_one_line_of_complaint() and "mine.ply lies in" in ended.err
    assert inside.read_bytes() == b"broken, but the user's own"


def test_without_its_extra(homolog, shapes, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    ended = homolog("collection", *shapes, "-o", tmp_path / "out", *OPTIONS)
    assert ended.is_one_line_of_complaint() and "homolog[collection]" in ended.err
    assert not (tmp_path / "out").exists()


@pytest.mark.process
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")
def test_an_interrupt_keeps_what_is_done(homolog, shapes, tmp_path):
    out = tmp_path / "out"
    command = [sys.executable, "-c", STUCK, "collection", *map(str, shapes), "-o", str(out), *map(str, OPTIONS)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "working\n"
            process.send_signal(signal.SIGINT)
            shown, complaint = process.communicate(timeout=120)
        finally:
            process.kill()
    assert (process.returncode, shown) == (130, "")
    assert complaint == "Interrupted; nothing was left half-written.\n"
    files = sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file())
    match = [f"matches/1/{name}" for name in ("correspondence.npz", "report.json", "source.ply", "target.ply")]
    assert files == ["manifest.json", *match, "records/1.json", "shapes/1.ply"]
    written = (out / "shapes" / "1.ply").stat().st_mtime_ns
    assert homolog("collection", *shapes, "-o", out, *OPTIONS).code == 0
    assert (out / "shapes" / "1.ply").stat().st_mtime_ns == written


@pytest.mark.parametrize(
    ("choice", "told"),
    [
        (
            [("people", 0.05, None)],
            "All shapes are matched with the weights people, which know them best (misfit 0.05).",
        ),
        (
            [("registration", None, None), ("hands", 0.2, None)],
            "All shapes are matched by registration: they are nearly rigid copies.",
        ),
        (
            [("axiomatic", None, 0.3), ("hands", 0.2, 0.5)],
            "All shapes are matched by axiomatic: its maps have the least misfit, 0.30 (hands 0.50).",
        ),
        (
            [("registration", None, 0.7), ("hands", 0.2, None)],
            "All shapes are matched by registration: its maps hardly contradict themselves (misfit 0.70).",
        ),
    ],
)
def test_what_all_shapes_are_matched_by(choice, told):
    assert collection._of_choice([Candidate(*each) for each in choice]) == told
