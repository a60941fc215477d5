"""Run of `hil identify ate` on a bench."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.bench.bench import Bench
from hil.bench.model import Identified, IdentifiedError
from hil.can.channel import Channel
from hil.experiments.ate.identify import Identification, as_part, identify_on, standard_errors
from hil.experiments.ate.motion import Ramps
from hil.experiments.ate.request import AteRequest, axis_knowledge, first_ramp, sensing_of
from hil.experiments.bus_demand import BusDemand
from hil.experiments.judge import check_axis_shown
from hil.experiments.measurement import Measurement, MeasurementOutcome
from hil.experiments.plan import timing_of
from hil.master.motion import RunResult
from hil.reporter import SILENT, Reporter
from hil.results.ate import AteFit, AteResult, AteRun, AteStandardErrors, KnownArm
from hil.results.base import MeasuredBench


@dataclass(frozen=True)
class AteOutcome(MeasurementOutcome[AteResult]):
    """End of an identification of the transmission error."""

    @property
    def part(self) -> IdentifiedError | None:
        """Entry for the model file; None if nothing was identified."""
        return self.result.ate


def identify_ate(
    bench: Bench,
    request: AteRequest,
    out: Path,
    identified: Identified | None = None,
    *,
    channel: Channel | None = None,
    overload: bool = False,
    reporter: Reporter = SILENT,
) -> AteOutcome:
    """Identify a transmission error on the bus and write its files.

    These are recordings, bus log and result.json, also if the identification fails.

    Raises:
        HilError: Nothing has moved yet: nodes or limits do not allow it.
        ChannelError: The bus cannot be opened, or was lost before anything was recorded.
    """
    knowledge = axis_knowledge(bench, request.axis, identified, sensorless=request.sensorless)
    first_ramp(bench, request, knowledge)
    what = f"identification of the transmission error of axis {request.axis}"
    check_axis_shown(what, bench, request.axis, identified)
    demand = BusDemand(what, (request.axis,), bench.bus.sync_period_s)

    def empty(described: MeasuredBench) -> AteResult:
        before = KnownArm.model_validate(knowledge, from_attributes=True)
        sensing = sensing_of(bench, request.axis, knowledge, sensorless=request.sensorless)
        return AteResult(bench=described, axis=request.axis, sensorless=request.sensorless, known_before=before, sensing=sensing)

    def keep(number: int, result: RunResult, motion: Ramps) -> None:
        measurement.result.passes.append(
            _run_entry(result, motion, measurement.made(result, f"ate-axis{request.axis}-pass{number}"))
        )

    with Measurement(bench, out, empty, channel=channel, reporter=reporter) as measurement:
        with measurement.session([demand], overload=overload) as session:
            identification = identify_on(session, request, knowledge, keep, reporter)
        today = measurement.started.date().isoformat()
        part = as_part(identification.estimate, request, today, knowledge, identification.reaction)
        _enter(measurement.result, identification, part.model_copy(update={"emulated": measurement.result.emulated}))
    return AteOutcome(measurement.result, measurement.failure)


def _run_entry(result: RunResult, motion: Ramps, made: dict[str, Any]) -> AteRun:
    period_s, made_of = motion.motion.period_s, motion.trajectory
    return AteRun(
        acceleration_rps_s=made_of.acceleration_rps_s, end_rps=made_of.end_rps, ramp_s=made_of.ramp_s,
        forward_from_s=motion.forward.start * period_s + made_of.dwell_s,
        backward_from_s=motion.backward.start * period_s + made_of.dwell_s,
        low_rev=motion.low_rev, high_rev=motion.high_rev, sync_period_s=period_s, sensor_missed=result.sensor_missed,
        motion_s=round(result.motion_s, 6), timing=timing_of(result), **made,
    )  # fmt: skip


def _enter(result: AteResult, identification: Identification, part: IdentifiedError) -> None:
    estimate = identification.estimate
    result.ate = part
    arm, scan = estimate.arm, identification.scan
    result.fit = AteFit(
        delay_s=arm.delay_s, delay_error_s=part.standard_error.get("accelerometer_delay_s", estimate.arm_error.delay_s),
        gear_fraction=arm.gear_fraction, arm_hz=arm.resonance_hz, arm_damping=arm.damping, band_hz=estimate.band_hz,
        residual=estimate.residual, explained=estimate.explained, explained_by_error=estimate.explained_by_error,
        motion_scale=estimate.motion_scale, motion_scale_error=estimate.motion_scale_error, miss=estimate.miss,
        agreement=tuple(estimate.agreement),
        carried=None if scan is None else {f"{k:g}": fraction for k, fraction in scan.fractions.items()},
    )  # fmt: skip
    result.history = tuple(AteStandardErrors(standard_error=standard_errors(each.estimate)) for each in identification.passes)
    result.is_within_goal = identification.is_good
    result.notes = tuple(identification.notes)
