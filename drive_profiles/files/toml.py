"""Reading of TOML files into frozen models, with located errors.

The unit of a number is in the name of its key (``torque_limit_nm``), so a wrong unit is a wrong key, and is reported.
"""

import datetime
import difflib
import json
import re
import reprlib
import tomllib
import types
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import pydantic

from drive_profiles.errors import FileError, Problem
from drive_profiles.files.reading import read_file
from drive_profiles.files.toml_lines import KeyPath, key_lines

__all__ = ["MAX_BYTES", "UNIT_NAMES", "FileError", "Problem", "Table", "load", "loads", "split_unit"]

MAX_BYTES = 1 << 20

UNIT_NAMES: dict[str, str] = {
    "_nm": "N·m",
    "_mnm": "mN·m",
    "_ncm": "N·cm",
    "_nm_rad": "N·m/rad",
    "_nm_s_rad": "N·m·s/rad",
    "_kg": "kg",
    "_g": "g",
    "_kg_m2": "kg·m²",
    "_kg_cm2": "kg·cm²",
    "_g_cm2": "g·cm²",
    "_rad": "rad",
    "_deg": "°",
    "_arcsec": "arcsec",
    "_arcmin": "arcmin",
    "_rad_s": "rad/s",
    "_deg_s": "°/s",
    "_rps": "rev/s",
    "_rpm": "rev/min",
    "_rad_s2": "rad/s²",
    "_deg_s2": "°/s²",
    "_rps_s": "rev/s²",
    "_hz": "Hz",
    "_khz": "kHz",
    "_s": "s",
    "_ms": "ms",
    "_us": "us",
    "_ns": "ns",
    "_per_s": "1/s",
    "_m": "m",
    "_mm": "mm",
    "_um": "um",
    "_m_s": "m/s",
    "_mm_s": "mm/s",
    "_m_s2": "m/s²",
    "_mm_s2": "mm/s²",
    "_per_mille": "per mille",
    "_percent": "%",
    "_counts": "counts",
    "_counts_s": "counts/s",
    "_counts_s2": "counts/s²",
    "_counts_per_rev": "counts/rev",
    "_bit_s": "bit/s",
    "_kbit_s": "kbit/s",
    "_a": "A",
    "_nm_a": "N·m/A",
    "_ma": "mA",
    "_v": "V",
    "_db": "dB",
}
_UNIT_BEHIND = re.compile(r"([\w-]+)\s*=\s*(?!0[xob])([-+]?[0-9][0-9_.eE+-]*)\s*([A-Za-zµ°%][^\s,}\]#]*)")
"""A number with a unit behind it, which is not TOML."""
_SUFFIXES = sorted(UNIT_NAMES, key=len, reverse=True)

M = TypeVar("M", bound=pydantic.BaseModel)


class Table(pydantic.BaseModel):
    """Base of every table of a file.

    Unknown keys are refused, instances are frozen, strings are never converted to numbers, and NaN is refused.
    """

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)


class WrongKeyError(ValueError):
    """A contradiction in a table, raised by validators with its key's path."""

    def __init__(self, message: str, at: KeyPath) -> None:
        """Keep the path."""
        self.at = at
        super().__init__(message)


def split_unit(key: str) -> tuple[str, str]:
    """Split a key into its stem and its unit suffix.

    The suffix is empty if there is none: ``start_rps`` gives (``start``, ``_rps``).
    """
    for suffix in _SUFFIXES:
        if key.endswith(suffix) and len(key) > len(suffix):
            return key[: -len(suffix)], suffix
    return key, ""


def load(path: str | Path, model: type[M], *, max_bytes: int = MAX_BYTES) -> M:
    """Read a TOML file (UTF-8) and validate it, best as a `Table`.

    Raises:
        FileError: With every problem found, by line.
    """
    path = Path(path)
    data = read_file(path, f"a TOML file of at most {max_bytes >> 20} MiB", max_bytes=max_bytes)
    try:
        text = data.decode("utf-8-sig")  # editors on Windows still write the mark
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise FileError(path, (Problem(line, "", f"byte 0x{data[error.start]:02x}", "UTF-8 text"),)) from error
    return loads(text, model, path)


