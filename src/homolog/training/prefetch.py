"""Loading what later steps need while earlier ones are computed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")

_STEPS_AHEAD = 4


def prefetched(load: Callable[[int], T], steps: Sequence[int], *, workers: int) -> Generator[T, None, None]:
    """What ``load`` gives for each step, in order, loaded by threads while the caller works on earlier ones."""
    pool = ThreadPoolExecutor(workers)
    try:
        waiting: deque[Future[T]] = deque()
        for step in steps:
            waiting.append(pool.submit(load, step))
            if len(waiting) > _STEPS_AHEAD:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)
