"""The server without a browser: the whole road, what is refused, what is bounded, and what is left behind."""

import json
import os
import re
import shutil
import socket
import sys
import threading
import zipfile
from contextlib import ExitStack, suppress
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from serving_tools import TRIANGLE, Listener, gone, pids, program, until

from homolog.core.errors import ArgumentError, ShapeError
from homolog.matching import RESULT_FILES, Match, load_alternatives
from homolog.serving import Limits, MatchCommand
from homolog.serving.command import MatchRequest, public_error, read_message
from homolog.serving.names import safe_file_name
from homolog.shapes import read_shape
from homolog.transfer import read_landmark_pairs

pytest.importorskip("uvicorn", reason="uvicorn is missing; pip install 'homolog[serve]'")

AXIOMATIC = MatchCommand(("--method=axiomatic",))
JOB = "/jobs/0123456789"
OUTSIDE = b'{"asset":{"version":"2.0"},"buffers":[{"uri":"../target/one.off","byteLength":9}]}'
FROM_ANN = {"X-Forwarded-For": "203.0.113.7"}
FROM_BEN = {"X-Forwarded-For": "203.0.113.8"}


def uploads(paths):
    return [(path.name, path.read_bytes()) for path in paths]


def raw(user):
    """A connection on which anything can be sent."""
    return socket.create_connection((user.place.hostname, user.place.port), timeout=120)


def host(user):
    return f"Host: {user.place.netloc}\r\n"


def assert_closed(connection):
    """By the other end, sooner or later, whatever came before."""
    with suppress(ConnectionError):
        while connection.recv(2**16):
            pass


def failure(listener):
    kind, data = listener.until("failed", "done")
    assert kind == "failed"
    assert "\n" not in data["error"]
    return data["error"]


# ---- the whole road


@pytest.mark.process
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other homes")
def test_two_files_become_a_map(serve, client, blobs, tmp_path, monkeypatch):
    for place in ("home", "cwd", "tmp"):
        (tmp_path / place).mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.chdir(tmp_path / "cwd")
    server = serve(AXIOMATIC)
    user = client(server)
    path, listener = user.match(*uploads(blobs), source_up="y")
    events = []
    for kind, data, number in listener:
        assert number == len(events)
        events.append((kind, data))
        if kind in ("done", "failed"):
            break
    assert events[-1] == ("done", {"archive": "one to other.zip", "maps": 1, "warnings": events[-1][1]["warnings"]})
    steps = [data for kind, data in events if kind == "step"]
    assert [step["done"] for step in steps] == list(range(len(steps)))
    (total,) = {step["total"] for step in steps}
    assert len(steps) <= total <= len(steps) + 2  # without weights, no features are computed
    assert steps[0]["step"] == "read source" and steps[-1]["step"] == "write"
    status, headers, page = user.ask("GET", f"{path}/view.html")
    assert status == 200 and headers["Content-Security-Policy"].startswith("sandbox allow-scripts allow-downloads;")
    assert "<title>one.off → other.ply</title>" in page.decode()
    status, _, packed = user.ask("GET", f"{path}/result.zip")
    with zipfile.ZipFile(BytesIO(packed)) as archive:
        assert archive.testzip() is None
        archive.extractall(tmp_path / "got")
    got = tmp_path / "got" / "homolog-result"
    assert {file.name for file in got.iterdir()} == {*RESULT_FILES, "view.html"}
    assert (got / "view.html").read_bytes() == page
    result = Match.load(got)
    order = result.source.points[:, 0].argsort()
    assert np.mean(result.target_to_source == order) > 0.9
    assert result.report["inputs"]["source"]["file"] == str(Path("source", "one.off"))
    # What the page has, the server forgets; and it has written nothing anywhere else.
    assert user.ask("DELETE", path)[0] == 204
    until(lambda: not any(server.folder.iterdir()))
    assert user.ask("GET", f"{path}/result.zip")[0] == 404
    assert user.ask("DELETE", path)[0] == 204
    assert list((tmp_path / "tmp").iterdir()) == [server.folder.parent]
    assert not any((tmp_path / "home").iterdir()) and not any((tmp_path / "cwd").iterdir())


