"""The page of a comparison: what stands in it, and what it says where something is missing."""

import shutil
from types import SimpleNamespace

import pytest

from hil.report.material import Material
from hil.report.pages import demo as page
from hil.report.pages.compare import MAPPED, OVERLAID, ComparedMotion, verdict
from hil.report.pages.page import typeset
from hil.report.writer import write_report_of
from hil.results.comparison import ComplianceFactors, TourNotch
from hil.results.files import load_result
from hil.results.runs import ExperimentsResult
from tests.hil.results.made import RAMP, comparison, robot, row, tour, written


def left_out(experiment, axis, treatment):
    return row(experiment, axis, treatment, None, left_out="<no learning>")


ROWS = [
    row(*RAMP, "none", 0.075),
    row(*RAMP, "low-gains", 0.042, compliance=ComplianceFactors(slow=3.7, peak=2.8)),
    row(*RAMP, "notch", 0.046),
    row("line-motion", None, "none", 0.125),
    row("line-motion", None, "notch", 0.063),
    row("line-motion", None, "low-gains", 0.074),
    left_out(*RAMP, "cancellation-learnt"),
]


@pytest.fixture(scope="module")
def directory(full_directory, tmp_path_factory):
    """A comparison of the runs of the demo's directory."""
    out = tmp_path_factory.mktemp("compare")
    shutil.copytree(full_directory, out / "reference")
    write_report_of(written(out, comparison(robot(ROWS))))
    return out


@pytest.mark.slow
def test_tables_and_figures_of_each_experiment_stand_in_one_file(directory):
    text = (directory / "report.html").read_text()
    for key in ("overview", "peaks-reference", "table-line-motion", "table-constant-acceleration-axis2", "compliance", "left-out",
                "vibration-reference-line-motion", "vibration-reference-constant-acceleration-axis2",
                "orders-reference-constant-acceleration-axis2"):  # fmt: skip
        assert f'id="{key}"' in text
    assert "Treatments side by side" in text
    assert "× 3.70" in text
    assert "specification" in text
    assert "&lt;no learning&gt;" in text
    assert "<no learning>" not in text
    assert "<script" not in text
    assert "src=" not in text


def test_a_missing_robot_does_not_keep_the_page_from_being_written(tmp_path):
    gone = robot([row(*RAMP, "none", None, not_judged="no bus")], ended="no bus")
    text = write_report_of(written(tmp_path, comparison(gone))).read_text()
    assert "The comparison is not complete" in text
    assert "no bus" in text


def test_the_verdict_names_the_treatment_that_keeps_the_specification_everywhere():
    found = verdict(
        comparison(robot([*ROWS, row(*RAMP, "cancellation", 0.003), row("line-motion", None, "cancellation", 0.004)]))
    )
    assert (found.kind, found.headline) == ("good", "Cancellation keeps the tip within ±0.05 mm in all 2 experiments")
    assert (
        "Gains halved: within the specification in 1 of 2, tip peak −44 … −1 %; the motor yields 3.7 times as far at 1 Hz."
        in (found.details)
    )


def test_a_single_experiment_is_not_counted():
    details = verdict(comparison(robot([row(*RAMP, "none", 0.075), row(*RAMP, "notch", 0.046)]))).details
    assert any(line.startswith("Notch: within the specification") for line in details)
    assert not any(" of 1" in line for line in details)


def test_a_treatment_that_was_not_run_everywhere_keeps_nothing_everywhere():
    found = verdict(comparison(robot([*ROWS, row(*RAMP, "cancellation", 0.003)])))
    assert (found.kind, found.headline) == ("open", "No single treatment keeps the tip within ±0.05 mm in all 2 experiments")


def test_a_refused_cancellation_is_said():
    refused = row(*RAMP, "cancellation", None, trial="refused", not_judged="worse", recording="there")
    found = verdict(comparison(robot([*ROWS, refused])))
    assert "Refused by its trial: reference, axis 2, constant acceleration, cancellation." in found.details


@pytest.mark.slow
def test_several_robots_stand_in_the_same_table(directory, tmp_path):
    shutil.copytree(directory / "reference", tmp_path / "reference")
    shutil.copytree(directory / "reference", tmp_path / "other")
    text = write_report_of(written(tmp_path, comparison(robot(ROWS), robot(ROWS, "other")))).read_text()
    assert text.count('id="table-line-motion"') == 1
    assert 'id="vibration-other-line-motion"' in text
    assert "in all 4 experiments" in text


