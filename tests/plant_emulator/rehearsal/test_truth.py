"""The true tip: windows in which treatments are compared are those of the motion, whatever a treatment adds to the speed."""

import math

import numpy as np
import pytest

from hil.recording import Recording
from plant_emulator.rehearsal.survey import interleaved
from plant_emulator.rehearsal.truth import tip_by_order_mm

PERIOD_S, AXIS, F_AL_HZ = 0.001, 2, 4.0
RISE_S, RATE = 2.0, 4.0


def ramp(added_rev: float = 0.0) -> Recording:
    """Ramp of 4 rev/s² whose start makes the arm ring down, with a second order added to the motor's motion."""
    time_s = np.arange(round(2.2 * RISE_S / PERIOD_S)) * PERIOD_S
    speed = RATE * np.minimum(time_s, np.maximum(2.0 * RISE_S - time_s, 0.0))
    turned = np.cumsum(speed) * PERIOD_S
    angle = 2.0 * math.pi * (turned + added_rev * np.cos(4.0 * math.pi * turned))
    ringing = np.exp(-1.5 * time_s) * np.sin(2.0 * math.pi * F_AL_HZ * time_s)
    return Recording({"time_s": time_s, f"axis{AXIS}_position_rad": angle, "tip_z_m_s2": ringing})


def test_what_a_cancellation_adds_to_the_speed_moves_no_window() -> None:
    plain, added = ramp(), ramp(added_rev=0.01)
    speed_rps = np.abs(np.gradient(plain.axis(AXIS, "position_rad"), PERIOD_S)) / (2.0 * math.pi)
    before = tip_by_order_mm(plain, AXIS, F_AL_HZ, speed_rps)
    after = tip_by_order_mm(added, AXIS, F_AL_HZ, speed_rps)
    assert set(before) == {1, 2, 4}
    assert after == pytest.approx(before)
    assert tip_by_order_mm(added, AXIS, F_AL_HZ)[4] != pytest.approx(before[4], rel=0.01), "its own speed moves them"


def test_of_a_ramp_that_passes_no_resonance_the_window_it_enters_counts() -> None:
    """Its top of 8 rev/s less the braking's part is 7.4 rev/s; order 4 meets 31 Hz at 7.75 rev/s."""
    assert set(tip_by_order_mm(ramp(), AXIS, 31.0)) == {4}
    assert tip_by_order_mm(ramp(), AXIS, 60.0) == {}
    assert set(tip_by_order_mm(ramp(), AXIS, 25.0)) == {4}, "order 2's window is entered, and not passed"


@pytest.mark.parametrize("count", [1, 3])
def test_a_vibration_beyond_half_of_the_sync_rate_is_measured_as_it_is(count: int) -> None:
    """70 Hz look like 55 Hz in samples of 8 ms; by three runs with a sensor that is later each time they are 70 Hz."""
    period_s, rows = 0.008, 500
    time_s = np.arange(rows) * period_s
    runs = [
        Recording({
            "time_s": time_s, f"axis{AXIS}_position_rad": np.sin(3.0 * time_s),
            "tip_z_m_s2": np.sin(2.0 * math.pi * 70.0 * (time_s - part * period_s / count)),
        })
        for part in range(count)
    ]  # fmt: skip
    found = interleaved(runs, AXIS)
    assert found.period_s == pytest.approx(period_s / count)
    assert found.axis(AXIS, "position_rad") == pytest.approx(np.sin(3.0 * found.time_s), abs=1e-6)
    assert found.columns["tip_z_m_s2"] == pytest.approx(np.sin(2.0 * math.pi * 70.0 * found.time_s), abs=1e-9)
    spectrum, line_hz = np.abs(np.fft.rfft(found.columns["tip_z_m_s2"])), np.fft.rfftfreq(len(found.time_s), found.period_s)
    assert line_hz[np.argmax(spectrum)] == pytest.approx(55.0 if count == 1 else 70.0, abs=0.3)
