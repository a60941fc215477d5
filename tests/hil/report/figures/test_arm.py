"""The arm in the report: drawn where it was, its error as large as stated, modes only where they are known."""

import itertools
import math
import re
from pathlib import Path

import numpy as np
import pytest

from hil.arm.kinematics import Kinematics
from hil.bench.bench import Bench, load_bench
from hil.bench.model import IdentifiedArm
from hil.bench.tip import joint_angles
from hil.experiments.motions import LINE_MOTION, line_motion
from hil.experiments.plan import Experiment, entries
from hil.master.motion import RunResult
from hil.recording import TIP, Recording
from hil.report import style
from hil.report.arm_motion import moved_arms
from hil.report.figures import arm_along_line, arm_swinging
from hil.report.material import Material
from hil.results.base import MeasuredBench
from hil.results.runs import ExperimentsResult
from plant_emulator.robots.robot import load_robot
from tests.hil.report.figures.test_figures import words
from tests.oracles.links import link_masses

BENCH = load_bench("reference-arm")
DIRECTION = np.array([0.6, 0.0, 0.8])
HZ, ACROSS_HZ = 10.0, 16.0
SHAKING_MM, ACROSS_MM = 0.06, 0.02


def recorded(bench: Bench, fraction: float) -> Recording:
    """The line of the bench, and a tip that swings at 10 Hz in the arm's plane and at 16 Hz across it."""
    motion = line_motion(bench, 0.002)
    columns = {"time_s": motion.time_s}
    for column, number in enumerate(motion.axes):
        columns[f"axis{number}_position_rad"] = motion.motor_angle_rad[:, column]
    time = motion.time_s
    shaking = np.zeros((len(time), 3))
    for hz, size_mm, direction in ((HZ, SHAKING_MM, DIRECTION), (ACROSS_HZ, ACROSS_MM, np.array([0.0, 1.0, 0.0]))):
        swinging = -1e-3 * fraction * size_mm * (2.0 * math.pi * hz) ** 2 * np.sin(2.0 * math.pi * hz * time)
        shaking += swinging[:, np.newaxis] * direction
    columns.update({name: shaking[:, place] for place, name in enumerate(TIP)})
    columns["missing"] = np.zeros(len(time))
    return Recording(columns)


def material(folder: Path, bench: Bench = BENCH, treatments=(("none", 1.0), ("cancellation-learnt", 0.1))) -> Material:
    """A directory of runs of the line, each with a tip that swings by a fraction."""
    runs = []
    for treatment, fraction in treatments:
        recording = recorded(bench, fraction)
        recording.save(folder / f"{treatment}.csv")
        result = RunResult(recording, len(recording.time_s), 0, 0, 1.0, 3.0, 250e-6, None)
        runs += entries(bench, Experiment(LINE_MOTION, None, treatment), result, f"{treatment}.csv")
    described = MeasuredBench(
        name=bench.name,
        bus="local:/tmp/robot.sock",
        clock="lock-step",
        started_utc="2025-01-01T12:00:00Z",
        versions={},
        file=bench,
    )
    ExperimentsResult(bench=described, runs=runs, emulated=True).write(folder / "result.json")
    return Material(folder)


@pytest.fixture(scope="module")
def known(tmp_path_factory) -> Material:
    return material(tmp_path_factory.mktemp("arm"))


def drawn(figure_of, material: Material):
    """A drawing and its matplotlib figure, laid out."""
    figures, original = [], style.to_svg
    with pytest.MonkeyPatch.context() as patch, style.styled():
        patch.setattr(style, "to_svg", lambda figure, key, **options: figures.append(figure) or original(figure, key))
        drawing = figure_of(material)
        for figure in figures:
            figure.draw_without_rendering()
    return drawing, figures[0] if figures else None


@pytest.fixture(scope="module")
def along(known):
    return drawn(arm_along_line.arm_along_line, known)


@pytest.fixture(scope="module")
def swinging(known):
    return drawn(arm_swinging.arm_swinging, known)


