"""Surroundings of processes that calculate: Ctrl-C waits while they start, whichever thread it comes by."""

import signal
import threading
import time

import pytest

from plant_emulator.trials.executors import deaf_children


def _ctrl_c_by_another_thread():
    other = threading.Thread(target=signal.raise_signal, args=(signal.SIGINT,))
    other.start()
    other.join()
    time.sleep(0.01)


def test_ctrl_c_that_comes_by_another_thread_waits_until_processes_are_written_down():
    written_down = []
    other_is_there = threading.Event()
    ends = threading.Event()

    def other():  # one that does not block the signal: the system gives it to this thread
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        other_is_there.set()
        ends.wait(10.0)
        signal.raise_signal(signal.SIGINT)

    thread = threading.Thread(target=other)
    thread.start()
    other_is_there.wait(10.0)

    def start():
        with deaf_children():
            ends.set()
            thread.join()
            time.sleep(0.01)
            written_down.append("process")

    with pytest.raises(KeyboardInterrupt):
        start()
    assert written_down == ["process"]


def test_ctrl_c_in_this_thread_waits_as_well():
    written_down = []

    def start():
        with deaf_children():
            signal.raise_signal(signal.SIGINT)
            written_down.append("process")

    with pytest.raises(KeyboardInterrupt):
        start()
    assert written_down == ["process"]


def test_afterwards_ctrl_c_acts_as_before():
    before = signal.getsignal(signal.SIGINT)
    with deaf_children():
        pass
    assert signal.getsignal(signal.SIGINT) is before
    with pytest.raises(KeyboardInterrupt):
        _ctrl_c_by_another_thread()


def test_a_thread_that_is_not_the_main_one_may_start_processes():
    done = []

    def start():
        with deaf_children():
            done.append(True)

    thread = threading.Thread(target=start)
    thread.start()
    thread.join()
    assert done == [True]
