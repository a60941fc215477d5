"""Cancellation from a model file: what it refuses before anything moves, and how a trial is judged."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.bench.bench import Bench, load_bench
from hil.bench.model import Identified, IdentifiedAxis, IdentifiedError, IdentifiedPlant
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.experiments.cancellation.cancellation import Pace, cancellation_for, cancellation_of
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.trial import averaged
from hil.experiments.cancellation.verdict import PartVerdict, Seen, judge
from hil.experiments.cancellation.verification import CancellationRefusedError, Trial, Verification
from hil.experiments.cancellation.waves import judged_rows
from hil.experiments.judge import vibration_scale
from hil.experiments.motions import constant_acceleration, line_motion
from hil.experiments.motor_inertia import given_inertia
from hil.recording import Recording
from hil.robot_tables import PlantTable, TransmissionErrorTable


@pytest.fixture(scope="module")
def bench() -> Bench:
    return load_bench("reference")


def with_model(bench: Bench, axis: int, **changes: object) -> Bench:
    table = bench.axis[axis]
    assert table.model is not None
    changed = table.model_copy(update={"model": table.model.model_copy(update=changes)})
    return bench.model_copy(update={"axis": {**bench.axis, axis: changed}})


def identified(bench: Bench, axis: int, a2_arcsec: float, phi2_deg: float = 0.0, **more: float) -> Identified:
    part = IdentifiedError(values=TransmissionErrorTable(a2_arcsec=a2_arcsec, phi2_deg=phi2_deg), **more)  # type: ignore[arg-type]
    return Identified(robot=bench.name).with_part(axis, part)


def test_axes_without_a_known_error_are_left_alone(bench: Bench) -> None:
    found = cancellation_for(bench, None, (2, 3, 5), 0.001)
    assert set(found.tables) == {2, 3}
    assert found.adder().uses_torque is False
    adder = found.adder()
    for step in range(100):
        references, torques = adder.laws.step([0.01 * step] * 3, [0.0] * 3)
    assert references[0] != 0.0
    assert references[2] == 0.0
    assert list(torques) == [0.0] * 3


def test_one_axis_alone_and_a_share(bench: Bench) -> None:
    found = cancellation_for(bench, None, (2, 3), 0.001)
    whole, part, alone = found.adder(), found.adder(0.3), found.adder(1.0, only=3)
    for i in range(300):
        angles = [0.01 * i, 0.02 * i]
        first, second, third = (each.laws.step(angles, [0.0] * 2)[0] for each in (whole, part, alone))
    assert list(second) == pytest.approx([0.3 * value for value in first], rel=0.02)  # but for the mixed waves
    assert list(third) == [0.0, first[1]]


def test_the_model_file_replaces_what_the_bench_believes(bench: Bench) -> None:
    believed = cancellation_for(bench, None, (2,), 0.001).tables[2]
    found = cancellation_for(bench, identified(bench, 2, 10.0, 30.0), (2,), 0.001).tables[2]
    assert found.orders == (2,)
    assert found.waves[0].phase_rad == pytest.approx(math.radians(30.0))
    assert np.abs(found.reference[0]) == pytest.approx(2.0 * np.abs(believed.reference[0]))


def test_a_measured_delay_of_the_set_points_is_a_phase_ahead(bench: Bench) -> None:
    plain, late = (
        cancellation_for(bench, identified(bench, 2, 5.0, 222.0, set_point_delay_s=delay), (2,), 0.001).tables[2]
        for delay in (0.0, 0.001)
    )
    at_6_rps = np.angle(late.reference[0, 120] / plain.reference[0, 120])
    assert math.degrees(at_6_rps) == pytest.approx(4.32, abs=0.01)


def test_the_torque_way_maps_offsets_and_gives_them_in_steps(bench: Bench) -> None:
    law = cancellation_for(bench, None, (2,), 0.001, actuation="torque", torque_steps_nm={2: 0.002}).adder()
    assert law.uses_torque
    given = {round(law.laws.step([0.0377 * i], [0.0])[1][0] / 0.002, 6) for i in range(400)}
    assert all(value == round(value) for value in given)
    assert max(given) >= 2.0


def without_plant(bench: Bench, **facts: float) -> Bench:
    """The bench without a model of axis 2."""
    return bench.model_copy(update={"axis": {2: bench.axis[2].model_copy(update={"model": None, **facts})}})


def identified_alone(bench: Bench) -> Identified:
    """A model file with what `hil identify ate` finds, and no plant."""
    ate = bench.axis[2].model.ate  # type: ignore[union-attr]
    error = IdentifiedError(values=ate, arm_hz=12.45, damping=0.0385)
    return Identified(robot=bench.name, axis={2: IdentifiedAxis(ate=error)})


def test_an_error_without_a_plant_is_cancelled_by_the_inertia_of_the_data_sheet(bench: Bench) -> None:
    known = identified_alone(bench)
    with pytest.raises(
        NotPossibleError, match=r"the motor inertia of axis 2 .*state motor_inertia_kg_m2 of its data sheet in \[axis\.2\]"
    ):
        cancellation_for(without_plant(bench), known, (2,), 0.001)
    stated = cancellation_for(without_plant(bench, motor_inertia_kg_m2=2.6e-4), known, (2,), 0.001)
    assert {part.order for part in stated.parts} == {2, 4}


def test_nothing_known_is_refused(bench: Bench) -> None:
    with pytest.raises(NotPossibleError, match="axis 5; hil identify ate"):
        cancellation_for(bench, None, (5,), 0.001)
    with pytest.raises(NotPossibleError, match="has no axis 4"):
        cancellation_for(bench, None, (4,), 0.001)
    with pytest.raises(NotPossibleError, match="the model file is of robot 'other'; expected"):
        cancellation_for(bench, Identified(robot="other"), (2,), 0.001)


def test_a_loop_that_follows_nothing_is_refused(bench: Bench) -> None:
    control = bench.axis[2].control.model_copy(update={"position_gain_per_s": 0.0})
    changed = bench.model_copy(update={"axis": {2: bench.axis[2].model_copy(update={"control": control})}})
    with pytest.raises(NotPossibleError, match="axis 2: the loop has no position gain"):
        cancellation_for(changed, None, (2,), 0.001)


def test_a_correction_too_large_to_be_one_is_refused(bench: Bench) -> None:
    motion = constant_acceleration(bench, 2, 0.002)
    cancellation_for(bench, None, (2,), 0.002).check(bench, motion)
    large = cancellation_for(bench, identified(bench, 2, 30.0), (2,), 0.002)
    large.check(bench, motion)  # a strong error of a real gear
    table = bench.axis[2]
    tight = table.limits.model_copy(update={"cancellation_rev": 0.01})
    with pytest.raises(
        UnsafeRequestError, match=r"axis 2 would be 0\.01\d+ rev; the limit is 0\.01 rev; limits\.cancellation_rev"
    ):
        large.check(bench.model_copy(update={"axis": {2: table.model_copy(update={"limits": tight})}}), motion)
    with pytest.raises(UnsafeRequestError, match=r"ΣA_k, would be 500 arcsec; the limit is 200 arcsec; no gear has as much"):
        cancellation_for(bench, identified(bench, 2, 500.0), (2,), 0.002, actuation="torque")
    weak = table.limits.model_copy(update={"torque_nm": 0.2})
    torque = cancellation_for(bench, identified(bench, 2, 190.0), (2,), 0.002, actuation="torque")
    with pytest.raises(UnsafeRequestError, match="the torque offset of axis 2"):
        torque.check(bench.model_copy(update={"axis": {2: table.model_copy(update={"limits": weak})}}), motion)


def test_limits_hold_with_the_correction(bench: Bench) -> None:
    motion = constant_acceleration(bench, 2, 0.002)
    found = cancellation_for(bench, None, (2,), 0.002)

    def limited(**changes: float) -> Bench:
        table = bench.axis[2]
        limits = table.limits.model_copy(update=changes)
        return bench.model_copy(update={"axis": {**bench.axis, 2: table.model_copy(update={"limits": limits})}})

    end = float(motion.motor_angle_rad.max()) / (2.0 * math.pi)
    with pytest.raises(UnsafeRequestError, match="the speed of axis 2 with its cancellation"):
        found.check(limited(speed_rps=10.5), motion)
    with pytest.raises(UnsafeRequestError, match="the position of axis 2 with its cancellation"):
        found.check(limited(position_max_rev=end + 0.001), motion)
    with pytest.raises(UnsafeRequestError, match="the position of axis 2 with its cancellation"):
        found.check(limited(position_min_rev=-0.001), motion)
    found.check(limited(position_max_rev=end + 1.02, position_min_rev=0.98), motion, [2.0 * math.pi])


def test_parts_are_left_out_one_by_one(bench: Bench) -> None:
    whole = cancellation_for(bench, None, (2, 3), 0.001)
    assert whole.parts == (Part(2, 2), Part(2, 4), Part(3, 2), Part(3, 4))
    less = whole.without([Part(2, 4), Part(3, 2), Part(3, 4)])
    assert less.parts == (Part(2, 2),)
    assert less.tables[2].reference[0].tolist() == whole.tables[2].reference[0].tolist()
    assert whole.without([]).parts == whole.parts


def test_only_the_motors_inertia_is_needed_and_somebody_must_know_it(bench: Bench) -> None:
    axes = {number: table.model_copy(update={"model": None}) for number, table in bench.axis.items()}
    blank = bench.model_copy(update={"axis": axes})
    model = bench.axis[2].model
    assert model is not None
    learnt = identified(bench, 2, 5.0, 222.0, arm_hz=12.4, damping=0.04, motor_inertia_kg_m2=model.motor_inertia_kg_m2)
    found = cancellation_for(blank, learnt, (2,), 0.001).tables[2]
    known = cancellation_for(bench, identified(bench, 2, 5.0, 222.0), (2,), 0.001).tables[2]
    at = slice(40, 160)
    assert np.abs(found.reference[0, at]) == pytest.approx(np.abs(known.reference[0, at]), rel=0.01)
    with pytest.raises(
        NotPossibleError, match=r"from the motor's data sheet: motor_inertia_kg_m2 in \[axis\.2\], or --motor-inertia-kg-m2"
    ):
        given_inertia(blank, None, 2, None)
    sheet = blank.model_copy(update={"axis": {**axes, 2: axes[2].model_copy(update={"motor_inertia_kg_m2": 2e-4})}})
    assert (given_inertia(sheet, None, 2, None), given_inertia(sheet, None, 2, 3e-4)) == (2e-4, 3e-4)
    assert given_inertia(blank, None, 2, 3e-4) == 3e-4
    assert given_inertia(bench, None, 2, 3e-4) is None  # a plant is better than a data sheet


def test_set_points_that_would_be_too_fast_end_the_cancellation_at_a_lower_frequency(bench: Bench) -> None:
    motion = constant_acceleration(bench, 2, 0.002)
    values = TransmissionErrorTable(a2_arcsec=10.0, phi2_deg=0.0, a4_arcsec=10.0)
    strong = Identified(robot=bench.name).with_part(2, IdentifiedError(values=values))
    free = cancellation_for(bench, strong, (2,), 0.002)
    with pytest.raises(UnsafeRequestError, match="the speed of axis 2 with its cancellation"):
        free.check(bench, motion)
    bounded = cancellation_for(bench, strong, (2,), 0.002, paces={2: Pace(10.0)})
    bounded.check(bench, motion)
    for row, order in enumerate((2, 4)):
        at_resonance = round(11.84 / order / bounded.tables[2].step_rps)
        assert bounded.tables[2].reference[row, at_resonance] == free.tables[2].reference[row, at_resonance]
    assert abs(bounded.tables[2].reference[1, 190]) < abs(free.tables[2].reference[1, 190])


def strong_error(bench: Bench) -> Identified:
    values = TransmissionErrorTable(a2_arcsec=10.0, phi2_deg=0.0, a4_arcsec=10.0)
    return Identified(robot=bench.name).with_part(2, IdentifiedError(values=values))


def test_what_the_speed_limit_has_no_room_for_is_done_by_a_torque_offset(bench: Bench) -> None:
    motion = constant_acceleration(bench, 2, 0.002)
    found = cancellation_of(bench, strong_error(bench), motion)
    found.check(bench, motion)
    assert found.uses_torque
    assert found.adder().uses_torque
    assert not cancellation_of(bench, None, motion).uses_torque  # the reference robot's own has room


def test_a_drive_without_a_torque_offset_gets_none(bench: Bench) -> None:
    motion = constant_acceleration(bench, 2, 0.002)
    without = bench.axis[2].model_copy(update={"profile": "trinamic_tmcm16xx"})
    found = cancellation_of(bench.model_copy(update={"axis": {**bench.axis, 2: without}}), strong_error(bench), motion)
    assert not found.uses_torque


def lagging(bench: Bench, lag_s: float, error_s: float) -> Identified:
    table = bench.axis[2]
    assert table.model is not None
    values = PlantTable(**table.model.model_dump(exclude={"ate"}))
    plant = IdentifiedPlant(
        values=values, standard_error={"torque_lag_s": error_s}, antiresonance_hz=12.0, resonance_hz=22.0, damping=0.02,
        torque_lag_s=lag_s,
    )  # fmt: skip
    return identified(bench, 2, 5.0).with_part(2, plant)


def test_a_lag_of_the_current_loop_is_allowed_for_however_uncertain_it_is(bench: Bench) -> None:
    """J_m and D_m of the model file are those that go with it: with another lag the correction would be off."""
    found = [cancellation_for(bench, lagging(bench, lag_s, 3e-4), (2,), 0.001).tables[2] for lag_s in (0.0, 4e-4, 4e-5)]
    none, long, short = (table.reference[0, 120] for table in found)
    assert abs(long / none - 1.0) > 0.002
    assert short / none - 1.0 == pytest.approx(0.1 * (long / none - 1.0), rel=0.05)


def test_a_trial_in_which_nothing_passes_is_refused_with_its_numbers() -> None:
    def verdict(order: int, turn_deg: float) -> PartVerdict:
        taken = 3.0 * np.exp(1j * math.radians(turn_deg))
        return judge(Part(3, order), 0.3, [Seen(1, gain, complex(3.0 - gain * taken), 1e-4) for gain in (0.0, 0.3, 1.0)])

    trial = Trial("without", Recording({}), {}, 1.0)
    good, bad = verdict(2, 3.0), verdict(4, 180.0)
    part_of = Verification(0.3, (trial, replace(trial, rms_m_s2=0.6)), (good, bad))
    assert part_of.is_good
    part_of.demand()
    assert part_of.left_out == {Part(3, 4)}
    entry = part_of.entry()
    assert [part.verdict for part in entry.parts] == ["accepted", "refused"]
    assert [part.order for part in entry.refused] == [4]
    assert entry.trials[0].reduction_fraction == pytest.approx(0.4)
    with pytest.raises(
        CancellationRefusedError, match=r"axis 3, order 4: with 30 % of its cancellation it rose by 30 .*turned by .180°"
    ) as caught:
        Verification(0.3, (trial,), (bad,)).demand()
    assert caught.value.exit_code == 9
    assert "the notch remains" in str(caught.value)


def test_rows_that_are_compared(bench: Bench) -> None:
    scale = vibration_scale(bench, (3,))
    for motion in (line_motion(bench, 0.002), constant_acceleration(bench, 3, 0.002)):
        columns = {"time_s": motion.time_s, "tip_z_m_s2": np.zeros(len(motion.time_s))}
        columns |= {f"axis{n}_position_rad": motion.motor_angle_rad[:, i] for i, n in enumerate(motion.axes)}
        assert 0.4 < np.count_nonzero(judged_rows(bench, Recording(columns), scale)) * 0.002 < 2.0
    still = Recording({"time_s": motion.time_s, "axis3_position_rad": np.zeros(len(motion.time_s))})
    with pytest.raises(NotPossibleError, match="excites the arm for 0 s"):
        judged_rows(bench, still, scale)


def test_the_mean_of_recordings() -> None:
    one, other = (Recording({"time_s": np.arange(3.0), "tip_z_m_s2": np.full(3, value)}) for value in (1.0, 2.0))
    assert averaged([one, other]).columns["tip_z_m_s2"].tolist() == [1.5] * 3
    with pytest.raises(ValueError, match="cannot be averaged"):
        averaged([one, Recording({"time_s": np.arange(4.0)})])
    with pytest.raises(ValueError, match="cannot be averaged"):
        averaged([])


def test_an_arm_that_resonates_at_40_hz_is_cancelled_there_too(bench: Bench) -> None:
    """No constant of a 12 Hz robot ends it at 60 Hz: the band of this one goes to twice its resonance."""
    model = bench.axis[2].model
    assert model is not None
    stiff = with_model(
        bench, 2, gear_stiffness_nm_rad=12.0 * model.gear_stiffness_nm_rad, motor_inertia_kg_m2=4.0 * model.motor_inertia_kg_m2
    )
    limits = stiff.axis[2].limits.model_copy(update={"speed_rps": 20.0})
    stiff = stiff.model_copy(update={"axis": {**stiff.axis, 2: stiff.axis[2].model_copy(update={"limits": limits})}})
    found = cancellation_for(stiff, None, (2,), 0.001)
    f_al_hz = found.scales[2].f_al_hz
    assert f_al_hz > 36.0
    table = found.tables[2]
    column = int(np.searchsorted(table.speeds_rps, 1.2 * f_al_hz / 4.0))
    assert 4.0 * table.speeds_rps[column] > 48.0  # from there on it would fade
    order = table.orders.index(4)
    assert table.motion[order, column] == pytest.approx(table.motion[order, 0])


@pytest.mark.parametrize(("sync_period_s", "whole_hz", "half_hz"), [(0.008, 45.0, 62.5), (0.004, 80.0, None)])
def test_slow_set_points_cancel_an_order_as_far_as_its_images_shake_the_arm_less(
    bench: Bench, sync_period_s: float, whole_hz: float, half_hz: float | None
) -> None:
    """At half of the SYNC rate an image is as large as its sine; beyond, it is larger. An arm of 27 Hz answers to both."""
    model = bench.axis[2].model
    assert model is not None
    slow = with_model(bench, 2, gear_stiffness_nm_rad=5.0 * model.gear_stiffness_nm_rad)
    limits = slow.axis[2].limits.model_copy(update={"speed_rps": 25.0})
    slow = slow.model_copy(update={"axis": {**slow.axis, 2: slow.axis[2].model_copy(update={"limits": limits})}})
    slow = slow.model_copy(update={"bus": slow.bus.model_copy(update={"sync_period_s": sync_period_s})})
    table = cancellation_for(slow, None, (2,), sync_period_s).tables[2]
    part = table.motion[table.orders.index(4)] / table.motion[table.orders.index(4), 1]
    frequency = 4.0 * table.speeds_rps
    assert part[frequency < min(whole_hz, 64.0)].min() > 0.99
    if half_hz is not None:
        assert part[np.argmin(np.abs(frequency - half_hz))] == pytest.approx(0.5, abs=0.01)
        assert part[frequency > 1.2 * half_hz].max() < 0.05
