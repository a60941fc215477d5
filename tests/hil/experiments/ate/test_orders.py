"""Robots with orders that nobody asked for: what identification and learning say of them, and that they do what they are told."""

import pytest

from hil.errors import HilError
from hil.experiments.ate.identify import as_part, identify_on
from hil.experiments.ate.request import AteRequest, AxisKnowledge
from hil.experiments.cancellation.learning import learn
from hil.robot_tables import TransmissionErrorTable
from plant_emulator.robots.robot import Robot
from tests.hil.experiments.ate.ate_rig import AXIS, RigSession, built

ORDER_1 = {"f_a": 7.0, "a1": 60.0, "a2": 3.0, "a4": 1.5, "noise": 0.1}


def with_order_3(amplitude_arcsec: float) -> Robot:
    """A robot of 12 Hz with 10″, 5″ and so much of order 3."""
    robot = built("")
    axis = robot.axis[AXIS]
    amplitudes, phases = axis.ate.amplitudes_arcsec(), axis.ate.phases_deg()
    table = TransmissionErrorTable.of({**amplitudes, 3: amplitude_arcsec}, {**phases, 3: 40.0})
    return robot.model_copy(update={"axis": {AXIS: axis.model_copy(update={"ate": table})}})


@pytest.mark.ci
def test_an_order_that_is_seen_and_not_in_the_set_is_named_with_what_to_do() -> None:
    request = AteRequest(AXIS, passes=1)
    found = identify_on(RigSession(with_order_3(3.0)), request, AxisKnowledge())  # type: ignore[arg-type]
    assert any("order 3 is significant but not in the set: 3″" in note and "--orders 1,2,3,4" in note for note in found.notes)
    assert found.scan is not None
    assert found.scan.fractions[2] > 0.5


@pytest.mark.slow
def test_an_order_that_is_asked_for_is_identified_with_the_others() -> None:
    request = AteRequest(AXIS, passes=2, orders=(1, 2, 3, 4))
    found = identify_on(RigSession(with_order_3(6.0)), request, AxisKnowledge())  # type: ignore[arg-type]
    part = as_part(found.estimate, request)
    assert part.values.amplitudes_arcsec() == pytest.approx({2: 10.0, 3: 6.0, 4: 5.0}, rel=0.02)
    assert part.values.phases_deg()[3] == pytest.approx(40.0, abs=1.0)
    assert {"a3_arcsec", "phi3_deg"} <= part.standard_error.keys()
    assert not any("not in the set" in note for note in found.notes)


@pytest.mark.ci
def test_what_leads_the_fit_astray_is_named_where_it_is_refused() -> None:
    request = AteRequest(AXIS, passes=1, orders=(2, 4))
    with pytest.raises(
        HilError, match=r"order 1 is significant but not in the set: 60″, 9\d % of the vibration; add it with --orders 1,2,4"
    ):
        identify_on(RigSession(built(**ORDER_1)), request, AxisKnowledge())  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_first_order_is_learnt_and_cancelled_where_the_axis_reaches_it() -> None:
    robot = built(**ORDER_1)
    inertia = robot.axis[AXIS].motor_inertia_kg_m2
    learnt = learn(RigSession(robot), AXIS, passes=4, motor_inertia_kg_m2=inertia)  # type: ignore[arg-type]
    assert learnt.reduction_fraction > 0.9
    assert learnt.part().values.a1_arcsec == pytest.approx(60.0, rel=0.02)