def test_a_request_becomes_options():
    request, names = MatchRequest.of({"source_up": "z", "partial": "target"}), {"source": "a.off", "target": "b.off"}
    line = MatchCommand(("--method=auto",), program=("homolog",)).line(names, request)
    files = [str(Path("source", "a.off")), str(Path("target", "b.off"))]
    assert line[:2] == ["homolog", "match"] and line[-3:] == ["--", *files]
    assert {"--no-cache", "--method=auto", "--source-up=z", "--target-up=y", "--partial=target"} <= {*line}


def test_landmarks_of_a_request_become_files(tmp_path):
    given = {"alternatives": "3", "landmarks": {"source": [5, 0], "target": [7, 161]}}
    request, names = MatchRequest.of(given), {"source": "a.off", "target": "b.off"}
    line = MatchCommand().line(names, request)
    files = line[line.index("--landmarks") + 1 :][:2]
    assert files == [str(Path("landmarks", f"{side}.txt")) for side in names] and "--alternatives=3" in line
    request.write_landmarks(tmp_path)
    pairs = read_landmark_pairs(*(tmp_path / file for file in files))
    assert pairs.source == (5, 0) and pairs.target == (7, 161)
    plain = MatchRequest.of({})
    plain.write_landmarks(tmp_path / "none")
    assert not (tmp_path / "none").exists() and "--landmarks" not in MatchCommand().line(names, plain)


@pytest.mark.parametrize(
    "landmarks",
    [
        *([], {}, "x", 5, {"source": [1]}, {"source": [1], "target": [2], "more": [3]}, {"source": [], "target": []}),
        *({"source": [1, 2], "target": [3]}, {"source": [-1], "target": [3]}, {"source": [True], "target": [3]}),
        *({"source": [[0, 0, 0]], "target": [[0, 0, 0]]}, {"source": [1.5], "target": [3]}, {"source": 1, "target": 3}),
        *({"source": [10**30], "target": [3]}, {"source": [*range(51)], "target": [*range(51)]}),
    ],
)
def test_landmarks_that_are_none_are_refused(landmarks):
    with pytest.raises(ArgumentError) as raised:
        MatchRequest.of({"landmarks": landmarks})
    assert len(str(raised.value)) < 120 and "landmarks" in str(raised.value)


@pytest.mark.process
def test_a_match_by_landmarks_with_alternatives(serve, client, blobs, tmp_path):
    """Each map can be had by itself; the result has them all."""
    user = client(serve(MatchCommand(("--method=registration",))))
    order = read_shape(blobs[0]).points[:, 0].argsort()
    at, wanted = [3, 77], np.argsort(order)[[3, 77]].tolist()
    path, listener = user.match(*uploads(blobs), alternatives="2", landmarks={"source": at, "target": wanted})
    kind, data = listener.until("failed", "done")
    assert (kind, data["maps"]) == ("done", 2)
    for name in ("result", "result-2"):
        with zipfile.ZipFile(BytesIO(user.ask("GET", f"{path}/{name}.zip")[2])) as archive:
            archive.extractall(tmp_path / name)
    assert user.ask("GET", f"{path}/result-3.zip")[0] == 404
    first = Match.load(tmp_path / "result" / "homolog-result")
    (second,) = load_alternatives(tmp_path / "result" / "homolog-result", first)
    alone = Match.load(tmp_path / "result-2" / "homolog-result")
    np.testing.assert_array_equal(second.source_to_target, alone.source_to_target)
    assert (first.source_to_target != second.source_to_target).any()
    assert first.source_to_target[at].tolist() == second.source_to_target[at].tolist() == wanted


