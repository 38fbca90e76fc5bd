"""Servers in threads."""

import threading

import pytest
from serving_tools import STUCK, Client, program

from homolog.serving import Limits


@pytest.fixture
def serve():
    """``serve(command, **limits)`` is a server that serves."""
    pytest.importorskip("uvicorn", reason="uvicorn is missing; pip install 'homolog[serve]'")
    from homolog.serving.server import MatchServer

    running = []

    def start(command, names=(), **limits):
        server = MatchServer(command, Limits(**limits), port=0, names=names)
        thread = threading.Thread(target=server.serve)
        thread.start()
        running.append((server, thread))
        return server

    yield start
    for server, thread in running:
        server.end()
        thread.join(timeout=120)
        assert not thread.is_alive()
        assert not server.folder.exists()


@pytest.fixture
def client():
    """``client(server)`` is someone who talks to it."""
    known = []

    def new(server):
        known.append(Client(server.address))
        return known[-1]

    yield new
    for one in known:
        one.leave()


@pytest.fixture
def stuck():
    """A command that waits to be ended, with a child."""
    return program(STUCK)


@pytest.fixture
def blobs(make, tmp_path):
    """Two small shapes as files, the second one relabelled."""
    from homolog.shapes import write_shape

    blob = make.blob(2)
    files = {"one.off": blob, "other.ply": make.relabelled(blob, blob.points[:, 0].argsort())}
    for name, shape in files.items():
        write_shape(tmp_path / name, shape)
    return [tmp_path / name for name in files]
