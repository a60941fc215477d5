"""Every kind of result is read by the class that has written it, and nothing is lost on the way."""

import dataclasses
import json
import types
import typing
from typing import Any, Literal, get_args, get_origin

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from hil.bench.bench import Bench
from hil.bench.model import IdentifiedArm, IdentifiedError, IdentifiedPlant
from hil.control.notch import FixedFilter
from hil.control.shapers import SwingingMode
from hil.design.notch_problem import Requirements
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.report.origin import origin_of
from hil.results.ate import AteResult
from hil.results.base import SCHEMA, MeasuredBench, Result
from hil.results.comparison import ComparisonResult, TourResult
from hil.results.files import ResultFileError, load_any, load_result
from hil.results.learning import LearningResult, MotionLearningResult
from hil.results.notch_design import NotchDesignResult
from hil.results.plant import PlantResult
from hil.results.runs import ExperimentsResult
from hil.robot_tables import NotchTable, PlantTable, TransmissionErrorTable
from tests.hil.results.made import BENCH, measured_bench, run_entry

KINDS: tuple[type[Result], ...] = (
    ExperimentsResult, ComparisonResult, TourResult, LearningResult, MotionLearningResult, PlantResult, AteResult,
    NotchDesignResult,
)  # fmt: skip

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
ERROR = IdentifiedError(
    values=TransmissionErrorTable(a2_arcsec=5.0, phi2_deg=222.0), standard_error={"a2_arcsec": 0.02}, note="22 °C"
)
VALUES = PlantTable(
    motor_inertia_kg_m2=2.6e-4, motor_damping_nm_s_rad=0.0, arm_inertia_kg_m2=8.0, arm_damping_nm_s_rad=4.8,
    gear_stiffness_nm_rad=49000.0, gear_damping_nm_s_rad=43.0,
)  # fmt: skip
ARM = IdentifiedArm(
    axes=(2, 3), joints_deg=(9.3, -111.4), masses=(1.0,) * 20, stiffness_nm_rad=(49000.0, 16000.0),
    standard_error_nm_rad=(50.0, 20.0), misfit=1.1, postures=3,
)  # fmt: skip
PLANT = IdentifiedPlant(values=VALUES, antiresonance_hz=12.4, resonance_hz=22.0, damping=0.04, cannot_tell=("D_m",))
ARM = IdentifiedArm(
    axes=(2, 3), joints_deg=(0.0, 20.0, 95.0), masses=(7.5, 0.25), stiffness_nm_rad=(49e3, 15e3),
    standard_error_nm_rad=(120.0, 40.0), misfit=1.2, postures=3, dip_error=0.002,
)  # fmt: skip

# what other files define has rules of its own: one that keeps them is enough
GIVEN: dict[Any, st.SearchStrategy[Any]] = {
    Bench: st.just(BENCH),
    MeasuredBench: st.just(measured_bench()),
    IdentifiedError: st.just(ERROR),
    TransmissionErrorTable: st.just(TransmissionErrorTable.of({1: 2.0, 2: 5.0, 3.5: 1.0}, {1: 20.0, 2: 222.0, 3.5: 9.0})),
    IdentifiedPlant: st.just(PLANT),
    IdentifiedArm: st.just(ARM),
    NotchTable: st.just(BENCH.axis[2].notch[0]),
    FixedFilter: st.just(FixedFilter(0.9, -1.6, 0.9, -1.6, 0.8)),
    SwingingMode: st.just(SwingingMode(11.8, 0.03)),
    Requirements: st.just(Requirements()),
    bool: st.booleans(),
    int: st.integers(-(1 << 31), 1 << 31),
    float: NUMBERS,
    str: st.text(st.characters(codec="utf-8"), max_size=8),
}


def values_of(annotation: Any) -> st.SearchStrategy[Any]:
    """Values of a type as result files use it."""
    if annotation in GIVEN:
        return GIVEN[annotation]
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is typing.Annotated:
        return values_of(arguments[0])
    if origin is Literal:
        return st.sampled_from(arguments)
    if origin in {typing.Union, types.UnionType}:
        return st.one_of(*(st.none() if each is type(None) else values_of(each) for each in arguments))
    if origin is tuple and arguments[-1] is not Ellipsis:
        return st.tuples(*(values_of(each) for each in arguments))
    if origin in {tuple, list}:
        return st.lists(values_of(arguments[0]), max_size=2).map(origin)
    if origin is dict:
        return st.dictionaries(values_of(arguments[0]), values_of(arguments[1]), max_size=2)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        fields = {
            name: values_of(field.annotation) for name, field in annotation.model_fields.items() if name != "schema_version"
        }
        return st.fixed_dictionaries(fields).map(lambda values: annotation(**values))
    if dataclasses.is_dataclass(annotation):
        hints = typing.get_type_hints(annotation)
        parts = {field.name: values_of(hints[field.name]) for field in dataclasses.fields(annotation)}
        return st.fixed_dictionaries(parts).map(lambda values: annotation(**values))
    raise AssertionError(f"no values of {annotation}")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
@settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
def test_what_is_written_is_read_again_by_the_same_class(kind, data, tmp_path):
    result = data.draw(values_of(kind))
    path = tmp_path / "result.json"
    result.write(path)
    again = load_any(path)
    assert type(again) is kind
    assert again == result
    assert again.dumps() == result.dumps()
    assert list(json.loads(again.dumps()))[:2] == ["schema", "kind"]


@pytest.mark.parametrize(
    ("error", "causes"),
    [
        (NotPossibleError("does not fit", ("bus load",)), ("bus load",)),
        (UnsafeRequestError("the speed", 12.0, 10.0, "rev/s"), ("limits",)),
        (NotPossibleError("no axis 4"), None),
        (KeyboardInterrupt(), None),
    ],
)
def test_a_failure_is_kept_with_its_causes(tmp_path, error, causes):
    result = ExperimentsResult(bench=measured_bench())
    result.note_failure(error)
    result.write(tmp_path / "result.json")
    assert load_any(tmp_path / "result.json").causes == causes


def test_the_kinds_have_names_of_one_spelling():
    names = {kind.model_fields["kind"].default for kind in KINDS}
    assert names == {"run", "compare", "tour", "learn", "learn-motion", "identify-plant", "identify-ate", "design-notch"}


def test_what_is_absent_is_no_key_and_what_has_no_number_is_null(tmp_path):
    stopped = run_entry(tip_peak_mm=None, within_spec=None, stopped="axis 2: too fast")
    kept = json.loads(ExperimentsResult(bench=measured_bench(), runs=[stopped]).dumps())
    (run,) = kept["runs"]
    assert run["tip_peak_mm"] is None
    assert run["stopped"] == "axis 2: too fast"
    assert not {"invalid", "trial", "timing", "repeated"} & run.keys()
    assert "not_restored" not in kept


def test_a_number_that_json_does_not_have_is_refused_where_it_arises():
    with pytest.raises(ValidationError, match="finite number"):
        run_entry(tip_peak_mm=float("nan"))


# -- what cannot be read ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"schema": 1, "runs": []}', f"schema 1; expected {SCHEMA}; run the command again"),
        ('{"runs": []}', "it has no `schema`"),
        ("[]", "it has no `schema`"),
        ("{", "not JSON"),
        ('{"schema": 2, "kind": "waltz"}', "'waltz'"),
        ('{"schema": 2, "kind": "run"}', "bench: is missing"),
    ],
)
def test_another_file_is_refused_with_its_name_and_what_is_wrong(tmp_path, text, words):
    path = tmp_path / "result.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ResultFileError) as error:
        load_any(path)
    assert str(error.value).startswith(f"{path}: ")
    assert words in str(error.value)
    assert error.value.exit_code == 3


def test_a_result_of_another_kind_is_refused_by_name(tmp_path):
    ExperimentsResult(bench=measured_bench()).write(tmp_path / "result.json")
    with pytest.raises(ResultFileError, match="the result of hil run, not that of a comparison"):
        load_result(tmp_path, ComparisonResult, "a comparison")


def test_an_unknown_key_is_a_mistake_and_not_left_alone(tmp_path):
    value = json.loads(ExperimentsResult(bench=measured_bench()).dumps()) | {"runz": []}
    (tmp_path / "result.json").write_text(json.dumps(value), encoding="utf-8")
    with pytest.raises(ResultFileError, match="runz: is an unknown key"):
        load_any(tmp_path / "result.json")


def test_a_result_of_a_version_whose_bench_file_had_other_keys_is_read_and_says_which(tmp_path):
    value = json.loads(ExperimentsResult(bench=measured_bench(), runs=[run_entry()], emulated=True).dumps())
    value["bench"]["file"]["axis"]["2"]["limits"]["jerk_rps_s2"] = 5.0
    value["bench"]["file"]["colour"] = "red"
    (tmp_path / "result.json").write_text(json.dumps(value), encoding="utf-8")
    result = load_any(tmp_path / "result.json")
    assert result.bench.file == BENCH
    assert sorted(result.unknown_keys) == ["axis.2.limits.jerk_rps_s2", "colour"]
    assert origin_of(result).band.endswith("does not know these keys of the bench file: axis.2.limits.jerk_rps_s2, colour.")
    assert origin_of(result).is_emulated
    del value["bench"]["file"]["axis"]["2"]["reduction_ratio"]
    (tmp_path / "result.json").write_text(json.dumps(value), encoding="utf-8")
    with pytest.raises(ResultFileError, match=r"axis\.2\.reduction_ratio: is missing"):
        load_any(tmp_path / "result.json")
