"""What is compared with what: plans, reasons for what is left out, the table, and what becomes of robots that fail."""

from types import SimpleNamespace

import pytest

from drive_profiles.address import parse_address
from hil.bench.bench import load_bench
from hil.bench.design import DesignedAxis, Designs
from hil.bench.model import Identified
from hil.cli import console
from hil.errors import NodeError, NotPossibleError, SafetyStopError, UnsafeRequestError
from hil.experiments.cancellation.cancellation import cancellation_for
from hil.experiments.comparison import run as module
from hil.experiments.comparison.plan import ComparisonRequest, KnownRobot, knowledge_by_robot, plan
from hil.experiments.comparison.run import compare
from hil.experiments.comparison.table import gathered
from hil.experiments.plan import Experiment, comparisons
from hil.experiments.runner import ExperimentsOutcome
from hil.experiments.treatment import TREATMENTS, Knowledge
from hil.results.comparison import ComparisonResult
from hil.results.files import load_result
from hil.results.runs import CancellationTrial, ExperimentsResult
from tests.hil.results.made import measured_bench, run_entry

BENCH = load_bench("reference")
IDEAL = SimpleNamespace(address=parse_address("local:/tmp/robot.sock"))
MBIT = SimpleNamespace(address=parse_address("local:/tmp/robot.sock@1M"))
RAMP, LINE = "constant-acceleration", "line-motion"


def unknown(bench=BENCH):
    return bench.model_copy(update={"axis": {n: t.model_copy(update={"model": None}) for n, t in bench.axis.items()}})


def designs(*axes):
    table = DesignedAxis(
        notch=BENCH.axis[2].notch, sensitivity_peak=1.5, phase_margin_deg=40.0, gain_margin_db=10.0, period_s=250e-6
    )
    return Designs(robot="reference", axis=dict.fromkeys(axes, table))


def reasons(made):
    return {(left.experiment.axis, left.experiment.treatment): left.reason for left in made.left_out}


@pytest.mark.slow
def test_all_that_the_files_allow_is_planned_and_the_rest_has_its_reason():
    made = plan(KnownRobot(BENCH), ComparisonRequest(), channel=IDEAL)
    drive = {each.treatment for each in made.experiments if each.loop == "drive"}
    cancelled = {"cancellation", "cancellation+notch", "cancellation-inside"}
    assert drive == {"none", "low-gains", "notch", *cancelled}
    assert [each for each in made.experiments if each.loop == "host" and each.axis == 2] == [
        Experiment(RAMP, 2, "none", "host"), Experiment(RAMP, 2, "fixed-notch", "host"),
    ]  # fmt: skip
    assert {each.axis for each in made.experiments} == {2, 3, None}
    said = reasons(made)
    assert {way for _, way in said} == {"notch-designed", "cancellation-learnt"}
    assert "--design" in said[2, "notch-designed"]
    assert "--learnt" in said[None, "cancellation-learnt"]


def test_a_cancellation_that_follows_is_run_where_it_is_named():
    asked = ComparisonRequest((RAMP,), (2,), ("cancellation", "cancellation-following"), frozenset({"cancellation-following"}))
    made = plan(KnownRobot(BENCH), asked, channel=IDEAL)
    assert [each.treatment for each in made.experiments] == ["none", "cancellation", "cancellation-following"]


@pytest.mark.slow
def test_what_the_host_closes_comes_last():
    places = [each.loop for each in plan(KnownRobot(BENCH), ComparisonRequest(), channel=IDEAL).experiments]
    assert places == sorted(places)


def test_without_a_model_neither_cancellation_nor_a_fixed_notch():
    made = plan(KnownRobot(unknown()), ComparisonRequest((RAMP,), (3,)), channel=IDEAL)
    assert [each.treatment for each in made.experiments] == ["none", "low-gains", "notch"]
    said = reasons(made)
    assert "hil identify" in said[3, "cancellation"]
    assert "hil identify plant" in said[3, "fixed-notch"]


def test_a_bus_that_does_not_carry_the_loop_leaves_the_fixed_notch_out_and_its_reference():
    made = plan(KnownRobot(BENCH), ComparisonRequest((RAMP,), (2,), ("none", "notch", "fixed-notch")), channel=MBIT)
    assert [(each.treatment, each.loop) for each in made.experiments] == [("none", "drive"), ("notch", "drive")]
    assert "--overload" in reasons(made)[2, "fixed-notch"]
    assert len(made.left_out) == 1
    forced = plan(KnownRobot(BENCH), ComparisonRequest((RAMP,), (2,), ("fixed-notch",)), channel=MBIT, overload=True)
    assert [each.loop for each in forced.experiments] == ["host", "host"]


