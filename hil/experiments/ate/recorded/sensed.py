"""Recordings of tip acceleration or motor torque behind the arm.

With arm and sensor from bench and model file, the signal gives the error of the angle.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.bench.bench import Bench
from hil.bench.model import Identified, identified_axis
from hil.design.ate.model import Arm
from hil.design.recorded.clock import SampledInstants, clock_of
from hil.design.recorded.fit import AngleSection
from hil.design.recorded.stretches import MotionStretch
from hil.design.recorded.through_arm import ArmPrior, RefinedArm, ThroughArm, arm_section, refined_arm
from hil.design.ringing import LAW_ERROR
from hil.design.uncertainty import LEAST_SPREAD, LIKELY
from hil.experiments.ate.recorded.request import MOST_SAMPLES, ContradictedError, RecordedRequest
from hil.experiments.ate.request import axis_knowledge, sensing_of
from hil.recordings.reading import Recorded
from hil.results.recorded_ate import Form

STILL_RINGS = 0.05
"""Accuracy: part of an arm's ringing that is left where a recording that starts in motion begins to count: where it is a
fifth, A_2 and φ_4 of two drawn recordings are 3.5 and 3.2 standard errors off, and with it 1.6 and 0.3."""


@dataclass(frozen=True)
class SensedFiles:
    """Recordings of a sensor behind the arm.

    Attributes:
        files: Recordings on an even grid.
        through: The same, through the arm.
    """

    files: list[Recorded]
    through: list[ThroughArm]
    clocks: list[SampledInstants]
    prior: ArmPrior
    source: str

    def refine(self, found: Sequence[tuple[int, MotionStretch]], orders: Sequence[float]) -> RefinedArm:
        """Refine the arm on some stretches."""
        return refined_arm([(self.through[number], stretch.rows) for number, stretch in found], orders, self.prior)

    def without_start(self, recorded: Recorded, each: MotionStretch) -> MotionStretch | None:
        """Stretch without the ringing with which a recording starts in motion, or None."""
        if each.rows.start > 8:
            return each
        arm, angle = self.prior.arm, recorded.motor_rad
        rings_s = -math.log(STILL_RINGS) / max(2.0 * math.pi * arm.resonance_hz * arm.damping, sys.float_info.min)
        start = int(np.searchsorted(recorded.time_s, rings_s))
        if each.rows.stop - start < 2:
            return None
        turns = abs(float(angle[each.rows.stop - 1] - angle[start])) / (2.0 * math.pi)
        return replace(each, rows=slice(start, each.rows.stop), turns=turns, from_s=float(recorded.time_s[start]))

    def section(self, recorded: Recorded, stretch: MotionStretch, arm: Arm) -> AngleSection:
        """Section of a stretch for the fit with an arm."""
        number = next(number for number, each in enumerate(self.files) if each is recorded)
        return arm_section(self.through[number], stretch.rows, arm).averaged(MOST_SAMPLES)


def sensed_files(
    files: Sequence[Recorded], request: RecordedRequest, form: Form, bench: Bench | None, identified: Identified | None
) -> SensedFiles:
    """Put recordings on an even grid, and find the arm's prior.

    Raises:
        ContradictedError: There is no bench, no plant, or another ratio; or a recording does not show the arm.
        NotPossibleError: The bench has no such axis, or it does not move the accelerometer.
    """
    if bench is None:
        raise ContradictedError(
            f"{files[0].path}: {form} shows an angle only through the plant; name the file with lever, ratio and "
            "plant with --bench"
        )
    is_torque = form == "motor torque"
    knowledge = axis_knowledge(bench, request.axis, identified, sensorless=is_torque)
    table = bench.axis[request.axis]
    prior, source = _prior(bench, request.axis, identified, knowledge.start, is_torque=is_torque)
    given = request.said.reduction_ratio
    if given is not None and not math.isclose(given, table.reduction_ratio, rel_tol=1e-6):
        raise ContradictedError(
            f"a reduction ratio of {given:g} was given; the bench file has {table.reduction_ratio:g} for axis {request.axis}"
        )
    sensing = sensing_of(bench, request.axis, knowledge, sensorless=is_torque)
    even, through, clocks = [], [], []
    for each in files:
        clock = clock_of(each.time_s, each.motor_rad)
        values = each.value["torque" if is_torque else "acceleration"]
        try:
            made = ThroughArm(clock.time_s, each.motor_rad, values, table.reduction_ratio, sensing, prior.arm.resonance_hz)
        except ValueError as error:
            raise ContradictedError(f"{each.path}: {error}") from error
        through.append(made)
        clocks.append(clock)
        even.append(replace(each, value={"time": made.time_s - made.time_s[0], "motor": made.motor_rad}))
    return SensedFiles(even, through, clocks, prior, source)


def _prior(bench: Bench, axis: int, identified: Identified | None, start: Arm | None, *, is_torque: bool) -> tuple[ArmPrior, str]:
    """Arm and delay from the model file, else the bench file."""
    part = identified_axis(identified, axis).plant
    if part is not None and start is not None:
        errors = part.standard_error
        resonance = errors.get("antiresonance_hz", 0.0) / part.antiresonance_hz
        damping = errors.get("damping", 0.0) / part.damping
        delay = part.torque_lag_s if is_torque else part.accelerometer_delay_s
        least = max(resonance, LAW_ERROR), max(damping, LEAST_SPREAD)
        error_s = LIKELY[2] if delay is None else 0.5 * LIKELY[2]
        return ArmPrior(replace(start, delay_s=delay or 0.0), *least, error_s), "the model file"
    plant = bench.axis[axis].plant()
    if plant is None:
        raise ContradictedError(
            f"no plant of axis {axis} is known, neither in the model file nor in the bench file; find it with hil identify plant"
        )
    arm = Arm.of(plant)
    arm = replace(arm, damping=max(arm.damping, 1e-4))
    return ArmPrior(arm, *LIKELY), "the bench file"
