"""Every error of a file: where, what, and what was expected."""

import datetime
import tomllib
from pathlib import Path
from typing import Literal

import pydantic
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.errors import DriveProfileError
from drive_profiles.files import toml as files
from drive_profiles.files.toml import FileError, Problem, Table, load, loads
from drive_profiles.files.toml_lines import key_lines


class Ate(Table):
    a2_arcsec: float


class Axis(Table):
    torque_limit_nm: float = pydantic.Field(gt=0, le=100)
    start_rps: float = 4.0
    forearm_m: tuple[float, float] = (0.0, 0.0)
    counts: int = 1
    ate: Ate | None = None


class Notch(Table):
    order: Literal[1, 2]


class Robot(Table):
    title: str = ""
    enabled: bool = True
    axis: dict[int, Axis]
    notch: list[Notch] = pydantic.Field(default_factory=list)


AXIS = "[axis.2]\ntorque_limit_nm = 7.1\n"


def problems(text, model=Robot):
    with pytest.raises(FileError) as caught:
        loads(text, model)
    return [tuple(problem) for problem in caught.value.problems]


def test_a_good_file_becomes_a_frozen_model_with_integer_keys():
    robot = loads(AXIS + "forearm_m = [1, 2]\nate = { a2_arcsec = 5 }\n[[notch]]\norder = 2\n", Robot)
    assert robot.axis[2].torque_limit_nm == 7.1
    assert robot.axis[2].forearm_m == (1.0, 2.0)
    assert isinstance(robot.axis[2].ate.a2_arcsec, float)
    with pytest.raises(pydantic.ValidationError):
        robot.title = "other"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "[axis.2]\ntorque_limit_mnm = 7100\n",
            (2, "axis.2.torque_limit_mnm", "wrong unit: 'torque_limit_mnm'", "torque_limit_nm (N·m)"),
        ),
        (
            "[axis.2]\ntorque_limit = 7.1\n",
            (2, "axis.2.torque_limit", "no unit: 'torque_limit'", "torque_limit_nm (N·m)"),
        ),
        (
            '[axis.2]\ntorque_limit_nm = "7.1 Nm"\n',
            (2, "axis.2.torque_limit_nm", "found '7.1 Nm'", "a number in N·m, the unit is in the key's name"),
        ),
        ("[axis.2]\n\ntorque_limit_nm = nan\n", (3, "axis.2.torque_limit_nm", "found nan", "a finite number in N·m")),
        ("[axis.2]\ntorque_limit_nm = -inf\n", (2, "axis.2.torque_limit_nm", "found -inf", "a finite number in N·m")),
        ("[axis.2]\ntorque_limit_nm = true\n", (2, "axis.2.torque_limit_nm", "found true", "a number in N·m")),
        ("[axis.2]\ntorque_limit_nm = 0\n", (2, "axis.2.torque_limit_nm", "found 0", "more than 0.0 N·m")),
        ("[axis.2]\ntorque_limit_nm = 101\n", (2, "axis.2.torque_limit_nm", "found 101", "at most 100.0 N·m")),
        (AXIS + "counts = 1.5\n", (3, "axis.2.counts", "found 1.5", "a whole number")),
        (AXIS + "counts = '7'\n", (3, "axis.2.counts", "found '7'", "a whole number")),
        (
            AXIS + "forearm_m = [\n  1.0, # ]\n  '2',\n]\n",
            (5, "axis.2.forearm_m[1]", "found '2'", "a number in m, the unit is in the key's name"),
        ),
        (AXIS + "ate = {}\n", (3, "axis.2.ate.a2_arcsec", "is missing", "a value in arcsec")),
        (AXIS + "ate = 3\n", (3, "axis.2.ate", "found 3", "a table")),
        ("title = 'x'\n\n[axis.2]\n", (3, "axis.2.torque_limit_nm", "is missing", "a value in N·m")),
        ("title = 'x'\n", (1, "axis", "is missing", "a table")),
        (AXIS.replace("2", "two"), (1, "axis.two", "found 'two'", "a whole number as the table's name")),
        (AXIS + "[[notch]]\norder = 2\n[[notch]]\norder = 3\n", (6, "notch[1].order", "found 3", "one of 1 or 2")),
        (AXIS + "[[notch]]\n", (3, "notch[0].order", "is missing", "one of 1, 2")),
        (
            AXIS + "[axis.02]\ntorque_limit_nm = 1\n",
            (3, "axis.02", "the same number as line 1", "each number once"),
        ),
        (
            AXIS + "[axis.3]\ntorque_limit_nm = 1\nstart_rsp = 4\n",
            (
                5,
                "axis.3.start_rsp",
                "unknown key 'start_rsp', did you mean start_rps?",
                "one of ate, counts, forearm_m, start_rps, torque_limit_nm",
            ),
        ),
    ],
)
def test_one_mistake_is_one_problem_at_its_line(text, problem):
    assert problems(text) == [problem]


