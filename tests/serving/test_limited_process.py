"""A program that is cancelled while it starts: nothing of it stays."""

import os
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import anyio
import pytest
from serving_tools import STUCK, gone, until

from homolog.serving import Limits
from homolog.serving import process as process_module
from homolog.serving.process import run_limited

pytestmark = pytest.mark.process


@pytest.fixture
def run(tmp_path):
    """Run a program that waits to be ended, with a child that does, too."""
    return partial(
        run_limited,
        (sys.executable, "-c", STUCK),
        folder=tmp_path,
        environment=dict(os.environ),
        limits=Limits(),
        on_line=lambda line: None,
    )


class Starts:
    """Stands in for ``anyio.open_process``, which it calls; what comes before and after it is held on the way."""

    def __init__(self, monkeypatch, before, after):
        self.open, self.before, self.after, self.pids = anyio.open_process, before, after, []
        monkeypatch.setattr(process_module.anyio, "open_process", self)

    async def __call__(self, *arguments, **options):
        await self.before()
        process = await self.open(*arguments, **options)
        self.pids.append(process.pid)
        await self.after()
        return process


async def nothing():
    """Goes on at once."""


@pytest.mark.parametrize("moment", ["before it is called", "before it starts", "as it starts", "once it has a child"])
def test_a_program_that_is_cancelled_early_does_not_stay(run, tmp_path, monkeypatch, moment):
    async def main():
        reached, released = anyio.Event(), anyio.Event()

        async def hold():
            reached.set()
            await released.wait()

        async def hold_with_child():
            await anyio.to_thread.run_sync(until, (tmp_path / "pids").exists)
            await hold()

        before = hold if moment == "before it starts" else nothing
        after = {"as it starts": hold, "once it has a child": hold_with_child}.get(moment, nothing)
        starts = Starts(monkeypatch, before, after)
        async with anyio.create_task_group() as group:
            if moment == "before it is called":
                group.cancel_scope.cancel()
            group.start_soon(run)
            if moment != "before it is called":
                await reached.wait()
            group.cancel_scope.cancel()
            released.set()
        return starts.pids

    with ThreadPoolExecutor(1) as own_thread:  # a browser of another test may hold an event loop in this one
        pids = own_thread.submit(anyio.run, main).result()
    if moment == "once it has a child":
        pids += [int(number) for number in (tmp_path / "pids").read_text().split()]
    assert len(pids) == (3 if moment == "once it has a child" else 1)
    assert until(lambda: gone(pids))
