"""Checks in a slow third of a turn and back."""

import math
from typing import Final

import numpy as np

from hil.commissioning.held import HeldAxis, held_axis
from hil.commissioning.seen import Checked
from hil.commissioning.standing import STOP_S
from hil.control.arrays import Real
from hil.design.estimation import SURE_SIGMAS
from hil.experiments.plant.motion import MotionBuilder, PlannedMotion, PlantRequest
from hil.experiments.plant.probe import PROBE_RPS, probe_motion, probe_trouble, slow_torque
from hil.master.control_words import QUICK_STOP
from hil.results.check import CheckEntry

SHOWN_TRAVEL: Final = (0.8, 1.25)
"""Part of the travel that the encoder must show."""
OVERRUN_REV: Final = 0.05
"""Turn beyond the ramp of a quick stop that a motor may take."""
LEFT_REV: Final = 0.05
"""Room that is left to a position limit at the end of a motion."""


def room_trouble(of: Checked, low_rev: float, high_rev: float) -> str | None:
    """Return why the motor lacks room to either side, or None."""
    limits = of.session.bench.axis[of.number].limits
    here = of.session.axes[of.number].position_rad() / math.tau
    if limits.position_min_rev + LEFT_REV <= here + low_rev and here + high_rev <= limits.position_max_rev - LEFT_REV:
        return None
    return (
        f"the motor is at {here:.2f} rev and would go from {here + low_rev:.2f} to {here + high_rev:.2f} rev; its limits are "
        f"{limits.position_min_rev:g} and {limits.position_max_rev:g} rev: move it away from them "
        f"with hil move --axis {of.number} --to REV"
    )


def check_turn(of: Checked) -> list[CheckEntry]:
    """Check brake, encoder sign and torque sign in a slow turn.

    The brake must open, the encoder follow, and the reported torque have the sign of the motion.
    """
    bench, table = of.session.bench, of.session.bench.axis[of.number]
    here = of.session.axes[of.number].position_rad() / math.tau
    planned = probe_motion(bench, PlantRequest(of.number), here)
    turns = planned.bias_rad / math.tau
    if (trouble := room_trouble(of, float(turns.min()), float(turns.max()))) is not None:
        return [of.not_made(name, trouble) for name in ("brake opens", "encoder sign", "torque sign")]
    with held_axis(of.session, of.number) as held:
        if held.rise():
            held.go(planned.bias_rad)
        recording = held.recorded()
    if not len(recording.time_s):
        return [of.stopped("brake opens", held, "before it turned")]
    path = of.keep(recording, f"axis-{of.number}-turn")
    if held.is_masters_fault:
        return [of.stopped("encoder sign", held, "in a slow third of a turn", path)]
    found = probe_trouble(planned, recording, of.number, table.limits.torque_nm, table.reduction_ratio)
    if found is not None:
        name = {"brake": "brake opens", "encoder": "encoder sign", "torque": "torque sign", "arm": "arm free"}[found.about]
        return [of.passed(name, False, found.sentence, path)]
    if held.stopped is not None:
        return [of.stopped("encoder sign", held, "in a slow third of a turn", path)]
    return _turned(of, planned, recording.axis(of.number, "position_rad"), recording.axis(of.number, "torque_nm"), path)


def _turned(of: Checked, planned: PlannedMotion, angle: Real, torque: Real, path: str) -> list[CheckEntry]:
    """Checks by a turn that was not stopped; shapes (n,)."""
    wanted, moved = planned.bias_rad, angle - angle[0]
    along = float(np.dot(moved, wanted) / np.dot(wanted, wanted))
    friction, _ = slow_torque(angle, torque, planned)
    seen = f"the motor's angle showed {100.0 * along:.0f} % of {np.ptp(wanted) / math.tau:.2g} rev"
    checks = [
        of.passed("brake opens", True, f"{seen} at up to {np.max(np.abs(torque)):.3g} N·m", path),
        of.passed("encoder sign", SHOWN_TRAVEL[0] <= along <= SHOWN_TRAVEL[1], f"{seen}, along the set-point", path),
    ]
    words = f"friction {friction[0]:+.3g} ± {friction[1]:.1g} N·m along the motion"
    if friction[0] > SURE_SIGMAS * friction[1]:
        return [*checks, of.passed("torque sign", True, words, path)]
    return [*checks, of.entry("torque sign", "NOT JUDGED", f"{words}: too little to differ from zero", path)]


def check_quick_stop(of: Checked) -> list[CheckEntry]:
    """Check that a quick stop ends a slow motion within its ramp."""
    bench, name = of.session.bench, "quick stop, moving"
    here = of.session.axes[of.number].position_rad() / math.tau
    builder = MotionBuilder(bench.bus.sync_period_s)
    limits = bench.axis[of.number].limits
    sign = 1.0 if here <= 0.5 * (limits.position_min_rev + limits.position_max_rev) else -1.0
    rows = builder.cruise(sign * PROBE_RPS, max(4, round(STOP_S / bench.bus.sync_period_s)))
    angles = math.tau * np.concatenate(builder.turns)
    turns = angles / math.tau
    if (trouble := room_trouble(of, float(turns.min()), float(turns.max()))) is not None:
        return [of.not_made(name, trouble)]
    with held_axis(of.session, of.number) as held:
        if not (held.rise() and held.go(angles[: rows.start + 1])):
            return [of.stopped(name, held, "before it")]
        return [_stopped(of, held, angles[rows], PROBE_RPS / limits.quick_stop_rps_s)]


def _stopped(of: Checked, held: HeldAxis, going_on: Real, ramp_s: float) -> CheckEntry:
    """Outcome of a quick stop, with set-points (n,) that go on meanwhile."""
    name, began = "quick stop, moving", held.slot.position_rad
    took_s = held.command(QUICK_STOP, going_on.tolist())
    turned_rev = abs(held.slot.position_rad - began) / math.tau
    if took_s is None:
        seen = f"still in operation {STOP_S:g} s after the command, and {turned_rev:.3f} rev further on (605Ah, 6085h)"
        return of.passed(name, False, seen)
    held.stopped = "quick stop"
    after = held.watch(0.1)
    turned_rev = abs((after[-1] if len(after) else held.slot.position_rad) - began) / math.tau
    allowed_rev = 0.5 * PROBE_RPS * ramp_s + OVERRUN_REV
    seen = f"stopped from {PROBE_RPS:g} rev/s and left operation after {1e3 * took_s:.0f} ms and {turned_rev:.3f} rev"
    return of.passed(name, turned_rev <= allowed_rev, f"{seen}, allowed {allowed_rev:.3f} rev")
