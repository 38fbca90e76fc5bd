"""Those who talk to a server, programs that stand in for a match, and waiting."""

import http.client
import json
import sys
import time
from urllib.parse import quote, urlsplit

import psutil

from homolog.serving import MatchCommand

TRIANGLE = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"

# Stands in for `homolog match`: starts a child, writes the numbers of both processes and a step, and waits to be ended.
STUCK = """
import os, subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
with open("now", "w") as file:
    file.write(f"{os.getpid()} {child.pid}")
os.rename("now", "pids")
print('{"step": "read source", "side": "source", "done": 0, "total": 9}', file=sys.stderr, flush=True)
time.sleep(600)
"""


def until(condition, seconds=120):
    """Wait for something that comes sooner or later, and give it."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "it never came"
        time.sleep(0.02)
    return found


def program(text):
    """A command that runs a program of these lines."""
    return MatchCommand(program=(sys.executable, "-c", text))


class Listener:
    """The events of a match, as they come."""

    def __init__(self, client, path, headers=()):
        self._connection = client.connection()
        self._connection.request("GET", path, headers=dict(headers))
        self.answer = self._connection.getresponse()

    def __iter__(self):
        event = {}
        while line := self.answer.readline().decode():
            name, _, value = line.rstrip("\n").partition(": ")
            if name:
                event[name] = value
            elif "event" in event:
                yield event["event"], json.loads(event["data"]), int(event["id"])
                event = {}

    def until(self, *kinds):
        """The first event of these kinds."""
        return next((kind, data) for kind, data, _ in self if kind in kinds)

    def close(self):
        """As a page that is closed does."""
        self.answer.close()
        self._connection.close()


class Client:
    """Someone who talks to a server, without any of a browser's manners."""

    def __init__(self, address):
        self.place = urlsplit(address)
        self._open = []

    def connection(self):
        return http.client.HTTPConnection(self.place.hostname, self.place.port, timeout=120)

    def ask(self, method, path, body=None, **headers):
        """Status, headers and body of an answer."""
        connection = self.connection()
        try:
            named = {name.replace("_", "-"): value for name, value in headers.items()}
            connection.request(method, path, body=body, headers=named)
            answer = connection.getresponse()
            return answer.status, answer.headers, answer.read()
        finally:
            connection.close()

    def call(self, method, path, headers, body=None):
        """Status, headers and body of an answer to a request with exactly these headers."""
        connection = self.connection()
        try:
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            for name, value in (headers | ({} if body is None else {"Content-Length": str(len(body))})).items():
                connection.putheader(name, value)
            connection.endheaders(body)
            answer = connection.getresponse()
            return answer.status, answer.headers, answer.read()
        finally:
            connection.close()

    def begin(self, **request):
        """Ask for a match, and listen: its path, and its events."""
        status, _, body = self.ask("POST", "/jobs", json.dumps(request))
        assert status == 201, body
        path = f"/jobs/{json.loads(body)['id']}"
        self._open.append(Listener(self, f"{path}/events"))
        return path, self._open[-1]

    def send(self, path, side, name, content):
        """Upload one shape: status, and what is said."""
        status, _, body = self.ask("PUT", f"{path}/{side}?name={quote(name)}", content)
        return status, json.loads(body)["error"] if body else None

    def match(self, source, target, **request):
        """Ask for a match of two pairs of a name and a content."""
        path, listener = self.begin(**request)
        for side, (name, content) in (("source", source), ("target", target)):
            assert self.send(path, side, name, content) == (204, None)
        return path, listener

    def leave(self):
        for listener in self._open:
            listener.close()


def pids(server):
    """The processes of all stuck matches of a server, once there are any."""
    files = list(server.folder.glob("*/pids"))
    return [int(number) for file in files for number in file.read_text().split()]


def gone(numbers):
    """Whether processes are no more; one that no one has waited for yet does nothing either."""
    return not any(alive(number) for number in numbers)


def alive(number):
    try:
        return psutil.Process(number).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
