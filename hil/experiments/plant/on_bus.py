"""Run of `hil identify plant` on a bench."""

import math
from dataclasses import asdict
from pathlib import Path

from hil.bench.bench import Bench
from hil.bench.model import update_file
from hil.can.channel import Channel
from hil.design.estimation import EstimatedParameter
from hil.design.friction import Friction
from hil.design.plant_identification import ResponseEstimate
from hil.experiments.measurement import Measurement, MeasurementOutcome
from hil.experiments.plant.checks import PlantNotIdentifiedError
from hil.experiments.plant.evaluation import PlantEvaluation
from hil.experiments.plant.identify import PlantIdentification
from hil.experiments.plant.motion import PlantRequest, bus_demand
from hil.experiments.plant.posture import bring_to, check_posture, felt_posture, joint_deg, standing_deg
from hil.master.session import Session
from hil.reporter import SILENT, Reporter
from hil.results.plant import ExcitationPlan, FrequencyResponseEntry, FrictionCurve, PlantRequestEntry, PlantResult


def run_identify_plant(
    bench: Bench,
    request: PlantRequest,
    out: Path,
    *,
    model: Path | None = None,
    channel: Channel | None = None,
    overload: bool = False,
    reporter: Reporter = SILENT,
) -> MeasurementOutcome[PlantResult]:
    """Identify a plant, and write `out/runs/*.csv`, `out/bus.log`, `out/result.json` and the model file.

    Where the plant was not identified, the recordings and a result with the reasons are written, but no model file.

    Args:
        model: Model file for the plant; None for none.

    Raises:
        HilError: Nothing has moved yet: the request, nodes, limits or the bus do not allow it.
        ChannelError: The bus cannot be opened, or was lost before anything was recorded.
    """
    demand = bus_demand(bench, request)
    check_posture(bench, request.posture_deg)
    request_entry = PlantRequestEntry(**asdict(request))
    with Measurement(
        bench,
        out,
        lambda described: PlantResult(bench=described, axis=request.axis, request=request_entry),
        channel=channel,
        reporter=reporter,
    ) as measurement:
        result = measurement.result
        with measurement.session([demand], overload=overload) as session:
            stood = standing_deg(session)
            bring_to(session, request.posture_deg)
            joints = standing_deg(session)
            evaluation = _perform(measurement, session, request, reporter)
            bring_to(session, {number: stood[number] for number in reversed(list(request.posture_deg))})
        how = f"{evaluation.excited} excitation of {evaluation.amplitude_nm:.3g} N·m"
        entry = evaluation.identified(f"identified {result.bench.started_utc}, {how}")
        entry = entry.model_copy(update={"emulated": result.emulated})
        enter(result, evaluation)
        result.identified = entry
        if model is not None:
            posture = None
            if joints:  # the own joint was in the middle of its travel, on the average
                travel = evaluation.travel
                joints[request.axis] = joint_deg(bench, request.axis, math.pi * (travel.low_rev + travel.high_rev))
                posture = felt_posture(entry, joints)
            update_file(model, bench.name, request.axis, entry, posture, keeps_known=bool(request.posture_deg))
            result.model_file = str(model)
    return MeasurementOutcome(measurement.result, measurement.failure)


def _perform(
    measurement: Measurement[PlantResult], session: Session, request: PlantRequest, reporter: Reporter
) -> PlantEvaluation:
    """Identify a plant, and keep recordings, checks and remarks."""
    result, identification = measurement.result, PlantIdentification(session, request, reporter)
    try:
        return identification.perform()
    except PlantNotIdentifiedError as error:
        result.not_identified = error.reasons
        raise
    finally:
        result.checks = tuple(identification.checks)
        result.remarks = tuple(identification.remarks)
        for name, recording in identification.recordings.items():
            result.recordings[name] = measurement.keep(recording, f"identify-plant-axis{request.axis}-{name}")


def enter(result: PlantResult, evaluation: PlantEvaluation) -> None:
    """Enter an evaluation into a result."""
    estimate, travel = evaluation.estimate, evaluation.travel
    result.plan = ExcitationPlan(
        excitation=evaluation.excited,
        amplitude_nm=evaluation.amplitude_nm,
        crest_factor=travel.wave.crest_factor,
        bias_rps=travel.bias_rps,
        period_s=travel.wave.period_s,
        periods=estimate.periods,
        travel_rev=(travel.low_rev, travel.high_rev),
    )
    result.plant = estimate.plant
    result.parameters = {**estimate.parameters, **_friction_parameters(evaluation.friction)}
    result.modes = estimate.modes
    result.misfit = estimate.misfit
    result.cannot_tell = evaluation.cannot_tell
    result.response = _response(estimate.response)
    result.tip_response = None if estimate.tip is None else _response(estimate.tip)
    result.friction = FrictionCurve.model_validate(evaluation.friction, from_attributes=True)


def _friction_parameters(friction: Friction) -> dict[str, EstimatedParameter]:
    return {
        "friction_coulomb_nm": friction.coulomb_nm,
        "friction_viscous_nm_s_rad": friction.viscous_nm_s_rad,
        "gravity_moment_nm": friction.gravity_moment_nm,
        "gravity_phase_deg": friction.gravity_phase_deg,
    }


def _response(response: ResponseEstimate) -> FrequencyResponseEntry:
    return FrequencyResponseEntry(
        frequency_hz=response.frequency_hz.tolist(),
        real=response.value.real.tolist(),
        imaginary=response.value.imag.tolist(),
        deviation=response.deviation.tolist(),
        radius=response.radius.tolist(),
        coherence=response.coherence.tolist(),
    )