def toml_value(value: object, *, hexadecimal: bool = False) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, dict):
        inside = ", ".join(f"{json.dumps(key)} = {toml_value(each)}" for key, each in value.items())
        return f"{{ {inside} }}" if inside else "{}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(toml_value(each) for each in value) + "]"
    if isinstance(value, int) and not isinstance(value, bool):
        return f"0x{value:X}" if hexadecimal and value >= 0 else str(value)
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")  # which JSON lets stand, and TOML does not


def table_lines(values: Mapping[Any, Any], name: str = "") -> list[str]:
    """Return the lines of a table: its plain values, then its tables and lists of tables.

    >>> table_lines({"robot": "r", "axis": {2: {"size": {"0.5": 1.0}, "notch": [{"order": 2}]}}})
    ['robot = "r"', '', '[axis.2.size]', '"0.5" = 1.0', '', '[[axis.2.notch]]', 'order = 2']
    """
    lines: list[str] = []
    tables: list[tuple[str, bool, dict[Any, Any]]] = []
    for key, value in values.items():
        own = str(key) if re.fullmatch(r"[A-Za-z0-9_-]+", str(key)) else toml_value(key)  # bare, a0.5_arcsec would be two keys
        path = f"{name}.{own}" if name else own
        if isinstance(value, dict):
            tables.append((path, False, value))
        elif isinstance(value, tuple | list) and value and isinstance(value[0], dict):
            tables += [(path, True, each) for each in value]
        else:
            lines.append(f"{own} = {toml_value(value)}")
    for path, is_listed, inside in tables:
        found = table_lines(inside, path)
        if is_listed:
            found = [f"[[{path}]]", *found]
        elif found and not found[0].startswith("["):  # a table of tables needs no head
            found = [f"[{path}]", *found]
        lines += ["", *found] if lines and found else found
    return lines


def loads(text: str, model: type[M], path: str | Path = "<text>") -> M:
    """Validate the text of a TOML file; `load` without the reading.

    Raises:
        FileError: With every problem found, by line.
    """
    path = Path(path)
    text = text.replace("\r\n", "\n")
    try:
        document = tomllib.loads(text)
        lines = key_lines(text)
        # By way of JSON: there, strict pydantic still takes "2" for the integer key of a table, and a list for a tuple.
        encoded = json.dumps(document, default=_isoformat)
    except (ValueError, RecursionError) as error:
        raise FileError(path, (_syntax_problem(text, error),)) from error
    twice = tuple(sorted(_numbered_twice(lines)))
    try:
        result = model.model_validate_json(encoded, strict=True)
    except pydantic.ValidationError as error:
        other = mistaken(lines, lambda mark: _has(model, mark))
        if other is not None:
            raise FileError(path, (Problem(0, "", f"is {other[0]}", other[1]),)) from None
        raise FileError(path, tuple(sorted((*twice, *_problems(error, model, lines))))) from None
    if twice:
        raise FileError(path, twice)
    return result


def _numbered_twice(lines: Mapping[KeyPath, int]) -> Iterator[Problem]:
    """Report tables such as ``axis.2`` beside ``axis.02``: two keys, one number."""
    seen: dict[KeyPath, KeyPath] = {}
    for path in lines:
        name = path[-1]
        if isinstance(name, str) and re.fullmatch(r"[+-]?[0-9]{1,18}", name):
            first = seen.setdefault((*path[:-1], int(name)), path)
            if first != path:
                yield Problem(lines[path], _dotted(path), f"the same number as line {lines[first]}", "each number once")


def _isoformat(value: object) -> str:
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    raise TypeError(f"TOML has no {type(value).__name__}")


def _syntax_problem(text: str, error: Exception) -> Problem:
    if isinstance(error, RecursionError):
        return Problem(0, "", "is nested too deeply", "a handful of levels")
    message = str(error)
    position = re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)$", message)
    if position is None:
        return Problem(0, "", message, "valid TOML")
    line = int(position[1]) if position[1] else text.rstrip("\n").count("\n") + 1
    unit = _UNIT_BEHIND.search(text.split("\n")[line - 1]) if position[1] else None
    if unit is not None:
        key, value, word = unit.groups()
        return Problem(line, key, f"{value} {word}: a unit behind the number", "the number alone, the unit is in the key's name")
    column = f" (column {position[2]})" if position[2] else " (end of file)"
    return Problem(line, "", message[: position.start()] + column, "valid TOML")


