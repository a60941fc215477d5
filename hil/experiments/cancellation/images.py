"""Images of a cancellation's set-points at the tip.

Set-points are sampled every T, and interpolated between: the motor moves at f − m/T too, where the arm answers otherwise. At the
SYNCs all of these look like f itself, an order of the motor. So what an image does there is taken off before an order is read,
and what it does to the tip counts at its own frequency.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hil.analysis import motor_speed_rps
from hil.control.arrays import Complex, Real
from hil.control.cancellation_table import IMAGES, CancellationTable
from hil.design.frequency import Loop
from hil.experiments.cancellation.effect import AxisWaves, Part, in_band
from hil.recording import Recording


def image_gains(axis: AxisWaves, table: CancellationTable, period_s: float) -> tuple[Real, Complex]:
    """Frequency in Hz of each image, and tip acceleration per lever by it.

    Both have the shape (`IMAGES`, waves, speeds). The acceleration is a factor of the wave at the SYNCs, for a motor that turns
    forwards; 0 where nothing but the arm on its gear is known.
    """
    known, orders = axis.response.known, np.array([wave.order for wave in table.waves])[:, np.newaxis]
    hz = orders * table.speeds_rps - (np.array(IMAGES) / period_s)[:, np.newaxis, np.newaxis]
    if table.image is None or not isinstance(known, Loop):
        return np.abs(hz), np.zeros(hz.shape, dtype=np.complex128)
    response = axis.response.at(np.abs(hz).ravel()).reshape(hz.shape)
    response = np.where(hz < 0.0, np.conj(response), response)
    # the motion of a table is taken off for an order's own wave
    sign = np.array([-1.0 if wave.degree == 1 else 1.0 for wave in table.waves])[:, np.newaxis]
    return np.abs(hz), -((2.0 * math.pi * hz) ** 2) * response * sign * table.image / known.plant.reduction_ratio


def acting(tables: Mapping[int, CancellationTable], gains: Mapping[Part, float]) -> dict[int, CancellationTable]:
    """Tables of the parts that acted; `gains` are their fractions, alike for those of an axis, or 0."""
    found = {}
    for number, table in tables.items():
        acted = {part.order: gain for part, gain in gains.items() if part.axis == number and gain != 0.0}
        cut = table.without([order for order in table.orders if order not in acted])
        if cut is not None:
            found[number] = cut.scaled(max(acted.values()))
    return found


def images_m_s2(recording: Recording, axes: Sequence[AxisWaves], tables: Mapping[int, CancellationTable]) -> Real:
    """Acceleration by the images of the tables that acted, at the SYNCs of a recording; shape (n,)."""
    total = np.zeros(len(recording.time_s))
    for axis in axes:
        table = tables.get(axis.number)
        if table is None:
            continue
        angle, speed_rps = recording.axis(axis.number, "position_rad"), motor_speed_rps(recording, axis.number)
        gain = np.sum(image_gains(axis, table, recording.period_s)[1], axis=0)
        made = np.zeros(len(angle), dtype=np.complex128)
        for wave, by_speed in zip(table.waves, gain, strict=True):
            own = _at(table, by_speed.real, speed_rps) + 1j * np.sign(speed_rps) * _at(table, by_speed.imag, speed_rps)
            made += own * np.exp(1j * (wave.order * angle + wave.phase_rad))
        total += axis.levers_m(len(angle)) * made.real
    return total


def image_sizes_m_s2(
    axis: AxisWaves, table: CancellationTable, speed_rps: Real, period_s: float, band_hz: tuple[float, float] | None
) -> Real:
    """Sum of the images' amplitudes in a band, per lever, by motor speed; of its shape. None: of all of them."""
    hz, gain = image_gains(axis, table, period_s)
    passed = 1.0 if band_hz is None else in_band(hz, band_hz)
    return _at(table, np.sum(passed * np.abs(gain), axis=(0, 1)), speed_rps)


def _at(table: CancellationTable, by_speed: Real, speed_rps: Real) -> Real:
    return np.asarray(np.interp(np.abs(speed_rps), table.speeds_rps, by_speed))
