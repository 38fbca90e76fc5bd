"""Signals that wait until a training has saved."""

import signal
import sys
import threading

import pytest

from homolog.training.interrupts import deferred_interrupts

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")


class Arrived(BaseException):
    """What the handler before raises."""


@pytest.fixture(params=[signal.SIGINT, signal.SIGTERM])
def number(request):
    """A signal whose handler raises."""

    def arrived(number, frame):
        raise Arrived(number)

    before = signal.signal(request.param, arrived)
    yield request.param
    signal.signal(request.param, before)


def test_a_signal_acts_when_the_block_ends(number):
    done = []
    with pytest.raises(Arrived), deferred_interrupts() as interrupts:
        assert not interrupts
        signal.raise_signal(number)
        assert interrupts
        done.append(True)
    assert done


def test_a_second_signal_acts_at_once(number):
    done = []
    with pytest.raises(Arrived), deferred_interrupts():
        signal.raise_signal(number)
        signal.raise_signal(number)
        done.append(True)
    assert not done


def test_without_a_signal_everything_is_as_before(number):
    before = signal.getsignal(number)
    with deferred_interrupts() as interrupts:
        assert signal.getsignal(number) is not before
    assert not interrupts
    assert signal.getsignal(number) is before
    with pytest.raises(ValueError, match="mine"), deferred_interrupts():
        raise ValueError("mine")
    assert signal.getsignal(number) is before


def test_other_threads_are_left_alone(number):
    before, seen = signal.getsignal(number), []

    def elsewhere():
        with deferred_interrupts() as interrupts:
            seen.append((bool(interrupts), signal.getsignal(number)))

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert seen == [(False, before)]