def test_a_wrong_key_that_stands_for_a_missing_one_is_said_once():
    assert len(problems("[axis.2]\ntorque_limit_mnm = 7100\n")) == 1
    assert len(problems("[axis.2]\nstart_rpm = 1\n")) == 2  # the wrong unit, and torque_limit_nm is missing


def test_all_mistakes_of_a_file_are_listed_by_line(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text('enabled = 1\n[axis.2]\ntorque_limit_mnm = 1\n[axis.3]\ntorque_limit_nm = "x"\nbogus = 1\n')
    with pytest.raises(FileError) as caught:
        load(path, Robot)
    assert [problem.line for problem in caught.value.problems] == [1, 3, 5, 6]
    lines = str(caught.value).splitlines()
    assert lines[1] == f"{path}:3: axis.2.torque_limit_mnm: wrong unit: 'torque_limit_mnm'; expected torque_limit_nm (N·m)"
    assert caught.value.path == path
    assert isinstance(caught.value, DriveProfileError)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a = 1\nb = \n", 2),
        ("a = 1\na = 2\n", 2),
        ("[axis.2]\n[axis.2]\n", 2),
        ('a = 1\nb = "open\n', 2),
        ("a = 1\n\nb = [1,\n", 3),
        ("a = 1\nb = 1 2\n", 2),
        ("a = \x00\n", 1),
        ('\na = """\n\n\n', 2),
    ],
)
def test_syntax_errors_are_located(text, line):
    ((found, key, message, expected),) = problems(text)
    assert (found, key, expected) == (line, "", "valid TOML")
    assert message


@pytest.mark.parametrize("text", ["a = " + "9" * 5000, "a = 0x" + "f" * 5000, "a = " + "[" * 5000])
def test_what_python_itself_cannot_take_is_a_file_error(text):
    assert len(problems(text)) == 1


def test_files_that_cannot_be_read_are_file_errors(tmp_path):
    for path, words in [
        (tmp_path / "none.toml", "none.toml: cannot be read"),
        (tmp_path, "cannot be read"),
    ]:
        with pytest.raises(FileError, match=words):
            load(path, Robot)
    path = tmp_path / "latin.toml"
    path.write_bytes(b"a = 1\nb = '\xe9'\n")
    with pytest.raises(FileError, match=r"latin\.toml:2: byte 0xe9; expected UTF-8 text"):
        load(path, Robot)
    path.write_bytes(b"#" * (files.MAX_BYTES + 1))
    with pytest.raises(FileError, match="larger than 1 MiB"):
        load(path, Robot)
    path.write_bytes(AXIS.encode().ljust(files.MAX_BYTES, b"\n"))
    assert load(path, Robot).axis[2].torque_limit_nm == 7.1


