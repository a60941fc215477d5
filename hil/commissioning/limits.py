"""Check of the drive's own position limits, in each direction.

The drive gets a near limit on one side and a far one on the other; the master's own lie beyond both. It must reach the far side,
where a limit with the wrong sign would stop it, and must not pass the near one.
"""

import math
from typing import Final

import numpy as np

from hil.commissioning.held import HeldAxis, held_axis
from hil.commissioning.seen import Checked
from hil.commissioning.turning import room_trouble
from hil.control.arrays import Real
from hil.control.trajectory import Smooth, sample_times
from hil.master.drive.limits import limit_of
from hil.results.check import CheckEntry

NEAR_REV, FAR_REV, ASKED_REV = 0.10, 0.30, 0.20
"""Near and far limit from where the motor stands, and how far it is asked to go."""
OVER_REV: Final = 0.04
"""Turn beyond a limit within which a drive comes to rest."""
ASKED_S, ASKED_RAMP_S = 1.5, 0.5


def check_limits(of: Checked) -> list[CheckEntry]:
    """Both limits, the upper first."""
    profile = of.session.axes[of.number].profile
    names = ("upper limit", "lower limit")
    if any(limit_of(key).held_by(profile) is None for key in ("position_min_rev", "position_max_rev")):
        unknown = (
            f"the drive holds no position limits of the bench file (profile {profile.label}); only the master does; set the "
            "drive's own with its maker's tool"
        )
        return [of.entry(name, "NOT JUDGED", unknown) for name in names]
    if (trouble := room_trouble(of, -FAR_REV, FAR_REV)) is not None:
        return [of.not_made(name, trouble) for name in names]
    return [_check(of, 1.0), _check(of, -1.0)]


def _check(of: Checked, sign: float) -> CheckEntry:
    """One limit: away from it first, then towards it.

    The sign is 1 for the upper limit, −1 for the lower.
    """
    name, here = ("upper limit" if sign > 0.0 else "lower limit"), of.session.axes[of.number].position_rad()
    low, high = sorted((here + sign * math.tau * NEAR_REV, here - sign * math.tau * FAR_REV))
    with held_axis(of.session, of.number, {"position_min_rev": low, "position_max_rev": high}) as held:
        away = -sign * _there(held)
        if not (held.rise() and held.go(away) and held.go(away[::-1])):
            return of.stopped(name, held, f"{ASKED_REV:g} rev away from it, on the side that is free")
        went = held.go(sign * _there(held))
        if went:
            held.rest(0.1)  # a drive that holds at its limit gets its set-point back
        recording = held.recorded()
    path = of.keep(recording, f"axis-{of.number}-{name.replace(' ', '-')}")
    furthest = float(np.max(sign * (recording.axis(of.number, "position_rad") - held.start_rad))) / math.tau
    seen = (
        f"sent by {sign * ASKED_REV:+.2f} rev, the motor moved {sign * furthest:+.3f} rev; its limit: {sign * NEAR_REV:+.2f} rev"
    )
    how = "" if held.stopped is None else f"; it stopped: {held.stopped}"
    return of.passed(name, furthest <= NEAR_REV + OVER_REV, seen + how, path)


def _there(held: HeldAxis) -> Real:
    """Return angles to the requested position and a rest; shape (n,)."""
    times = sample_times(ASKED_S, held.period_s)
    way = math.tau * ASKED_REV * np.asarray(Smooth(ASKED_S, ASKED_RAMP_S).position(times))
    return np.concatenate([way, np.full(round(0.1 / held.period_s), way[-1])])
