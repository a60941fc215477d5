"""Checks of accelerometer and encoder by a swing of the motor.

The accelerometer's axis, direction and mounting, and the scale of the encoder. The motor swings θ_m(t) = A (1 − cos ωt)/2 over
whole periods. Well below its resonances the arm follows as θ_m/N, so a sensor at the lever ℓ measures −ω² ℓ θ_m/N. Each axis of
the sensor is compared with that by its component at ω; other components near ω give the standard error.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.bench.bench import LEAST_LEVER_M, AxisTable
from hil.commissioning.held import held_axis
from hil.commissioning.seen import Checked
from hil.commissioning.turning import room_trouble
from hil.control.arrays import Real
from hil.recording import TIP, Recording
from hil.results.check import CheckEntry

SWING_HZ, SWING_REV, SWING_PERIODS = 1.5, 0.2, 6
"""Swing of the motor, peak to peak, and its periods; the first is left out."""
SCALE: Final = 1.4
"""Factor by which what is seen may be off: an arm that rings at 4 Hz swings by a sixth more at 1.5 Hz."""
UNSURE: Final = 0.15
"""Standard error of a ratio beyond which nothing is told."""
ELSEWHERE: Final = 0.5
"""Ratio that another axis of the sensor shows, where it is the one that feels the arm."""
NAMES = ("x", "y", "z")


@dataclass(frozen=True)
class Ratio:
    """Measured over expected component.

    Attributes:
        value: The ratio; its sign is the direction.
    """

    value: float
    error: float

    @property
    def is_told(self) -> bool:
        """True if it is known well enough."""
        return self.error <= UNSURE

    @property
    def holds(self) -> bool:
        """True if it is 1 within its uncertainty."""
        return 1.0 / SCALE - 2.0 * self.error <= self.value <= SCALE + 2.0 * self.error

    @property
    def words(self) -> str:
        """The ratio in words."""
        return f"{self.value:+.2f} ± {self.error:.2f}"


def check_sensing(of: Checked) -> list[CheckEntry]:
    """Swing the motor, and compare the arm's motion with the bench file."""
    if (trouble := room_trouble(of, 0.0, SWING_REV)) is not None:
        return [of.not_made("accelerometer", trouble)]
    with held_axis(of.session, of.number) as held:
        count = round(SWING_PERIODS / SWING_HZ / held.period_s)
        times = np.arange(count) * held.period_s
        swing = 0.5 * SWING_REV * math.tau * (1.0 - np.cos(math.tau * SWING_HZ * times))
        swing *= np.minimum(1.0, times * SWING_HZ)  # the first period is left out: the amplitude grows in it
        if held.rise() and held.rest(0.1) and held.go(swing):
            held.rest(0.2)
        recording = held.recorded()
        first = round(0.1 / held.period_s) + round(1.0 / SWING_HZ / held.period_s)
    path = of.keep(recording, f"axis-{of.number}-swing")
    if held.stopped is not None:
        return [of.stopped("accelerometer", held, "while it swung", path)]
    rows = slice(first, round(0.1 / held.period_s) + count)
    table = of.session.bench.axis[of.number]
    checks = [_accelerometer(of, table, recording, rows, path)]
    if table.load_encoder is not None:
        checks.append(_load_encoder(of, table, recording, rows, path))
    return checks


