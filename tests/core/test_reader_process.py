"""A reader in a process of its own: what it gives, and that nothing it does harms or outlives its caller."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from homolog.core import reader_process
from homolog.core.reader_process import ReaderProcessError, read_in_process

HEAD = "import numpy as np, os, sys, time, ctypes\ndef read(path, *more):\n    "


def reader(folder: Path, body: str) -> Path:
    script = folder / "reader.py"
    script.write_text(HEAD + body)
    return script


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "numbers.bin"
    path.write_bytes(b"content")
    return path


def refusal(script: Path, file: Path) -> str:
    with pytest.raises(ReaderProcessError) as caught:
        read_in_process(script, file, library="LIB")
    return str(caught.value)


def test_arrays_of_any_kind_come_by_their_names(tmp_path: Path, file: Path) -> None:
    body = 'return {"a": np.arange(6.0).reshape(2, 3).T, "b": np.zeros((0, 3), "i4"), "size": np.array(len(more))}'
    found = read_in_process(reader(tmp_path, body), file, "x", "y", library="LIB")
    assert list(found) == ["a", "b", "size"]
    np.testing.assert_array_equal(found["a"], np.arange(6.0).reshape(2, 3).T)
    assert (found["b"].shape, found["b"].dtype, int(found["size"])) == ((0, 3), np.dtype("i4"), 2)


def test_reasons_crashes_and_prints(tmp_path: Path, file: Path, capfd: pytest.CaptureFixture[str]) -> None:
    loud = 'print("noise"); os.write(2, b"noise"); '
    assert refusal(reader(tmp_path, loud + 'raise ValueError("the reason")'), file) == "the reason"
    assert refusal(reader(tmp_path, loud + "ctypes.string_at(0)"), file) == "LIB cannot take it in"
    assert refusal(reader(tmp_path, loud + "os.abort()"), file) == "LIB cannot take it in"
    assert refusal(reader(tmp_path, loud + "sys.exit(0)"), file) == "LIB cannot take it in"
    assert capfd.readouterr() == ("", "")


def test_memory_and_time_are_bounded(tmp_path: Path, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("resource")
    too_much = reader(tmp_path, 'return {"a": np.ones(50_000_000)}')
    if sys.platform == "linux":
        assert "HOMOLOG_EXPANSION_MB" in refusal(too_much, file)
        monkeypatch.setenv("HOMOLOG_EXPANSION_MB", "2000")
        assert read_in_process(too_much, file, library="LIB")["a"].sum() == 50_000_000
    monkeypatch.setattr(reader_process, "_PROCESSOR_SECONDS", 1.0)
    monkeypatch.setattr(reader_process, "_SECONDS", 300.0)
    assert (
        refusal(reader(tmp_path, "while True: pass"), file) == "LIB has not read it within 1 s of the processor's time"
    )
    monkeypatch.setattr(reader_process, "_SECONDS", 1.0)
    assert "has not read it within 1 s" in refusal(reader(tmp_path, "time.sleep(100)"), file)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the limit of the processor ends it")
@pytest.mark.process
def test_it_dies_with_the_process_that_called_it(tmp_path: Path, file: Path) -> None:
    told = tmp_path / "pid"
    script = reader(tmp_path, f"open({str(told)!r}, 'w').write(str(os.getpid()) + '.')\n    while True: pass")
    # Without limits of its own that could end it in time.
    code = "from pathlib import Path; from homolog.core import reader_process\n"
    code += "reader_process._PROCESSOR_SECONDS = reader_process._SECONDS = 3600.0\n"
    code += f"reader_process.read_in_process(Path({str(script)!r}), Path({str(file)!r}), library='LIB')"
    with subprocess.Popen([sys.executable, "-c", code]) as parent:
        while not (told.exists() and told.read_text().endswith(".")):
            assert parent.poll() is None
            time.sleep(0.05)
        child = psutil.Process(int(told.read_text()[:-1]))
        os.kill(parent.pid, signal.SIGKILL)
    child.wait(timeout=120)