def with_masses(bench: Bench = BENCH) -> Bench:
    """The bench with the links' masses, and the stiffness of the gears that the line moves."""
    robot = load_robot("reference-arm")
    stiffness = {number: robot.axis[number].gear_stiffness_nm_rad for number in (2, 3, 5)}
    axes = {
        number: table.model_copy(update={"gear_stiffness_nm_rad": stiffness.get(number)}) for number, table in bench.axis.items()
    }
    return bench.model_copy(update={"arm": robot.arm, "axis": axes})


def panel(figure, ylabel: str):
    return next(axes for axes in figure.axes if axes.get_ylabel() == ylabel)


def lines(axes, label: str):
    """Every line in the look of the one with a label."""
    first = next(line for line in axes.get_lines() if str(line.get_label()).startswith(label))
    return [line for line in axes.get_lines() if line.get_color() == first.get_color() and line.get_lw() == first.get_lw()]


@pytest.mark.ci
def test_the_arm_stands_where_its_motors_were_and_its_tip_on_the_line(known, along):
    _, figure = along
    run = known.result.runs[0]
    recording = known.recording(run)
    arm = Kinematics.of(BENCH.arm)
    angles = joint_angles(BENCH, recording)[[0, -1]]
    for title, column in (("From the side", [0, 2]), ("From above", [0, 1])):
        axes = next(each for each in figure.axes if each.get_title(loc="left") == title)
        shown = [np.column_stack(line.get_data()) for line in axes.get_lines()]
        for skeleton in arm.skeleton(angles)[..., column]:
            assert any(line.shape == skeleton.shape and np.allclose(line, skeleton, atol=1e-9) for line in shown), title
        path = np.column_stack(lines(axes, "path of the tip")[0].get_data())
        wanted = np.array([[BENCH.line_motion.start_m.x, BENCH.line_motion.start_m.z]])
        if title == "From the side":
            np.testing.assert_allclose(path[:1], wanted, atol=1e-6)
        assert axes.get_aspect() == 1.0


def test_the_error_is_as_many_times_as_large_as_the_title_says_and_around_its_point_of_the_path(known, along):
    drawing, figure = along
    magnification = float(re.search(r"error drawn ([\d.]+) times", drawing.title)[1])
    assert f"{magnification:g} times as large" in drawing.caption
    first = moved_arms(known)[0]
    upwards, sideways = panel(figure, "Upwards (mm)"), panel(figure, "Sideways (mm)")
    shown = np.concatenate([np.column_stack(line.get_data()) for line in lines(upwards, "no treatment")])
    inside = first.moved_mm[first.judged]  # the line goes along x
    np.testing.assert_allclose(shown[:, 1], inside[:, 2], atol=1e-9)
    count = len(lines(upwards, "no treatment"))
    way = 1e3 * (first.tip_m[first.judged][:, 0] - first.tip_m[0, 0])
    middles = np.concatenate([np.full(len(each), np.mean(each)) for each in np.array_split(way, count)])
    np.testing.assert_allclose((shown[:, 0] - middles) / magnification, inside[:, 0], atol=1e-6)
    across = np.concatenate([line.get_ydata() for line in lines(sideways, "no treatment")])
    np.testing.assert_allclose(np.abs(across), np.abs(inside[:, 1]), atol=1e-9)
    assert np.max(np.abs(shown[:, 1])) == pytest.approx(0.8 * SHAKING_MM, rel=0.05)
    for axes in (upwards, sideways):
        assert axes.get_aspect() == magnification  # a circle is one on paper
        rings = lines(axes, "specification")
        assert len(rings) == count
        for ring in rings:
            x, y = ring.get_data()
            np.testing.assert_allclose(np.hypot((x - np.mean(x[:-1])) / magnification, y), 0.05, rtol=1e-6)
        widest = [line.get_xdata() for line in lines(axes, "no treatment")]
        assert all(np.max(one) < np.min(other) for one, other in itertools.pairwise(widest))


