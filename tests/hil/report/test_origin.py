"""The origin of a page's numbers: every page of an emulated robot says so."""

import pytest

from hil.bench.bench import load_bench
from hil.report.origin import NOT_RECORDED, origin_of, origin_of_table
from hil.results.base import MeasuredBench
from hil.results.comparison import ComparisonRequestEntry, ComparisonResult, ComparisonRobot
from hil.results.runs import ExperimentsResult

AXES = {"axis 2": True, "axis 3": True, "axis 5": True, "accelerometer": True}


def result_of(answers: dict[str, bool | None]) -> ExperimentsResult:
    bench = MeasuredBench(
        name="reference", bus="can0", clock="wall", started_utc="2025-01-01T12:00:00Z", versions={}, file=load_bench("reference")
    )
    result = ExperimentsResult(bench=bench)
    result.note_emulation(answers)
    return result


def test_a_wholly_emulated_bench_is_called_that() -> None:
    result = result_of(AXES)
    assert (result.emulated, result.emulated_parts) == (True, None)
    origin = origin_of(result)
    assert (origin.word, origin.is_emulated) == ("emulated", True)
    assert origin.band.startswith("Emulated robot")
    assert '"emulated": true' in result.dumps()


def test_a_real_robot_has_no_band() -> None:
    result = result_of(dict.fromkeys(AXES, False))
    assert result.emulated is False
    assert (origin_of(result).word, origin_of(result).band) == ("measured", "")


def test_a_mixed_bench_names_what_is_emulated_and_what_is_not() -> None:
    result = result_of({**AXES, "axis 3": False, "accelerometer": False})
    assert result.emulated is True, "it is not a measurement of a robot"
    origin = origin_of(result)
    assert origin.word == "partly emulated"
    assert origin.band == "Partly emulated: axis 2, axis 5. Not emulated: axis 3, accelerometer."


@pytest.mark.parametrize("answers", [{}, dict.fromkeys(AXES), {**dict.fromkeys(AXES, False), "axis 2": None}])
def test_what_nobody_answered_is_not_known(answers: dict[str, bool | None]) -> None:
    result = result_of(answers)
    assert result.emulated is None
    assert origin_of(result) == NOT_RECORDED


def test_an_older_result_without_the_key_is_read_and_called_not_recorded() -> None:
    old = ExperimentsResult.model_validate_json(result_of(AXES).dumps().replace('"emulated": true, ', ""))
    assert old.emulated is None
    assert origin_of(old).band.startswith("This result does not record whether the robot was emulated")


def robot(name: str, emulated: bool | None, parts: tuple[str, ...] | None = None) -> ComparisonRobot:
    return ComparisonRobot(
        name=name, source="", directory=name, bus="", tip_mm=0.05, rows=(), compliance=(), not_restored=(), emulated=emulated,
        emulated_parts=parts,
    )  # fmt: skip


def table(*robots: ComparisonRobot, emulated: bool | None) -> ComparisonResult:
    request = ComparisonRequestEntry(experiments=(), axes=(), treatments=(), named=())
    return ComparisonResult(started_utc="2025-01-01T12:00:00Z", request=request, robots=list(robots), emulated=emulated)


def test_a_comparison_says_it_of_each_robot() -> None:
    both = origin_of_table(table(robot("a", True), robot("b", True), emulated=True))
    assert (both.word, both.band[:14]) == ("emulated", "Emulated robot")
    mixed = origin_of_table(table(robot("a", True), robot("b", False), robot("c", True, ("axis 2",)), emulated=True))
    assert (mixed.word, mixed.is_emulated) == ("partly emulated", True)
    assert mixed.band == "Partly emulated. a: emulated; b: a real robot; c: emulated: axis 2."
    assert origin_of_table(table(robot("a", None), emulated=None)) == NOT_RECORDED
    assert origin_of_table(table(robot("a", False), emulated=False)).band == ""
