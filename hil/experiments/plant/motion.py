"""Motions of a plant identification.

Slow turns show friction and gravity; stretches at bias speed carry the excitation.

On an arm all of them stay near the present position (`arm_travel_rev`), as slowly as that takes.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from drive_profiles.family.profile import Profile
from hil.bench.bench import AxisTable, Bench, Limits
from hil.control.arrays import Complex, Real
from hil.control.excitation import Excitation, band_lines, chirp, multisine, quiet_bias_rps
from hil.control.trajectory import Smooth, sample_times
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.experiments.bus_demand import BusDemand, takes_torque_offset
from hil.experiments.motions import MARGIN_REV
from hil.master.motion import Motion
from hil.master.run import APPROACH_RAMP_S
from hil.master.whereabouts import move_command

SETTLE_S = 0.4
"""Accuracy: time from the start of a slow stretch to its evaluated part: a loop of K_pp = 10/s is 2 % of its lag off by then."""
PERIODS_S = (2.0, 1.0)
"""Bound: periods of the excitation that are tried: lines every 0.5 Hz, or every 1 Hz where the travel is short."""
PER_STRETCH = (9, 8, 7, 6, 5, 3)
"""Bound: periods in a row that average the transmission error to nothing (not 4: it divides the order)."""
PILOT_PERIODS = min(PER_STRETCH)
"""Periods of the pilot: the fewest over which orders 1, 2 and 4 average to nothing."""
FEWEST = 6
"""Probability: periods below which the scatter between them, right to 1/√(2·5) = 32 %, is no measure of confidence."""
SLOW_TURNS = 4.0
"""Measured: motor turns of a slow stretch: 2.8 or 5.7 change the friction and gravity of four drawn robots (10700, 10712, 10730,
10735) by up to 3.7 standard errors, which they change by up to 42 %."""
SLOW_RPS = (0.4, 0.8)
"""Bound: speeds of the slow turns, beside the bias speed: below 1 rev/s static friction shows."""
FAST_RPS, FAST_FRACTION = 3.5, 0.5
"""Measured with `SLOW_TURNS`: fastest of the slow turns: 4.9 changes 0.6; with 2.5, τ_C of 10730 is 7.8 standard errors off its
value and has 12 times the error. It is no faster than half of the speed limit, so that no vibration comes near that."""

LEAST_TURNS = 6.01
"""Bound: motor turns of a stretch of three periods of 1 s, and what goes before, in which all orders average to nothing."""
SLOWER = (1.0, 0.85, 0.7, 0.55, 0.4)
"""Accuracy: factors of the wanted bias speed that are tried on an arm until the stretch fits, so it may be up to 27 % slower than
one that would; the slow turns use the first three."""

ExcitedSignal = Literal["torque", "reference"]
Shape = Literal["multisine", "chirp"]


@dataclass(frozen=True)
class PlantRequest:
    """Request of a plant identification.

    Attributes:
        amplitude_nm: Peak of the excitation as a torque at the motor; None to choose it by a pilot run.
        low_hz: Lower end of the band; None to choose it by the pilot run.
        high_hz: Upper end of the band; None to choose it by the pilot run and the SYNC period.
        bias_rps: Approximate motor speed under the excitation; None for one at which the transmission error does not ring.
        excitation: Signal to which the excitation is added; `auto` for the torque where the drive allows it.
        with_accelerometer: Use the accelerometer, and refuse where it does not follow the axis.
        posture_deg: Angles of an arm's joints, by axis, to which the arm is brought first and from which it comes back.
    """

    axis: int
    amplitude_nm: float | None = None
    low_hz: float | None = None
    high_hz: float | None = None
    bias_rps: float | None = None
    periods: int = 10
    excitation: Literal["auto", "torque", "reference"] = "auto"
    shape: Shape = "multisine"
    with_accelerometer: bool = True
    posture_deg: Mapping[int, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse an amplitude that is not above 0."""
        if self.amplitude_nm is not None and not self.amplitude_nm > 0.0:
            raise NotPossibleError(f"an excitation of {self.amplitude_nm:g} N·m; expected more than 0 (--amplitude-nm)")


@dataclass(frozen=True)
class Band:
    """Band and bias speed of an excitation."""

    low_hz: float
    high_hz: float
    bias_rps: float


@dataclass(frozen=True)
class Travel:
    """Travel of the axis under the excitation.

    Attributes:
        wave: One period of the excitation.
        number: Number of that wave: each has phases of its own.
        per_stretch: Periods of each stretch that are evaluated, after one to settle.
        stretches: Number of stretches, back and forth.
    """

    bias_rps: float
    wave: Excitation
    per_stretch: int
    stretches: int
    low_rev: float
    high_rev: float
    number: int = 0

    @property
    def samples(self) -> int:
        """Number of samples of one period."""
        return len(self.wave.wave)


