"""Images of a cancellation's set-points, in recordings as they come."""

import math

import numpy as np
import pytest

from hil.control.angles import ARCSEC
from hil.control.cascade import Cascade
from hil.design.frequency import Loop, TwoInertia
from hil.design.inverse import CyclicTiming, cancellation_table
from hil.experiments.cancellation.effect import AxisWaves, Part, Response
from hil.experiments.cancellation.images import acting, images_m_s2
from hil.recording import Recording

SYNC_S, COUNT, SPEED_RPS = 0.008, 400, 7.0
LOOP = Loop(TwoInertia(120.0, 2.6e-4, 8e-4, 8.0, 6.0, 48950.0, 42.0), Cascade(25.0, 0.196, 3.92))
TABLE = cancellation_table(LOOP, {2: 5.0 * ARCSEC}, {2: 0.5}, CyclicTiming(SYNC_S, 250e-6), 12.0, "reference")


def turning(rows: int) -> Recording:
    time = SYNC_S * np.arange(rows)
    angle = 2.0 * math.pi * SPEED_RPS * time
    return Recording({"time_s": time, "axis2_position_rad": angle, "tip_z_m_s2": np.zeros(rows)})


def test_a_recording_that_misses_its_last_rows_has_the_images_of_the_others() -> None:
    """A lever that changes along the motion has a value for each of its rows, and a recording may be shorter."""
    axis = AxisWaves(2, (2,), np.linspace(0.5, 0.9, COUNT), Response(LOOP), np.zeros(COUNT))
    whole, short = (images_m_s2(turning(rows), [axis], {2: TABLE}) for rows in (COUNT, COUNT - 30))
    assert np.max(np.abs(whole)) > 0.0
    assert short[:300] == pytest.approx(whole[:300], rel=1e-3, abs=1e-6 * float(np.max(np.abs(whole))))


def test_what_did_not_act_has_no_images_and_half_of_a_cancellation_half_of_them() -> None:
    axis = AxisWaves(2, (2,), np.asarray(0.7), Response(LOOP), np.zeros(COUNT))
    assert acting({2: TABLE}, {Part(2, 2): 0.0}) == {}
    half, whole = (images_m_s2(turning(COUNT), [axis], acting({2: TABLE}, {Part(2, 2): gain})) for gain in (0.5, 1.0))
    assert half == pytest.approx(0.5 * whole, abs=0.02 * float(np.max(np.abs(whole))))
