"""What is loaded ahead: in order, by threads that end, errors included."""

import threading
import time

import pytest

from homolog.training.prefetch import prefetched


def test_prefetched_is_in_order_and_ahead():
    ahead = threading.Event()

    def load(step):
        if step == 3:  # is not done before the next one has begun
            assert ahead.wait(120)
        if step == 4:
            ahead.set()
        time.sleep(0.01 * (step % 3))
        return step

    steps = prefetched(load, range(3, 20), workers=3)
    assert next(steps) == 3
    assert list(steps) == list(range(4, 20))
    assert list(prefetched(load, range(0), workers=1)) == []


def test_prefetched_ends_its_threads_and_passes_errors_on():
    def load(step):
        if step == 4:
            raise ValueError("four")
        return step

    before = threading.active_count()
    with pytest.raises(ValueError, match="four"):
        list(prefetched(load, range(10), workers=2))
    steps = prefetched(load, range(10), workers=2)
    next(steps)
    steps.close()
    assert threading.active_count() == before