@pytest.mark.parametrize(
    "body",
    [
        *("", "[]", "{", '{"weights": "x"}', '{"partial": "both"}', '{"source_up": ["y"]}', "[" * 4000),
        *('{"alternatives": 2}', '{"alternatives": "9"}', '{"landmarks": {"source": [1], "target": ["x"]}}'),
    ],
)
def test_other_requests_are_refused(serve, client, stuck, body):
    status, _, said = client(serve(stuck)).ask("POST", "/jobs", body)
    assert status == 400 and len(json.loads(said)["error"]) < 120


# ---- files that are no shapes


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("claims.ply", b"ply\nformat ascii 1.0\nelement vertex 1000000000\nproperty float x\nproperty float y\n"
         b"property float z\nend_header\n0 0 0\n", "1000000000 elements vertex"),
        ("outside.gltf", OUTSIDE,
         "refers to '../target/one.off' outside its own folder"),
        ("elsewhere.gltf", b'{"asset":{"version":"2.0"},"buffers":[{"uri":"https://a.org/b/c.bin","byteLength":9}]}',
         "refers to 'https://a.org/b/c.bin' outside its own folder"),
        ("alone.gltf", b'{"asset":{"version":"2.0"},"buffers":[{"uri":"c.bin","byteLength":9}]}',
         "refers to 'c.bin', which is not beside it; put that file there, or export"),
        ("<img src=x onerror=alert(1)>.off", b"\0" * 99, "binary data"),
    ],
)  # fmt: skip
def test_a_bad_file_is_one_clear_message(tmp_path, monkeypatch, name, content, said):
    """That of its reader, without the server's folders."""
    plain = safe_file_name(name)
    (tmp_path / "source").mkdir()
    (tmp_path / "source" / plain).write_bytes(content)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ShapeError) as raised:
        read_shape(Path("source", plain))
    error = public_error(str(raised.value), tmp_path, {"source": plain, "target": "one.off"})
    assert error.startswith(f"{name.translate(dict.fromkeys(map(ord, '<>'), '_'))} ") and said in error
    assert str(tmp_path) not in error and "source" not in error
    assert os.sep not in error.replace(said, "")  # where the file says it


@pytest.mark.process
def test_the_command_says_what_is_wrong_with_a_file(serve, client, blobs):
    server = serve(AXIOMATIC)
    _, listener = client(server).match(("outside.gltf", OUTSIDE), uploads(blobs)[0])
    kind, data = listener.until("failed", "done")
    assert kind == "failed" and data["side"] == "source"
    assert re.match(r"outside\.gltf .* refers to '\.\./target/one\.off' outside its own folder", data["error"])
    until(lambda: not any(server.folder.iterdir()))


@pytest.mark.parametrize(
    ("name", "said"),
    [("virus.exe", "suffix '.exe'"), ("no", "no suffix"), ("scan.nii.gz", "is a volume"), ("a.off\0.sh", "suffix"),
     ("../../etc/passwd", "passwd has no suffix"), ("", "no suffix"), (".off", "no suffix")],
)  # fmt: skip
def test_a_name_of_no_shape(serve, client, stuck, name, said):
    server = serve(stuck)
    user = client(server)
    path, listener = user.begin()
    status, error = user.send(path, "source", name, TRIANGLE)
    assert status == 415 and said in error
    assert failure(listener) == error
    until(lambda: not any(server.folder.iterdir()))


@pytest.mark.parametrize(
    ("name", "stored"),
    [
        ("../../../../tmp/evil.off", "evil.off"),
        ("/etc/cron.d/evil.off", "evil.off"),
        ("C:\\Windows\\evil.off", "evil.off"),
        ("~root/x.ply", "x.ply"),
        ("--weights=x.off", "--weights=x.off"),
        ("\N{SNOWMAN} a b.OFF", "\N{SNOWMAN} a b.OFF"),
        ("x\0y\n\u202ez.off", "x_y__z.off"),
        ("\N{PILE OF POO}" * 5000 + ".off", "\N{PILE OF POO}" * 56 + ".off"),
        ("a:b|c?.off", "a_b_c_.off"),
    ],
)
def test_a_hostile_name_stays_in_its_folder(serve, client, stuck, name, stored):
    server = serve(stuck)
    user = client(server)
    path, _ = user.begin()
    assert user.send(path, "source", name, TRIANGLE) == (204, None)
    files = [file.relative_to(server.folder).parts[1:] for file in server.folder.rglob("*") if file.is_file()]
    assert files == [("source", stored)]