def axis_table(bench: Bench, number: int) -> AxisTable:
    """Table of an axis in the bench file.

    Raises:
        NotPossibleError: The bench has no such axis, or does not know its gains.
    """
    bench.check_axis(number)
    bench.axis[number].gains(f"the plant of axis {number}")
    return bench.axis[number]


def bus_demand(bench: Bench, request: PlantRequest) -> BusDemand:
    """Demand of the runs on the bus.

    Raises:
        NotPossibleError: The bench has no such axis.
    """
    table = axis_table(bench, request.axis)
    by_torque = request.excitation == "torque" or (
        request.excitation == "auto" and takes_torque_offset(Profile.load(table.profile))
    )
    title = f"the identification of the plant of axis {request.axis}"
    return BusDemand(title, (request.axis,), bench.bus.sync_period_s, with_torque_offset=by_torque)


def plan_travel(
    bench: Bench, request: PlantRequest, band: Band, start_rev: float, excited: ExcitedSignal, *, is_pilot: bool = False
) -> Travel:
    """Plan the travel for the requested periods.

    Args:
        excited: Signal to which the excitation is added.
        is_pilot: A single stretch of three periods.

    Raises:
        NotPossibleError: The bench has no such axis, or the band is empty.
        UnsafeRequestError: Travel, speed or torque would leave the bench file's limits.
    """
    table, sync = axis_table(bench, request.axis), bench.bus.sync_period_s
    limits = table.limits
    _check_request(request, band, limits)
    low, high = limits.position_min_rev + MARGIN_REV, limits.position_max_rev - MARGIN_REV
    travel = arm_travel_rev(bench, request.axis)
    is_held = travel < high - low
    if not low <= start_rev <= high:
        where = low if start_rev < low else high
        what = f"the present position of axis {request.axis}"
        remedy = f"{move_command(request.axis, where)} moves it there"
        raise UnsafeRequestError(what, start_rev, where, "rev", remedy)
    if is_held:
        low, high = max(low, start_rev - 0.5 * travel), min(high, start_rev + 0.5 * travel)
    slower, needed = SLOWER if is_held and request.bias_rps is None else (1.0,), math.inf
    for wanted_rps in (factor * band.bias_rps for factor in slower):
        for period_s, periods in _periods(request, is_pilot=is_pilot):
            bias = quiet_bias_rps(wanted_rps, period_s, periods)
            # a period to settle, those that are evaluated, a ramp at either end
            length = bias * (period_s * (1 + periods) + APPROACH_RAMP_S)
            needed = min(needed, length)
            if length > high - low:
                continue
            begin = min(max(start_rev - (0.5 * length if is_held else 0.0), low), high - length)
            stretches = 1 if is_pilot else max(2, 2 * math.ceil(request.periods / periods / 2.0))
            return Travel(bias, _wave(request, band, period_s, sync, table, excited), periods, stretches, begin, begin + length)
    if is_held:
        what = f"the travel of axis {request.axis} at {SLOWER[-1] * band.bias_rps:.3g} rev/s"
        raise UnsafeRequestError(what, needed, high - low, "rev", "raise identification_travel_deg, or lower --bias-rps")
    what = f"the travel of axis {request.axis} at {band.bias_rps:g} rev/s"
    raise UnsafeRequestError(what, needed, high - low, "rev", f"lower --bias-rps (the limits leave {high - low:.4g} rev)")


def with_wave(travel: Travel, number: int, bench: Bench, request: PlantRequest, band: Band, excited: ExcitedSignal) -> Travel:
    """Travel with another wave of the same lines; a chirp has only one.

    Another run of the same wave repeats what is rounded, and what a nonlinear gear distorts; with other phases that is
    independent of it, and the mean over the runs loses it.

    Args:
        number: Number of the wave.
        band: Band of the travel.
        excited: Signal to which the excitation is added.
    """
    if request.shape == "chirp":
        return travel
    table, sync_s = axis_table(bench, request.axis), bench.bus.sync_period_s
    return replace(travel, wave=_wave(request, band, travel.wave.period_s, sync_s, table, excited, number), number=number)


def arm_travel_rev(bench: Bench, axis: int) -> float:
    """Motor revolutions, end to end, of a stretch on an arm.

    They are infinite without an arm.

    Fewer than `LEAST_TURNS` do not average the transmission error to nothing: the default limit gives way to them.
    """
    travel = bench.travel_rev(axis)
    return max(travel, LEAST_TURNS) if bench.identification_travel_deg is None else travel


