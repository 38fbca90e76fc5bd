"""The server of one page: what it answers, to whom, and how it ends."""

import socket
import threading

import pytest
from serving_tools import Client

from homolog.core.errors import ArgumentError
from homolog.serving import PageServer

PAGE = "<!DOCTYPE html><title>\N{SNOWMAN}</title>"


@pytest.fixture
def user():
    """Someone who talks to a server of the page."""
    server = PageServer(PAGE, port=0)
    thread = threading.Thread(target=server.serve)
    thread.start()
    yield Client(server.address)
    server.end()
    thread.join(timeout=60)
    server.close()
    assert not thread.is_alive()


def test_it_serves_the_page(user):
    for path in ("/", "/?a=b"):
        status, headers, body = user.ask("GET", path)
        assert (status, body.decode(), headers["Content-Type"]) == (200, PAGE, "text/html; charset=utf-8")
        assert headers["Content-Security-Policy"].startswith(
            "sandbox allow-scripts allow-downloads; default-src 'none';"
        )
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin" and headers["Cache-Control"] == "no-store"
        assert "Access-Control-Allow-Origin" not in headers
    for path in ("/favicon.ico", "/../etc/passwd", "/%2e"):
        assert user.ask("GET", path)[::2] == (404, b"")
    assert user.ask("POST", "/", b"x")[0] == 501


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Host": "evil.example"},
        {"Host": "127.0.0.1.evil.example:80"},
        {"Host": "127.0.0.1", "Origin": "http://evil.example"},
        {"Host": "127.0.0.1", "Origin": "null"},
        {"Host": "127.0.0.1", "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"},
    ],
)
def test_no_other_site_reads_it(user, headers):
    status, _, body = user.call("GET", "/", headers)
    assert status == 403 and "<" not in body.decode()


def test_a_connection_that_says_nothing_keeps_no_one_waiting(user):
    with socket.create_connection((user.place.hostname, user.place.port)):
        assert user.ask("GET", "/")[0] == 200


def test_it_takes_the_next_free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        server = PageServer(PAGE, port=port)
        server.close()
        assert port < int(server.address.rpartition(":")[2]) < port + 100


def test_an_address_of_another_machine_is_refused():
    with pytest.raises(ArgumentError, match=r"^host is '203\.0\.113\.7', which cannot be listened on"):
        PageServer(PAGE, "203.0.113.7", 0)
