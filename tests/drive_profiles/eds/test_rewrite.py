"""A file with other parameter values: they are read back from it, and no other byte has changed."""

import difflib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_profiles import eds
from drive_profiles.eds import values as eds_values
from drive_profiles.eds.export import entries
from drive_profiles.errors import FileError

QUIRKS = Path(__file__).parent / "quirks"
COMPACT = {0x1016, 0x1028}
TEXTS = st.text(st.characters(codec="latin-1", categories=("L", "N", "P", "S", "Zs")), min_size=1, max_size=30)


def files() -> dict[str, bytes]:
    """Each with its line ends and its encoding."""
    configured = (QUIRKS / "configured.dcf").read_bytes()
    return {
        "configured": configured,
        "crlf": configured.replace(b"\n", b"\r\n"),
        "dos": configured.replace(b"\n", b"\r\n").replace(b"axis 1", "Größe".encode("cp850")),
        "no last line end": configured.rstrip(),
        "numbers": (QUIRKS / "numbers.eds").read_bytes(),
        "structure": (QUIRKS / "structure.eds").read_bytes(),
    }


FILES = files()
READ = {name: eds.loads(data) for name, data in FILES.items()}


def some_value(data_type: int) -> st.SearchStrategy:
    limits = eds_values.limits_of(data_type)
    if limits is not None:
        return st.integers(*limits)
    if data_type in eds_values.REALS:
        return st.floats(allow_nan=False, allow_infinity=False, width=eds_values.REALS[data_type])
    return (
        TEXTS.filter(lambda text: text == text.strip() and text.isprintable())
        if data_type == 0x09
        else st.binary(min_size=1, max_size=20)
    )


@pytest.mark.slow
@settings(max_examples=60)
@given(st.data())
def test_the_values_are_read_back_and_every_other_line_is_as_it_was(data):
    name = data.draw(st.sampled_from(sorted(FILES)))
    description = READ[name]
    variables = {
        (variable.index, variable.subindex): variable
        for _, variable in entries(description.dictionary)
        if variable.index in range(0x1000, 0x10000)
        and not (variable.index in COMPACT and variable.subindex == 0)
        and not (0x1401 <= variable.index < 0x2000)
    }
    keys = data.draw(st.lists(st.sampled_from(sorted(variables)), unique=True, max_size=6))
    wanted = {key: data.draw(some_value(variables[key].data_type), label=str(key)) for key in keys}
    try:
        rewritten = description.rewrite(wanted)
    except FileError as error:
        assert "encoding" in str(error)  # noqa: PT017 - a text that the file's code page lacks, which only the drawing decides
        assert name == "dos"
        return
    again = eds.loads(rewritten)
    assert {key: again.values[key] for key in wanted} == wanted
    assert {key: value for key, value in again.values.items() if key not in wanted} == {
        key: value for key, value in description.values.items() if key not in wanted
    }
    # A value takes one line; a compact array may need a section with a count for it, and a last line without an end gets one.
    old, new = FILES[name].splitlines(keepends=True), rewritten.splitlines(keepends=True)
    compact = {index for index, _ in keys if index in COMPACT}
    allowed = len(keys) + 3 * len(compact) + (name == "no last line end")
    steps = [step for step in difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes() if step[0] != "equal"]
    assert sum(max(end - start, new_end - new_start) for _, start, end, new_start, new_end in steps) <= allowed
    for _, start, end, new_start, new_end in steps:
        for line in (*old[start:end], *new[new_start:new_end]):
            assert compact or line.startswith(b"ParameterValue") or line in {old[-1], old[-1] + b"\n"}


@pytest.mark.parametrize("name", sorted(FILES))
def test_nothing_to_write_is_the_same_file(name):
    assert READ[name].rewrite({}) == FILES[name]


def test_one_value_is_one_line():
    description = READ["crlf"]
    rewritten = description.rewrite({(0x2001, 0): 5, (0x2005, 0): 1})
    assert rewritten == FILES["crlf"].replace(b"=0xFFFE # minus", b"=5 # minus").replace(
        b"DefaultValue=true\r\n", b"DefaultValue=true\r\nParameterValue=1\r\n"
    )


def test_values_of_a_compact_array_get_their_section():
    rewritten = READ["configured"].rewrite({(0x1028, 2): 9, (0x1016, 1): 1, (0x1016, 4): 4})
    assert b"CompactSubObj=2\n\n[1028Value]\nNrOfEntries=1\n2=9\n" in rewritten
    assert b"[1016Value]\nNrOfEntries=3\n1=1\n3=7\n4=4\n" in rewritten


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({(0x2001, 0): 40_000}, "INTEGER16"),
        ({(0x2001, 0): "5"}, "INTEGER16"),
        ({(0x2001, 0): 1.0}, "INTEGER16"),
        ({(0x2002, 0): " blank in front"}, "blanks around it"),
        ({(0x2002, 0): "two\nlines"}, "does not print"),
        ({(0x2002, 0): ""}, "empty"),
        ({(0x2000, 0): float("nan")}, "nan"),
        ({(0x2FFF, 0): 1}, "2FFF:00: is not an object"),
        ({(0x1200, 9): 1}, "1200:09: is not an object"),
        ({(0x1800, 1): 1}, "1800:01: is not an object with a section"),
        ({(0x1016, 0): 1}, "1016:00: is not an object with a section"),
    ],
)
def test_what_cannot_be_written_is_refused_with_its_place(values, words):
    with pytest.raises(FileError, match=words):
        READ["configured"].rewrite(values)


def test_a_character_that_the_file_cannot_hold_is_refused():
    with pytest.raises(FileError, match="encoding"):
        READ["dos"].rewrite({(0x2002, 0): "日"})
