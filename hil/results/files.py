"""Reading of result files by the class that wrote them."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import Field, TypeAdapter, ValidationError

from drive_profiles.files.toml import wrong_value
from hil.errors import FileProblemError
from hil.results.arm import ArmResult
from hil.results.ate import AteResult
from hil.results.base import RESULT_FILE, SCHEMA, MeasuredResult, Result
from hil.results.comparison import ComparisonResult, TourResult
from hil.results.learning import LearningResult, MotionLearningResult
from hil.results.notch_design import NotchDesignResult
from hil.results.plant import PlantResult
from hil.results.recorded_ate import RecordedAteResult
from hil.results.runs import ExperimentsResult

AnyResult = Annotated[
    ExperimentsResult
    | ComparisonResult
    | TourResult
    | LearningResult
    | MotionLearningResult
    | PlantResult
    | AteResult
    | RecordedAteResult
    | ArmResult
    | NotchDesignResult,
    Field(discriminator="kind"),
]
_ANY: TypeAdapter[AnyResult] = TypeAdapter(AnyResult)

R = TypeVar("R", bound=Result)

SHOWN_PROBLEMS = 5
"""Problems of a file that are shown; one wrong key often causes many."""


class ResultFileError(FileProblemError, ValueError):
    """A file is not a result that can be read here."""


def load_any(path: Path) -> AnyResult:
    """Read a result of any kind.

    Raises:
        OSError: The file cannot be read.
        ResultFileError: The file has another schema, no known kind, or wrong fields for its kind.
    """
    try:
        text = path.read_text(encoding="utf-8")
        value = json.loads(text)
    except UnicodeDecodeError as error:
        raise ResultFileError(path, f"not JSON: byte 0x{error.object[error.start]:02x}; expected UTF-8 text") from error
    except ValueError as error:
        raise ResultFileError(path, f"not JSON: {error}") from error
    schema = value.get("schema") if isinstance(value, dict) else None
    if schema is None:
        raise ResultFileError(path, "not a result: it has no `schema`")
    if schema != SCHEMA:
        raise ResultFileError(
            path,
            f"schema {schema}; expected {SCHEMA}; run the command again, or use the version that wrote it "
            "(recordings and bus.log beside it can be read as before)",
        )
    kinds = [kind.model_fields["kind"].default for kind in get_args(get_args(AnyResult)[0])]
    if value.get("kind") not in kinds:
        raise ResultFileError(path, f"its kind is {value.get('kind')!r}; expected one of {', '.join(kinds)}")
    try:
        return _ANY.validate_json(text)
    except ValidationError as error:
        unknown = _unknown_bench_keys(error)
        if not unknown:
            raise ResultFileError(path, _problems(error)) from error
    return _without(unknown, json.loads(text), path)


def _unknown_bench_keys(error: ValidationError) -> list[tuple[str, ...]]:
    """Return the bench file's unknown keys, if nothing else is wrong."""
    places = [
        tuple(str(each) for each in problem["loc"][1:]) for problem in error.errors() if problem["type"] == "extra_forbidden"
    ]
    only = len(places) == error.error_count() and all(place[:2] == ("bench", "file") for place in places)
    return places if only else []


def _without(unknown: list[tuple[str, ...]], value: dict[str, Any], path: Path) -> AnyResult:
    """Read a result of another version, whose bench file has keys that this one does not know."""
    for place in unknown:
        table = value
        for key in place[:-1]:
            table = table[int(key)] if isinstance(table, list) else table[key]
        table.pop(place[-1])
    try:
        result = _ANY.validate_json(json.dumps(value))
    except ValidationError as error:
        raise ResultFileError(path, _problems(error)) from error
    if isinstance(result, MeasuredResult):
        result.leave_out(".".join(place[2:]) for place in unknown)
    return result


def load_result(directory: Path, kind: type[R], what: str) -> R:
    """Read the result.json of a directory, which must be of one kind.

    An error names the expected origin, `what`: `a comparison`.

    Raises:
        OSError: The file is missing, or cannot be read.
        ResultFileError: The file is of another kind, or no result.
    """
    path = directory / RESULT_FILE
    result = load_any(path)
    if not isinstance(result, kind):
        raise ResultFileError(path, f"the result of hil {result.kind.replace('-', ' ')}, not that of {what}")
    return result


def _problem(detail: Mapping[str, Any]) -> str:
    said = {"missing": "is missing", "extra_forbidden": "is an unknown key"}
    return said.get(detail["type"]) or "; expected ".join(filter(None, wrong_value(detail)))


def _problems(error: ValidationError) -> str:
    problems = [f"{'.'.join(map(str, each['loc'][1:] or each['loc']))}: {_problem(dict(each))}" for each in error.errors()]
    more = "" if len(problems) <= SHOWN_PROBLEMS else f"; and {len(problems) - SHOWN_PROBLEMS} more"
    return "; ".join(problems[:SHOWN_PROBLEMS]) + more
