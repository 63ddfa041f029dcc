"""Time is counted where it is spent; stopping waits for the frame to end."""

import os
import signal
import time

import pytest

from slam.pipeline.progress import stop_on_interrupt
from slam.timing import StageTimer


def test_a_stage_entered_twice_counts_both_times():
    clock = StageTimer()
    for _ in range(2):
        with clock.stage("sleep"):
            time.sleep(0.002)
    assert clock.lap()["sleep"] >= 4.0


def test_a_lap_starts_from_nothing():
    clock = StageTimer()
    with clock.stage("first"):
        pass
    clock.lap()
    assert clock.lap() == {}


def test_time_counts_even_when_the_stage_fails():
    clock = StageTimer()
    with pytest.raises(ValueError, match="inside"), clock.stage("failing"):
        raise ValueError("inside")
    assert "failing" in clock.lap()


def test_the_first_interrupt_is_a_request_and_the_second_one_stops():
    with stop_on_interrupt() as stop:
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.requested
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def test_the_former_signal_handler_is_restored():
    before = signal.getsignal(signal.SIGINT)
    with stop_on_interrupt():
        pass
    assert signal.getsignal(signal.SIGINT) is before
