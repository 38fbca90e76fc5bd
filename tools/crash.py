"""Kill commands at random moments and at every rename, run them again, and compare with runs that were left alone.

Run from the root of the checkout, on a system with ``fork``::

    python tools/crash.py crashes --kills 100 --seed 0

Each command first runs twice. What both give alike, byte by byte, a killed and repeated run must give as well; what
differs between these two is not compared, nor are seconds and memory, which they may have alike by chance. No file may
be there that theirs have not, no process may be left, and a result must be one of the two or be refused. Exits with 1
where anything is wrong.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import psutil
import trimesh

from homolog.cli import main as command
from homolog.core.errors import HomologError
from homolog.matching import RESULT_FILES, Match
from homolog.shapes import Shape, write_shape

RECIPE = """
data = {split = "all"}
samples = {points = 100, subsets = 2}
network = {width = 16, blocks = 2, out_channels = 16}
clouds = {noise = [0.01]}
operators = {n_eigenpairs = 16}
loss = {map_eigenpairs = 8}
training = {steps = 8, checkpoint_minutes = 0}
validation = {shapes = 2, pairs = 1, every = 4}
orienter = {steps = 2}
"""
N_SHAPES = 5
# For the workers of a killed command to end.
_SECONDS_TO_END = 120.0
# TensorBoard names its files by time and process.
_BY_TIME = "events.out"


@dataclass(frozen=True)
class Case:
    """A command that is killed.

    Args:
        name: to report.
        arguments: of the command; ``{out}`` and ``{data}`` stand for the folders.
        older: arguments of a command that is run first, and whose result the killed one replaces.
    """

    name: str
    arguments: str
    older: str = ""


_MATCH = "match {data}/off/s0.off {data}/off/s1.off -o {out} -q --method "
CASES = (
    Case("match", _MATCH + "axiomatic", older=_MATCH + "nearest-features"),
    Case("evaluate", "evaluate {data} --method axiomatic -n 3 -q --json {out}/scores.json --csv {out}/pairs.csv"),
    Case("synth", "synth views {data} -n 5 --processes 1 -o {out}"),
    Case("collection", "collection {data}/off/s0.off {shapes} --method axiomatic --processes 1 -q -o {out}"),
    Case("track", "track {shapes} --method axiomatic -q -o {out}"),
    Case("train", "train {data} --recipe {data}/recipe.toml --device cpu --resume -q -o {out}"),
    Case("two processes", "collection {data}/off/s0.off {shapes} --method axiomatic --processes 2 -q -o {out}"),
)


def make_data(folder: Path) -> None:
    """A folder of small shapes that correspond point by point, and a recipe."""
    sphere = trimesh.creation.icosphere(subdivisions=2)
    for name in ("off", "corres"):
        (folder / name).mkdir(parents=True)
    for number in range(N_SHAPES):
        bumps = 1 + 0.2 * np.sin(3 * sphere.vertices @ [1, 2, 3] + 0.1 * number)
        points = sphere.vertices * bumps[:, None] * [1 + 0.1 * number, 1, 0.7]
        write_shape(folder / "off" / f"s{number}.off", Shape(points, sphere.faces))
        (folder / "corres" / f"s{number}.vts").write_text("\n".join(map(str, range(1, len(points) + 1))))
    (folder / "recipe.toml").write_text(RECIPE)


class Command:
    """A command in a process of its own, forked from this one, which has loaded everything."""

    def __init__(self, arguments: Sequence[str], *, log: Path, die_at: int | None = None) -> None:
        self.began, self._log = time.monotonic(), log
        self.pid = os.fork()
        if not self.pid:
            _run(arguments, log, die_at)

    def kill(self, seconds: float) -> None:
        """Kill it after some seconds, and see that its workers end."""
        time.sleep(seconds)
        workers = psutil.Process(self.pid).children(recursive=True)
        os.kill(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)
        _, left = psutil.wait_procs(workers, timeout=_SECONDS_TO_END)
        for process in left:
            process.kill()
        assert not left, f"{len(left)} processes are left"

    def end(self) -> int:
        """Wait for its end, and give its exit code."""
        _, status = os.waitpid(self.pid, 0)
        return os.waitstatus_to_exitcode(status)

    def succeed(self) -> float:
        """Wait for its end, and give its seconds."""
        code = self.end()
        assert code == 0, f"exit code {code}: {self._log.read_text(errors='replace')[-400:]}"
        return time.monotonic() - self.began


def _run(arguments: Sequence[str], log: Path, die_at: int | None) -> None:
    """Be the command, in a forked process; ``die_at`` is the number of the rename before which it is killed."""
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(file, 1)
    os.dup2(file, 2)
    code, count = 1, _count_renames(die_at)
    try:
        sys.argv = ["homolog", *arguments]
        command.main()
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    finally:
        sys.stdout.flush()
        log.with_suffix(".renames").write_text(str(count["renames"]))
        os._exit(code)


def _count_renames(die_at: int | None) -> Counter[str]:
    """Have this process count the files that it gives another name, and kill itself before one of these."""
    count = Counter[str]()

    def counted(original: Callable[..., Any]) -> Callable[..., Any]:
        def rename(path: Path, target: Path) -> Any:
            count["renames"] += 1
            if count["renames"] == die_at:
                os.kill(os.getpid(), signal.SIGKILL)
            return original(path, target)

        return rename

    for name in ("replace", "hardlink_to"):
        setattr(Path, name, counted(getattr(Path, name)))
    return count


def contents(folder: Path) -> dict[str, str]:
    """The hash of each file in a folder, hidden ones included; of tables and JSON without what was measured."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.name.startswith(_BY_TIME)]
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(_without_measurements(path)).hexdigest() for path in files
    }