@pytest.mark.ci
def test_many_treatments_have_a_diagram_each(directory, tmp_path):
    """More than can be told apart in one: the title of each has its number."""
    shutil.copytree(directory / "reference", tmp_path / "reference")
    kept = load_result(tmp_path / "reference", ExperimentsResult, "runs")
    plain = [run for run in kept.runs if run.experiment == "line-motion" and run.treatment == "notch"]
    ways = ("low-gains", "notch-designed", "cancellation")
    kept.runs += [run.model_copy(update={"treatment": way}) for way in ways for run in plain]
    written(tmp_path / "reference", kept)
    rows = [row("line-motion", None, way, 0.06) for way in ("none", "notch", *ways)]
    assert len(rows) > OVERLAID
    text = write_report_of(written(tmp_path, comparison(robot(rows)))).read_text()
    assert "Orange, behind each" in text


def test_order_maps_of_many_treatments_are_parts_with_titles_of_their_own(monkeypatch):
    monkeypatch.setattr("hil.report.pages.compare.order_maps", lambda key, title, *_: (key, title))
    motion = ComparedMotion(robot(ROWS), SimpleNamespace(f_al=lambda axis: None), *RAMP, several=False)
    vars(motion)["runs"] = [(None, SimpleNamespace(label=str(number), recording=None)) for number in range(MAPPED + 1)]
    title = "Axis 2: which order shakes the tip"
    assert [each for _, each in motion.orders()] == [title, f"{title}, part 2"]


def demo_with(told, full_directory, tmp_path):
    """A demo's directory with a tour below it; only what is looked at is copied."""
    (tmp_path / "tour").mkdir()
    shutil.copy(full_directory / "result.json", tmp_path)
    written(tmp_path / "tour", told)
    return tmp_path


def test_the_demo_shows_the_tour_and_links_to_it(full_directory, tmp_path):
    out = demo_with(tour(robot(ROWS)), full_directory, tmp_path)
    table = page._own_robot(Material(out))
    assert "href='tour/report.html'" in table.caption
    assert [cells[0] for cells in table.rows] == ["untreated", "gains halved", "notch"]
    assert typeset(table.caption) == table.caption
    own = write_report_of(out / "tour").read_text()
    assert '<a href="x/report.html">report</a>' in own


def test_a_tour_that_ended_early_says_where(full_directory, tmp_path):
    out = demo_with(tour(failure="the wire broke"), full_directory, tmp_path)
    table = page._own_robot(Material(out))
    assert table.title == "It ended early"
    assert table.rows[0][1] == "the wire broke"
    assert "the wire broke" in write_report_of(out / "tour").read_text()


def test_the_tour_of_an_earlier_demo_is_left_alone(full_directory, tmp_path):
    old = tour(robot(ROWS), started_utc="2024-01-01T12:00:00+00:00")
    assert page._own_robot(Material(demo_with(old, full_directory, tmp_path))) is None
    assert page._own_robot(Material(full_directory)) is None


@pytest.mark.parametrize(
    ("designed_mm", "missed", "said"),
    [
        (
            0.060,
            ("M_s 1.9, at most 1.7 required", "phase margin 28 deg, at least 30 deg required"),
            [
                "Axis 2, constant acceleration: the designed notch leaves 0.060 mm, the bench file's notch 0.046 mm.",
                "Axis 2: the design does not keep the bench file's notch, since it misses 2 requirements. "
                "The worst: M_s 1.9, at most 1.7 required.",
            ],
        ),
        (
            0.060,
            (),
            [
                "Axis 2, constant acceleration: the designed notch leaves 0.060 mm, the bench file's notch 0.046 mm.",
                "Axis 2: the design predicted 0.050 mm, and 0.070 mm for the bench file's notch.",
            ],
        ),
        (0.046, ("M_s 1.9, at most 1.7 required",), []),
    ],
)
def test_a_designed_notch_never_looks_worse_without_the_reason(designed_mm, missed, said):
    made = tour(robot([row(*RAMP, "none", 0.075), row(*RAMP, "notch", 0.046), row(*RAMP, "notch-designed", designed_mm)]))
    notches = (
        TourNotch(axis=2, designed_mm=0.050, given_mm=0.070, missed=missed),
        TourNotch(axis=3, designed_mm=0.1, given_mm=0.2),
    )
    told = made.model_copy(update={"tour": made.tour.model_copy(update={"notches": notches})})
    assert [text for text in verdict(told).details if "designed notch leaves" in text or text.startswith("Axis")] == said
    assert not [text for text in verdict(made).details if "designed notch leaves" in text]
