"""Tasks in the workers of Ray: their order, their failures, workers that die, and what is left of it all."""

import logging
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import psutil
import pytest

from homolog.core.cluster import Cluster
from homolog.core.errors import ArgumentError, DataError, HomologError, MissingExtraError
from homolog.core.files import atomic_path
from homolog.core.tasks import run_tasks
from homolog.synthesis import synthesize_animals

ray = pytest.importorskip("ray", reason="Ray is missing; pip install 'homolog[cluster]'")
pytestmark = [
    pytest.mark.process,
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals"),
]


def begun(number, folder):
    """Say that a task has begun and where; give both, after a while."""
    Path(folder, f"{number} {os.getpid()} {time.monotonic_ns()}").touch()
    time.sleep(0.1)
    return number, os.getpid()


def half_written(number, folder):
    """The first time that a task is done, its worker dies amid writing."""
    path = Path(folder, f"{number}.txt")
    with atomic_path(path) as temporary:
        temporary.write_text(str(number))
        if number == 3 and not Path(folder, "died").exists():
            Path(folder, "died").touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return number


def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)


def fail(folder):
    raise DataError(f"{folder} is none of ours")


def add_one(values):
    values += 1  # as joblib's workers may
    return values


def threads():
    return os.environ["OMP_NUM_THREADS"], os.environ["HOMOLOG_CACHE"], str(Path.cwd())


def run(tasks, cluster, **others):
    given = []
    named = [(str(number), task) for number, task in enumerate(tasks)]
    run_tasks([named], processes=cluster, progress=lambda *_: None, told=given.append, **others)
    return given


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A user's Ray of two cores, which must be there after all tests, and its address."""
    token = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_TOKEN": "0123456789abcdef" * 4}
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("RAY_AUTH_MODE", raising=False)
        for name, value in token.items():
            patch.setenv(name, value)
        ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
        logging.getLogger("ray").setLevel(logging.CRITICAL)
        ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, object_store_memory=10**8)
        yield ray.get_runtime_context().gcs_address
        assert ray.is_initialized() and ray.get(ray.remote(lambda: 1).remote()) == 1
        ray.shutdown()
        patch.delenv("RAY_AUTH_MODE", raising=False)  # which Ray sets


def test_results_come_in_the_order_of_the_tasks_from_two_workers(cluster, tmp_path):
    given = run([partial(begun, number, tmp_path) for number in range(8)], Cluster())
    assert [number for number, _ in given] == list(range(8))
    processes = {process for _, process in given}
    assert len(processes) == 2 and os.getpid() not in processes


def test_tasks_are_given_what_they_need(cluster, monkeypatch, tmp_path):
    monkeypatch.setenv("HOMOLOG_CACHE", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert run([threads], Cluster()) == [("1", str(tmp_path), str(tmp_path))]
    values = np.zeros(10**6)  # large enough for Ray to keep it where nobody may write
    assert (run([partial(add_one, values)], Cluster())[0] == 1).all() and (values == 0).all()


def test_a_worker_that_dies_is_replaced_and_its_task_done_again(cluster, tmp_path):
    given = run([partial(half_written, number, tmp_path) for number in range(8)], Cluster(), writes=tmp_path)
    assert given == list(range(8))
    assert {path.name for path in tmp_path.iterdir()} == {"died", *(f"{number}.txt" for number in range(8))}


def test_a_task_at_which_every_worker_dies_is_one_line(cluster):
    with pytest.raises(ArgumentError, match=r"a worker died at the same task 4 times.*fewer --processes"):
        run([die], Cluster())


def test_a_failure_is_raised_as_it_is_and_no_further_task_begins(cluster, tmp_path):
    tasks = [partial(fail, tmp_path), *(partial(begun, number, tmp_path) for number in range(40))]
    with pytest.raises(DataError, match=r"^\S+ is none of ours$"):
        run(tasks, Cluster())
    assert len(list(tmp_path.iterdir())) < 20


def test_a_worker_that_cannot_see_a_folder_names_it(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr("homolog.core.cluster.is_there", lambda path: True)  # of this process
    with pytest.raises(HomologError, match=r"the worker \S+ cannot see /nowhere/shapes; have all files"):
        run([partial(abs, 1)], Cluster(), reads=[Path("/nowhere/shapes")])


def test_an_address_where_nobody_answers_is_one_line(monkeypatch):
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    for address in ("127.0.0.1:1", "ray://127.0.0.1:1", "here:there"):
        with pytest.raises(ArgumentError, match=f"there is no Ray cluster at '{address}'"):
            run([partial(abs, 1)], Cluster(address))


def test_nothing_is_made_for_a_cluster_that_does_not_answer(tmp_path):
    with pytest.raises(ArgumentError, match=r"there is no Ray cluster at '127\.0\.0\.1:1'"):
        synthesize_animals(tmp_path / "animals", 2, processes=Cluster("127.0.0.1:1"))
    assert not (tmp_path / "animals").exists()


def test_without_ray_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'homolog\[cluster\]'"):
        Cluster()


def homolog(*arguments, environment=None):
    command = [sys.executable, "-m", "homolog", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def made_by(folder):
    """The bytes of all files of a folder."""
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_users_cluster_makes_the_same_bytes_though_a_worker_is_killed(cluster, tmp_path):
    asked = ["synth", "animals", "-n", 6, "--vertices", 500, "-q"]
    one = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    alone = homolog(*asked, "-o", tmp_path / "alone", "--processes", 2, environment=one)
    assert alone.communicate(timeout=300) == ("", "")
    ended = homolog(*asked, "-o", tmp_path / "cluster", "--cluster", cluster, environment=one)
    first = tmp_path / "cluster" / "records"
    until(lambda: first.is_dir() and any(first.iterdir()))
    # Of those that end meanwhile, psutil knows no command line.
    every = psutil.process_iter(["cmdline"])
    workers = [each for each in every if "ray::_in_worker" in " ".join(each.info["cmdline"] or [])]
    workers[0].kill()
    assert ended.communicate(timeout=300) == ("", "") and ended.returncode == 0
    assert made_by(tmp_path / "cluster") == made_by(tmp_path / "alone")


def test_an_interrupt_ends_the_ray_that_was_begun_and_leaves_nothing_half_written(tmp_path):
    environment = {**os.environ, "TMPDIR": str(tmp_path / "temporary"), "PYTHONPATH": os.pathsep.join(sys.path)}
    output = tmp_path / "animals"
    (tmp_path / "temporary").mkdir()
    before = set(Path("/tmp").glob("homolog-ray-*"))
    command = homolog(
        *("synth", "animals", "-n", 40, "--vertices", 500, "-o", output, "--cluster", "ray", "--processes", 2),
        environment=environment,
    )
    until(lambda: (output / "records").is_dir() and any((output / "records").iterdir()))
    others = psutil.Process(command.pid).children(recursive=True)
    command.send_signal(signal.SIGINT)
    said = command.communicate(timeout=60)
    assert command.returncode == 130 and said == ("", "Interrupted; nothing was left half-written.\n")
    until(lambda: not any(each.is_running() and each.status() != psutil.STATUS_ZOMBIE for each in others))
    assert not [path for path in output.rglob("*") if path.name.startswith(".homolog")]
    assert set(Path("/tmp").glob("homolog-ray-*")) <= before


def until(holds):
    deadline = time.monotonic() + 120
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.05)
