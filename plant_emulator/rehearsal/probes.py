"""Wrong corrections, which the trial must refuse."""

import cmath
import math
from collections.abc import Mapping

from hil.bench.bench import Bench
from hil.bench.model import Identified, IdentifiedAxis, IdentifiedError, IdentifiedPlant, with_identified
from hil.errors import HilError
from hil.experiments.cancellation.cancellation import cancellation_on
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.trial import choose
from hil.experiments.motions import constant_acceleration
from hil.robot_tables import ORDERS, PlantTable, TransmissionErrorTable
from plant_emulator.rehearsal.estimates import sensor_delay_s
from plant_emulator.rehearsal.gear import gear_plant
from plant_emulator.rehearsal.record import PROBES, ProbeRecord
from plant_emulator.rehearsal.survey import Survey, session_on
from plant_emulator.rehearsal.truth import ratio_of_tips
from plant_emulator.robots.fleet import draw
from plant_emulator.robots.robot import Robot

WRONG_FROM = 0.99
"""Fraction of an order's error that a correction leaves, from which on it is wrong: 60° of phase leave all of it."""


def probe(robot: Robot, bench: Bench, axis: int, survey: Survey, before: Mapping[float, float]) -> dict[str, ProbeRecord]:
    """Test the trial with wrong corrections."""
    found = {}
    with session_on(robot, bench) as session:
        for name, table in wrong_corrections(robot, axis).items():
            model = model_of(robot, bench, axis, table)
            session.adopt(with_identified(bench, model))
            motion = constant_acceleration(bench, axis, bench.bus.sync_period_s)
            try:
                choice = choose(session, cancellation_on(session, model, motion), motion, shows_filter=False)
            except HilError:
                found[name] = ProbeRecord()
                continue
            verdicts = choice.verification.verdicts
            used = {verdict.part.order for verdict in verdicts if verdict.verdict == "accepted"}
            if not used & wrong_orders(robot.axis[axis].apparent_ate, table):
                found[name] = ProbeRecord(accepted=False)
                continue
            left_out = [Part(axis, verdict.part.order) for verdict in verdicts if verdict.part.order not in used]
            found[name] = ProbeRecord(True, ratio_of_tips(survey.cancelled(model, left_out), before))
    return {name: found[name] for name in PROBES if name in found}


def wrong_corrections(robot: Robot, axis: int) -> dict[str, TransmissionErrorTable]:
    """Return wrong ATEs, named as in `record.PROBES`."""
    true = robot.axis[axis].apparent_ate
    amplitudes, phases = true.amplitudes_arcsec(), true.phases_deg()
    made = {}
    for order in amplitudes.keys() & set(ORDERS):
        for angle in (60, 90, 180):
            turned = {**phases, order: phases[order] + angle}
            made[f"phi{order}_off_{angle}"] = TransmissionErrorTable.of(amplitudes, turned)
        made[f"a{order}_times_3"] = TransmissionErrorTable.of({**amplitudes, order: 3.0 * amplitudes[order]}, phases)
    made["another_robot"] = draw(robot.seed + 1).axis[min(draw(robot.seed + 1).axis)].ate
    return made


def wrong_orders(true: TransmissionErrorTable, assumed: TransmissionErrorTable) -> set[float]:
    """Return the orders that a correction does not reduce."""
    wrong: set[float] = set()
    known, turned = true.amplitudes_arcsec(), true.phases_deg()
    for order, amplitude in assumed.amplitudes_arcsec().items():
        there = cmath.rect(known.get(order, 0.0), math.radians(turned.get(order, 0.0)))
        taken = cmath.rect(amplitude, math.radians(assumed.phases_deg()[order]))
        if abs(there - taken) >= WRONG_FROM * abs(there):
            wrong.add(order)
    return wrong


def model_of(robot: Robot, bench: Bench, number: int, error: TransmissionErrorTable) -> Identified:
    """Return a model file with the true plant and an assumed ATE."""
    axis = robot.axis[number]
    values = PlantTable(**{name: getattr(axis, name) for name in PlantTable.model_fields})
    gear = gear_plant(axis, None)
    plant = IdentifiedPlant(
        values=values,
        antiresonance_hz=gear.antiresonance_hz,
        resonance_hz=gear.resonance_hz,
        damping=gear.damping,
        torque_lag_s=axis.current_time_constant_s,
        coulomb_friction_nm=axis.coulomb_friction_nm,
        gravity_moment_nm=axis.gravity_moment_nm,
    )
    delay_s = sensor_delay_s(robot.accelerometer, gear.antiresonance_hz)
    part = IdentifiedError(values=error, accelerometer_delay_s=delay_s, gear_reaction=float(axis.gear_reaction))
    return Identified(robot=bench.name, axis={number: IdentifiedAxis(plant=plant, ate=part)})