def test_no_path_of_the_server_is_shown(tmp_path):
    names = {"source": "a b.off", "target": "a.off"}
    for error, shown in (
        (f"{tmp_path.resolve()}/source/a b.off is empty", "a b.off is empty"),
        ("target/a.off could not be read as OFF", "a.off could not be read as OFF"),
        ("/home/me/lions.safetensors is damaged (/opt/lib/x.so)", "lions.safetensors is damaged (x.so)"),
        ("C:\\Users\\me\\x.pth is damaged", "x.pth is damaged"),
        ("it does not end with </VTKFile>; 3 km/h", "it does not end with </VTKFile>; 3 km/h"),
        (f"target/a.off is bad ({tmp_path.resolve()}/target/a.off: line 3)", "a.off is bad (a.off: line 3)"),
    ):
        assert public_error(error, tmp_path, names) == shown


@pytest.mark.parametrize("uri", ["../a/b.bin", "./a/b/c.bin", "target/a.off", "https://a.org/b/c.bin", "a/b.bin"])
def test_what_a_file_refers_to_is_shown_as_it_says_it(tmp_path, uri):
    names = {"source": "a.gltf", "target": "a.off"}
    error = f"a.gltf could not be read as GLTF: it refers to {uri!r}, which is not beside it"
    assert public_error(f"source/{error}", tmp_path, names) == error


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('{"step": "map", "side": null, "done": 3, "total": 9}', {"step": "map", "side": None, "done": 3, "total": 9}),
        ('{"error": "no"}', {"error": "no"}),
        *[(line, {}) for line in ("", "map ...", "Error: no", "[1]", "3", '"step"', "{", '{"step"}', "[" * 5000)],
    ],
)
def test_only_json_objects_are_messages(line, message):
    assert read_message(line) == message


@pytest.mark.process
@pytest.mark.parametrize(
    ("step", "side", "said", "data"),
    [
        ("read target", "target", "target/a.off is empty", {"error": "the target a.off is empty", "side": "target"}),
        ("operators of source", "source", "a.off is flat", {"error": "the source a.off is flat", "side": "source"}),
        ("map", None, "a.off or a.off cannot be", {"error": "a.off or a.off cannot be"}),
    ],
)
def test_which_shape_is_to_blame(serve, client, step, side, said, data):
    """Though both files have one name."""
    messages = [{"step": step, "side": side, "done": 2, "total": 5}, {"error": said}]
    lines = "\n".join(map(json.dumps, messages))
    server = serve(program(f"import sys; print({lines!r}, file=sys.stderr); sys.exit(2)"))
    _, listener = client(server).match(("x/a.off", TRIANGLE), ("y/a.off", TRIANGLE))
    assert listener.until("step") == ("step", {"step": step, "done": 2, "total": 5})
    assert listener.until("failed", "done") == ("failed", data)


@pytest.mark.parametrize(("name", "status"), [("a.exe", 415), ("large.off", 413)])
def test_which_upload_is_to_blame(serve, client, stuck, name, status):
    user = client(serve(stuck, max_mb=0.01))
    path, listener = user.begin()
    answer, _, body = user.ask("PUT", f"{path}/target?name={name}", bytes(20_000))
    assert answer == status and json.loads(body)["side"] == "target"
    assert listener.until("failed")[1] == json.loads(body)


# ---- sizes


def test_a_file_that_says_that_it_is_too_large(serve, client, stuck):
    server = serve(stuck, max_mb=0.01)
    user = client(server)
    path, listener = user.begin()
    status, error = user.send(path, "source", "large.off", bytes(20_000))
    assert (status, error) == (413, "large.off is larger than 0.01 MB, the limit here; reduce it")
    assert failure(listener) == error
    until(lambda: not any(server.folder.iterdir()))