def test_a_host_closed_loop_at_the_edge_is_left_out():
    slow = BENCH.model_copy(update={"bus": BENCH.bus.model_copy(update={"host_sync_period_s": 0.008})})
    made = plan(KnownRobot(slow), ComparisonRequest((RAMP,), (2,), ("notch", "fixed-notch")), channel=IDEAL)
    assert "axis 2 closed over the bus at 8 ms" in reasons(made)[2, "fixed-notch"]


def test_a_design_of_another_axis_is_not_taken_for_this_one():
    made = plan(
        KnownRobot(BENCH, Knowledge(designs=designs(2))),
        ComparisonRequest((RAMP, LINE), (2, 3), ("notch-designed",)),
        channel=IDEAL,
    )
    assert {each.axis for each in made.experiments} == {2, None}
    assert reasons(made)[3, "notch-designed"] == "notch-designed: the design file has no filter for axis 3"


def test_an_axis_without_a_notch_has_none_to_compare():
    with pytest.raises(NotPossibleError, match=r"nothing to compare: notch: the bench file has no notch for axis 5"):
        plan(KnownRobot(BENCH), ComparisonRequest((RAMP,), (5,), ("notch",)), channel=IDEAL)


def test_a_robot_without_the_motion_is_said_to_have_none():
    bench = BENCH.model_copy(update={"line_motion": None})
    made = plan(KnownRobot(bench), ComparisonRequest((RAMP, LINE), (2,), ("notch",)), channel=IDEAL)
    assert "line_motion" in reasons(made)[None, "notch"]


def test_files_are_sorted_by_their_robot():
    mine, other = Identified(robot="reference"), Identified(robot="other")
    found = knowledge_by_robot([mine], [designs(2)], [], ["reference"])
    assert found["reference"].identified is mine
    assert found["reference"].learnt is None
    with pytest.raises(NotPossibleError, match="'other'"):
        knowledge_by_robot([other], [], [], ["reference"])
    with pytest.raises(NotPossibleError, match="two files"):
        knowledge_by_robot([mine, mine], [], [], ["reference"])
    with pytest.raises(NotPossibleError, match="the model file is of robot 'other'"):
        plan(KnownRobot(BENCH, Knowledge(identified=other)), ComparisonRequest(), channel=IDEAL)


def test_every_treatment_of_hil_run_can_be_compared():
    assert ComparisonRequest().treatments == TREATMENTS


# -- gathering, with runs that are made up ---------------------------------------------------------------------------------


def trial(*, is_good):
    return CancellationTrial(before_m_s2=0.1, gain=0.3, is_good=is_good, trials=())


def entry(experiment, **changes):
    peak = {"none": 0.075, "notch": 0.045, "cancellation": 0.003}.get(experiment.treatment, 0.06)
    values = {
        "experiment": experiment.name, "axis": experiment.axis, "loop": experiment.loop, "tip_peak_mm": peak,
        "spectrum_area": 10.0 * peak, "recording": f"runs/{experiment.file_name}",
    }  # fmt: skip
    return run_entry(experiment.treatment, **(values | changes))


@pytest.fixture
def runner(monkeypatch):
    """`run_experiments` without a bus; `changes` by treatment, `ends` by directory, after `count` runs where it is given."""
    made = SimpleNamespace(changes={}, ends={}, count=None, called=[])

    def run(bench, experiments, out, **options):
        del options
        made.called.append(out.name)
        end = made.ends.get(out.name)
        if isinstance(end, Exception) and not isinstance(end, SafetyStopError) and made.count is None:
            raise end
        runs = [entry(each, **made.changes.get(each.treatment, {})) for each in experiments][: made.count]
        return ExperimentsOutcome(ExperimentsResult(bench=measured_bench(), runs=runs, comparisons=comparisons(runs)), end)

    monkeypatch.setattr(module, "run_experiments", run)
    return made


def rows_of(done, robot=0):
    return {row.treatment: row for row in done.result.robots[robot].rows}


SELECTION = ComparisonRequest((RAMP,), (2,), ("low-gains", "notch", "cancellation", "cancellation-learnt"))


