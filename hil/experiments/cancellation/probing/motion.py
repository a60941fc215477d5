"""Recordings of a probed motion."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from hil.bench.bench import Bench
from hil.bench.model import Identified, IdentifiedError, identified_axis
from hil.control.arrays import Real
from hil.design.frequency import LIKELY_DAMPING
from hil.design.modes.fit import MODE_GRID
from hil.design.probing import Effects, ProbedStep
from hil.experiments.cancellation.effect import Part, sight
from hil.experiments.cancellation.waves import ProbedRows, response_of, waves_of
from hil.master.motion import Motion
from hil.recording import Recording
from hil.robot_tables import TransmissionErrorTable

Outcome = Literal["learnt", "not reached", "not seen", "nothing found"]

CHANGES_HZ = 3.0
"""Bound: frequency up to which amplitude and phase of what an order does to the tip change: as a resonance is passed, by no more
than its width 2 ζ f, 3 Hz at 30 Hz with ζ = 0.05."""
LEAST_KEPT = 0.5
"""Probability: fraction of the rest of an effect that must be no noise, so that it is kept."""
LEAST_PART_SEEN = 0.9
"""Part of an order's prior variance that the runs must remove before an order that they do not show counts as absent."""


def smoothed(found: Effects, parts: Sequence[Part], recording: Recording, rows: slice) -> Effects:
    """Reduce the noise of effects.

    An order shakes the tip by its own sine, whose amplitude and phase change slowly:

        b_cos = Re h(t) e^{j k θ_m}, b_sin = Re j h(t) e^{j k θ_m}

    What else an effect has, such as sums and differences with other orders, is kept as far as it is beyond the noise.
    """
    count = found.effects.shape[2]
    time_s = np.arange(count) * recording.period_s
    terms = 2 + math.ceil(2.0 * CHANGES_HZ * time_s[-1])
    slow = np.cos(np.pi * np.outer(np.arange(terms), (np.arange(count) + 0.5) / count))
    noise = float(np.sum(found.noise[:, 0])) * count
    free = min(1.0, terms / max(found.independent / len(found.noise), 1.0))
    effects, scale = found.effects.copy(), np.ones(2 * len(parts))
    for at, part in enumerate(parts):
        own = slice(2 * at, 2 * at + 2)
        turning = np.exp(1j * part.order * recording.axis(part.axis, "position_rad")[rows])
        waves = slow.T * turning[:, None]
        design = np.concatenate([np.hstack([waves.real, waves.imag]), np.hstack([-waves.imag, waves.real])])
        pair = found.effects[own]
        fitted = design @ np.linalg.lstsq(design, pair.transpose(0, 2, 1).reshape(2 * count, -1), rcond=None)[0]
        smooth = fitted.reshape(2, count, -1).transpose(0, 2, 1)
        rest = pair - smooth
        expected = noise * (1.0 - free) * np.diag(found.inverse)[1:][own]
        kept = 1.0 - expected / np.maximum(np.sum(rest**2, axis=(1, 2)), 1e-300)
        kept = np.where(kept > LEAST_KEPT, kept, 0.0)
        effects[own] = smooth + kept[:, None, None] * rest
        scale[own] = np.sqrt(free + kept**2 * (1.0 - free))
    whole = np.concatenate([[1.0], scale])
    return replace(found, effects=effects, inverse=found.inverse * np.outer(whole, whole))


def peak_and_rms(rows_mm: Real) -> tuple[float, float]:
    """Peak and root mean square of a displacement in mm.

    The peak is the largest in any direction; the root mean square is that of all directions together.

    >>> peak_and_rms(np.array([[3.0, 0.0], [4.0, 0.0], [0.0, 1.0]]))
    (5.0, 3.605551275463989)
    """
    lengths = np.linalg.norm(rows_mm, axis=0)
    return float(np.max(lengths)), float(np.sqrt(np.mean(lengths**2)))


class GearReaction(NamedTuple):
    """Reaction of a gear on its motor.

    Attributes:
        part: Part of τ_g θ_sync′ that loads the motor.
        friction_nm: Friction of the motor, which is not a load of the gear.
    """

    part: float = 0.0
    friction_nm: float = 0.0


def with_values(
    known: Identified,
    motion: Motion,
    values: Mapping[Part, complex],
    inertias: Mapping[int, float | None],
    arm_hz: float,
    reactions: Mapping[int, GearReaction] | None = None,
) -> Identified:
    """Give the axes of a motion certain transmission errors.

    Returns the model file with them and no others on these axes.

    The values are A_k e^{jφ_k} in arcsec. J_m is given where no file has a plant; from the resonance follows the highest
    frequency of a cancellation; a reaction that is not given is that of the model file.
    """
    for number in motion.axes:
        own = {part.order: value for part, value in values.items() if part.axis == number and value != 0.0}
        before = identified_axis(known, number).ate
        reaction = GearReaction() if before is None else GearReaction(before.gear_reaction, before.motor_friction_nm)
        reaction = (reactions or {}).get(number, reaction)
        error = IdentifiedError(
            values=table_of_values(own),
            arm_hz=arm_hz,
            damping=LIKELY_DAMPING,
            accelerometer_delay_s=0.0 if before is None else before.accelerometer_delay_s,
            set_point_delay_s=0.0 if before is None else before.set_point_delay_s,
            gear_reaction=reaction.part,
            motor_friction_nm=reaction.friction_nm,
            motor_inertia_kg_m2=inertias.get(number),
        )
        known = known.with_part(number, error)
    return known