@pytest.mark.ci
def test_the_tip_is_seen_to_draw_its_line_at_each_resonance_before_and_after(known, swinging):
    drawing, figure = swinging
    titles = [axes.get_title(loc="left") for axes in figure.axes if " Hz: " in axes.get_title(loc="left")]
    assert [float(title.split()[0]) for title in titles] == pytest.approx([HZ, ACROSS_HZ], abs=0.2)
    for title, size in zip(titles, (SHAKING_MM, ACROSS_MM), strict=True):
        before, after = map(float, re.search(r": ([\d.]+) → ([\d.]+) mm", title).groups())
        assert before == pytest.approx(size, rel=0.05)
        assert after == pytest.approx(0.1 * size, rel=0.06, abs=1e-4)
    names = [(axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes if " Hz: " in axes.get_title(loc="left")]
    assert names == [("x (m)", "z (m)"), ("x (m)", "y (m)")]  # what goes across the arm is seen from above
    assert "along (0.60, 0.00, 0.80)" in drawing.caption
    assert "along (0.00, 1.00, 0.00)" in drawing.caption
    assert "The arm's modes are not drawn" in drawing.caption
    assert drawing.origin == "measured"


@pytest.mark.ci
def test_where_masses_and_stiffness_are_known_the_modes_are_drawn_and_said_to_be_computed(tmp_path):
    drawing, figure = drawn(arm_swinging.arm_swinging, material(tmp_path, with_masses()))
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    found = [float(re.search(r"Mode at ([\d.]+) Hz, computed", title)[1]) for title in titles if title.startswith("Mode")]
    assert found[0] < 10.5  # 10.44 Hz at the line's start, less as the arm stretches
    assert found[1] > 14.7
    assert len(found) == 3
    assert drawing.origin == "measured and computed"
    assert "axes 1, 4, 6, whose stiffness is not known, count as rigid" in drawing.caption
    half = with_masses().model_copy(update={"axis": {**with_masses().axis, 5: BENCH.axis[5]}})  # a gear that moves, unknown
    without = with_masses().model_copy(update={"arm": BENCH.arm})
    for bench in (half, without, BENCH.model_copy(update={"arm": None})):
        assert arm_swinging.known_modes(bench, None, BENCH.arm.home_rad(), (2, 3, 5)) is None


@pytest.mark.ci
def test_modes_are_drawn_by_masses_that_were_identified_and_said_to_be(tmp_path):
    """θ of the true bodies, as a model file has it: the same modes as by the bodies themselves."""
    robot, moving = load_robot("reference-arm"), (2, 3, 5)
    known = IdentifiedArm(
        axes=moving, joints_deg=robot.arm.home_deg, masses=tuple(link_masses(robot.arm).tolist()),
        stiffness_nm_rad=tuple(robot.axis[axis].gear_stiffness_nm_rad for axis in moving), standard_error_nm_rad=(0.0,) * 3,
        misfit=1.0, postures=3,
    )  # fmt: skip
    posture = robot.arm.home_rad()
    found = arm_swinging.known_modes(BENCH, known, posture, moving)
    bodies = arm_swinging.known_modes(with_masses(), None, posture, moving)
    assert found.rigid == bodies.rigid == (1, 4, 6)
    for one, other in zip(found.shapes, bodies.shapes, strict=True):
        assert one.frequency_hz == pytest.approx(other.frequency_hz, rel=1e-9)
        assert abs(one.tip_m @ other.tip_m) == pytest.approx(1.0)
    assert [mode.frequency_hz for mode in found.shapes] == pytest.approx([10.44, 14.73, 36.00], abs=0.01)
    assert arm_swinging.known_modes(BENCH, known, posture, (1, 2, 3)) is None
    other = known.model_copy(update={"masses": known.masses[:30]})  # of another arm
    assert arm_swinging.known_modes(BENCH, other, posture, moving) is None
    made = material(tmp_path)
    made.result.arm = known
    drawing, _ = drawn(arm_swinging.arm_swinging, made)
    assert "identified in 3 postures" in drawing.caption
    assert drawing.origin == "measured and computed"


def test_of_several_treatments_the_one_that_leaves_least_stands_beside_nothing(tmp_path):
    made = material(tmp_path, treatments=(("notch", 0.6), ("none", 1.0), ("cancellation-learnt", 0.1)))
    assert [moved.run.entry.treatment for moved in moved_arms(made)] == ["none", "cancellation-learnt"]


@pytest.mark.ci
def test_a_single_run_is_drawn_alone(tmp_path):
    made = material(tmp_path, treatments=(("notch", 0.6),))
    drawing, figure = drawn(arm_along_line.arm_along_line, made)
    assert [moved.run.entry.treatment for moved in moved_arms(made)] == ["notch"]
    assert lines(panel(figure, "Upwards (mm)"), "notch")
    assert drawing is not None


@pytest.mark.ci
def test_of_a_line_upwards_both_directions_across_it_are_shown_and_named(tmp_path):
    start = BENCH.line_motion.start_m
    motion = BENCH.line_motion.model_copy(update={"end_m": start.model_copy(update={"z": start.z + 0.15})})
    made = material(tmp_path, BENCH.model_copy(update={"line_motion": motion}))
    _, figure = drawn(arm_along_line.arm_along_line, made)
    first = moved_arms(made)[0]
    inside = first.moved_mm[first.judged]
    for name, column in (("Forwards (mm)", 0), ("Sideways (mm)", 1)):
        shown = np.concatenate([line.get_ydata() for line in lines(panel(figure, name), "no treatment")])
        np.testing.assert_allclose(np.abs(shown), np.abs(inside[:, column]), atol=1e-6)


@pytest.mark.ci
def test_a_line_that_goes_nowhere_has_no_path_along_which_an_error_could_be_drawn(tmp_path):
    motion = BENCH.line_motion.model_copy(
        update={"end_m": BENCH.line_motion.start_m.model_copy(update={"x": 0.51}), "duration_s": 2.2}
    )
    drawing, figure = drawn(arm_along_line.arm_along_line, material(tmp_path, BENCH.model_copy(update={"line_motion": motion})))
    assert drawing.title == "The arm along its line"
    assert len(figure.axes) == 3


@pytest.mark.ci
def test_an_arm_that_is_not_judged_is_drawn_along_its_line_all_the_same(tmp_path):
    """Nobody knows at which frequencies it rings: where it was is known."""
    unknown = BENCH.model_copy(update={"specification": BENCH.specification.model_copy(update={"band_hz": None})})
    made = material(tmp_path, unknown)
    assert [run.tip_peak_mm for run in made.result.runs] == [None, None]
    drawing, figure = drawn(arm_along_line.arm_along_line, made)
    assert drawing.title == "The arm along its line"
    assert len(figure.axes) == 3
    assert arm_swinging.arm_swinging(made) is None


@pytest.mark.parametrize("figure_of", [arm_along_line.arm_along_line, arm_swinging.arm_swinging])
def test_without_an_arm_there_is_nothing_to_draw(known, figure_of):
    made = Material(known.directory)
    made.bench = BENCH.model_copy(update={"arm": None})
    assert figure_of(made) is None


@pytest.mark.parametrize("name", ["along", "swinging"])
def test_nothing_lies_on_something_else_and_every_axis_is_named(name, request):
    _, figure = request.getfixturevalue(name)
    found = list(words(figure))
    for number, (first, box) in enumerate(found):
        assert box.x0 >= -1, first
        assert box.x1 <= figure.bbox.width + 1, first
        assert box.y0 >= -1, first
        assert box.y1 <= figure.bbox.height + 1, first
        for second, other in found[number + 1 :]:
            apart = box.x1 <= other.x0 + 1 or other.x1 <= box.x0 + 1 or box.y1 <= other.y0 + 1 or other.y1 <= box.y0 + 1
            assert apart, f"{first!r} lies on {second!r}"
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            shown = axes.axison and any(label.get_visible() and label.get_text() for label in axis.get_ticklabels())
            shared = axes.get_xlabel() == "" and axis is axes.xaxis  # the panel below has the name
            assert not shown or shared or re.search(r"\([^()]+\)$", axis.get_label().get_text())