def test_byte_order_mark_and_windows_line_ends_are_taken(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_bytes(b"\xef\xbb\xbf" + AXIS.replace("\n", "\r\n").encode() + b"bogus = 1\r\n")
    with pytest.raises(FileError) as caught:
        load(path, Robot)
    assert [problem.line for problem in caught.value.problems] == [3]


def test_validators_of_the_model_speak_in_their_own_words():
    class Range(Table):
        low: float
        high: float

        @pydantic.model_validator(mode="after")
        def _ordered(self):
            if self.low > self.high:
                raise ValueError("low is above high")
            return self

    class File(Table):
        range: Range

    assert problems("\n[range]\nlow = 2\nhigh = 1\n", File) == [(2, "range", "low is above high", "")]


def test_union_members_do_not_get_into_the_key():
    class File(Table):
        value: Ate | float

    found = problems("\nvalue = { a2_arcsec = 1, b = 2 }\n", File)
    assert (2, "value.b", "unknown key 'b'", "one of a2_arcsec") in found
    assert {key for _, key, *_ in found} == {"value.b", "value"}


def test_a_key_from_a_dictionary_may_be_called_like_a_field():
    class Entry(Table):
        unit: str

    class File(Table):
        entries: dict[str, Entry]

    assert problems("[entries.unit]\nunits = ''\n", File) == [
        (2, "entries.unit.units", "unknown key 'units', did you mean unit?", "one of unit")
    ]


def test_dates_reach_the_model():
    class File(Table):
        taken: datetime.date

    assert loads("taken = 2026-11-21\n", File).taken == datetime.date(2026, 11, 21)


def test_odd_keys_and_values_are_shown_short_and_harmless():
    (problem,) = problems(AXIS + f'"a\\u001b[31m b" = "{"x" * 500}"\n')
    text = str(FileError(Path("f"), (Problem(*problem),)))
    assert "\x1b" not in text
    assert len(text) < 300
    (problem,) = problems(AXIS + f'counts = "\\u001b{"x" * 500}"\n')
    assert "\x1b" not in problem[2]
    assert len(problem[2]) < 60


@pytest.mark.parametrize(
    ("key", "parts"),
    [
        ("torque_limit_nm", ("torque_limit", "_nm")),
        ("velocity_gain_nm_s_rad", ("velocity_gain", "_nm_s_rad")),
        ("gear_stiffness_nm_rad", ("gear_stiffness", "_nm_rad")),
        ("position_gain_per_s", ("position_gain", "_per_s")),
        ("stribeck_velocity_rad_s", ("stribeck_velocity", "_rad_s")),
        ("acceleration_rps_s", ("acceleration", "_rps_s")),
        ("encoder_counts_per_rev", ("encoder", "_counts_per_rev")),
        ("torque_constant_nm_a", ("torque_constant", "_nm_a")),
        ("order", ("order", "")),
        ("_nm", ("_nm", "")),
    ],
)
def test_units_in_names(key, parts):
    assert files.split_unit(key) == parts


SAMPLE = '''# comment with [brackets] and "quotes"
title = """
[axis.9]
not_a_key = 3 \\"""
""""
literal = \'\'\'
x = 1
\'\'\'
a.b."c.d" = 1  # dotted
when = 1979-05-27 07:32:00
list = [
  [1, 2], # ]
  { x = "}", y.z = [
     'a]',
  ] },
]
[table]
k = 'it # is'
  [ "quoted key" . 'and literal' ]
v = 1
[[array]]
n = 1
[array.sub]
s = 1
[[array]]
n = 2
[[array.deep]]
d = 1
[[array.deep]]
d = 2
'''


def test_the_scanner_is_not_confused():
    lines = key_lines(SAMPLE)
    assert {".".join(map(str, path)): line for path, line in lines.items() if path[0] not in ("array", "quoted key")} == {
        "title": 2,
        "literal": 6,
        "a": 9,
        "a.b": 9,
        "a.b.c.d": 9,
        "when": 10,
        "list": 11,
        "list.0": 12,
        "list.0.0": 12,
        "list.0.1": 12,
        "list.1": 13,
        "list.1.x": 13,
        "list.1.y": 13,
        "list.1.y.z": 13,
        "list.1.y.z.0": 14,
        "table": 17,
        "table.k": 18,
    }
    assert lines["quoted key", "and literal", "v"] == 20
    assert lines["array", 0, "n"] == 22
    assert lines["array", 0, "sub", "s"] == 24
    assert lines["array", 1, "n"] == 26
    assert lines["array", 1, "deep", 1, "d"] == 30


def paths_of(value, path=()):
    if path:
        yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield from paths_of(inner, (*path, key))


@pytest.mark.parametrize("text", [SAMPLE, SAMPLE.rstrip("\n"), "", "# only\n", "a={}\nb=[]\n", "a=''\nb=\"\"\n"])
def test_the_scanner_finds_exactly_the_paths_that_tomllib_reads(text):
    assert set(key_lines(text)) == set(paths_of(tomllib.loads(text)))


ALPHABET = [*"ab1.=[]{},\"'#\n -\\", '"""', "'''", "\n[", "\n[[", "]]\n", " = ", "a = ", "\n"]


@given(st.lists(st.sampled_from(ALPHABET), max_size=25).map("".join))
def test_whatever_tomllib_reads_the_scanner_reads_too(text):
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    assert set(key_lines(text)) == set(paths_of(document))


@given(st.text(max_size=60) | st.lists(st.sampled_from(ALPHABET), max_size=25).map("".join))
def test_no_text_raises_anything_but_a_file_error(text):
    try:
        loads(text, Robot)
    except FileError as error:
        assert error.problems  # noqa: PT017 - a text may as well be valid
        assert all(problem.line >= 0 and problem.message for problem in error.problems)  # noqa: PT017


@pytest.mark.parametrize(
    "text", ["[axis]\n2 = { torque_limit_nm = 7.1 Nm }\n", "[axis.2]\ntorque_limit_nm = 7.1Nm # of the sheet\n"]
)
def test_a_unit_behind_a_number_is_named(text):
    ((line, key, found, expected),) = problems(text)
    assert (line, key, found) == (2, "torque_limit_nm", "7.1 Nm: a unit behind the number")
    assert expected == "the number alone, the unit is in the key's name"


def test_a_contradiction_names_the_key_that_its_table_calls_wrong():
    class Twice(Table):
        first: int
        second: int

        @pydantic.model_validator(mode="after")
        def _different(self):
            raise files.WrongKeyError("the same as first", ("second",))

    assert problems("first = 1\nsecond = 1\n", Twice) == [(2, "second", "the same as first", "")]
