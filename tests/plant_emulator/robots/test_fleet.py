"""The fleet: robots drawn by seed, within the stated ranges, and their blank bench files."""

import math

import pytest

from drive_profiles.address import parse_address
from drive_profiles.files.toml import loads
from hil.bench.bench import Bench
from hil.plan.check import check
from plant_emulator.motion.axes import Axes
from plant_emulator.robots.blank_bench import TABLE_3, blank_bench, file_text
from plant_emulator.robots.fleet import RANGES, REAL_HYSTERESIS_NM, antiresonance_hz, draw
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.trials.distributions import Even

SEEDS = range(200)


def test_equal_seeds_draw_equal_robots_and_others_draw_others() -> None:
    assert draw(5) == draw(5)
    assert draw(5).axis[2].reduction_ratio != draw(6).axis[2].reduction_ratio or draw(5).axis != draw(6).axis


def test_every_drawn_robot_is_within_the_ranges() -> None:
    for seed in SEEDS:
        robot = draw(seed)
        axis = robot.axis[2]
        ratio = axis.arm_inertia_kg_m2 / (axis.reduction_ratio**2 * axis.motor_inertia_kg_m2)
        assert RANGES["reduction_ratio"][0] <= axis.reduction_ratio <= RANGES["reduction_ratio"][1]
        assert 0.999 * RANGES["antiresonance_hz"][0] <= antiresonance_hz(axis) <= 1.001 * RANGES["antiresonance_hz"][1]
        assert 0.999 * RANGES["inertia_ratio"][0] <= ratio <= 1.001 * RANGES["inertia_ratio"][1]
        assert RANGES["a2"][0] <= axis.ate.a2_arcsec <= RANGES["a2"][1]
        assert RANGES["encoder_bits"][0] <= math.log2(axis.encoder_counts_per_rev) <= RANGES["encoder_bits"][1]
        assert axis.static_friction_nm >= axis.coulomb_friction_nm
        assert robot.sync_period_s in RANGES["sync_period_s"].values
        assert robot.bus.bitrate in RANGES["bitrate"].values


def test_the_ranges_are_filled() -> None:
    found = sorted(antiresonance_hz(draw(seed).axis[2]) for seed in SEEDS)
    assert found[0] < 4.5
    assert found[-1] > 26.0
    assert {draw(seed).sync_period_s for seed in SEEDS} == set(RANGES["sync_period_s"].values)


def test_a_quantity_with_another_range_shifts_no_other_quantity() -> None:
    other = draw(3, {**RANGES, "a2": Even(0.0, 1.0)})
    mine = draw(3)
    assert other.axis[2].ate.a2_arcsec != mine.axis[2].ate.a2_arcsec
    assert other.axis[2].model_copy(update={"ate": mine.axis[2].ate}) == mine.axis[2]
    assert other.accelerometer == mine.accelerometer


@pytest.mark.ci
def test_the_kinds_differ_in_gear_and_current_loop_alone() -> None:
    for seed in SEEDS:
        linear, real, any_kind = (draw(seed, kind=kind).axis[2] for kind in ("linear", "real", "any"))
        assert (linear.hysteresis_torque_nm, linear.wind_up_softness, linear.current_time_constant_s) == (0.0, 0.0, 0.0)
        assert real.hysteresis_torque_nm <= REAL_HYSTERESIS_NM
        unlike = {"hysteresis_torque_nm", "wind_up_softness", "current_time_constant_s"}
        assert linear.model_dump(exclude=unlike) == real.model_dump(exclude=unlike) == any_kind.model_dump(exclude=unlike)


def test_the_second_axis_does_not_change_the_first() -> None:
    assert draw(4, axes=3).axis[2] == draw(4).axis[2]
    assert sorted(draw(4, axes=3).axis) == [2, 3, 5]


@pytest.mark.parametrize(("seed", "axes", "words"), [(-1, 1, "seed -1"), (1, 0, "0 axes"), (1, 4, "4 axes")])
def test_a_stable_refuses_what_it_cannot_draw(seed: int, axes: int, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        draw(seed, axes=axes)


@pytest.mark.parametrize("kind", ["linear", "real", "any"])
def test_a_blank_bench_file_is_valid_and_knows_nothing_of_plant_and_error(kind: str) -> None:
    for seed in range(40):
        robot = draw(seed, kind=kind)
        bench = loads(blank_bench(robot), Bench)
        table, axis = bench.axis[2], robot.axis[2]
        assert table.model is None
        assert (table.reduction_ratio, table.tip_lever_m) == (axis.reduction_ratio, axis.tip_lever_m)
        assert table.limits.torque_nm == axis.torque_limit_nm
        assert table.notch[0].model_dump(include=set(TABLE_3)) == TABLE_3
        assert bench.bus.address == str(parse_address(f"local:/tmp/robot.sock@{robot.bus.bitrate}")), "spelt as all commands do"


def test_the_motion_of_a_blank_bench_file_keeps_its_limits() -> None:
    for seed in SEEDS:
        bench = loads(blank_bench(draw(seed)), Bench)
        motion, limits = bench.constant_acceleration, bench.axis[2].limits
        assert motion is not None
        assert motion.end_rps <= limits.speed_rps
        assert limits.acceleration_rps_s is not None
        assert max(motion.acceleration_rps_s, motion.deceleration_rps_s) <= limits.acceleration_rps_s
        distance = 0.5 * motion.end_rps**2 * (1.0 / motion.acceleration_rps_s + 1.0 / motion.deceleration_rps_s)
        assert distance <= limits.position_max_rev


def test_a_drawn_robot_stands_still_behind_its_brakes() -> None:
    for seed in range(10):
        axes = Axes(draw(seed))
        axes.advance(400)
        assert abs(float(axes.plant_state[0]["arm_acceleration_rad_s2"])) < 1e-3


def test_a_written_robot_file_reads_as_the_same_robot() -> None:
    for seed in range(20):
        robot = draw(seed, axes=1 + seed % 3)
        assert loads(file_text(robot), Robot) == robot
    reference = load_robot("reference")
    assert loads(file_text(reference), Robot) == reference


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_the_bus_of_every_drawn_robot_carries_its_cycle(axes: int) -> None:
    for seed in range(24):
        robot = draw(seed, axes=axes)
        bench = loads(blank_bench(robot), Bench)
        verdict = check(bench, tuple(bench.axis), "drive", robot.sync_period_s, with_notch=True, notch_state=False)
        assert verdict.fits is not False, verdict.sentence