def _accelerometer(of: Checked, table: AxisTable, recording: Recording, rows: slice, path: str) -> CheckEntry:
    """Check the sensor's axis and direction, and the encoder's scale."""
    name, period_s = "accelerometer", recording.period_s
    if of.session.bench.accelerometer.from_load_encoders:
        return of.entry(name, "NOT JUDGED", "there is none: the joints' encoders give the tip", path)
    if recording.doubt is not None:
        return of.passed(name, False, recording.doubt, path)
    raw = np.stack([recording.columns[each] for each in TIP], axis=1)
    if not np.any(np.ptp(raw, axis=0) > 0.0):
        return of.passed(name, False, f"all its axes show {raw[0].tolist()} m/s² all the time; check the sensor", path)
    if table.tip_lever_m < LEAST_LEVER_M:
        return of.entry(name, "NOT JUDGED", f"this axis moves it by a lever of {1e3 * table.tip_lever_m:.2g} mm only", path)
    angle = recording.axis(of.number, "position_rad")[rows]
    expected = table.tip_lever_m / table.reduction_ratio * angle
    own = _ratio(expected, recording.felt_m_s2[rows], period_s, derivative=2)
    others = [_ratio(expected, raw[rows, i], period_s, derivative=2) for i in range(3)]
    if not own.is_told:
        return of.entry(name, "NOT JUDGED", f"{own.words} of the expected signal: too uncertain", path)
    if own.holds:
        return of.passed(name, True, f"{own.words} of what encoder, reduction_ratio and lever of the bench file predict", path)
    return of.passed(name, False, _wrong(of, own, others), path)


def _wrong(of: Checked, own: Ratio, others: list[Ratio]) -> str:
    """Return the likely cause of a wrong sensor signal, in words."""
    seen = f"{own.words} of what the bench file predicts"
    if -SCALE <= own.value <= -1.0 / SCALE:
        return f"{seen}: it moves against the motor; the encoder counts backwards (607Eh), or the sensor sits upside down"
    if of.session.bench.arm is None and abs(own.value) < ELSEWHERE:
        i = int(np.argmax([abs(each.value) for each in others]))
        if abs(others[i].value) > ELSEWHERE:
            return f"{seen} along z, {others[i].words} along {NAMES[i]}: the sensor is turned; its z must point along the motion"
    if abs(own.value) < 0.1:
        return f"{seen}: the sensor does not move with this axis (sensor of another axis, not mounted, or defective)"
    return f"{seen}: scale of the encoder, reduction_ratio, tip_lever_m or unit of the sensor is wrong by this factor"


def _load_encoder(of: Checked, table: AxisTable, recording: Recording, rows: slice, path: str) -> CheckEntry:
    """The joint's encoder against the motor's."""
    angle = recording.axis(of.number, "position_rad")[rows] / table.reduction_ratio
    load = recording.axis(of.number, "load_rad")[rows]
    if not np.all(np.isfinite(load)):
        return of.entry("encoder scale", "NOT JUDGED", "the joint's encoder did not answer in every cycle", path)
    found = _ratio(angle, load, recording.period_s)
    if not found.is_told:
        return of.entry("encoder scale", "NOT JUDGED", f"{found.words} of the motor's turn: too uncertain", path)
    tail = "" if found.holds else " (counts_per_rev, is_reversed, encoder_counts_per_rev, reduction_ratio)"
    return of.passed("encoder scale", found.holds, f"the joint's encoder shows {found.words} of the motor's turn{tail}", path)


def _ratio(expected: Real, seen: Real, period_s: float, derivative: int = 0) -> Ratio:
    """Return the ratio of components at the swing's frequency.

    Measured over expected signal, with its standard error. Signals have the shape (n,), whole periods of the swing; `derivative`
    is the order that applies to the expected one.
    """
    count = len(expected)
    line = round(SWING_HZ * count * period_s)
    window = np.hanning(count + 1)[:-1]  # of whole periods it leaks into the lines beside a component, and no further
    slope = np.linspace(-1.0, 1.0, count)
    flat = np.column_stack([np.ones(count), slope])
    spectra = []
    for signal in (expected, seen):
        left = signal - flat @ np.linalg.lstsq(flat, signal, rcond=None)[0]
        spectra.append(np.fft.rfft(window * left))
    wanted = spectra[0][line] * (2j * math.pi * SWING_HZ) ** derivative
    near = [each for each in range(2, 3 * line) if 1 < each % line < line - 1]
    noise = math.sqrt(float(np.mean(np.abs(spectra[1][near]) ** 2)))
    return Ratio(float((spectra[1][line] / wanted).real), noise / abs(wanted))