def table_of_values(values: Mapping[float, complex]) -> TransmissionErrorTable:
    """Amplitudes and phases of complex ones, by order."""
    sizes = {order: abs(value) for order, value in values.items()}
    return TransmissionErrorTable.of(
        sizes, {order: float(np.degrees(np.angle(value))) % 360.0 for order, value in values.items()}
    )


def resonances_hz(
    bench: Bench, identified: Identified, motion: Motion, recordings: Sequence[Recording], rows: ProbedRows
) -> dict[int, float]:
    """Find the resonance of each axis by which a trial reads its orders.

    An arm has several; each axis gets that in which it takes part most. What an axis without one would be is not in it.

    The recordings are of runs in which the orders shake the tip, each with amplitudes of its own.
    """
    responses = {number: made for number in motion.axes if (made := response_of(bench, identified, number)) is not None}
    orders = {number: tuple(part.values.amplitudes_arcsec()) for number in responses if (part := identified.axis[number].ate)}
    free = [
        number
        for number in orders
        if orders[number] and identified.axis[number].plant is None and bench.axis[number].model is None
    ]
    tried = np.geomspace(*rows.band_hz, MODE_GRID).tolist()
    mask = np.zeros(len(recordings[0].time_s), dtype=np.bool_)
    mask[rows.rows] = True
    found: dict[int, float] = {}

    def left(hz: Mapping[int, float]) -> float:
        model = identified
        for number, value in hz.items():
            own = model.axis[number].ate
            model = model if own is None else model.with_part(number, own.model_copy(update={"arm_hz": value}))
        made = {number: response for number in responses if (response := response_of(bench, model, number)) is not None}
        waves = waves_of(bench, made, orders, motion, recordings[0])
        return sum(float(np.sum(sight(each, waves, mask, rows.band_hz).residual ** 2)) for each in recordings)

    before: dict[int, float] | None = None
    while found != before:
        before = dict(found)
        for number in free:
            found[number] = min(tried, key=lambda hz: left({**found, number: hz}))
    return found


@dataclass(frozen=True)
class PartOutcome:
    """Outcome of one order of one axis in the runs.

    Attributes:
        outcome: `learnt`, or why it is left at 0.
        value: A e^{jφ} in arcsec; 0 if it is left out.
        amplitude_error: Standard error of A in arcsec; None if nothing is known.
        seen: Fraction of it that the runs show.
    """

    part: Part
    outcome: Outcome
    value: complex = 0.0
    amplitude_error: float | None = None
    phase_error_deg: float | None = None
    seen: float = 0.0
    words: str = ""


def values_by_part(parts: Sequence[Part], vector: Real) -> dict[Part, complex]:
    """Convert settings to complex values by part.

    The settings are A cos φ and A sin φ of each part in turn, a value is A e^{jφ}.
    """
    return {part: complex(vector[2 * index], vector[2 * index + 1]) for index, part in enumerate(parts)}


def settings_of(parts: Sequence[Part], values: Mapping[Part, complex]) -> Real:
    """A cos φ and A sin φ of each part in turn."""
    pairs = [values.get(part, 0j) for part in parts]
    return np.array([each for value in pairs for each in (value.real, value.imag)])


def told_part(part: Part, index: int, vector: Real, step: ProbedStep, least_sigmas: float) -> PartOutcome:
    """Outcome of a part, by its position among the settings.

    It is learnt if its amplitude has so many standard errors, of that along A e^{jφ} and that across the larger one.
    """
    own = slice(2 * index, 2 * index + 2)
    value, block, seen = complex(*vector[own]), step.covariance[own, own], float(np.mean(step.seen[own]))
    direction = vector[own] / max(abs(value), 1e-300)
    both = (direction, np.array([-direction[1], direction[0]]))
    along, across = (math.sqrt(max(float(each @ block @ each), 0.0)) for each in both)
    if abs(value) / max(along, across, 1e-300) >= least_sigmas:
        phase, phase_error = math.degrees(math.atan2(value.imag, value.real)) % 360.0, math.degrees(across / abs(value))
        words = f"{part.words}: {abs(value):.2f} ± {along:.2f}″ ∠ {phase:.1f}° ± {phase_error:.1f}°"
        return PartOutcome(part, "learnt", value, along, phase_error, seen, words)
    if seen < LEAST_PART_SEEN:
        words = (
            f"{part.words}: left at 0: it hardly moves the tip, or cannot be separated from another order; the runs "
            f"show {100.0 * seen:.0f} % of it"
        )
        return PartOutcome(part, "not seen", seen=seen, words=words)
    words = f"{part.words}: left at 0: {abs(value):.2f} ± {along:.2f}″ is not significant"
    return PartOutcome(part, "nothing found", amplitude_error=along, seen=seen, words=words)
