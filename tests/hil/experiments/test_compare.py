"""What is compared with what: plans, reasons for what is left out, the table, and what becomes of robots that fail."""

import json
from types import SimpleNamespace

import pytest

from drive_profiles.address import parse_address
from hil.errors import NodeError, NotPossibleError, SafetyStopError
from hil.experiments import compare as module
from hil.experiments.compare import Robot, Selection, compare, knowledge_by_robot, plan, summary
from hil.experiments.plan import Experiment
from hil.experiments.treatment import TREATMENTS, Knowledge
from hil.master.bench import load_bench
from hil.master.designed import DesignedAxis, Designs
from hil.master.identified import Identified

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
    return {(left.experiment.axis, left.experiment.compensation): left.reason for left in made.left_out}


def test_all_that_the_files_allow_is_planned_and_the_rest_has_its_reason():
    made = plan(Robot(BENCH), Selection(), channel=IDEAL)
    drive = {each.compensation for each in made.experiments if each.loop == "drive"}
    assert drive == {"none", "low-gains", "notch", "ate", "ate+notch", "ate-inside"}
    assert [each for each in made.experiments if each.loop == "host" and each.axis == 2] == [
        Experiment(RAMP, 2, "none", "host"), Experiment(RAMP, 2, "fixed-notch", "host"),
    ]  # fmt: skip
    assert {each.axis for each in made.experiments} == {2, 3, None}
    said = reasons(made)
    assert {way for _, way in said} == {"notch-optimised", "adaptive"}
    assert "--design" in said[2, "notch-optimised"]
    assert "--learnt" in said[None, "adaptive"]


def test_what_the_host_closes_comes_last():
    places = [each.loop for each in plan(Robot(BENCH), Selection(), channel=IDEAL).experiments]
    assert places == sorted(places)


def test_without_a_model_neither_cancellation_nor_a_fixed_notch():
    made = plan(Robot(unknown()), Selection((RAMP,), (3,)), channel=IDEAL)
    assert [each.compensation for each in made.experiments] == ["none", "low-gains", "notch"]
    said = reasons(made)
    assert "hil identify" in said[3, "ate"]
    assert "hil identify plant" in said[3, "fixed-notch"]


def test_a_bus_that_does_not_carry_the_loop_leaves_the_fixed_notch_out_and_its_reference():
    made = plan(Robot(BENCH), Selection((RAMP,), (2,), ("none", "notch", "fixed-notch")), channel=MBIT)
    assert [(each.compensation, each.loop) for each in made.experiments] == [("none", "drive"), ("notch", "drive")]
    assert "--overload" in reasons(made)[2, "fixed-notch"]
    assert len(made.left_out) == 1
    forced = plan(Robot(BENCH), Selection((RAMP,), (2,), ("fixed-notch",)), channel=MBIT, overload=True)
    assert [each.loop for each in forced.experiments] == ["host", "host"]


def test_a_host_closed_loop_at_the_edge_is_left_out():
    slow = BENCH.model_copy(update={"bus": BENCH.bus.model_copy(update={"host_sync_period_s": 0.008})})
    made = plan(Robot(slow), Selection((RAMP,), (2,), ("notch", "fixed-notch")), channel=IDEAL)
    assert "axis 2 closed over the bus at 8 ms" in reasons(made)[2, "fixed-notch"]


def test_a_design_of_another_axis_is_not_taken_for_this_one():
    made = plan(Robot(BENCH, Knowledge(designs=designs(2))), Selection((RAMP, LINE), (2, 3), ("notch-optimised",)), channel=IDEAL)
    assert {each.axis for each in made.experiments} == {2, None}
    assert reasons(made)[3, "notch-optimised"] == "notch-optimised: the design file has no filter for axis 3"


def test_an_axis_without_a_notch_has_none_to_compare():
    with pytest.raises(NotPossibleError, match=r"nothing to compare: notch: the bench file has no notch for axis 5"):
        plan(Robot(BENCH), Selection((RAMP,), (5,), ("notch",)), channel=IDEAL)


def test_a_robot_without_the_motion_is_said_to_have_none():
    bench = BENCH.model_copy(update={"line_motion": None})
    made = plan(Robot(bench), Selection((RAMP, LINE), (2,), ("notch",)), channel=IDEAL)
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
    with pytest.raises(NotPossibleError, match="the model file is of 'other'"):
        plan(Robot(BENCH, Knowledge(identified=other)), Selection(), channel=IDEAL)


def test_every_treatment_of_hil_run_can_be_compared():
    assert Selection().treatments == TREATMENTS


# -- gathering, with runs that are made up ---------------------------------------------------------------------------------


def entry(experiment, **changes):
    peak = {"none": 0.075, "notch": 0.045, "ate": 0.003}.get(experiment.compensation, 0.06)
    found = {
        "experiment": experiment.name, "axis": experiment.axis, "compensation": experiment.compensation, "loop": experiment.loop,
        "order": 2, "control_period_s": 250e-6, "tip_peak_mm": peak, "spectrum_area": 10.0 * peak, "within_spec": peak <= 0.05,
        "recording": f"runs/{experiment.file_name}",
    }  # fmt: skip
    return found | changes