def test_the_table_has_changes_trials_costs_and_reasons(runner, tmp_path, capsys):
    runner.changes["cancellation"] = {"trial": trial(is_good=True)}
    done = compare([plan(KnownRobot(BENCH), SELECTION, channel=IDEAL)], SELECTION, tmp_path)
    rows = rows_of(done)
    assert rows["none"].tip_peak_change_pct is None
    assert rows["notch"].tip_peak_change_pct == pytest.approx(-40.0)
    assert rows["cancellation"].trial == "accepted"
    assert (rows["cancellation"].compliance.slow, rows["cancellation"].compliance.peak) == (1.0, 1.0)
    assert rows["low-gains"].compliance.slow == pytest.approx(3.7, abs=0.1)
    assert rows["cancellation-learnt"].left_out
    assert done.unmet == []  # nobody has asked for it by name
    assert {each.treatment for each in done.result.robots[0].compliance} == {"none", "low-gains", "notch"}
    assert done.result == load_result(tmp_path, ComparisonResult, "a comparison")
    console.show_comparison(done.result)
    said = capsys.readouterr().out
    assert "Runs left out or not judged" in said
    assert "× 3.70" in said


def test_the_area_and_its_change_are_those_of_one_window():
    """The worst window of a treated run may be another one than that of the untreated run."""
    peaks = {"none": {1: (0.7, 1.0), 2: (0.6, 1.2)}, "notch": {1: (0.6, 0.9), 2: (0.7, 1.3)}}
    windows = [
        entry(Experiment(RAMP, 2, treatment), order=order, tip_peak_mm=peak, spectrum_area=area)
        for treatment, of in peaks.items()
        for order, (peak, area) in of.items()
    ]
    result = ExperimentsResult(bench=measured_bench(), runs=windows, comparisons=comparisons(windows))
    asked = ComparisonRequest((RAMP,), (2,), ("notch",))
    rows = {row.treatment: row for row in gathered(plan(KnownRobot(BENCH), asked, channel=IDEAL), "", result, "").rows}
    assert (rows["none"].tip_peak_mm, rows["notch"].tip_peak_mm) == (0.7, 0.7)
    assert (rows["none"].spectrum_area, rows["notch"].spectrum_area) == (1.0, 0.9)
    assert rows["notch"].spectrum_area_change_pct == pytest.approx(-10.0)


def test_a_line_names_its_axes_and_a_ramp_has_its_whole_peak(runner, tmp_path, capsys):
    runner.changes["notch"] = {"ramp_peak_mm": 0.145}
    asked = ComparisonRequest((RAMP, LINE), (2,), ("notch",))
    done = compare([plan(KnownRobot(BENCH), asked, channel=IDEAL)], asked, tmp_path)
    assert [row.ramp_peak_mm for row in done.result.robots[0].rows if row.treatment == "notch"] == [0.145, 0.145]
    console.show_comparison(done.result)
    assert "line motion of axes 2, 3 and 5\n" in capsys.readouterr().out


def test_what_was_asked_for_by_name_is_missed(runner, tmp_path):
    named = ComparisonRequest((RAMP,), (2,), ("notch", "cancellation-learnt"), frozenset({"notch", "cancellation-learnt"}))
    done = compare([plan(KnownRobot(BENCH), named, channel=IDEAL)], named, tmp_path)
    assert len(done.unmet) == 1
    assert done.unmet[0].startswith("reference, axis 2, cancellation-learnt: ")


def test_a_refused_cancellation_has_no_number_of_its_own(runner, tmp_path):
    runner.changes["cancellation"] = {"trial": trial(is_good=False), "invalid": "cancellation refused", "within_spec": False}
    done = compare([plan(KnownRobot(BENCH), SELECTION, channel=IDEAL)], SELECTION, tmp_path)
    row = rows_of(done)["cancellation"]
    assert (row.trial, row.tip_peak_mm, row.within_spec) == ("refused", None, None)
    assert row.not_judged == "cancellation refused"
    assert done.unmet == ["reference, axis 2, cancellation: cancellation refused"]


def two_robots():
    other = BENCH.model_copy(update={"name": "Other arm"})
    return [plan(KnownRobot(bench), SELECTION, channel=IDEAL) for bench in (BENCH, other, BENCH)]


def test_each_robot_has_a_directory_of_its_own(runner, tmp_path):
    done = compare(two_robots(), SELECTION, tmp_path)
    assert runner.called == ["reference", "other-arm", "reference-2"]
    assert [robot.directory for robot in done.result.robots] == runner.called