def _without_measurements(path: Path) -> bytes:
    """What a file holds; of a table or of JSON without the columns and keys of seconds and of memory."""

    def kept(table: dict[str, Any]) -> dict[str, Any]:
        return {key: value for key, value in table.items() if "seconds" not in key and "peak_mb" not in key}

    content = path.read_bytes()
    if path.suffix == ".json":
        return json.dumps(json.loads(content, object_hook=kept)).encode()
    if path.suffix == ".csv":
        return json.dumps([kept(row) for row in csv.DictReader(content.decode().splitlines())]).encode()
    return content


class Campaign:
    """The kills of one case.

    Args:
        case: which.
        root: a folder for all that is written.
        data: the shapes.
    """

    def __init__(self, case: Case, root: Path, data: Path) -> None:
        self.case, self.root, self.data, self.wrong = case, root, data, list[str]()
        self.older = dict[str, str]()
        if case.older:
            self.older = self._whole("older", case.older)
        self.expected = self._whole("first", case.arguments)
        again = self._whole("second", case.arguments)
        assert self.expected.keys() == again.keys()
        self.compared = sorted(name for name, digest in self.expected.items() if again[name] == digest)
        self.n_renames = int((root / "log.renames").read_text())

    def kill(self, seconds: float, die_at: int | None = None) -> None:
        """Kill it at a moment or at a rename, run it again, and note what is wrong."""
        out = self._place("killed")
        try:
            killed = self._start(self.case.arguments, out, die_at)
            killed.end() if die_at is not None else killed.kill(seconds)
            self._check_result(out)
            self._start(self.case.arguments, out).succeed()
            self._check_end(contents(out))
        except AssertionError as error:
            moment = f"at {seconds:.3f} s" if die_at is None else f"before rename {die_at}"
            self.wrong.append(f"{self.case.name}, killed {moment}: {error}")
            print(self.wrong[-1], flush=True)

    def _whole(self, name: str, arguments: str) -> dict[str, str]:
        out = self._place(name)
        self.seconds = self._start(arguments, out).succeed()
        return contents(out)

    def _place(self, name: str) -> Path:
        """A folder with the older result, if there is one, and nothing else."""
        out = self.root / name
        shutil.rmtree(out, ignore_errors=True)
        if self.older:
            shutil.copytree(self.root / "older", out)
        out.mkdir(parents=True, exist_ok=True)
        return out

    def _start(self, arguments: str, out: Path, die_at: int | None = None) -> Command:
        shapes = " ".join(f"{self.data}/off/s{number}.off" for number in range(1, N_SHAPES))
        words = arguments.format(out=out, data=self.data, shapes=shapes).split()
        return Command(words, log=self.root / "log", die_at=die_at)

    def _check_result(self, out: Path) -> None:
        """A result that is read is the older one or the new one, and no mixture."""
        if not self.older:
            return
        try:
            Match.load(out)
        except HomologError:
            return
        found = contents(out)
        arrays = [name for name in RESULT_FILES if name in self.compared]
        states = [{name: state[name] for name in arrays} for state in (self.older, self.expected)]
        assert {name: found[name] for name in arrays} in states, "a mixture of two results is read"

    def _check_end(self, found: dict[str, str]) -> None:
        more, fewer = sorted(found.keys() - self.expected.keys()), sorted(self.expected.keys() - found.keys())
        assert not more, f"left over: {more}"
        assert not fewer, f"missing: {fewer}"
        differ = [name for name in self.compared if found[name] != self.expected[name]]
        assert not differ, f"differ: {differ}"


def run(root: Path, kills: int, seed: int) -> int:
    """Kill all commands so often in all, print what was found, and give the number of faults."""
    data, cache, temporary = root / "data", root / "cache", root / "temporary"
    make_data(data)
    temporary.mkdir()
    os.environ |= {"HOMOLOG_CACHE": str(cache), "TMPDIR": str(temporary)}
    tempfile.tempdir = None
    random, faults = Random(seed), 0
    for number, case in enumerate(CASES):
        campaign = Campaign(case, root / case.name.replace(" ", "_"), data)
        share = kills * (number + 1) // len(CASES) - kills * number // len(CASES)
        renames = random.sample(range(1, campaign.n_renames + 1), min(campaign.n_renames, (share + 1) // 2))
        for one in sorted(renames):
            shutil.rmtree(cache, ignore_errors=True)
            campaign.kill(0, die_at=one)
        for _ in range(share - len(renames)):
            shutil.rmtree(cache, ignore_errors=True)
            campaign.kill(random.uniform(0, campaign.seconds))
        faults += len(campaign.wrong)
        print(
            f"{case.name}: {share} kills, {len(renames)} of them at renames (of {campaign.n_renames}); "
            f"{len(campaign.compared)} of {len(campaign.expected)} files compared; {len(campaign.wrong)} faults",
            flush=True,
        )
    left = [path.name for folder in (temporary, cache) for path in folder.rglob(".homolog-*")]
    print(f"{kills} kills, {faults} faults, {len(left)} temporary files left in the cache and the temporary folder")
    return faults + len(left)


def main() -> None:
    """Read the options, and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="a new folder for all that is written")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if not hasattr(os, "fork"):
        parser.error("this system has no fork")
    options.out.mkdir(parents=True)
    sys.exit(run(options.out.resolve(), options.kills, options.seed) > 0)


if __name__ == "__main__":
    main()