def test_a_file_that_does_not_say_how_large_it_is(serve, client, stuck):
    """It is stopped on the way: the answer is there though the file has no end."""
    server = serve(stuck, max_mb=0.01)
    user = client(server)
    path, listener = user.begin()
    connection = user.connection()
    connection.putrequest("PUT", f"{path}/source?name=endless.off")
    connection.putheader("Transfer-Encoding", "chunked")
    connection.endheaders()
    connection.send(b"5000\r\n" + bytes(0x5000) + b"\r\n")
    answer = connection.getresponse()
    assert answer.status == 413 and b"larger than 0.01 MB" in answer.read()
    connection.close()
    assert "larger than 0.01 MB" in failure(listener)
    until(lambda: not any(server.folder.iterdir()))


def test_a_second_source_is_refused(serve, client, stuck):
    user = client(serve(stuck))
    path, _ = user.begin()
    assert user.send(path, "source", "a.off", TRIANGLE)[0] == 204
    assert user.send(path, "source", "b.off", TRIANGLE) == (409, "this match has its source already")
    assert user.send(path, "middle", "b.off", TRIANGLE)[0] == 404


def test_limits_are_positive_numbers():
    for wrong in ({"max_mb": 0}, {"minutes": float("nan")}, {"memory_gb": float("inf")}, {"jobs": 0}, {"queue": -1}):
        with pytest.raises(ArgumentError, match=next(iter(wrong))):
            Limits(**wrong)
    assert Limits(jobs=2, queue=0).admitted == 2


# ---- bounds on number, time and memory


@pytest.mark.process
def test_only_so_many_at_once(serve, client, stuck):
    server = serve(stuck, jobs=1, queue=1)
    first, second, third = client(server), client(server), client(server)
    shapes = ("a.off", TRIANGLE), ("b.off", TRIANGLE)
    running, events = first.match(*shapes)
    assert events.until("step")[1]["step"] == "read source"
    _, events = second.match(*shapes)
    assert events.until("waiting", "step") == ("waiting", {"ahead": 0})
    status, _, body = third.ask("POST", "/jobs", "{}")
    assert status == 503 and "2 matches are under way here" in json.loads(body)["error"]
    first_pids = until(lambda: pids(server))
    assert len(first_pids) == 2
    first.ask("DELETE", running)
    assert events.until("step", "failed")[0] == "step"  # its turn has come
    until(lambda: gone(first_pids))
    assert third.ask("POST", "/jobs", "{}")[0] == 201


def test_a_place_is_free_before_the_folder_is_gone(serve, client, stuck, monkeypatch):
    begun, free = threading.Event(), threading.Event()

    def remove(folder, ignore_errors):
        begun.set()
        assert free.wait(120)
        shutil.rmtree(folder, ignore_errors)

    monkeypatch.setattr("homolog.serving.jobs.shutil", SimpleNamespace(rmtree=remove))
    server = serve(stuck, jobs=1, queue=0)
    user = client(server)
    path, _ = user.begin()
    status, _, body = user.ask("POST", "/jobs", "{}")
    assert status == 503 and json.loads(body)["error"].startswith("1 match is under way here, ")
    user.ask("DELETE", path)
    assert begun.wait(120)
    try:
        assert user.ask("POST", "/jobs", "{}")[0] == 201
    finally:
        free.set()


def test_one_address_has_only_so_many(serve, client, stuck, monkeypatch):
    monkeypatch.setattr("homolog.serving.job._RECONNECT_SECONDS", 600)
    server = serve(stuck, per_address=1)
    user = client(server)

    def ask(headers):
        status, _, body = user.ask("POST", "/jobs", "{}", **headers)
        return status, json.loads(body)

    first = ask(FROM_ANN)[1]
    status, data = ask(FROM_ANN)
    assert status == 429 and data["error"].startswith("1 match is under way from your address, ")
    assert [ask(other)[0] for other in (FROM_BEN, {}, {}, {})] == [201] * 4
    user.ask("DELETE", f"/jobs/{first['id']}")
    until(lambda: ask(FROM_ANN)[0] == 201)


