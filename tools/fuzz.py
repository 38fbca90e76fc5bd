"""Read damaged files with every reader, and keep those on which one fails.

Run from the root of the checkout; needs Linux and the extras of ``dev``::

    python tools/fuzz.py --mutants 20000 --seed 1 --out build/fuzz
    python tools/fuzz.py --files build/fuzz/failures/* --out build/again

A reader may give a result or raise a ``HomologError`` of one line. A traceback, a crash, another message, printed
lines, more than 10 s of the processor, or more memory than twice the file and 250 MB is a failure: it is printed, and
the file is kept. The same seed makes the same mutants. Workers are ended with whatever they started, and end by
themselves where this process is killed.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np
import PIL.Image  # noqa: F401  # loaded here, so that no file is charged with it
import pypcd4.pypcd4  # noqa: F401
import scipy.io  # noqa: F401
import torch

import homolog
from fuzz_mutations import mutate
from fuzz_seeds import OPERATORS, Seed, body, make_seeds
from homolog import Match, OperatorCache
from homolog.core.ends import end_with_parent
from homolog.core.errors import HomologError
from homolog.datasets import read_truth
from homolog.datasets.description import read_description
from homolog.matching import read_point_map
from homolog.training import read_recipe
from homolog.transfer.appearance import read_appearance
from homolog.transfer.inputs import read_array, read_labels
from homolog.transfer.landmarks import read_landmarks
from homolog.transfer.skin import read_skin
from homolog.viewing.scene import scene_of
from homolog.volumes import mask_surface, read_mask

_SECONDS = 10.0
_MEGABYTES = 250.0
_LONGEST_MESSAGE = 500
# Of a reader's own process, before it reads anything.
_PLAIN_PROCESS_MEGABYTES = 150.0
_BATCH = 250
_MEBIBYTE = 2**20
_BODY = body()


# ---- readers: what is done with a file, and what must be true of what was read


def _shape(file: Path) -> None:
    shape = homolog.read_shape(file)
    json.dumps(homolog.check(shape).to_dict(), allow_nan=False)
    clean = homolog.repair(shape).shape
    assert np.isfinite(clean.points).all(), "a repaired shape has points that are no numbers"
    assert clean.faces is None or 0 <= clean.faces.min() <= clean.faces.max() < clean.n_points, "faces do not fit"


def _look(file: Path) -> None:
    file = next(file.parent.glob("*.obj"))
    read_appearance(file, homolog.read_shape(file))


def _skin(file: Path) -> None:
    shape = homolog.read_shape(file)
    read_appearance(file, shape)
    read_skin(file, shape)


def _volume(file: Path) -> None:
    mask_surface(read_mask(file))


def _weights(file: Path) -> None:
    features = homolog.load_weights(file)
    assert all(tensor.isfinite().all() for tensor in features.network.state_dict().values()), "weights are no numbers"


def _cache(file: Path) -> None:
    """A damaged entry is computed anew."""
    found = OperatorCache(file.parent).operators(_BODY, settings=OPERATORS)
    expected = homolog.compute_operators(_BODY, settings=OPERATORS)
    assert np.allclose(found.eigenvalues, expected.eigenvalues, atol=1e-4), "a damaged entry was believed"


def _array(file: Path) -> None:
    read_array(file, _BODY)
    read_labels(file, _BODY)


def _map(file: Path) -> None:
    read_point_map(file)


def _truth(file: Path) -> None:
    read_truth((file, file), (_BODY, _BODY))


def _landmarks(file: Path) -> None:
    marks = read_landmarks(file)
    marks.write_from(file.with_name("again" + "".join(file.suffixes)), marks.points, "RAS")


def _recipe(file: Path) -> None:
    read_recipe(file).for_dataset()


def _description(file: Path) -> None:
    read_description(file)


def _result(file: Path) -> None:
    found = Match.load(file if file.is_dir() else file.parent)
    for confidence in (found.source_confidence, found.target_confidence):
        assert ((confidence >= 0) & (confidence <= 1)).all(), "a confidence is not between 0 and 1"
    scene_of(found).title.encode()


READERS: dict[str, Callable[[Path], None]] = {
    **{"shape": _shape, "look": _look, "skin": _skin, "volume": _volume, "weights": _weights, "cache": _cache},
    **{"array": _array, "map": _map, "truth": _truth, "landmarks": _landmarks, "recipe": _recipe},
    **{"description": _description, "result": _result},
}
_BY_SUFFIX = {
    **dict.fromkeys((".mhd", ".mha", ".nii", ".gz", ".nrrd", ".nhdr"), "volume"),
    **dict.fromkeys((".safetensors", ".pth"), "weights"),
    **{".mtl": "look", ".png": "look", ".mat": "map", ".vts": "truth", ".fcsv": "landmarks", ".json": "landmarks"},
    **{".toml": "recipe", "": "result"},
}


class Task(NamedTuple):
    """A file to read: one that is there, or a seed to damage.

    Args:
        number: of the mutant; what is damaged, and how, follows from it and from the campaign's seed.
        seed: the file, and its reader.
        chance: the seed of its random numbers; None for a file as it is.
    """

    number: int
    seed: Seed
    chance: str | None

    def make(self, folder: Path) -> Path:
        """Copy the file and its neighbours into a folder, and damage it."""
        source = self.seed.file
        if source.is_dir():
            shutil.copytree(source, folder)
            return folder
        folder.mkdir()
        for beside in source.parent.iterdir():
            if beside.is_file():  # and no pipe
                shutil.copy(beside, folder / beside.name)
        copy = folder / source.name
        if self.chance is not None:
            copy.write_bytes(mutate(source.read_bytes(), source.suffix, Random(self.chance)))
        return copy


# ---- a worker: a fork that reads one file after the other, and tells of each


def _work(tasks: Sequence[Task], pipe: int, folder: Path, parent: int) -> None:
    os.setsid()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    end_with_parent(parent)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (12 * 2**30, 12 * 2**30))
    printed = folder / "printed"
    log = os.open(printed, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(log, 1)
    os.dup2(log, 2)
    logging.getLogger("homolog").addHandler(logging.NullHandler())
    for task in tasks:
        os.truncate(printed, 0)
        file = task.make(folder / "mutant")
        os.write(pipe, f"{task.number}\n".encode())
        said = _read(task.seed.reader, file)
        if printed.stat().st_size and not said:
            said = f"printed: {printed.read_text(errors='replace')[:200]!r}"
        os.write(pipe, f"{json.dumps([said, _allowed(file)])}\n".encode())
        shutil.rmtree(folder / "mutant")


def _read(reader: str, file: Path) -> str:
    """What is wrong with how a file was read; nothing if all is well."""
    began, before, said = sum(os.times()[:4]), _peak(anew=True), ""
    try:
        READERS[reader](file)
    except HomologError as error:
        said = _fault_of(str(error).replace(str(file), "FILE"))
    except BaseException as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        said = f"traceback: {type(error).__name__} at {Path(last.filename).name}:{last.lineno}: {str(error)[:200]!r}"
    used = _peak() - before
    if not said and used > _allowed(file):
        said = f"memory: {used:.0f} MB"
    seconds = sum(os.times()[:4]) - began  # of this process and of readers' own, whatever else the machine does
    return said or (f"slow: {seconds:.1f} s" if seconds > _SECONDS else "")


def _fault_of(message: str) -> str:
    if len(message) > _LONGEST_MESSAGE or not message.isprintable():
        return f"message: {message[:_LONGEST_MESSAGE]!r}"
    return "" if "allocate" not in message else f"message of memory: {message!r}"


def _allowed(file: Path) -> float:
    """The megabytes that may be taken to read a file, or a folder."""
    held = [file] if file.is_file() else [*file.glob("*")]
    return 2 * sum(each.stat().st_size for each in held if each.is_file()) / _MEBIBYTE + _MEGABYTES


def _peak(process: str = "self", *, anew: bool = False) -> float:
    """The most memory that a process has held, in megabytes; from now on, if it is to begin anew; 0 if it is gone."""
    with suppress(OSError):
        if anew:
            Path(f"/proc/{process}/clear_refs").write_text("5")
        found = Path(f"/proc/{process}/status").read_text().partition("VmHWM:")[2]
        return int(found.split()[0]) / 1024 if found else 0.0
    return 0.0


def _peak_of_children(process: int) -> float:
    """The most memory that a process which it runs has held beyond a plain start, in megabytes."""
    with suppress(OSError):
        children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
        return max(map(_peak, children), default=0.0) - _PLAIN_PROCESS_MEGABYTES
    return 0.0


# ---- the campaign


def _ended(worker: int) -> int:
    """End a worker with whatever it started; its exit status."""
    with suppress(ProcessLookupError, PermissionError):  # it may have ended, or not have a group of its own yet
        os.killpg(worker, signal.SIGKILL)
    with suppress(ProcessLookupError):
        os.kill(worker, signal.SIGKILL)
    return os.waitpid(worker, 0)[1]


class Campaign:
    """Reads files in workers, one batch after the other, and keeps what fails below a folder."""

    def __init__(self, out: Path, seconds: float) -> None:
        self.failures: Counter[str] = Counter()
        self.read: Counter[str] = Counter()
        self._kept, self._seconds = out / "failures", seconds
        self._kept.mkdir(parents=True, exist_ok=True)

    def run(self, tasks: Sequence[Task]) -> None:
        """Read all files; a worker that crashes or hangs costs only the file that it had."""
        for start in range(0, len(tasks), _BATCH):
            left = list(tasks[start : start + _BATCH])
            while left:
                left = left[self._batch(left) :]

    def _batch(self, tasks: Sequence[Task]) -> int:
        """Read files until one ends the worker; how many were read."""
        reading, writing = os.pipe()
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            parent, worker = os.getpid(), os.fork()
            if not worker:
                os.close(reading)
                try:
                    _work(tasks, writing, Path(folder), parent)
                finally:
                    os._exit(0)
            os.close(writing)
            try:
                done, said = self._listen(reading, tasks, worker)
            finally:  # also after Ctrl-C or SIGTERM
                os.close(reading)
                status = _ended(worker)
        if done < len(tasks):
            self._note(tasks[done], said or f"crash: signal {status & 127}, exit code {status >> 8}")
            done += 1
        return done

    def _listen(self, pipe: int, tasks: Sequence[Task], worker: int) -> tuple[int, str]:
        """Hear what a worker tells of each file, until it ends or is silent for too long."""
        done, rest, began, used = 0, b"", time.monotonic(), 0.0
        while done < len(tasks):
            used = max(used, _peak_of_children(worker))
            if not select.select([pipe], [], [], 0.02)[0]:
                if time.monotonic() - began > self._seconds:
                    return done, f"hang: longer than {self._seconds:g} s"
                continue
            part = os.read(pipe, 65536)
            if not part:
                return done, ""
            *lines, rest = (rest + part).split(b"\n")
            for line in lines:
                began = time.monotonic()
                if line.startswith(b"["):
                    said, allowed = json.loads(line)
                    self._note(tasks[done], said or (f"memory: {used:.0f} MB" if used > allowed else ""))
                    done, used = done + 1, 0.0
        return done, ""

    def _note(self, task: Task, said: str) -> None:
        self.read[task.seed.reader] += 1
        if not said:
            return
        self.failures[said.partition(":")[0]] += 1
        name = f"{said.partition(':')[0].replace(' ', '_')}-{task.seed.reader}-{task.number}"
        shutil.rmtree(self._kept / name, ignore_errors=True)
        kept = task.make(self._kept / name)
        print(f"{kept}: {said}", flush=True)


def _mutants(seeds: Sequence[Seed], number: int, campaign: int) -> list[Task]:
    drawn = Random(campaign).choices(seeds, weights=[seed.often for seed in seeds], k=number)
    return [Task(index, seed, f"{campaign}/{index}") for index, seed in enumerate(drawn)]


def _given(files: Sequence[Path]) -> list[Task]:
    """Files as they are, those in folders too; one with a report is a result, and one of a failure names its reader."""
    found = list[Task]()
    for path in files:
        is_result = path.is_dir() and (path / "report.json").exists()
        held = [path] if is_result or not path.is_dir() else [file for file in sorted(path.iterdir()) if file.is_file()]
        named = next((word for word in path.name.split("-")[1:2] if word in READERS), None)
        found += [Task(0, Seed(file, named or _BY_SUFFIX.get(file.suffix, "shape")), None) for file in held]
    return [task._replace(number=number) for number, task in enumerate(found)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a campaign; the exit code says whether a reader failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutants", type=int, default=20_000, help="how many to make")
    parser.add_argument("--seed", type=int, default=1, help="of the random numbers")
    parser.add_argument("--out", type=Path, default=Path("build/fuzz"), help="where failures are kept")
    parser.add_argument("--only", nargs="*", choices=READERS, help="the readers to try; all by default")
    parser.add_argument("--files", type=Path, nargs="*", help="files or folders to read as they are, not mutants")
    parser.add_argument("--seconds", type=float, default=20.0, help="after which a reader is ended")
    options: Any = parser.parse_args(arguments)
    # Of a pool of threads, a fork inherits the locks but not the threads: its first parallel step would wait for ever.
    torch.set_num_threads(1)
    # As after Ctrl-C, blocks are left, so that no worker and no folder stays behind.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    campaign, began = Campaign(options.out, options.seconds), time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        if options.files:
            tasks = _given(options.files)
        else:
            seeds = make_seeds(Path(folder) / "seeds")
            chosen = [seed for seed in seeds if seed.reader in (options.only or READERS)]
            tasks = _mutants(chosen, options.mutants, options.seed)
        campaign.run(tasks)
    failed = sum(campaign.failures.values())
    print(f"{len(tasks)} files in {time.monotonic() - began:.0f} s: {dict(sorted(campaign.read.items()))}")
    print(f"{failed} failures: {dict(sorted(campaign.failures.items()))}")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