@pytest.fixture
def runner(monkeypatch):
    """`run_experiments` without a bus; `changes` by treatment, `ends` by directory."""
    made = SimpleNamespace(changes={}, ends={}, called=[])

    def run(bench, experiments, out, **options):
        del options
        made.called.append(out.name)
        end = made.ends.get(out.name)
        if isinstance(end, Exception) and not isinstance(end, SafetyStopError):
            raise end
        runs = [entry(each, **made.changes.get(each.compensation, {})) for each in experiments]
        result = {"runs": runs, "comparisons": module_comparisons(runs), "bench": {"versions": {}}, "not_restored": []}
        return SimpleNamespace(result=result, stopped=end)

    from hil.experiments.plan import comparisons as module_comparisons  # noqa: PLC0415

    monkeypatch.setattr(module, "run_experiments", run)
    return made


def rows_of(done, robot=0):
    return {row["compensation"]: row for row in done.result["robots"][robot]["rows"]}


SELECTION = Selection((RAMP,), (2,), ("low-gains", "notch", "ate", "adaptive"))


def test_the_table_has_changes_trials_costs_and_reasons(runner, tmp_path):
    runner.changes["ate"] = {"trial": {"is_good": True}}
    done = compare([plan(Robot(BENCH), SELECTION, channel=IDEAL)], SELECTION, tmp_path)
    rows = rows_of(done)
    assert rows["none"]["tip_peak_change_pct"] is None
    assert rows["notch"]["tip_peak_change_pct"] == pytest.approx(-40.0)
    assert rows["ate"]["trial"] == "accepted"
    assert rows["ate"]["compliance"] == {"slow": 1.0, "peak": 1.0}
    assert rows["low-gains"]["compliance"]["slow"] == pytest.approx(3.7, abs=0.1)
    assert "left_out" in rows["adaptive"]
    assert done.unmet == []  # nobody has asked for it by name
    assert {each["compensation"] for each in done.result["robots"][0]["compliance"]} == {"none", "low-gains", "notch"}
    assert done.result == json.loads((tmp_path / "result.json").read_text())
    assert any("left out: adaptive" in line for line in summary(done.result))
    assert any("×3.70" in line for line in summary(done.result))


def test_what_was_asked_for_by_name_is_missed(runner, tmp_path):
    named = Selection((RAMP,), (2,), ("notch", "adaptive"), frozenset({"notch", "adaptive"}))
    done = compare([plan(Robot(BENCH), named, channel=IDEAL)], named, tmp_path)
    assert len(done.unmet) == 1
    assert done.unmet[0].startswith("reference, axis 2, adaptive: ")


def test_a_refused_cancellation_has_no_number_of_its_own(runner, tmp_path):
    runner.changes["ate"] = {"trial": {"is_good": False}, "invalid": "cancellation refused", "within_spec": False}
    done = compare([plan(Robot(BENCH), SELECTION, channel=IDEAL)], SELECTION, tmp_path)
    row = rows_of(done)["ate"]
    assert (row["trial"], row["tip_peak_mm"], row["within_spec"]) == ("refused", None, None)
    assert row["not_judged"] == "cancellation refused"
    assert done.unmet == ["reference, axis 2, ate: cancellation refused"]


def two_robots():
    other = BENCH.model_copy(update={"name": "Other arm"})
    return [plan(Robot(bench), SELECTION, channel=IDEAL) for bench in (BENCH, other, BENCH)]


def test_each_robot_has_a_directory_of_its_own(runner, tmp_path):
    done = compare(two_robots(), SELECTION, tmp_path)
    assert runner.called == ["reference", "other-arm", "reference-2"]
    assert [robot["directory"] for robot in done.result["robots"]] == runner.called


def test_a_robot_that_does_not_answer_leaves_the_others_to_be_run(runner, tmp_path):
    runner.ends["reference"] = NodeError(2, "no answer")
    done = compare(two_robots(), SELECTION, tmp_path)
    assert runner.called == ["reference", "other-arm", "reference-2"]
    assert done.failure is runner.ends["reference"]
    assert done.result["robots"][0]["ended"] == "node 2: no answer"
    assert rows_of(done)["notch"]["not_judged"] == "node 2: no answer"
    assert rows_of(done, 1)["notch"]["tip_peak_mm"] == 0.045


def test_after_a_stop_nothing_else_is_moved(runner, tmp_path):
    runner.ends["reference"] = SafetyStopError("axis 2 left its limits")
    done = compare(two_robots(), SELECTION, tmp_path)
    assert runner.called == ["reference"]
    assert done.failure is runner.ends["reference"]
    assert "not run" in done.result["robots"][1]["ended"]
    assert done.result["robots"][1]["not_restored"] == []