def _periods(request: PlantRequest, *, is_pilot: bool) -> Iterator[tuple[float, int]]:
    """Periods of the excitation in s, in the order of trial."""
    for period_s in PERIODS_S:
        for periods in (PILOT_PERIODS,) if is_pilot else PER_STRETCH:
            if periods <= math.ceil(request.periods / 2):
                yield period_s, periods


def _check_request(request: PlantRequest, band: Band, limits: Limits) -> None:
    """Refuse an impossible request, or one beyond the limits."""
    if request.periods < FEWEST:
        raise NotPossibleError(f"{request.periods} periods are too few to show their scatter; at least {FEWEST} are needed")
    if band.bias_rps < 0.2:
        raise NotPossibleError(
            f"a bias of {band.bias_rps:g} rev/s is too slow for constant friction; at least 0.2 rev/s is needed"
        )
    if 2.0 * band.bias_rps > limits.speed_rps:
        what = f"the speed of axis {request.axis} with the excitation on the bias"
        raise UnsafeRequestError(what, 2.0 * band.bias_rps, limits.speed_rps, "rev/s", "lower --bias-rps")
    if request.amplitude_nm is not None and request.amplitude_nm > 0.8 * limits.torque_nm:
        what = f"the torque of the excitation on axis {request.axis}"
        raise UnsafeRequestError(what, request.amplitude_nm, 0.8 * limits.torque_nm, "N·m", "lower --amplitude-nm")


def _wave(
    request: PlantRequest, band: Band, period_s: float, sync_s: float, table: AxisTable, excited: ExcitedSignal, number: int = 0
) -> Excitation:
    """One period of the excitation with a peak of 1 N·m.

    It is a torque, or the reference for which the drive's law gives that torque.
    """
    samples = round(period_s / sync_s)
    try:
        lines = band_lines(band.low_hz, band.high_hz, period_s, sync_s)
    except ValueError as error:
        raise NotPossibleError(f"{error} (--low-hz, --high-hz, bus.sync_period_s)", ("cycle",)) from error
    law = table.gains(f"the plant of axis {request.axis}")
    jw = 2j * math.pi * lines / period_s
    gain: Complex = np.ones(len(lines), dtype=np.complex128)
    if excited == "reference":
        pi = law.velocity_gain_nm_s_rad + law.velocity_integral_gain_nm_rad / jw
        gain = np.asarray(law.position_gain_per_s * pi, dtype=np.complex128)
        if not np.all(np.abs(gain) > 0.0):
            raise NotPossibleError(
                f"axis {request.axis} has no position gain or no velocity gain, so a reference excites nothing; "
                "choose --excitation torque"
            )
    is_chirp, amplitude = request.shape == "chirp", 1.0 / np.abs(gain)
    wave = chirp(lines, amplitude, samples, sync_s) if is_chirp else multisine(lines, amplitude, samples, sync_s, number)
    if excited == "torque":
        return wave
    spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
    spectrum[lines] = np.fft.rfft(wave.wave)[lines] * gain
    from_zero = np.roll(wave.wave, -int(np.argmin(np.abs(wave.wave))))  # set-points begin without a jump
    return Excitation(from_zero / np.max(np.abs(np.fft.irfft(spectrum, samples))), sync_s, lines)


@dataclass
class MotionBuilder:
    """Builder of a motion from pieces, in motor turns."""

    sync_s: float
    turns: list[Real] = field(default_factory=lambda: [np.zeros(1)])
    offset: list[Real] = field(default_factory=lambda: [np.zeros(1)])
    rows: int = 1

    def _append(self, turns: Real, offset: Real | None = None) -> None:
        self.turns.append(turns)
        self.offset.append(np.zeros(len(turns)) if offset is None else offset)
        self.rows += len(turns)

    @property
    def here(self) -> float:
        """Present end of the motion, motor turns."""
        return float(self.turns[-1][-1])

    def rest(self, duration_s: float) -> None:
        """Add a rest."""
        self._append(np.full(max(1, round(duration_s / self.sync_s)), self.here))

    def go(self, there: float, bench: Bench, axis: int) -> None:
        """Add a smooth move to a position in motor turns."""
        distance = there - self.here
        if abs(distance) < 1e-9:
            return
        way = Smooth.way(distance, bench.approach_rps, APPROACH_RAMP_S, bench.axis[axis].limits.acceleration_rps_s)
        self._append(self.here + distance * way.position(sample_times(way.duration_s, self.sync_s)[1:]))

    def cruise(self, rps: float, count: int, excitation: Real | None = None) -> slice:
        """Add a ramp up, a constant speed and a ramp down.

        Args:
            rps: Speed of the stretch; its sign is the direction.
            count: Number of rows at that speed.
            excitation: Excitation on these rows, which fades after them; shape (count,).

        Returns:
            The rows at constant speed.
        """
        ramp = round(APPROACH_RAMP_S / self.sync_s)
        rising = 0.5 - 0.5 * np.cos(math.pi * (np.arange(ramp) + 0.5) / ramp)
        speed = np.concatenate([rising, np.ones(count), rising[::-1]])
        where = self.here + rps * self.sync_s * np.cumsum(speed)
        added = np.zeros(len(speed))
        if excitation is not None:
            added[ramp : ramp + count] = excitation
            fade = min(ramp, count)
            added[ramp + count : ramp + count + fade] = excitation[:fade] * rising[::-1][:fade]
        first = self.rows + ramp
        self._append(where, added)
        return slice(first, first + count)