def test_a_robot_that_does_not_answer_leaves_the_others_to_be_run(runner, tmp_path):
    runner.ends["reference"] = NodeError(2, "no answer")
    done = compare(two_robots(), SELECTION, tmp_path)
    assert runner.called == ["reference", "other-arm", "reference-2"]
    assert done.failure is runner.ends["reference"]
    assert done.result.robots[0].ended == "node 2: no answer"
    assert rows_of(done)["notch"].not_judged == "node 2: no answer"
    assert rows_of(done, 1)["notch"].tip_peak_mm == 0.045


def test_runs_before_a_failure_are_in_the_table_and_the_others_say_why_they_are_not(runner, tmp_path):
    runner.ends["reference"], runner.count = NodeError(2, "no answer"), 2
    done = compare([plan(KnownRobot(BENCH), SELECTION, channel=IDEAL)], SELECTION, tmp_path)
    rows = rows_of(done)
    assert [rows[name].tip_peak_mm is None for name in ("none", "low-gains", "notch")] == [False, False, True]
    assert rows["notch"].not_judged == done.result.robots[0].ended == "node 2: no answer"
    assert done.failure is runner.ends["reference"]


def test_what_an_earlier_comparison_has_left_is_not_taken_for_this_one(runner, tmp_path):
    (tmp_path / "reference").mkdir()
    old = ExperimentsResult(bench=measured_bench(), runs=[entry(Experiment(RAMP, 2, "notch"))])
    old.write(tmp_path / "reference" / "result.json")
    runner.ends["reference"] = NodeError(2, "no answer")
    done = compare([plan(KnownRobot(BENCH), SELECTION, channel=IDEAL)], SELECTION, tmp_path)
    assert rows_of(done)["notch"].tip_peak_mm is None


def test_after_a_stop_nothing_else_is_moved(runner, tmp_path):
    runner.ends["reference"] = SafetyStopError("axis 2 left its limits")
    done = compare(two_robots(), SELECTION, tmp_path)
    assert runner.called == ["reference"]
    assert done.failure is runner.ends["reference"]
    assert "not run" in done.result.robots[1].ended
    assert done.result.robots[1].not_restored == ()


@pytest.mark.ci
def test_on_an_arm_filters_beside_a_cancellation_are_run_only_where_they_are_named():
    arm = load_bench("reference-arm")
    axes = {n: t.model_copy(update={"model": BENCH.axis[n].model}) if n in (2, 3) else t for n, t in arm.axis.items()}
    known = KnownRobot(arm.model_copy(update={"axis": axes}))
    made = plan(known, ComparisonRequest((RAMP,), (2,)), channel=IDEAL)
    assert {"cancellation", "notch"} <= {each.treatment for each in made.experiments}
    assert "cancellation+notch" not in {each.treatment for each in made.experiments}
    assert "leave more vibration than the cancellation alone" in reasons(made)[2, "cancellation+notch"]
    assert not made.remarks
    both = ("cancellation", "cancellation+notch")
    named = plan(known, ComparisonRequest((RAMP,), (2,), both, frozenset(both)), channel=IDEAL)
    assert {each.treatment for each in named.experiments} == {"none", *both}
    assert len(named.remarks) == 1
    assert "leave more vibration than the cancellation alone" in named.remarks[0]


@pytest.mark.ci
@pytest.mark.parametrize("treatment", ["cancellation", "cancellation+notch"])
def test_orders_that_would_be_too_fast_are_left_out_as_in_a_run_and_the_treatment_is_compared(treatment):
    """At 12 rev/s the set-points of order 4 would be faster than the axis may be: a run leaves the highest orders out there."""
    axis = BENCH.axis[2]
    error = axis.model.ate.model_copy(update={"a2_arcsec": 50.0, "a4_arcsec": 14.0})
    slow = axis.model_copy(
        update={
            "model": axis.model.model_copy(update={"ate": error}),
            "limits": axis.limits.model_copy(update={"speed_rps": 12.0}),
        }
    )
    bench = BENCH.model_copy(update={"axis": {**BENCH.axis, 2: slow}})
    request = ComparisonRequest((RAMP,), (2,), ("none", treatment), frozenset({treatment}))
    motion = Experiment(RAMP, 2, "none").motion(bench)
    with pytest.raises(UnsafeRequestError, match="the speed of axis 2 with its cancellation"):
        cancellation_for(bench, None, (2,), motion.period_s).check(bench, motion)
    made = plan(KnownRobot(bench), request, channel=IDEAL)
    assert {each.treatment for each in made.experiments} == {"none", treatment}
    assert made.left_out == ()
