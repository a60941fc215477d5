"""A result against an older one: unlike things are refused, and a difference is told from chance only where it can be."""

import json
import math
import shutil

import pytest
from typer.testing import CliRunner

from hil.bench.model import IdentifiedError
from hil.cli.main import app
from hil.errors import NotPossibleError
from hil.report.against.alike import check_robot, paired_runs
from hil.report.against.numbers import NumberPair, numbers_table, run_numbers
from hil.report.against.page import differing, settings_table
from hil.results.ate import AteResult, KnownArm, Sensing
from hil.results.learning import LearningResult
from hil.results.runs import ExperimentsResult
from tests.hil.results.made import measured_bench, run_entry, written


def bench(**changes):
    """A bench as measured, with a changed bench file."""
    made = measured_bench()
    value = json.loads(made.file.model_dump_json())
    for path, change in changes.items():
        *way, last = path.split("__")
        table = value
        for key in way:
            table = table[key]
        table[last] = change
    return made.model_copy(update={"file": type(made.file).model_validate_json(json.dumps(value))})


def result(*runs, emulated=True, **changes):
    return ExperimentsResult(bench=bench(**changes), runs=list(runs or [run_entry()]), emulated=emulated)


def ate(axis=2, a2=5.0, error=0.1):
    values = {"a2_arcsec": a2, "phi2_deg": 10.0}
    part = IdentifiedError.model_validate({"values": values, "standard_error": {"a2_arcsec": error, "phi2_deg": 2.0}})
    return AteResult(
        bench=bench(), axis=axis, sensorless=False, known_before=KnownArm(source="the bench file", start=None),
        sensing=Sensing(gain=0.5), ate=part, emulated=True,
    )  # fmt: skip


RATIO = {"axis__2__reduction_ratio": 80.0}


@pytest.mark.parametrize(
    ("new", "old", "why"),
    [
        (result(), ate(), "one is of hil run, the other of hil identify ate"),
        (result(), result(name="another"), "one is of the robot “reference”, the other of “another”"),
        (result(), result(emulated=False), "the new one is of an emulated robot, the other was measured on a real one"),
        (result(), result(**RATIO), "axis 2 has a gear of 120 in one, of 80 in the other"),
        (ate(), ate(3), "one is of axis 2, the other of axis 3"),
        (
            result(), result(run_entry(axis=3)),
            "one moved constant acceleration of axis 2, the other constant acceleration of axis 3",
        ),
        (
            result(), result(constant_acceleration__end_rps=8.0),
            "the motion differs: in constant_acceleration end_rps = 8.0 became",
        ),
        (result(), result(run_entry(order=4)), "no run of one has the same motion, window and treatment"),
    ],
)  # fmt: skip
def test_unlike_things_are_refused_in_words(tmp_path, new, old, why):
    for name, each in (("new", new), ("old", old)):
        (tmp_path / name).mkdir()
        written(tmp_path / name, each)
    found = CliRunner().invoke(app, ["report", str(tmp_path / "new"), "--against", str(tmp_path / "old")])
    assert found.exit_code == 3, found.output
    assert f"the results are too different to compare: {why}" in found.output
    assert list(tmp_path.glob("new/*.html")) == []


def test_results_that_have_nothing_to_compare_are_refused(tmp_path):
    for name in ("new", "old"):
        (tmp_path / name).mkdir()
        written(tmp_path / name, LearningResult(bench=measured_bench(), model="learnt.toml"))
    found = CliRunner().invoke(app, ["report", str(tmp_path / "new"), "--against", str(tmp_path / "old")])
    assert found.exit_code == 3
    assert "this is a result of hil learn" in found.output


def test_a_robot_of_which_it_is_not_known_whether_it_is_emulated_may_be_compared():
    check_robot(result(emulated=None), result())
    with pytest.raises(NotPossibleError):
        check_robot(result(emulated=False), result())


def test_a_motion_of_another_version_is_compared_without_its_table():
    """Its bench file may have one that this version does not know."""
    entries = [run_entry().model_copy(update={"experiment": "spiral"}) for _ in range(2)]
    assert len(paired_runs(result(entries[0]), result(entries[1])).pairs) == 1


def test_windows_meet_their_own_and_what_is_left_once_meets_the_other():
    new = result(run_entry("none"), run_entry("none", order=4), run_entry("notch"), run_entry("cancellation", order=4))
    old = result(run_entry("none"), run_entry("none", order=4), run_entry("low-gains"))
    paired = paired_runs(new, old)
    met = [(pair.old.treatment, pair.new.treatment, pair.new.order) for pair in paired.pairs]
    assert met == [("none", "none", 2), ("none", "none", 4), ("low-gains", "notch", 2)]
    assert [(run.treatment, run.order) for run in paired.only_new] == [("cancellation", 4)]
    assert paired.only_old == ()


