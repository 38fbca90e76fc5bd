"""``homolog view``: the page, what colours it has, the server, and what is refused."""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import urllib.request

import numpy as np
import pytest

from homolog.cli import browsing
from homolog.matching import Match
from homolog.shapes import read_shape

PLAIN = ("--method", "axiomatic", "--orient", "given")


@pytest.fixture
def result(homolog, files, tmp_path):
    """What a match of a mesh and a cloud wrote."""
    assert homolog("match", files.mesh, files.other, *PLAIN, "-o", tmp_path / "result").code == 0
    return tmp_path / "result"


@pytest.fixture
def truth(files, tmp_path):
    """The true common points of the two files, in two files."""
    paths = tmp_path / "source.vts", tmp_path / "target.vts"
    for path, vertices in zip(paths, (files.order, np.arange(162)), strict=True):
        path.write_text("".join(f"{vertex + 1}\n" for vertex in vertices))
    return paths


def scene_of(page):
    scene = re.search(r'id="scene">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL)
    return json.loads(scene.group(1))


def layers_of(page, number=0):
    return {layer["name"]: layer for layer in scene_of(page)["maps"][number]["layers"]}


def test_page(homolog, result, tmp_path):
    page = tmp_path / "page.html"
    ended = homolog("view", result, "--html", page)
    assert (ended.code, ended.out, ended.err) == (0, f"{page}\n", "")
    assert "<title>mesh.off → other.obj</title>" in page.read_text(encoding="utf-8")
    assert list(layers_of(page)) == ["Match", "Confidence"]


def test_match_writes_the_same_page(homolog, result, files, tmp_path):
    of_view, of_match = tmp_path / "view.html", tmp_path / "match.html"
    assert homolog("view", result, "--html", of_view).code == 0
    ended = homolog("match", files.mesh, files.other, *PLAIN, "-o", tmp_path / "again", "--html", of_match)
    assert ended.code == 0 and ended.out.splitlines()[-1] == str(of_match)
    assert of_match.read_bytes() == of_view.read_bytes()
    ended = homolog(
        "match", files.mesh, files.other, "-o", tmp_path / "no", "--html", tmp_path / "absent" / "page.html"
    )
    assert ended.is_one_line_of_complaint()
    assert not (tmp_path / "no").exists()


def test_a_result_is_shown_with_its_alternatives(homolog, truth, files, tmp_path):
    """As the page that the match itself wrote; and with the error of each."""
    of_match, of_view, result = tmp_path / "match.html", tmp_path / "view.html", tmp_path / "result"
    method = ("--method", "registration", "--orient", "auto")
    assert (
        homolog("match", files.mesh, files.other, "-o", result, *method, "--alternatives", 2, "--html", of_match).code
        == 0
    )
    assert homolog("view", result, "--html", of_view).code == 0
    assert of_view.read_bytes() == of_match.read_bytes()
    first, second = scene_of(of_view)["maps"]
    assert first["name"] == "1: the likeliest" and re.match(r"2: .*turned by \d+°$", second["name"])
    misfit = json.loads((result / "alternative-2" / "report.json").read_text())["orientation"]["misfit"]
    assert second["note"].startswith(f"Misfit {misfit:.3f}, ") and second["note"].endswith("folder alternative-2.")
    assert homolog("view", result, "--html", of_view, "--truth", *truth).code == 0
    ramps = [layers_of(of_view, number)["Error"]["ramp"]["high"] for number in (0, 1)]
    assert ramps[1] > ramps[0]
    (result / "alternative-2" / "report.json").unlink()
    ended = homolog("view", result, "--html", of_view)
    assert ended.is_one_line_of_complaint() and "alternative-2 has no report.json" in ended.err


def test_the_command_on_the_page_matches_by_its_landmarks(homolog, files, tmp_path, monkeypatch):
    """Whatever was said of the pair, with files as the page saves them; the new page then shows the landmarks."""
    monkeypatch.chdir(tmp_path)
    said = ("--method", "registration", "--orient", "given", "--clutter", "keep", "--proxy", "never")
    assert homolog("match", files.mesh, files.other, "-o", "first", *said, "--html", "first.html").code == 0
    guide = scene_of(tmp_path / "first.html")["guide"]
    assert guide["known"] == []
    at, wanted = [5, 60], np.argsort(files.order)[[5, 60]].tolist()
    for name, file, points in zip(guide["files"], (files.mesh, files.other), (at, wanted), strict=True):
        labelled = enumerate(read_shape(file).points[points].tolist(), 1)
        controls = [
            {"label": str(number), "position": place, "positionStatus": "defined"} for number, place in labelled
        ]
        (tmp_path / name).write_text(
            json.dumps({"markups": [{"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": controls}]})
        )
    program, *words = shlex.split(guide["command"])
    assert program == "homolog" and homolog(*words).code == 0
    assert Match.load("guided").source_to_target[at].tolist() == wanted
    options = [json.loads((tmp_path / name / "report.json").read_text())["options"] for name in ("first", "guided")]
    assert options[0] == {**options[1], "landmarks": None}
    known = scene_of(tmp_path / "guided.html")["guide"]["known"]
    assert [[end["index"] for end in each["ends"]] for each in known] == [
        list(pair) for pair in zip(at, wanted, strict=True)
    ]


def test_page_with_all_layers(homolog, result, truth, files, tmp_path):
    page = tmp_path / "page.html"
    ended = homolog("view", result, "--html", page, "--truth", *truth, "--weights", files.weights, "-q")
    assert (ended.code, ended.err) == (0, "")
    layers = layers_of(page)
    assert list(layers) == ["Match", "Confidence", "Error", "Features"]
    assert layers["Error"]["ramp"]["unit"] == "% of √area"


def test_what_is_refused(homolog, result, truth, files, tmp_path):
    page = tmp_path / "page.html"
    short = tmp_path / "short.vts"
    short.write_text("1\n2\n")
    beyond = tmp_path / "beyond.vts"
    beyond.write_text("1\n" * 161 + "163\n")
    nothing = tmp_path / "nothing.vts"
    nothing.write_text("-1\n" * 162)
    for arguments, said in (
        ([tmp_path], "no correspondence.npz"),
        ([tmp_path / "absent"], "there is no folder"),
        ([result, "--truth", short, truth[1]], "line i must be the same point"),
        ([result, "--truth", truth[0], beyond], "names vertex 163, but the shape has 162"),
        ([result, "--truth", truth[0], nothing], "no point in common"),
        ([result, "--truth", truth[0], tmp_path / "absent.vts"], "absent.vts"),
        ([result, "--weights", files.rubbish], "rubbish.ply"),
    ):
        ended = homolog("view", *arguments, "--html", page)
        assert ended.is_one_line_of_complaint(), ended.err
        assert said in ended.err
        assert not page.exists()
    ended = homolog("view", result, "--html", tmp_path / "absent" / "page.html")
    assert ended.is_one_line_of_complaint()
    assert "create it first" in ended.err


@pytest.mark.parametrize(
    ("option", "value"), [("--host", "no such host"), ("--host", "203.0.113.7"), ("--port", "70000")]
)
def test_addresses_that_cannot_be_listened_on(homolog, result, option, value):
    ended = homolog("view", result, option, value)
    assert ended.is_one_line_of_complaint()
    assert option.strip("-") in ended.err


@pytest.mark.process
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")
def test_the_server_prints_its_address_and_ends_by_ctrl_c(result):
    command = [sys.executable, "-m", "homolog", "view", str(result), "--port", "0", "--no-open"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            address = process.stdout.readline().strip()
            assert re.fullmatch(r"http://127\.0\.0\.1:\d+", address)
            with urllib.request.urlopen(address, timeout=30) as answer:
                assert "<title>mesh.off → other.obj</title>" in answer.read().decode()
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert (process.returncode, out, err) == (0, "", "Serving until Ctrl-C.\n")


def test_a_browser_is_opened_only_where_it_is_seen(monkeypatch):
    for name in ("SSH_CONNECTION", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(browsing.sys, "platform", "linux")
    assert not browsing._has_screen()
    monkeypatch.setitem(os.environ, "DISPLAY", ":0")
    assert browsing._has_screen()
    monkeypatch.setitem(os.environ, "SSH_CONNECTION", "here there")
    assert not browsing._has_screen()


def test_a_result_without_its_original_files_is_shown(homolog, result, files, tmp_path):
    """The folder alone is enough, wherever it was moved."""
    moved = tmp_path / "moved"
    shutil.move(result, moved)
    assert homolog("view", moved, "--html", tmp_path / "page.html").code == 0


def test_picture(homolog, result, files, tmp_path):
    picture = tmp_path / "both.png"
    ended = homolog("view", result, "--picture", picture, "--picture-width", 200, "--lines", 3)
    assert (ended.code, ended.out, ended.err) == (0, f"{picture}\n", "")
    of_match = tmp_path / "match.png"
    ended = homolog(
        "match", files.mesh, files.other, *PLAIN, "-o", tmp_path / "again", "--picture", of_match,
        "--picture-width", 200, "--lines", 3,
    )  # fmt: skip
    assert ended.code == 0 and str(of_match) in ended.out
    assert of_match.read_bytes() == picture.read_bytes()
    assert homolog("view", result, "--picture", tmp_path / "both.jpg").is_one_line_of_complaint()


@pytest.mark.parametrize("option", ["--lines", "--picture-width"])
def test_how_to_draw_a_picture_that_is_not_wanted_is_refused(homolog, result, files, tmp_path, option):
    for command in (("view", result), ("match", files.mesh, files.other, "-o", tmp_path / "none")):
        ended = homolog(*command, option, 300)
        assert ended.is_one_line_of_complaint() and option in ended.err and "--picture FILE.png" in ended.err
    assert not (tmp_path / "none").exists()
