"""Remainder of a vibration with a cancellation, and its cause.

The causes are those that the trial's own recordings show.

A cause is named only if its own vibration, predicted independently of the remainder, is found in it: without that vibration
the remainder must meet the goal, or at least half of its excess must vanish. If no cause qualifies, but images of the set-points
alone, beyond the band too, exceed the goal, they are the cause; else the result says that there is none. The causes:

- `speed limit`: the part for which neither set-points nor torque had room, by the tables of the cancellation.
- `frequency limit`: the part that the tables leave out towards the highest frequency of the cancellation, and the images of slow
  set-points. What no sample shows of it is taken from the model.
- `order left out`: an order that is not cancelled: not known, or not passed by the trial.
- `gear reaction`: the gear's torque moves the motor through its own error, by τ_g dθ_sync/dθ_m.
- `estimate`: the orders themselves, turned or scaled alike at all speeds: their values are not known well enough.
- `sensor noise`: a remainder above the goal may hide in the noise.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.analysis import TipScale, motor_speed_rps
from hil.control.angles import ARCSEC
from hil.control.arrays import Real, Rows
from hil.control.cancellation_table import CancellationTable
from hil.design.estimation import FAR_SIGMAS
from hil.design.frequency import Loop
from hil.experiments.cancellation.effect import AxisWaves, Look, Part, acceleration_of, alike, unshown
from hil.experiments.cancellation.images import acting, image_sizes_m_s2
from hil.experiments.peaks import Windows
from hil.experiments.window import NOISE_PEAK
from hil.recording import Recording
from hil.results.runs import CancellationRemainder, RemainderCause

JOLT_FACTOR = 1.3
"""Bound: what is asked at least, in units of what the motion makes of its own: that of the goal (docs/rehearsal.md)."""
HALF = 0.5
"""Bound: part of what is above that a cause takes away at least: that of a true cause (docs/rehearsal-results.md)."""
ABOUT = (0.3, 2.5)
"""Measured: amplitude found over that reckoned with which a cause counts as found: on 13 drawn robots 0.9 to 1.5, and once
3.6."""
REACTION_TURN = math.radians(50.0)
"""Largest angle between the reckoned reaction and what is found of it."""

UNKNOWN: frozenset[RemainderCause] = frozenset({"sensor noise", "not explained"})
"""Causes that are none of the robot's, and are said of the worst window alone."""

REMEDIES: Mapping[RemainderCause, str] = {
    "speed limit": "raise limits.speed_rps if the axis allows it, or move more slowly",
    "frequency limit": "part of the vibration is above the cancellation's highest frequency: move more slowly, or shorten the "
    "SYNC period if it sets that frequency",
    "order left out": "repeat the identification of that order: hil identify ate, hil learn",
    "gear reaction": "reduce the load or the acceleration: the reaction of the gear grows with its torque",
    "estimate": "repeat hil identify ate or hil learn with --plant, with the robot warm and at its working load",
    "sensor noise": "take a better accelerometer, or repeat the run with --repeat",
    "not explained": "the measurements do not show why",
}


@dataclass(frozen=True)
class TrialView:
    """Data of a trial for the account of the remainder.

    Attributes:
        used: Parts that passed, and are used.
        recording: One recording of the motion.
        rows: Rows that are read; shape (n,).
    """

    looks: Sequence[Look]
    used: tuple[Part, ...]
    windows: Windows
    recording: Recording
    rows: Rows
    axes: tuple[AxisWaves, ...]
    scale: TipScale

    @property
    def passed(self) -> float:
        """Fraction of the sensor's whole band that is read."""
        return min(1.0, 2.0 * self.recording.period_s * (self.scale.band_hz[1] - self.scale.band_hz[0]))


def remainder(seen: TrialView, tables: Mapping[int, CancellationTable], quiet_mm: float) -> CancellationRemainder | None:
    """Find the remainder of the vibration and its cause; None if not shown."""
    with_them, without = alike(seen.looks, seen.used), alike(seen.looks, ())
    if not with_them or not without:
        return None
    return _Account(seen, tables, quiet_mm, with_them, without).entry()


