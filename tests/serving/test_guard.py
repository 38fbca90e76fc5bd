"""Which requests a server takes for its own page's, and which names it may be given."""

import re

import pytest

from homolog.core.errors import ArgumentError
from homolog.serving.guard import HostNames, refusal

NAMES = HostNames.of("127.0.0.1", ["shapes.example.org"])


@pytest.mark.parametrize(
    ("headers", "allowed"),
    [
        ({"Host": "127.0.0.1"}, True),
        ({"Host": "localhost:99"}, True),
        ({"Host": "[::1]:8080"}, True),
        ({"Host": "192.168.1.7"}, True),
        ({"Host": "Shapes.example.org."}, True),
        ({"Host": "evil.example"}, False),
        ({"Host": "localhost.evil.example"}, False),
        ({"Host": "127.0.0.1.evil.example"}, False),
        ({"Host": "127.0.0.1@evil.example"}, False),
        ({"Host": "["}, False),
        ({"Host": ""}, False),
        ({}, False),
        ({"Host": "localhost", "Origin": "http://localhost"}, True),
        ({"Host": "shapes.example.org", "Origin": "https://shapes.example.org"}, True),
        ({"Host": "shapes.example.org:443", "Origin": "https://shapes.example.org"}, True),
        ({"Host": "127.0.0.1:8080", "Origin": "https://shapes.example.org"}, True),
        ({"Host": "127.0.0.1:8080", "Origin": "https://shapes.example.org:8443"}, False),
        ({"Host": "localhost:443", "Origin": "http://localhost"}, False),
        ({"Host": "localhost:8080", "Origin": "http://localhost"}, False),
        ({"Host": "localhost", "Origin": "http://evil.example"}, False),
        ({"Host": "localhost", "Origin": "http://localhost:3000"}, False),
        ({"Host": "localhost", "Origin": "null"}, False),
        ({"Host": "localhost", "Origin": ""}, False),
        ({"Host": "localhost", "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}, False),
        ({"Host": "localhost", "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}, True),
        ({"Host": "localhost", "Sec-Fetch-Site": "cross-site"}, False),
        ({"Host": "localhost", "Sec-Fetch-Site": "same-origin"}, True),
    ],
)
def test_who_may_ask(headers, allowed):
    reason = refusal({name.lower(): value for name, value in headers.items()}, NAMES)
    assert (reason is None) == allowed and (allowed or "\n" not in reason)


def test_the_name_that_a_server_listens_at_is_its_own():
    assert refusal({"host": "workstation:8080"}, HostNames.of("Workstation")) is None
    assert refusal({"host": "workstation:8080"}, HostNames.of("127.0.0.1")) is not None


@pytest.mark.parametrize(
    "name",
    ["https://shapes.example.org", "shapes.example.org:443", "example.org/match", "*.org", "a b", "::1", "", "."],
)
def test_a_name_is_a_name_alone(name):
    with pytest.raises(ArgumentError, match=f"^name is {re.escape(repr(name))}, but must be a host's name alone, such"):
        HostNames.of("127.0.0.1", [name])
