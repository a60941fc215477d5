"""The control period and the plant in C compute what the specification in plain Python says, to the last bit."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.control.cascade import Cascade
from hil.control.notch import Notch
from plant_emulator.core import CORE
from plant_emulator.motion import record
from plant_emulator.motion.axes import Axes
from plant_emulator.physics.articulated import LINK
from plant_emulator.physics.axis import CHANGE, PAST, PLANT, PLANT_STATE, hang_at_rest, synchronous_error
from plant_emulator.robots.encoders import MotorEncoder
from plant_emulator.robots.fleet import draw
from plant_emulator.robots.robot import load_robot
from tests.oracles import arm, motion, plant
from tests.oracles.records import numbers, plain

SEEDS = st.integers(0, 2**32 - 1)
MODES = (record.POSITION, record.TORQUE, record.PROFILE, record.VELOCITY, record.PROFILE_VELOCITY, record.PROFILE_TORQUE)
PERIOD_S, SUBSTEPS = 250e-6, 4


def random_plant(source):
    """Constants of an axis, with everything that an axis can have, or without."""
    rows = np.zeros(1, PLANT)
    p = rows[0]
    for name in PLANT.names:
        p[name] = source.uniform(0.0, 1.0, p[name].shape)
    p["reduction_ratio"], p["motor_inertia_kg_m2"], p["arm_inertia_kg_m2"] = 100.0, 1e-5, source.uniform(0.5, 8.0)
    p["motor_damping_nm_s_rad"], p["gear_stiffness_nm_rad"], p["gear_damping_nm_s_rad"] = 1e-4, source.uniform(5e3, 5e4), 10.0
    p["coulomb_friction_nm"], p["static_friction_nm"], p["stribeck_velocity_rad_s"] = 0.01, 0.013, 2.0
    p["gravity_moment_nm"], p["home_angle_rad"] = source.uniform(0.0, 60.0), source.uniform(-2.0, 2.0)
    for name in ("a1_rad", "a2_rad", "a4_rad", "more_rad", "joint_rad"):
        p[name] = source.uniform(0.0, 3e-4, p[name].shape)
    p["more_orders"], p["cogging_nm"] = source.uniform(0.2, 9.0, 4), source.uniform(0.0, 1e-3, 4)
    p["joint_orders"], p["cogging_orders"] = source.uniform(0.01, 0.1, 4), source.integers(4, 40, 4)
    for name in ("has_more_orders", "is_eccentric", "is_cogging", "gear_reaction"):
        p[name] = float(source.integers(0, 2))
    p["wind_up_softness"], p["wind_up_torsion_rad"] = source.choice([0.0, 0.3]), 2e-4
    p["hysteresis_torque_nm"], p["hysteresis_torsion_rad"] = source.choice([0.0, 3.0]), 1e-4
    p["current_time_constant_s"] = source.choice([0.0, 5e-4])
    return rows


def random_state(source):
    rows = np.zeros(1, PLANT_STATE)
    rows[0] = (
        source.uniform(-300.0, 300.0), source.uniform(-60.0, 60.0), source.uniform(-3.0, 3.0), source.uniform(-0.6, 0.6),
        source.uniform(-1.0, 1.0), source.uniform(-0.5, 0.5), 0.0,
    )  # fmt: skip
    rows["arm_angle_rad"] = rows["motor_angle_rad"] / 100.0 + source.uniform(-3e-4, 3e-4)
    return rows


@given(SEEDS)
def test_a_step_of_the_plant_is_that_of_the_specification(seed):
    source = np.random.default_rng(seed)
    plants, states = random_plant(source), random_state(source)
    p, s = plain(plants[0]), plain(states[0])
    for _ in range(20):
        command, braked = float(source.uniform(-1.0, 1.0)), bool(source.integers(0, 2))
        CORE.call.plant_step(
            CORE.pointer(plants, "plant"), CORE.pointer(states, "plant_state"), command, braked, PERIOD_S, SUBSTEPS
        )
        plant.plant_step(p, s, command, braked, PERIOD_S, SUBSTEPS)
        assert numbers(states[0]) == numbers(s)
    assert synchronous_error(plants[0], 0.7) == plant.synchronous_error(p, 0.7)
    assert CORE.call.cogging(CORE.pointer(plants, "plant"), 0.7) == plant.cogging(p, 0.7)
    hang_at_rest(plants[0], states[0])
    plant.hang_at_rest(p, s)
    assert numbers(states[0]) == numbers(s)


@given(SEEDS)
def test_a_gear_that_changes_is_that_of_the_specification(seed):
    source = np.random.default_rng(seed)
    plants, states, changes, pasts = random_plant(source), random_state(source), np.zeros(1, CHANGE), np.zeros(1, PAST)
    for name in CHANGE.names:
        changes[name] = source.uniform(0.0, 1e-2, changes[name].shape)
    changes["thermal_constant_s"], changes["step_s"] = 100.0, 1e-3
    p, s, c, past = plain(plants[0]), plain(states[0]), plain(changes[0]), plain(pasts[0])
    of = CORE.pointer(plants, "plant"), CORE.pointer(states, "plant_state")
    change, gone = CORE.pointer(changes, "change"), CORE.pointer(pasts, "past")
    for _ in range(10):
        braked = bool(source.integers(0, 2))
        CORE.call.go_through(change, gone, *of, braked, PERIOD_S)
        CORE.call.put_error(change, gone, of[0])
        plant.go_through(c, past, p, s, braked, PERIOD_S)
        plant.put_error(c, past, p)
        assert numbers(pasts[0]) == numbers(past)
        assert numbers(plants[0]) == numbers(p)


def random_axes(source, robot):
    """The axes of a robot, with limits, switches, filters and a cancellation that act now and then."""
    axes = Axes(robot)
    for row in range(len(axes.numbers)):
        Cascade(source.uniform(5.0, 40.0), source.uniform(0.005, 0.1), source.uniform(0.0, 2.0)).write(axes.cascade_config[row])
        Notch(order=2).write(axes.notch_config[row, 0])
        Notch(order=1, mode=2, start_rps=2.0).write(axes.notch_config[row, 1])
        m = axes.motion[row]
        for name in ("cancel_a2_rad", "cancel_phi2_rad", "cancel_a4_rad", "cancel_phi4_rad", "cancel_a1_rad", "cancel_phi1_rad"):
            m[name] = source.uniform(0.0, 2e-3)
        m["cancel_inertia_kg_m2"], m["cancel_damping_nm_s_rad"] = 1e-5, 1e-4
        for name in ("home", "probe_1", "probe_2"):
            m[f"{name}_low_counts"], m[f"{name}_high_counts"] = np.sort(source.uniform(-20_000, 20_000, 2))
        m["negative_switch_counts"], m["positive_switch_counts"] = -15_000, 15_000
        m["profile_speed_rad_s"], m["profile_acceleration_rad_s2"], m["profile_deceleration_rad_s2"] = 25.0, 300.0, 250.0
        m["torque_slope_nm_s"], m["max_profile_speed_rad_s"], m["max_acceleration_rad_s2"] = 5.0, 20.0, 280.0
        m["following_window_rad"], m["following_periods"], m["max_speed_rad_s"] = 0.3, 60, 55.0
        m["low_counts"], m["high_counts"] = -60_000, 60_000
        m["position_window_rad"], m["position_window_periods"], m["velocity_window_rad_s"] = 1e-2, 5, 0.3
        m["velocity_window_periods"], m["velocity_threshold_rad_s"], m["velocity_threshold_periods"] = 5, 0.2, 5
        m["stop_deceleration_rad_s2"] = source.choice([80.0, math.inf])
        if row == 0:
            encoder = MotorEncoder(error_1_arcsec=40.0, phase_1_deg=30.0, error_2_arcsec=20.0, phase_2_deg=80.0, noise_counts=1.5)
            encoder.write(axes.rows["encoder"][row], 131_072, int(source.integers(0, 2**63)))
        if row == 1:
            change = axes.rows["change"][row]
            for name in CHANGE.names:
                change[name] = source.uniform(0.0, 1e-2, change[name].shape)
            change["a_rad"], change["thermal_constant_s"], change["step_s"], change["is_changing"] = 2e-4, 100.0, 1e-2, 1.0
        axes.open_brake(row, record.POSITION, 8)
    return axes


def wander(axes, spec, source, rounds):
    """Give both the same orders at random, and compare them after each interpolation period; returns the modes that acted."""
    pointer, count, seen = CORE.pointer(axes.rows, "axis"), len(axes.numbers), set()
    prepared = CORE.pointer(np.zeros(count, CORE.dtype("prepared")), "prepared")
    for _ in range(rounds):
        row = int(source.integers(0, count))
        m, s = axes.motion[row], spec[row].motion
        what = source.integers(0, 6)
        if what == 0 and m["mode"] != record.BRAKED:
            mode = int(source.choice(MODES))
            CORE.call.begin_mode(pointer + row, mode)
            motion.begin_mode(spec[row], mode)
        elif what == 1 and m["mode"] != record.BRAKED:
            deceleration = float(source.choice([60.0, 400.0, math.inf]))
            CORE.call.begin_stop(pointer + row, deceleration)
            motion.begin_stop(spec[row], deceleration)
        elif what == 2:
            values = {
                "target_counts": math.floor(source.uniform(-40_000, 40_000)), "target_speed_rad_s": source.uniform(-30.0, 30.0),
                "target_torque_nm": source.uniform(-0.3, 0.3), "torque_offset_nm": source.uniform(-0.05, 0.05), "trip": 0,
                "velocity_offset_rad_s": source.uniform(-1.0, 1.0), "cancel_mode": int(source.integers(0, 2)),
                "input_mask": int(source.choice([0, 31])), "edge_mask": int(source.choice([0, 0x7FF])), "edges": 0, "event": 0,
                "forced_inputs": int(source.choice([0, 4])), "extrapolation_periods": int(source.choice([0, 12])),
            }  # fmt: skip
            for name, value in values.items():
                m[name] = value
                setattr(s, name, m[name].item())
        else:
            target = float(m["target_counts"]) + math.floor(source.uniform(-400, 400) * source.choice([1.0, 1.0, 1.0, 100.0]))
            CORE.call.set_point(pointer + row, target, PERIOD_S)
            motion.set_point(spec[row], target, PERIOD_S)
        CORE.call.advance(8, PERIOD_S, SUBSTEPS, pointer, prepared, count, CORE.NULL)
        motion.advance(8, PERIOD_S, SUBSTEPS, spec)
        assert numbers(axes.rows) == numbers(spec)
        seen |= {int(mode) for mode in axes.motion["mode"]}
    return seen


@pytest.mark.ci
@given(SEEDS)
@settings(max_examples=12)
def test_the_control_period_is_that_of_the_specification_in_every_mode(seed):
    source = np.random.default_rng(seed)
    axes = random_axes(source, draw(int(source.integers(0, 1000)), kind="real", axes=1 + seed % 3))
    wander(axes, [plain(each) for each in axes.rows], source, 30)


@pytest.mark.parametrize("seed", range(3))
def test_axes_in_lock_step_move_as_each_does_alone_to_the_last_bit(seed):
    source = np.random.default_rng(seed)
    robots = [draw(seed, kind="real", axes=3), draw(seed + 1, kind="linear", axes=3)]
    together = np.concatenate([random_axes(source, each).rows for each in robots])
    alone, count, trace = together.copy(), len(together), np.zeros((8, len(together), 3))
    first, second = ((CORE.pointer(rows, "axis"), np.zeros(count, CORE.dtype("prepared"))) for rows in (together, alone))
    prepared, others = CORE.pointer(first[1], "prepared"), CORE.pointer(second[1], "prepared")
    for _ in range(60):
        row = int(source.integers(0, count))
        target, mode = int(source.integers(-3000, 3000)), int(source.choice(MODES))
        for pointer, _ in (first, second):
            CORE.call.set_point(pointer + row, target, PERIOD_S)
            CORE.call.begin_mode(pointer + (row + 1) % count, mode)
        CORE.call.advance(8, PERIOD_S, SUBSTEPS, first[0], prepared, count, CORE.pointer(trace))
        for each in range(count):
            CORE.call.advance(8, PERIOD_S, SUBSTEPS, second[0] + each, others + each, 1, CORE.NULL)
        assert numbers(together) == numbers(alone)
        assert trace[-1, :, 2].tolist() == alone["plant_state"]["arm_acceleration_rad_s2"].tolist()


@pytest.mark.slow
def test_the_control_period_is_that_of_the_specification_over_a_hundred_thousand_steps_of_the_solver():
    source = np.random.default_rng(7)
    axes = random_axes(source, load_robot("reference"))
    seen = wander(axes, [plain(each) for each in axes.rows], source, 1050)  # 1,050 · 8 periods · 4 sub-steps · 3 axes
    assert seen == {*MODES, record.STOPPING}


@pytest.mark.parametrize("seed", range(3))
def test_the_links_of_an_arm_are_those_of_the_specification(seed):
    source = np.random.default_rng(seed)
    count = 2 + seed
    links = np.zeros(count + 1, LINK)
    links[0]["frame"] = np.eye(3)
    links[0]["acceleration"][3:] = 0.0, 0.0, 9.81
    for link in links[1:]:
        turn, _ = np.linalg.qr(source.standard_normal((3, 3)))
        link["turn"], link["origin"], link["mass_kg"] = turn, source.uniform(-0.5, 0.5, 3), source.uniform(0.5, 5.0)
        link["centre"], link["inertia"] = source.uniform(-0.2, 0.2, 3), np.diag(source.uniform(0.01, 0.1, 3))
    spec, joints = [plain(each) for each in links], source.uniform(-1.0, 1.0, (4, count))
    for each, record_of in zip(spec, links, strict=True):
        each.frame, each.body = record_of["frame"].copy(), record_of["body"].copy()
    theirs, tool, moved = joints.copy(), source.uniform(-1.0, 1.0, (4, 3)), np.zeros((4, 3))
    expected = moved.copy()
    pointer = CORE.pointer(links, "link")
    CORE.call.accelerations(pointer, count, CORE.pointer(joints))
    arm.accelerations(spec, theirs)
    assert np.array_equal(joints, theirs)
    CORE.call.tool_motion(pointer, count, CORE.pointer(tool), CORE.pointer(moved))
    arm.tool_motion(spec, count, tool, expected)
    assert np.array_equal(moved, expected)
    CORE.call.holding_torques(pointer, count, CORE.pointer(joints))
    arm.holding_torques(spec, theirs)
    assert np.array_equal(joints, theirs)


def test_an_arm_on_elastic_joints_is_that_of_the_specification(arm_robot):
    axes = Axes(arm_robot)
    source, moving = np.random.default_rng(3), axes.arm
    constants = [plain(each) for each in moving.joints]
    links = [plain(each) for each in moving.links]
    count = len(constants)
    near, drive, turning = [plant.grid_point(each) for each in constants], np.zeros((2, count)), np.zeros((4, count))
    stages, state = np.zeros((4, count, 6)), [axes.plant_state[row] for row in moving.order]
    for i in range(count):
        stages[0, i, 0], stages[0, i, 2] = state[i]["motor_angle_rad"], state[i]["arm_angle_rad"]
    torques = source.uniform(-0.2, 0.2, (40, count))
    for row in moving.order:
        axes.open_brake(row, record.TORQUE)
        axes.motion[row]["torque_low_nm"], axes.motion[row]["torque_high_nm"] = -9.0, 9.0
    for each in torques:
        for i, row in enumerate(moving.order):
            axes.motion[row]["target_torque_nm"] = each[i]
        axes.advance(1)
        drive[0] = each
        arm.flexible_period(constants, links, near, drive, turning, stages, PERIOD_S, axes.robot.plant_substeps)
        found = [[float(one[name]) for name in PLANT_STATE.names[:6]] for one in state]
        assert np.array_equal(found, stages[0])


ANY = st.one_of(st.sampled_from([0.0, math.nan, math.inf, -math.inf, 5e-324, 1.8e308, -9.3e18]), st.floats())


@pytest.mark.ci
@given(st.lists(ANY, min_size=6, max_size=6), st.lists(ANY, min_size=5, max_size=5), st.sampled_from(MODES), SEEDS)
@settings(max_examples=100)
def test_any_number_goes_through_the_control_period(state, given_to, mode, seed):
    axes = random_axes(np.random.default_rng(seed), load_robot("reference"))
    for name, value in zip(PLANT_STATE.names[:6], state, strict=True):
        axes.plant_state[0][name] = value
    names = ("target_counts", "target_speed_rad_s", "target_torque_nm", "velocity_offset_rad_s", "counts_per_rad")
    for name, value in zip(names, given_to, strict=True):
        axes.motion[0][name] = value
    CORE.call.begin_mode(CORE.pointer(axes.rows, "axis"), mode)
    axes.motion["input_mask"] = 31
    axes.advance(4)
    axes.stop(0, math.inf)
    axes.advance(4)


@pytest.fixture
def arm_robot():
    from plant_emulator import robots  # noqa: PLC0415

    return load_robot(f"{robots.__path__[0]}/reference_arm.toml")