@pytest.mark.parametrize(
    ("host", "counted"),
    [
        ("127.0.0.1", None),
        ("::1", None),
        ("::ffff:127.0.0.1", None),
        ("203.0.113.7", "203.0.113.7"),
        ("::ffff:203.0.113.7", "203.0.113.7"),
        ("2001:db8::1", "2001:db8::/64"),
        ("2001:db8::ffff:1", "2001:db8::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("unknown", "unknown"),
    ],
)
def test_what_counts_as_one_address(host, counted):
    from homolog.serving.addresses import client_network

    assert client_network(host) == counted


@pytest.mark.process
def test_a_match_that_takes_too_long(serve, client, stuck):
    server = serve(stuck, minutes=0.05)
    _, listener = client(server).match(("a.off", TRIANGLE), ("b.off", TRIANGLE))
    started = until(lambda: pids(server))
    assert (
        failure(listener)
        == "the match took longer than 0.05 minutes, the limit here, and was stopped; use smaller shapes"
    )
    until(lambda: gone(started))


def test_files_that_do_not_come(serve, client, stuck):
    _, listener = client(serve(stuck, minutes=0.01)).begin()
    assert "did not arrive within 0.01 minutes" in failure(listener)


def test_files_that_stop_coming(serve, client, stuck, monkeypatch):
    server = serve(stuck)
    user = client(server)
    path, listener = user.begin()
    monkeypatch.setattr("homolog.serving.upload._IDLE_SECONDS", 0.1)
    with raw(user) as connection:
        head = f"PUT {path}/source?name=a.off HTTP/1.1\r\n{host(user)}Content-Length: 99\r\n\r\n"
        connection.sendall(head.encode() + b"OFF")
        assert failure(listener) == "nothing of the files came for 0.1 seconds; try again"
        until(lambda: not any(server.folder.iterdir()))


def test_a_request_that_has_no_end(serve, client, stuck, monkeypatch):
    monkeypatch.setattr("homolog.serving.app._LONGEST_REQUEST_SECONDS", 0.1)
    user = client(serve(stuck))
    with raw(user) as connection:
        connection.sendall(f"POST /jobs HTTP/1.1\r\n{host(user)}Content-Length: 99\r\n\r\n{{".encode())
        assert connection.recv(99).startswith(b"HTTP/1.1 408 ")


@pytest.mark.parametrize("sent", ["", "GET / HTT", "GET /absent HTTP/1.1\r\n{host}\r\nGET / HTT"])
def test_a_connection_that_says_nothing_is_closed(serve, client, stuck, monkeypatch, sent):
    """Before its first request, within one, and within a later one."""
    monkeypatch.setattr("homolog.serving.connection._IDLE_SECONDS", 0.1)
    user = client(serve(stuck))
    with raw(user) as connection:
        connection.sendall(sent.format(host=host(user)).encode())
        assert_closed(connection)


def test_a_connection_that_takes_no_answer_is_closed(serve, client, stuck, monkeypatch):
    server = serve(stuck)
    user = client(server)
    page = len(user.ask("GET", "/")[2])
    monkeypatch.setattr("homolog.serving.connection._IDLE_SECONDS", 0.1)
    with raw(user) as connection:
        with suppress(OSError):  # answers that no buffers on the way hold, and no more of them read than that they come
            connection.sendall(f"GET / HTTP/1.1\r\n{host(user)}\r\n".encode() * (2**26 // page))
            connection.recv(1)
        until(lambda: not server._server.server_state.connections)


@pytest.mark.process
def test_a_connection_that_waits_for_its_match_is_kept(serve, client):
    """However long that says nothing."""
    server = serve(program(SLOW))
    _, listener = client(server).match(("a.off", TRIANGLE), ("b.off", TRIANGLE))
    listener.until("step")
    for connection in list(server._server.server_state.connections):
        connection.loop.call_soon_threadsafe(connection._close_if_idle)
    (folder,) = server.folder.iterdir()
    (folder / "go").touch()
    assert listener.until("step", "failed")[1]["step"] == "read target"


def test_one_address_has_half_of_the_connections(serve, client, stuck, monkeypatch):
    monkeypatch.setattr("homolog.serving.connection._IDLE_SECONDS", 600)
    monkeypatch.setattr("homolog.serving.connection.client_network", lambda host: host)
    user = client(serve(stuck, jobs=1, queue=0))
    with ExitStack() as held:
        *_, eighth, ninth = [held.enter_context(raw(user)) for _ in range(9)]
        assert_closed(ninth)
        eighth.sendall(f"GET / HTTP/1.1\r\n{host(user)}\r\n".encode())
        assert eighth.recv(99).startswith(b"HTTP/1.1 200 ")


def test_a_match_that_no_one_listens_to_is_forgotten(serve, client, stuck, monkeypatch):
    monkeypatch.setattr("homolog.serving.job._RECONNECT_SECONDS", 0.1)
    server = serve(stuck)
    user = client(server)
    assert user.ask("POST", "/jobs", "{}")[0] == 201
    until(lambda: not any(server.folder.iterdir()))


SLOW = """
import pathlib, sys, time
print('{"step": "read source", "side": "source", "done": 0, "total": 9}', file=sys.stderr, flush=True)
while not pathlib.Path("go").exists():
    time.sleep(0.02)
print('{"step": "read target", "side": "target", "done": 1, "total": 9}', file=sys.stderr, flush=True)
time.sleep(600)
"""
GREEDY = """
import sys
hold = []
while True:
    hold.append(b"x" * 2**20)
"""
REFUSED = """
import sys
try:
    bytearray(2**30)
except MemoryError:
    print('{"error": "not enough memory"}', file=sys.stderr)
    sys.exit(2)
"""


@pytest.mark.process
@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such limit")
def test_the_system_keeps_a_match_to_its_memory(serve, client):
    _, listener = client(serve(program(REFUSED), memory_gb=0.25)).match(("a.off", TRIANGLE), ("b.off", TRIANGLE))
    assert failure(listener) == "not enough memory"


@pytest.mark.process
def test_where_the_system_does_not_the_server_does(serve, client, monkeypatch, tmp_path):
    (tmp_path / "unlimited.py").write_text("import os, sys; os.execv(sys.argv[2], sys.argv[2:])")
    monkeypatch.setattr("homolog.serving.process._LIMITED", tmp_path / "unlimited.py")
    _, listener = client(serve(program(GREEDY), memory_gb=0.25)).match(("a.off", TRIANGLE), ("b.off", TRIANGLE))
    assert "needed more than 0.25 GB of memory" in failure(listener)


@pytest.mark.process
@pytest.mark.parametrize(
    ("ending", "said"),
    [("raise RuntimeError('/secret/place')", "for a reason that is not known"), ("os.abort()", "the match broke off")],
)
def test_an_end_that_no_one_foresaw(serve, client, ending, said, caplog):
    command = program(f"import os, sys; print('x' * 10**6, file=sys.stderr, flush=True); {ending}")
    _, listener = client(serve(command)).match(("a.off", TRIANGLE), ("b.off", TRIANGLE))
    error = failure(listener)
    assert said in error and "secret" not in error
    assert "a match ended with code" in caplog.text  # whoever runs the server is told more


# ---- pages that are closed, and a server that ends


@pytest.mark.process
def test_a_page_that_closes_ends_its_match(serve, client, stuck, monkeypatch):
    monkeypatch.setattr("homolog.serving.job._RECONNECT_SECONDS", 0.1)
    server = serve(stuck)
    _, listener = client(server).match(("a.off", TRIANGLE), ("b.off", TRIANGLE))
    started = until(lambda: pids(server))
    listener.close()
    until(lambda: gone(started) and not any(server.folder.iterdir()))


@pytest.mark.process
def test_a_connection_that_comes_back_keeps_the_match(serve, client, stuck):
    server = serve(stuck)
    user = client(server)
    path, listener = user.match(("a.off", TRIANGLE), ("b.off", TRIANGLE))
    *_, last = next(event for event in listener if event[0] == "step")
    listener.close()
    again = Listener(user, f"{path}/events", {"Last-Event-ID": str(last - 1)})
    assert next(iter(again))[0] == "step"
    again.close()


def test_an_upload_that_breaks_off_ends_its_match(serve, client, stuck):
    server = serve(stuck)
    user = client(server)
    path, _ = user.begin()
    with socket.create_connection((user.place.hostname, user.place.port)) as raw:
        head = f"PUT {path}/source?name=a.off HTTP/1.1\r\nHost: {user.place.netloc}\r\nContent-Length: 1000\r\n\r\n"
        raw.sendall(head.encode() + b"OFF")
        until(lambda: list(server.folder.glob("*/source/a.off")))
    until(lambda: not any(server.folder.iterdir()))


@pytest.mark.process
def test_the_end_of_the_server_ends_its_matches(serve, client, stuck):
    server = serve(stuck)
    _, listener = client(server).match(("a.off", TRIANGLE), ("b.off", TRIANGLE))
    started = until(lambda: pids(server))
    server.end()
    assert [kind for kind, *_ in listener][-1:] in (["step"], ["waiting"])  # the events come to an end
    until(lambda: gone(started) and not server.folder.exists())


# ---- other sites, and other users


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "Shapes.example.org.", "Origin": "https://shapes.example.org."}, 201),
        ({"Host": "evil.example"}, 403),
        ({"Host": "localhost", "Origin": "http://evil.example"}, 403),
    ],
)
def test_other_sites_are_refused(serve, client, stuck, headers, status):
    """As ``test_guard`` has it of each header."""
    assert client(serve(stuck, names=["shapes.example.org"])).call("POST", "/jobs", headers, b"{}")[0] == status


