"""Tasks that cost nothing, for the tests of those who give them out: functions of a module, as processes import them."""

import os
import signal
import sys
import time
from pathlib import Path


def squared(seed):
    return {"seed": seed, "walk": "walked", "square": seed * seed, "third": seed / 3.0, "cpu_s": time.process_time()}


def dies_once(seed, folder, mortal):
    """The mortal seed's process kills itself the first time."""
    trace = Path(folder) / f"died-{seed}"
    if seed == mortal and not trace.exists():
        trace.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return squared(seed)


def dies_always(seed, folder, mortal):
    if seed == mortal:
        with (Path(folder) / "deaths").open("a") as file:
            file.write("x")
        os.kill(os.getpid(), signal.SIGKILL)
    return squared(seed)


def tells_and_waits(seed, folder):
    """Leaves the number of its process, and takes a while."""
    (Path(folder) / f"at-{seed}").write_text(str(os.getpid()))
    time.sleep(1.0)
    return squared(seed)


def sleeps(seed, folder):
    (Path(folder) / f"at-{seed}").write_text(str(os.getpid()))
    time.sleep(600.0)
    return squared(seed)


def parent_and_modules():
    """Process that this one was forked from, and the modules that it has."""
    return os.getppid(), sorted(sys.modules)
