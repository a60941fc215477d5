"""Checks of an axis at rest."""

import math
from typing import Final

import numpy as np

from hil.commissioning.held import held_axis
from hil.commissioning.seen import Checked
from hil.master.control_words import QUICK_STOP
from hil.results.check import CheckEntry

WATCH_S: Final = 0.4
"""Time for which a motor without torque is watched."""
STILL_REV: Final = 0.01
"""Turn of a motor that counts as standing; a brake has some play."""
STOP_S: Final = 0.5
"""Time that a drive may take to go out of operation, beside the ramp of a quick stop."""
LATE_S: Final = 0.2
"""Time beyond the consumer heartbeat time, within which a drive must have noticed that its master is silent."""
CONSUMER_PERIODS: Final = 3.0
"""Heartbeat periods after which a drive is told to take its master for lost."""


def check_standstill(of: Checked) -> list[CheckEntry]:
    """Check the axis at rest without torque, and its quick stop.

    It must remain at rest before it is enabled and after a quick stop, and the quick stop must end its torque.
    """
    with held_axis(of.session, of.number) as held:
        before = held.watch(WATCH_S)
        if not _stands(before):
            return [of.passed("brake holds", False, f"{_turned(before)} before anything was enabled")]
        if not (held.rise() and held.rest(WATCH_S)):
            return [of.stopped("stands enabled", held, "although it was commanded to rest")]
        rest = np.zeros(round(STOP_S / held.period_s))
        took_s = held.command(QUICK_STOP, rest.tolist())
        if took_s is None:
            words = f"still in operation {1e3 * STOP_S:.0f} ms after the command (605Ah, 6085h)"
            return [of.passed("quick stop, standing", False, words)]
        after = held.watch(WATCH_S)
        held.stopped = "quick stop"
        return [
            of.passed("stands enabled", True, f"enabled for {WATCH_S:g} s, no stop, no emergency"),
            of.passed("quick stop, standing", True, f"left operation after {1e3 * took_s:.0f} ms"),
            of.passed("brake holds", _stands(after), f"{_turned(after)} after the torque ended (a brake, or friction)"),
        ]


def check_heartbeat(of: Checked) -> list[CheckEntry]:
    """Check that the drive stops without the master's heartbeat."""
    with held_axis(of.session, of.number) as held:
        if not (held.rise() and held.rest(0.1)):
            return [of.stopped("heartbeat loss", held, "although it was commanded to rest")]
        limit_s = CONSUMER_PERIODS * of.session.bench.bus.heartbeat_s
        took_s = held.silence(limit_s + LATE_S)
        if took_s is None:
            seen = f"still enabled {1e3 * (limit_s + LATE_S):.0f} ms after the master's last heartbeat (1016h, 6007h)"
            return [of.passed("heartbeat loss", False, seen)]
        held.stopped = "heartbeat"
        seen = f"left operation {1e3 * took_s:.0f} ms after the master's last heartbeat, expected about {1e3 * limit_s:.0f} ms"
        return [of.passed("heartbeat loss", True, seen)]


def _stands(angles_rad: np.ndarray) -> bool:
    return len(angles_rad) > 0 and float(np.ptp(angles_rad)) <= math.tau * STILL_REV


def _turned(angles_rad: np.ndarray) -> str:
    if not len(angles_rad):
        return "no position came"
    return f"the motor turned by {np.ptp(angles_rad) / math.tau:.4f} rev in {WATCH_S:g} s"