class _Account:
    """Account of the remainder in the worst window."""

    def __init__(
        self, seen: TrialView, tables: Mapping[int, CancellationTable], quiet_mm: float, after: list[Look], before: list[Look]
    ) -> None:
        self._seen, self._tables, self._after, self._before = seen, tables, after, before
        self._count = min(len(look.sighting.vibration) for look in (*after, *before))
        windows = seen.windows
        self._left = self._mean([look.sighting.vibration - look.sighting.images for look in after])
        self._noise_mm = windows.noise_mm / math.sqrt(len(after))
        self._jolt_mm = max(map(min, self._jolts_mm(before), self._jolts_mm(after)))
        self._quiet_mm, self._asked_mm = quiet_mm, max(quiet_mm, JOLT_FACTOR * self._jolt_mm)
        self._unseen_mm = windows.to_mm * self._unseen_m_s2()
        self._peaks = {order: self._peak_mm(order) for order in windows.rows}
        self._look_at(max(self._peaks, key=lambda order: self._peaks[order]))

    def _look_at(self, order: float | None) -> None:
        """Select the window whose cause is searched."""
        self._order, self._left_mm = order, self._peaks[order]
        self._is_seen = self._left_mm > self._asked_mm
        self._rows = self._seen.windows.rows[order][: self._count]

    def _mean(self, values: Sequence[Real]) -> Real:
        return np.asarray(np.mean([each[: self._count] for each in values], axis=0))

    def _jolts_mm(self, looks: Sequence[Look]) -> Iterator[float]:
        """Peak of the motion's own vibration in each window, as far as that window shows it.

        One amplitude is fitted to all rows, so a jolt at the start of a ramp also puts vibration at its end, real or not.
        """
        own = self._mean([_without_orders(look) for look in looks])
        residual = self._mean([look.sighting.residual for look in looks])
        for rows in self._seen.windows.rows.values():
            fitted, found = own[rows[: self._count]], (own + residual)[rows[: self._count]]
            share = min(max(float(fitted @ found) / max(float(fitted @ fitted), 1e-30), 0.0), 1.0)
            yield self._seen.windows.to_mm * share * float(np.max(np.abs(fitted)))

    def _peak_mm(self, order: float | None, removed: float | Real = 0.0, *, with_unseen: bool = True) -> float:
        """Peak in a window, reduced by the noise's part of the power, with what samples do not show of it.

        That has other frequencies, so the powers add up. `removed` is a vibration that is taken off.
        """
        rows = self._seen.windows.rows[order][: self._count]
        tip = self._seen.windows.to_mm * (self._left - removed)[rows]
        power = float(np.mean(tip**2))
        part = max(power - self._noise_mm**2, 0.0) / max(power, 1e-30)
        return float(np.max(np.hypot(math.sqrt(part) * tip, with_unseen * self._unseen_mm[rows])))

    def entry(self) -> CancellationRemainder:
        """Entry of the remainder for the result file."""
        hidden_mm = NOISE_PEAK * self._noise_mm
        causes: list[RemainderCause] = []
        if self._is_seen:
            worst = self._order
            for order in sorted(self._peaks, key=lambda each: -self._peaks[each]):
                self._look_at(order)
                causes += [self._cause()] if self._is_seen else []
            self._look_at(worst)
        elif hidden_mm > self._asked_mm:
            causes.append(self._hidden_cause())
        named = tuple(dict.fromkeys([*causes[:1], *(cause for cause in causes if cause not in UNKNOWN)]))
        return CancellationRemainder(
            order=self._order, left_mm=self._left_mm, asked_mm=self._asked_mm, jolt_mm=self._jolt_mm, noise_mm=hidden_mm,
            causes=named, words=self._words(named, hidden_mm),
        )  # fmt: skip

    def _words(self, causes: Sequence[RemainderCause], hidden_mm: float) -> str:
        where = "" if self._order is None else f" in the window of order {self._order:g}"
        if not causes:
            jolt = f"; the motion alone, without any order, makes up to {self._jolt_mm:.4f} mm"
            return f"the cancellation leaves {self._left_mm:.4f} mm{where}" + jolt * (self._left_mm > self._quiet_mm)
        asked = f"(goal: {self._asked_mm:.4f} mm)"
        remedies = "; ".join(f"{cause}: {REMEDIES[cause]}" for cause in causes)
        if self._left_mm <= self._asked_mm:
            return f"up to {hidden_mm:.4f} mm{where} may hide in the sensor noise {asked}; {remedies}"
        return f"the cancellation leaves {self._left_mm:.4f} mm{where} {asked}; {remedies}"

    def _cause(self) -> RemainderCause:
        """Cause that removes most of the remainder, if it explains it."""
        unseen_mm = self._left_mm - self._shown_mm()
        kept = {name: self._shown_mm(vibration) + unseen_mm for name, vibration in self._reckoned().items()}
        kept["frequency limit"] -= unseen_mm
        best = min(kept, key=lambda name: kept[name])
        if self._explains(kept[best]):
            return best
        if self._explains(self._shown_mm(self._waves(self._seen.used, self._after)) + unseen_mm):
            return "estimate"
        if self._images_exceed(self._order):
            return "frequency limit"
        if self._left_mm - self._asked_mm < self._noise_mm:
            return "sensor noise"
        return "not explained"

    def _hidden_cause(self) -> RemainderCause:
        """Cause of a remainder that the noise hides.

        Its own vibration exceeds what was requested; otherwise the noise itself is the cause.
        """
        largest: dict[RemainderCause, float] = {}
        for name, vibration in self._reckoned().items():
            peaks = self._seen.windows.peaks_mm(vibration)
            order = max(peaks, key=lambda each: peaks[each])
            if peaks[order] > self._asked_mm:
                largest[name] = peaks[order]
                if peaks[order] > self._left_mm:
                    self._order, self._left_mm = order, peaks[order]
        if not largest and any(map(self._images_exceed, self._peaks)):
            return "frequency limit"
        return max(largest, key=lambda name: largest[name], default="sensor noise")

    def _images_exceed(self, order: float | None) -> bool:
        """True if images, in the band or beyond, make more than is asked: a SYNC so slow has other effects beside them."""
        rows = self._seen.windows.rows[order][: self._count]
        return float(np.max(self._seen.windows.to_mm * self._images_m_s2(None)[rows])) > self._asked_mm

    def _reckoned(self) -> dict[RemainderCause, Real]:
        """Vibration of each cause that can be reckoned, whatever is left."""
        fitted, by_frequency = self._after[0].sighting.amplitude, self._given_up("frequency limit")
        return {
            "order left out": self._waves([part for part in fitted if part not in self._seen.used], self._after),
            "frequency limit": self._found(by_frequency, math.pi),
            "speed limit": self._found(self._given_up("speed limit"), math.pi),
            "gear reaction": self._found_reaction(),
        }

    def _explains(self, kept_mm: float) -> bool:
        """True if what a cause leaves is small enough."""
        return kept_mm <= self._left_mm - HALF * (self._left_mm - self._asked_mm)

    def _shown_mm(self, removed: float | Real = 0.0) -> float:
        """Peak of what samples show in the worst window, without a vibration."""
        return self._peak_mm(self._order, removed, with_unseen=False)

    def _waves(self, parts: Sequence[Part], looks: Sequence[Look]) -> Real:
        """Vibration of the significant parts in some runs."""
        total = np.zeros(self._count)
        for part in parts:
            size, look = self._amplitude(looks, part), looks[0].sighting
            variance = look.unit_variance[part] * look.noise_variance
            if abs(size) > FAR_SIGMAS * math.sqrt(2.0 * variance / len(looks)):
                total += look.wave(part, size)[: self._count]
        return total

    def _amplitude(self, looks: Sequence[Look], part: Part) -> complex:
        return complex(np.mean([look.sighting.amplitude[part] for look in looks]))

    def _shares(self) -> Iterator[tuple[Part, Real, dict[RemainderCause, Real]]]:
        """Each used part with its motor speed, and the fraction of it that each limit leaves out; shapes (rows,)."""
        for part in self._seen.used:
            table = self._tables.get(part.axis)
            if table is None:
                continue
            own = [wave.degree == 1 and wave.order == part.order for wave in table.waves]
            made = np.asarray(table.motion)[own]
            asked = made if table.asked is None else np.asarray(table.asked)[own]
            whole = asked.max(initial=0.0)
            if whole <= 0.0:
                continue
            speed = self._speed_rps(part.axis)
            by_frequency, by_speed = whole - asked[0], asked[0] - made[0]
            yield part, speed, {
                "frequency limit": np.interp(speed, table.speeds_rps, by_frequency / whole),
                "speed limit": np.interp(speed, table.speeds_rps, by_speed / whole),
            }  # fmt: skip

    def _given_up(self, limit: RemainderCause) -> Real:
        """Vibration of the parts' fractions that a limit leaves out."""
        total = np.zeros(self._count)
        for part, _, shares in self._shares():
            total += shares[limit] * self._waves([part], self._before)
        return total

    def _unseen_m_s2(self) -> Real:
        """Amplitude of these fractions and images that the band contains and samples do not show; shape (rows,)."""
        total, axes = np.zeros(self._count), {axis.number: axis for axis in self._seen.axes}
        window = self._seen.recording.period_s, self._seen.scale.band_hz
        for part, speed, shares in self._shares():
            if part.axis in axes:
                axis, hz = axes[part.axis], part.order * speed
                angle_rad = abs(self._amplitude(self._before, part)) * ARCSEC * np.abs(axis.response.at(hz))
                share = sum(shares.values()) * unshown(hz, *window)
                total += share * np.abs(self._lever_m(axis)) * angle_rad * (2.0 * math.pi * hz) ** 2
        # images are taken off the samples: all that the band contains of them is here
        return np.asarray(total + self._images_m_s2(self._seen.scale.band_hz))

    def _images_m_s2(self, band_hz: tuple[float, float] | None) -> Real:
        """Amplitude of the images in a band, or of all of them; shape (rows,)."""
        total, acted = np.zeros(self._count), acting(self._tables, dict.fromkeys(self._seen.used, 1.0))
        for axis in self._seen.axes:
            if axis.number in acted:
                speed, period_s = self._speed_rps(axis.number), self._seen.recording.period_s
                sizes = image_sizes_m_s2(axis, acted[axis.number], speed, period_s, band_hz)
                total += np.abs(self._lever_m(axis)) * sizes
        return total

    def _found_reaction(self) -> Real:
        """Vibration by the gear's reaction, as it is found."""
        reckoned = np.zeros(self._count)
        for axis in self._seen.axes:
            if axis.number in self._tables and isinstance(axis.response.known, Loop):
                reckoned += self._reaction(axis, axis.response.known, self._tables[axis.number])
        return self._found(reckoned, REACTION_TURN)

    def _found(self, reckoned: Real, most_turn: float) -> Real:
        """Reckoned vibration as found in the remainder, or 0 without it.

        `most_turn` is the largest angle between it and what is found, rad.
        """
        none = np.zeros(self._count)
        if not np.any(reckoned):
            return none
        both = np.stack([reckoned, np.imag(scipy.signal.hilbert(reckoned))], axis=1)
        rows = self._rows if self._is_seen else np.ones(self._count, dtype=np.bool_)
        found = np.linalg.lstsq(both[rows], self._left[rows], rcond=None)[0]
        factor, turn = math.hypot(*found), math.atan2(-found[1], found[0])
        noise = (self._noise_mm / self._seen.windows.to_mm) ** 2 / self._seen.passed
        error = math.sqrt(noise / max(float(np.sum(reckoned[rows] ** 2)), 1e-30))
        if not ABOUT[0] <= factor <= ABOUT[1] or abs(turn) > most_turn or factor < FAR_SIGMAS * error:
            return none
        return np.asarray(both @ found)

    def _reaction(self, axis: AxisWaves, loop: Loop, table: CancellationTable) -> Real:
        """Vibration by −τ_g dθ_sync/dθ_m of the whole error at the motor."""
        recording, ratio = self._seen.recording, loop.plant.reduction_ratio
        angle, period_s = recording.axis(axis.number, "position_rad"), recording.period_s
        corner = min(0.25 * self._seen.scale.f_al_hz, 0.2 / period_s)
        slow = scipy.signal.butter(2, corner, fs=1.0 / period_s, output="sos")
        speed = np.gradient(scipy.signal.sosfiltfilt(slow, angle), period_s)
        carried = scipy.signal.sosfiltfilt(slow, recording.axis(axis.number, "torque_nm"))
        carried = carried - loop.plant.motor_inertia_kg_m2 * np.gradient(speed, period_s)
        slope = np.zeros(len(angle))
        for index, wave in enumerate(table.waves):
            if wave.degree == 1:
                size = float(np.max(table.motion[index])) / ratio
                slope -= wave.order * size * np.sin(wave.order * angle + wave.phase_rad)
        torque = -ratio * carried * slope
        made = acceleration_of(torque, period_s, self._seen.scale.band_hz, lambda hz: _per_torque(axis, loop, hz))
        return self._lever_m(axis) * np.asarray(made[self._seen.rows[: len(made)]][: self._count])

    def _speed_rps(self, number: int) -> Real:
        """Motor speed of an axis in the rows that are read; shape (rows,)."""
        return np.abs(motor_speed_rps(self._seen.recording, number))[self._seen.rows][: self._count]

    def _lever_m(self, axis: AxisWaves) -> Real:
        """Lever of an axis in the rows that are read; shape () or (rows,)."""
        return axis.lever_m if np.ndim(axis.lever_m) == 0 else axis.lever_m[self._seen.rows[: len(axis.lever_m)]][: self._count]


def _per_torque(axis: AxisWaves, loop: Loop, frequency_hz: Real) -> NDArray[np.complex128]:
    """Response θ_l/τ at the sensor, X/(N (A + C)); 0 where X is."""
    response = axis.response.at(frequency_hz)
    inside = response != 0.0
    motor = loop.plant.terms(2j * math.pi * frequency_hz[inside])[0] + loop.controller(frequency_hz[inside])
    response[inside] /= loop.plant.reduction_ratio * motor
    return response


def _without_orders(look: Look) -> Real:
    """Vibration that the motion itself causes: without noise and orders."""
    seen = look.sighting
    rest = seen.vibration - seen.images - seen.residual
    for part, size in seen.amplitude.items():
        rest = rest - seen.wave(part, size)
    return np.asarray(rest)
