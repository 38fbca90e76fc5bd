"""``homolog serve``: what is refused before it serves."""

import sys

import pytest

pytest.importorskip("uvicorn", reason="uvicorn is missing; pip install 'homolog[serve]'")


def test_what_is_refused(homolog, files):
    for arguments, said in (
        (["--host", "203.0.113.7"], "host"),
        (["--weights", files.rubbish], "rubbish.ply"),
        (["--minutes", "nan"], "minutes"),
        (["--jobs", "0"], "jobs"),
        (["--name", "https://shapes.example.org"], "name is 'https://shapes.example.org'"),
    ):
        ended = homolog("serve", *arguments)
        assert ended.is_one_line_of_complaint(), ended.err
        assert said in ended.err


def test_it_needs_its_extra(homolog, monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    monkeypatch.delitem(sys.modules, "homolog.serving.server", raising=False)
    ended = homolog("serve")
    assert ended.is_one_line_of_complaint()
    assert "uvicorn" in ended.err and "homolog[serve]" in ended.err