def _problems(error: pydantic.ValidationError, model: type[pydantic.BaseModel], lines: dict[KeyPath, int]) -> tuple[Problem, ...]:
    found: list[Problem] = []
    renamed: set[KeyPath] = set()
    missing: list[tuple[KeyPath, Problem]] = []
    for detail in error.errors(include_url=False):
        location = detail["loc"]
        path, line = _located((*location, *getattr(detail.get("ctx", {}).get("error"), "at", ())), lines)
        match detail["type"]:
            case "extra_forbidden":
                message, expected, meant = _unknown_key(str(location[-1]), _known_keys(model, location[:-1]))
                if meant:
                    renamed.add((*location[:-1], meant))
                found.append(Problem(line, _dotted(path), message, expected))
            case "missing":
                problem = Problem(line, _dotted((*path, location[-1])), "is missing", _kind(model, location))
                missing.append((location, problem))
            case _:
                problem = Problem(line, _dotted(path), *wrong_value(detail))
                # of a value that may be of several types each says so
                same = next((row for row, each in enumerate(found) if each[:3] == problem[:3]), None)
                if same is None:
                    found.append(problem)
                elif found[same].expected.startswith("a whole number"):  # which is a number as well
                    found[same] = problem
    # A key under a wrong name is one mistake, so its right name is not reported as missing beside it.
    found.extend(problem for location, problem in missing if location not in renamed)
    return tuple(sorted(dict.fromkeys(found)))


def _located(location: KeyPath, lines: dict[KeyPath, int]) -> tuple[KeyPath, int]:
    """Return the longest file path within a location, and its line."""
    path: KeyPath = ()
    for part in location:
        for candidate in ((*path, part), (*path, str(part))):
            if candidate in lines:
                path = candidate
                break
    return path, lines.get(path, 1)


def _dotted(path: KeyPath) -> str:
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            name = part if re.fullmatch(r"[\w-]+", part) else json.dumps(part)
            text += f".{name}" if text else name
    return text


def _unknown_key(key: str, known: Mapping[str, object]) -> tuple[str, str, str]:
    stem, suffix = split_unit(key)
    for name in known:
        known_stem, known_suffix = split_unit(name)
        if known_suffix and known_stem in {stem, key}:
            what = "wrong unit" if suffix and known_stem == stem else "no unit"
            return f"{what}: {key!r}", f"{name} ({UNIT_NAMES[known_suffix]})", name
    close = difflib.get_close_matches(key, known, n=1)
    hint = f", did you mean {close[0]}?" if close else ""
    listed = ", ".join(sorted(known)) or "no keys here"
    return f"unknown key {reprlib.repr(key)}{hint}", f"one of {listed}" if known else listed, close[0] if close else ""


def wrong_value(detail: Mapping[str, Any]) -> tuple[str, str]:
    """Return what pydantic found in place of a value, and what it expected."""
    found, context = f"found {_shown(detail['input'])}", detail.get("ctx", {})
    location: KeyPath = detail["loc"]
    unit = _unit_of(location)
    in_unit = f" in {unit}" if unit else ""
    match detail["type"]:
        case "value_error" | "assertion_error":
            return str(context.get("error", detail["msg"])), ""
        case "float_type" | "int_type" | "float_parsing" | "int_parsing" if location[-1] != "[key]":
            kind = "a whole number" if detail["type"].startswith("int") else "a number"
            note = ", the unit is in the key's name" if unit and isinstance(detail["input"], str) else ""
            return found, f"{kind}{in_unit}{note}"
        case "int_parsing" | "int_type":
            return f"found {_shown(detail['input'])}", "a whole number as the table's name"
        case "finite_number":
            return found, f"a finite number{in_unit}"
        case "greater_than" | "greater_than_equal" | "less_than" | "less_than_equal" as bound:
            words = {"greater_than": "more than", "greater_than_equal": "at least", "less_than": "less than"}
            limit = next(iter(context.values()))
            return found, f"{words.get(bound, 'at most')} {limit}{' ' + unit if unit else ''}"
        case "literal_error" | "enum":
            return found, f"one of {context['expected']}"
        case "model_type" | "dict_type" | "model_attributes_type":
            return found, "a table"
        case _:
            message = detail["msg"].removeprefix("Input should be ").removeprefix("Value should be ")
            return found, message[:1].lower() + message[1:]


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return "a table" if isinstance(value, dict) else reprlib.repr(value)