def test_two_that_are_left_over_are_not_guessed_at():
    new = result(run_entry("none"), run_entry("notch"), run_entry("cancellation"))
    paired = paired_runs(new, result(run_entry("none"), run_entry("low-gains")))
    assert len(paired.pairs) == 1
    assert [run.treatment for run in paired.only_new] == ["notch", "cancellation"]
    assert [run.treatment for run in paired.only_old] == ["low-gains"]


@pytest.mark.parametrize(
    ("old", "new", "errors", "told"),
    [
        (5.0, 5.3, (0.1, 0.1), True),
        (5.0, 5.2, (0.1, 0.1), False),
        (5.0, 9.0, (0.1, None), None),
        (5.0, 9.0, (None, None), None),
        (5.0, 9.0, (0.0, 0.0), None),
        (None, 9.0, (0.1, 0.1), None),
        (math.inf, 9.0, (0.1, 0.1), None),
    ],
)
def test_a_difference_is_told_from_chance_beyond_two_of_its_standard_errors(old, new, errors, told):
    assert NumberPair("", "", "", old, new, *errors).is_beyond is told


def test_an_angle_differs_by_the_nearer_way_round():
    pair = NumberPair("", "φ", "°", 359.0, 1.0, 0.5, 0.5, is_angle=True)
    assert pair.difference == pytest.approx(2.0)
    assert NumberPair("", "φ", "°", 1.0, 359.0, is_angle=True).difference == pytest.approx(-2.0)


def test_the_table_has_the_difference_with_its_error_and_numbers_that_neither_has_are_left_out():
    order = {"order_mm": 0.040, "order_error_mm": 0.001}
    paired = paired_runs(result(run_entry(**order)), result(run_entry(tip_peak_mm=0.1, order_mm=0.050, order_error_mm=0.001)))
    rows = {row[0]: row[1:] for row in numbers_table(list(run_numbers(paired.pairs))).rows}
    assert rows["Tip peak"] == ["0.1", "0.075", "mm", "−0.025 (−25.0 %)", "–"]
    assert rows["Order amplitude"] == [
        "0.050 ± 0.001",
        "0.040 ± 0.001",
        "mm",
        "−0.010 ± 0.001",
        "yes: 7.1 standard errors",
    ]
    assert rows["Missed cycles"][:2] == ["0", "0"]
    assert "SYNC lateness, p99" not in rows


def test_settings_that_differ_are_named_by_group_and_key():
    old = result(axis__2__control__velocity_gain_nm_s_rad=0.123, bus__sync_period_s=0.004)
    found = differing(result(), old)
    assert [(each.group, each.key, each.old) for each in found] == [
        ("Control", "axis.2.control.velocity_gain_nm_s_rad", "0.123"),
        ("Bench file", "bus.sync_period_s", "0.004"),
    ]
    assert settings_table(found).groups == {0: "Control", 1: "Bench file"}
    assert differing(result(), result()) == []


def test_identifications_are_compared_with_their_errors(tmp_path):
    for name, each in (("new", ate(a2=6.0)), ("old", ate())):
        (tmp_path / name).mkdir()
        written(tmp_path / name, each)
    found = CliRunner().invoke(app, ["report", str(tmp_path / "new"), "--against", str(tmp_path / "old")])
    assert found.exit_code == 0, found.output
    text = (tmp_path / "new" / "against.html").read_text(encoding="utf-8").replace("&nbsp;", " ")
    assert "No setting differs; 1 of 2 numbers that have a standard error differ by more than chance" in text
    assert "yes: 7.1 standard errors" in text
    assert 'id="errors-by-order"' in text


@pytest.mark.slow
def test_the_page_has_both_tips_in_one_figure_that_can_be_zoomed(full_directory, tmp_path):
    new, old = (shutil.copytree(full_directory, tmp_path / name) for name in ("new", "old"))
    value = json.loads((old / "result.json").read_text(encoding="utf-8"))
    keep = [run for run in value["runs"] if run["axis"] == 2 and run["loop"] == "drive"]
    value["runs"] = keep
    (old / "result.json").write_text(json.dumps(value), encoding="utf-8")
    found = CliRunner().invoke(app, ["report", str(new), "--against", str(old), "--interactive"])
    assert found.exit_code == 0, found.output
    text = (new / "against.html").read_text(encoding="utf-8").replace("&nbsp;", " ")
    assert text.count('<figure id="tip-') == text.count('<div class="wide zoom"') == 2
    assert "Only in the new result: line motion, notch, drive-closed" in text
    assert not (new / "report.html").exists() or (new / "report.html").read_bytes() == (old / "report.html").read_bytes()