def test_every_answer_binds_the_browser(serve, client, stuck):
    user = client(serve(stuck))
    for method, path, status in (
        ("GET", "/", 200), ("GET", "/absent", 404), ("PUT", "/", 405), ("GET", f"{JOB}/events", 404),
        ("GET", f"{JOB}/view.html", 404), ("GET", f"{JOB}/result.zip", 404), ("DELETE", f"{JOB}/events", 405),
        ("PUT", f"{JOB}/source?name=a.off", 404), ("GET", "/jobs/../../etc/passwd", 404),
        ("GET", "/jobs/%2e%2e%2f%2e%2e%2fetc/view.html", 404),
    ):  # fmt: skip
        answer, headers, body = user.ask(method, path)
        assert answer == status, path
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff" and headers["Referrer-Policy"] == "no-referrer"
        assert headers["Cache-Control"] == "no-store" and headers["Server"] is None
        assert path == "/" or list(json.loads(body)) == ["error"]


def test_a_result_that_is_not_there_yet(serve, client, stuck):
    user = client(serve(stuck))
    path, _ = user.begin()
    for name in ("view.html", "result.zip"):
        status, _, body = user.ask("GET", f"{path}/{name}")
        assert status == 404 and "not done" in json.loads(body)["error"]


def test_the_word_of_a_match_cannot_be_guessed(serve, client, stuck):
    """Of 32 signs each, no two alike; nor is it the name of the match's folder."""
    server = serve(stuck)
    words = {client(server).begin()[0].removeprefix("/jobs/") for _ in range(5)}
    assert len(words) == 5 and all(len(word) == 32 for word in words)
    assert not words & {folder.name for folder in server.folder.iterdir()}
    if os.name == "posix":
        assert server.folder.stat().st_mode & 0o077 == 0