def _unit_of(location: KeyPath) -> str:
    """Return the unit of the innermost key that has one: ``start_m.x``."""
    for part in reversed(location):
        if isinstance(part, str) and (suffix := split_unit(part)[1]):
            return UNIT_NAMES[suffix]
    return ""


def _kind(model: type[pydantic.BaseModel], location: KeyPath) -> str:
    """Return the kind of value that a missing key needs."""
    unit = _unit_of(location[-1:])
    if unit:
        return f"a value in {unit}"
    for annotation in _annotations(model, location):
        for kind, words in ((bool, "true or false"), (int, "a whole number"), (float, "a number"), (str, "a string")):
            if annotation is kind:
                return words
        if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
            return f"a table with {', '.join(_fields(annotation))}"
        if get_origin(annotation) is Literal:
            return f"one of {', '.join(map(repr, get_args(annotation)))}"
        if get_origin(annotation) is dict:
            return "a table"
        if get_origin(annotation) in {list, tuple}:
            return "a list"
    return "this key"


def _known_keys(model: type[pydantic.BaseModel], location: KeyPath) -> dict[str, object]:
    known: dict[str, object] = {}
    for annotation in _annotations(model, location):
        if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
            known.update(_fields(annotation))
    return known


def _annotations(model: object, location: KeyPath) -> list[Any]:
    """Return the types that the model allows at this place."""
    here = list(_flat(model))
    for part in location:
        deeper = [leaf for annotation in here for step in _step(annotation, part) for leaf in _flat(step)]
        here = deeper or here  # names of union members are not a step into the file
    return here


def _has(model: object, mark: KeyPath) -> bool:
    """Return True if the model allows a path, whose `ANY` is any key of a table of tables."""
    here = list(_flat(model))
    for part in mark:
        here = [leaf for each in here for step in _step(each, part) for leaf in _flat(step)]
    return bool(here)


def _step(annotation: Any, part: str | int) -> Iterator[Any]:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        if part in (fields := _fields(annotation)):
            yield fields[str(part)]
    elif isinstance(origin, type) and issubclass(origin, Mapping):
        yield arguments[1]
    elif origin is not None and isinstance(part, int):
        yield from (argument for argument in arguments if argument is not Ellipsis)


def _flat(annotation: Any) -> Iterator[Any]:
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from _flat(get_args(annotation)[0])
    elif origin in {Union, types.UnionType}:
        for member in get_args(annotation):
            yield from _flat(member)
    else:
        yield annotation


def _fields(model: type[pydantic.BaseModel]) -> dict[str, Any]:
    return {field.alias or name: field.annotation for name, field in model.model_fields.items()}


ANY = "*"
"""Stands for the number or the name of a table."""
KINDS: dict[str, tuple[KeyPath, ...]] = {
    "a bench file": (("bus", "sync_period_s"), ("axis", ANY, "limits")),
    "a robot file": (("axis", ANY, "gear_damping_nm_s_rad"), ("axis", ANY, "torque_limit_nm")),
    "a model file": (("axis", ANY, "plant"), ("axis", ANY, "ate", "standard_error")),
    "a design file": (("axis", ANY, "sensitivity_peak"),),
    "a file of faults": (("fault",),),
    "a layout of a recording": (("column",), ("unit",)),
    "a spread of plants": (("gear_stiffness_percent",), ("arm_inertia_percent",), ("a2_percent",)),
    "a drive profile": (("identity",), ("parameters",)),
    "a parameter set": (("header",), ("tuning",), ("limits",), ("communication",), ("commissioning",)),
}
"""Kinds of TOML files of all three tools, told apart by keys that no other kind has."""


def _fits(path: KeyPath, mark: KeyPath) -> bool:
    return len(path) == len(mark) and all(key in {part, ANY} for part, key in zip(path, mark, strict=True))


def mistaken(paths: Collection[KeyPath], allowed: Callable[[KeyPath], bool]) -> tuple[str, str] | None:
    """Return the kind of a file and the one that is expected; None if it may be that one.

    Args:
        paths: Paths of the keys of the file.
        allowed: True for a path that the expected kind has.
    """
    expected = [kind for kind, marks in KINDS.items() if any(allowed(mark) for mark in marks)]
    found = [kind for kind, marks in KINDS.items() if any(_fits(path, mark) for mark in marks for path in paths)]
    return (found[0], expected[0]) if found and expected and not set(found) & set(expected) else None
