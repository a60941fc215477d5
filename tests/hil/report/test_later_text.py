"""A text made beside this process is that which would have been made here, whatever becomes of the copy that makes it."""

import subprocess
import sys
import textwrap

import pytest

ALONE = """
import os, signal, sys, threading, time
os.sched_getaffinity = lambda process: range(2)
from hil.report.later_text import LaterText
"""
"""A process with one thread, which those of a test run are not, and with two processors."""

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="copies of a process are made on Linux")


def alone(program):
    done = subprocess.run(
        [sys.executable, "-c", ALONE + textwrap.dedent(program)], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.stderr == ""
    return done.stdout.split()


def test_texts_come_from_copies_each_its_own_and_none_is_left_behind():
    said = alone("""
        texts = [LaterText(lambda number=number: f"{number}:{os.getpid()}:{'é' * 200_000}") for number in range(7)]
        for text in texts:
            number, process, rest = str(text).split(":")
            print(number, process != str(os.getpid()), len(rest), str(text) == str(text))
        try:
            os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            print("none")
    """)
    assert said == [*" ".join(f"{number} True 200000 True" for number in range(7)).split(), "none"]


@pytest.mark.ci
def test_no_more_copies_than_processors_are_at_work():
    said = alone("""
        begun = time.monotonic()
        texts = [LaterText(lambda: time.sleep(0.3) or str(time.monotonic())) for _ in range(6)]
        ended = sorted(float(str(text)) for text in texts)
        print(all(later - earlier > 0.25 for earlier, later in zip(ended, ended[2:])))
    """)
    assert said == ["True"]


@pytest.mark.parametrize("end", ["os.kill(os.getpid(), signal.SIGKILL)", "os._exit(3)", "1 / 0", "sys.exit(0)"])
def test_a_copy_that_fails_is_replaced_by_this_process(end):
    said = alone(f"""
        here = os.getpid()
        def make():
            if os.getpid() != here:
                {end}
            return "made"
        print(str(LaterText(make)))
    """)
    assert said == ["made"]


def test_a_mistake_is_raised_here():
    said = alone("""
        def make():
            raise ValueError("the colour")
        text = LaterText(make)
        try:
            str(text)
        except ValueError as error:
            print(error)
    """)
    assert said == ["the", "colour"]


def test_beside_other_threads_and_on_one_processor_it_is_made_here():
    said = alone("""
        stop = threading.Event()
        other = threading.Thread(target=stop.wait)
        other.start()
        print(str(LaterText(lambda: str(os.getpid()))) == str(os.getpid()))
        stop.set()
        other.join()
        os.sched_getaffinity = lambda process: range(1)
        print(str(LaterText(lambda: str(os.getpid()))) == str(os.getpid()))
    """)
    assert said == ["True", "True"]


def test_a_program_that_never_asks_ends_all_the_same():
    assert alone("""
        LaterText(lambda: time.sleep(0.2) or "")
        print("ended")
    """) == ["ended"]


def test_a_failing_copy_does_not_flush_what_this_process_has_yet_to_print():
    said = alone("""
        sys.stdout.write("once ")
        print(str(LaterText(lambda: str(1 / 1))))
    """)
    assert said == ["once", "1.0"]
