"""What is asked of a run: what does not go together is refused, and the rest follows from it."""

from dataclasses import replace

import numpy as np
import pytest

from drive_profiles.family.profile import Profile
from hil.bench.bench import load_bench
from hil.control.notch import FixedFilter
from hil.control.treatments import LoopName
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.master.drive.axis import DriveAxis
from hil.master.motion import FilterUse, Motion
from hil.master.request import RunRequest, check_motion

BENCH = load_bench("reference")
MOTION = Motion((2,), np.arange(4) * 250e-6, np.zeros((4, 1)), starts_at_home=False)
OFFSET = Motion((2,), np.arange(4) * 250e-6, np.zeros((4, 1)), starts_at_home=False, torque_offset_nm=np.zeros((4, 1)))
FIXED = {2: FixedFilter(1.0, 0.0, 0.0, 0.0, 0.0)}


class Adder:
    """Adds nothing, with or without torques."""

    def __init__(self, *, uses_torque: bool) -> None:
        self.uses_torque = uses_torque

    def step(self, references_rad, positions_rad, torques_nm):  # type: ignore[no-untyped-def]
        return [0.0], [0.0]


def axes(number: int) -> list[DriveAxis]:
    return [DriveAxis(None, number, BENCH.axis[number])]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("request_", "number", "words"),
    [
        (RunRequest(MOTION, "notch", "drive"), 5, r"axis\.5\.notch"),
        (RunRequest(MOTION, "none", "host", Adder(uses_torque=False)), 2, "--loop drive"),
        (RunRequest(OFFSET, "none", "host"), 2, "--loop drive"),
        (RunRequest(MOTION, "none", "drive", fixed=FIXED), 2, "--loop host"),
    ],
)
def test_what_does_not_go_together_is_refused(request_: RunRequest, number: int, words: str) -> None:
    with pytest.raises(NotPossibleError, match=words):
        request_.check(axes(number))


@pytest.mark.parametrize(
    ("filters", "loop", "in_drives"),
    [("none", "drive", False), ("notch", "drive", True), ("none", "host", False), ("notch", "host", False)],
)
def test_the_place_of_the_filters_follows_from_the_loop(filters: FilterUse, loop: LoopName, in_drives: bool) -> None:
    asked = RunRequest(MOTION, filters, loop)
    asked.check(axes(2))
    assert asked.filters_in_drives == in_drives
    assert (asked.host_loops(axes(2)) is None) == (loop == "drive")


def test_torque_offsets_are_sent_where_motion_or_adder_has_them() -> None:
    assert not RunRequest(MOTION, "none", "drive").uses_torque_offset
    assert not RunRequest(MOTION, "none", "drive", Adder(uses_torque=False)).uses_torque_offset
    assert RunRequest(MOTION, "none", "drive", Adder(uses_torque=True)).uses_torque_offset
    assert RunRequest(OFFSET, "none", "drive").uses_torque_offset


def test_a_torque_offset_needs_a_drive_with_csp() -> None:
    axis = axes(2)[0]
    axis.profile = Profile.load("harmonic_drive_yukondrive")
    with pytest.raises(NotPossibleError, match="axis 2: a torque offset needs CSP; harmonic_drive_yukondrive has IP"):
        RunRequest(OFFSET, "none", "drive").check([axis])


def set_points(turns: list[float], period_s: float = 0.002) -> Motion:
    angles = 2.0 * np.pi * np.array(turns)[:, np.newaxis]
    return Motion((2,), np.arange(len(turns)) * period_s, angles, starts_at_home=False)


def test_set_points_accelerate_no_more_than_the_limit_whatever_made_them() -> None:
    """100 rev/s² are 0.0004 rev between the steps of one period and those of the next."""
    step = 100.0 * 0.002**2
    check_motion(set_points([0.0, 0.0, step, 3.0 * step, 5.0 * step, 6.0 * step, 6.0 * step]), axes(2), [0.0])
    for jumps in ([0.0, 0.0, 2.0 * step, 3.0 * step, 3.0 * step], [0.0, 2.0 * step, 2.0 * step], [0.0, 0.0, step, 3.0 * step]):
        with pytest.raises(UnsafeRequestError, match=r"the acceleration of axis 2 would be \d+ rev/s²; the limit is 100 rev/s²"):
            check_motion(set_points(jumps), axes(2), [0.0])


def test_an_excitation_on_the_set_points_is_no_acceleration_of_the_motion() -> None:
    step = 100.0 * 0.002**2
    shaken = set_points([0.0, 5.0 * step, -5.0 * step, 5.0 * step, 0.0])
    check_motion(replace(shaken, excitation_rad=shaken.motor_angle_rad), axes(2), [0.0])
    with pytest.raises(UnsafeRequestError, match="acceleration"):
        check_motion(shaken, axes(2), [0.0])