@dataclass(frozen=True)
class PlannedMotion:
    """Motion with the rows that are evaluated.

    Attributes:
        bias_rad: The motion without the excitation, from its start; shape (n,).
        excitation: Excitation in N·m or rad; shape (n,).
        stretches: Evaluated rows at constant speed.
        speeds_rps: Speeds of the stretches, signed.
        wave: Number of the excitation's wave.
    """

    motion: Motion
    bias_rad: Real
    excitation: Real
    stretches: tuple[slice, ...]
    speeds_rps: tuple[float, ...]
    wave: int = 0


def planned(
    builder: MotionBuilder, request: PlantRequest, excited: ExcitedSignal, stretches: list[slice], speeds: list[float]
) -> PlannedMotion:
    """Finish a builder's motion, with its evaluated rows and their speeds.

    Args:
        stretches: Evaluated rows.
        speeds: Speed of each stretch, rev/s, signed.
    """
    bias, added = math.tau * np.concatenate(builder.turns), np.concatenate(builder.offset)
    times = np.arange(len(bias), dtype=np.float64) * builder.sync_s
    has_offset = excited == "torque" and bool(np.any(added))
    angle = bias + added if excited == "reference" else bias
    motion = Motion(
        (request.axis,), times, angle[:, np.newaxis], starts_at_home=False,
        torque_offset_nm=added[:, np.newaxis] if has_offset else None,
        excitation_rad=added[:, np.newaxis] if excited == "reference" else None,
    )  # fmt: skip
    return PlannedMotion(motion, bias, added, tuple(stretches), tuple(speeds))


def slow_motion(bench: Bench, request: PlantRequest, travel: Travel, start_rev: float, fastest_rps: float) -> PlannedMotion:
    """Plan the slow motion for friction and gravity.

    Args:
        fastest_rps: Fastest of the speeds, unless the bias speed is.
    """
    builder = MotionBuilder(bench.bus.sync_period_s)
    builder.rest(0.1)
    whole = travel.high_rev - travel.low_rev
    stretches, speeds = [], []
    builder.go(travel.low_rev - start_rev, bench, request.axis)
    fastest_rps = min(fastest_rps, whole / (2.0 * (APPROACH_RAMP_S + SETTLE_S)))
    for speed in (*SLOW_RPS, travel.bias_rps, max(fastest_rps, travel.bias_rps)):
        room = whole - speed * APPROACH_RAMP_S
        turns = room if speed == travel.bias_rps else min(SLOW_TURNS, room)
        count = round(turns / speed / builder.sync_s)
        skip = round(SETTLE_S / builder.sync_s)
        for sign in (1.0, -1.0):
            rows = builder.cruise(sign * speed, count)
            stretches.append(slice(rows.start + skip, rows.stop))
            speeds.append(sign * speed)
    builder.go(0.0, bench, request.axis)
    builder.rest(0.1)
    return planned(builder, request, "torque", stretches, speeds)


def excited_motion(
    bench: Bench,
    request: PlantRequest,
    travel: Travel,
    start_rev: float,
    excited: ExcitedSignal,
    amplitude_nm: float,
) -> PlannedMotion:
    """Motion back and forth at the bias speed under the excitation.

    Args:
        excited: Signal to which the excitation is added.
    """
    builder = MotionBuilder(bench.bus.sync_period_s)
    builder.rest(0.1)
    builder.go(travel.low_rev - start_rev, bench, request.axis)
    periods = travel.per_stretch
    samples = travel.samples
    wave = np.tile(amplitude_nm * travel.wave.wave, periods + 1)
    lead = max(1, samples // 2)
    wave[:lead] *= 0.5 - 0.5 * np.cos(math.pi * (np.arange(lead) + 0.5) / lead)
    stretches, speeds = [], []
    for number in range(travel.stretches):
        speed = travel.bias_rps if number % 2 == 0 else -travel.bias_rps
        rows = builder.cruise(speed, len(wave), wave)
        stretches.append(slice(rows.start + samples, rows.stop))
        speeds.append(speed)
    builder.go(0.0, bench, request.axis)
    builder.rest(0.1)
    return replace(planned(builder, request, excited, stretches, speeds), wave=travel.number)
