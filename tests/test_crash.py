"""Commands that are killed and run again end as if nothing had been; ``make crash`` kills more often."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "tools" / "crash.py"
if not SCRIPT.is_file():
    pytest.skip("the tools are not beside the tests", allow_module_level=True)


@pytest.mark.process
@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows cannot fork")
def test_ten_kills_leave_no_trace(tmp_path):
    command = [sys.executable, SCRIPT, tmp_path / "crashes", "--kills", "10", "--seed", "1"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=1800, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.splitlines()[-1].startswith("10 kills, 0 faults, 0 temporary files left")
