"""A folder of vendors' files, as they are found in the field: all of them are read, and nothing of them is lost or bent.

The folder is named by the environment variable HIL_EDS_CORPUS, else it is ``shared/eds`` beside the repository. The stranger is
canopen's own reader, on the files that it takes: both must see the same, but for the faults that it passes over in silence.
"""

import logging
import os
import time
from functools import cache
from pathlib import Path

import canopen
import pytest
from canopen.objectdictionary import ODVariable

from drive_profiles import eds
from drive_profiles.eds import values as eds_values
from drive_profiles.eds.export import as_text, entries
from drive_profiles.eds.variables import Content

CORPUS = Path(os.environ.get("HIL_EDS_CORPUS", Path(__file__).parents[4] / "shared" / "eds"))
FILES = sorted(path for path in CORPUS.glob("*") if path.suffix.lower() in {".eds", ".dcf", ".xdd"}) if CORPUS.is_dir() else []
NODE_ID = 5
LONGEST_S = 30.0
"""No measure of speed, but the end of a reader that has lost its way."""

pytestmark = pytest.mark.skipif(not FILES, reason=f"no folder of vendors' files at {CORPUS}; HIL_EDS_CORPUS names one")
each_file = pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)


@cache
def description_of(path: Path, node_id: int | None = NODE_ID) -> eds.Description:
    """A file that is read once; nobody changes it."""
    return eds.load(path, node_id=node_id)


def facts(variable: ODVariable) -> dict[str, object]:
    names = ("name", "data_type", "access_type", "pdo_mappable", "min", "max", "default", "value", "relative")
    return {name: getattr(variable, name) for name in names}


def variables(dictionary: canopen.ObjectDictionary) -> dict[tuple[int, int], ODVariable]:
    return {(variable.index, variable.subindex): variable for _, variable in entries(dictionary)}


@pytest.mark.slow
@each_file
def test_every_file_is_read_to_its_end(path):
    start = time.process_time()
    description = description_of(path, None)
    assert time.process_time() - start < LONGEST_S
    assert len(description.dictionary) > 30
    assert not description.refused


@pytest.mark.slow
@each_file
def test_no_number_is_outside_its_type(path):
    for variable in variables(description_of(path).dictionary).values():
        limits = eds_values.limits_of(variable.data_type)
        for number in (variable.default, variable.min, variable.max, variable.value):
            if limits is not None and number is not None:
                assert limits[0] <= number <= limits[1]


@pytest.mark.slow
@each_file
def test_canopen_s_reader_sees_the_same_but_for_its_silent_faults(path):
    logging.getLogger("canopen").setLevel(logging.CRITICAL)
    try:
        stranger = canopen.import_od(str(path), node_id=NODE_ID)
    except Exception as error:  # noqa: BLE001 - it stops in many ways
        pytest.skip(f"canopen does not read it: {type(error).__name__}")
    description = description_of(path)
    ours, theirs = variables(description.dictionary), variables(stranger)
    warned = {problem.key for problem in description.warnings}
    assert {index: type(item) for index, item in description.dictionary.indices.items()} == {
        index: type(item) for index, item in stranger.indices.items()
    }
    assert ours.keys() == theirs.keys()
    for key, variable in ours.items():
        mine, other = facts(variable), facts(theirs[key])
        for name in mine:
            if mine[name] != other[name]:
                assert is_silent_fault(name, mine[name], other[name], warned, variable), (key, name, mine[name], other[name])


def is_silent_fault(name: str, ours: object, theirs: object, warned: set[str], variable: ODVariable) -> bool:
    """Where canopen's reader errs: bit patterns, $NODEID behind its number, values out of range, empty values kept."""
    section = f"[{variable.index:04X}"
    told = any(key.lower().startswith(section.lower()) for key in warned)
    if ours is None and theirs in {"", b""}:
        return True
    if name == "relative":
        return told and ours is True
    limits = eds_values.limits_of(variable.data_type)
    assert limits is not None
    return (
        told and isinstance(theirs, int) and not limits[0] <= theirs <= limits[1] and (ours is None or (theirs - ours) % 256 == 0)
    )


@pytest.mark.slow
@each_file
@pytest.mark.parametrize("kind", ["eds", "dcf"])
def test_a_clean_copy_has_no_faults_and_says_the_same(path, kind):
    description = description_of(path)
    again = eds.loads(as_text(description, kind).encode(), f"copy.{kind}", node_id=NODE_ID)
    # What remains is wrong with the device, and no way of writing mends it.
    assert [problem.message for problem in again.warnings if problem.message != "no sub-index 0"] == []
    ours, theirs = variables(description.dictionary), variables(again.dictionary)
    left_out = {"value"} if kind == "eds" else set()
    for key, variable in ours.items():
        if 7 < key[0] < 0x1000:
            continue  # dummies that canopen's exporter does not know
        expected = {name: fact for name, fact in facts(variable).items() if name not in left_out}
        assert {name: fact for name, fact in facts(theirs[key]).items() if name not in left_out} == expected


@pytest.mark.slow
@each_file
def test_values_are_written_without_touching_anything_else(path):
    description = description_of(path)
    if description.file_format == "xdd":
        pytest.skip("an XDD file is not rewritten")
    assert description.rewrite({}) == path.read_bytes()
    wanted: dict[tuple[int, int], Content] = {}
    for key, variable in variables(description.dictionary).items():
        limits = eds_values.limits_of(variable.data_type)
        if limits is not None and key[0] >= 0x2000 and len(wanted) < 20:
            wanted[key] = limits[0]
    again = eds.loads(description.rewrite(wanted), path, node_id=NODE_ID)
    assert {key: again.values[key] for key in wanted} == wanted
    assert {key: value for key, value in again.values.items() if key not in wanted} == {
        key: value for key, value in description.values.items() if key not in wanted
    }


@pytest.mark.slow
@each_file
def test_the_sync_period_s_exponent_is_small_and_negative(path):
    dictionary = description_of(path, None).dictionary
    item = dictionary.indices.get(0x60C2)
    default = item.subindices[2].default if item is not None and 2 in item.subindices else None
    assert default is None or -128 <= default <= 63


def test_parameter_values_of_both_spellings_are_offered():
    counts = {path.name: len(description_of(path).values) for path in FILES if path.suffix == ".dcf"}
    for name, count in {"Elmo_Gold-Whistle_V002.dcf": 298, "Technosoft_ISD860.dcf": 84, "Pilz_PRBT_0_1.dcf": 29}.items():
        assert counts.get(name, count) == count
