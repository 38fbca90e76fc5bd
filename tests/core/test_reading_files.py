"""Files of others: only ordinary ones are opened, and a name that begins with a tilde may be one."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from homolog.core.errors import ArgumentError
from homolog.core.files import expanded, ordinary, parse_json, read_bytes, read_text, sha256


def test_only_ordinary_files_are_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").write_bytes(b"\xef\xbb\xbfone\r\ntwo\r")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    (tmp_path / "itself").symlink_to(tmp_path / "itself")
    assert read_text(tmp_path / "link") == "one\ntwo\n"
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path, tmp_path / "itself", tmp_path / "none"):
        for reader in (read_bytes, ordinary):
            with pytest.raises(OSError):
                reader(path)
        with pytest.raises(ArgumentError, match="cannot be read"):
            sha256(path)


def test_a_tilde_is_a_home_folder_unless_there_is_such_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert expanded("~/a") == tmp_path / "home" / "a"
    assert expanded("~") == tmp_path / "home"
    with pytest.raises(ArgumentError, match="no such user"):
        expanded("~x.ply")
    (tmp_path / "~x.ply").touch()
    (tmp_path / "~folder").mkdir()
    assert expanded("~x.ply") == Path("~x.ply")
    assert expanded("~folder/a.ply") == Path("~folder/a.ply")


def test_json_that_lies_too_deep_is_no_json() -> None:
    assert parse_json('{"a": [1]}') == {"a": [1]}
    for text in ("[" * 100_000 + "]" * 100_000, '{"a":' * 100_000 + "1" + "}" * 100_000, "{", "1" * 5000):
        with pytest.raises(ValueError):
            parse_json(text)
