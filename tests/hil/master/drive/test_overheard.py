"""Scope and export scale a log alike: by what was heard or stated of a drive, never by how it was delivered."""

import math
from pathlib import Path

import pytest

import drive_profiles
from drive_profiles.eds.description import load
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType
from hil.bench.bench import load_bench
from hil.export.decoded import NodeUnits
from hil.logs.nodes import Node, described_node
from hil.master.drive.needs import Need
from hil.master.drive.scale import OverheardQuestions
from hil.scope.readers import scales_of

EDS = Path(drive_profiles.__file__).parent / "vendors" / "emulated_drive.eds"
COUNTS, RATED_MNM = 4096, 2000
SCALES = {(0x608F, 1): COUNTS, (0x608F, 2): 1, (0x6076, 0): RATED_MNM, (0x6091, 1): 1, (0x6091, 2): 1} | {
    (0x6092, 1): COUNTS,
    (0x6092, 2): 1,
}


def as_scope(node, bench):
    """rad per unit and N·m per mille; None where the scope shows what is on the bus."""
    table = bench.axis[2] if bench is not None else None
    found = scales_of(node, 2, table, None if table is None else Profile.load(table.profile))
    return (None if found.rev_per_count is None else found.rev_per_count * 2.0 * math.pi), found.nm_per_mille


def as_export(node, bench):
    units = NodeUnits(node, bench)
    position, torque = units.of((0x6064, 0)), units.of((0x6077, 0))
    return (position.factor if position.unit else None), (torque.factor if torque.unit else None)


@pytest.fixture(params=[as_scope, as_export])
def scaled(request):
    return request.param


@pytest.fixture(params=["reference", None])
def bench(request):
    return None if request.param is None else load_bench(request.param)


def described(text, tmp_path, name):
    """A node as a description has it, with its position in a PDO: else nobody asks for its scale."""
    mapped = text
    for entry, value in (("1A00sub0", "1"), ("1A00sub1", "0x60640020")):
        start = mapped.index("DefaultValue", mapped.index(f"[{entry}]"))
        mapped = f"{mapped[:start]}DefaultValue={value}{mapped[mapped.index(chr(10), start) :]}"
    (tmp_path / name).write_text(mapped, encoding="utf-8")
    return described_node(2, load(tmp_path / name, node_id=2))


def dcf(text):
    """A DCF of the drive: each scale with its parameter's value."""
    for (index, subindex), value in SCALES.items():
        name = f"[{index:04X}sub{subindex}]" if (index, 1) in SCALES else f"[{index:04X}]"
        place = text.index("\n", text.index(name)) + 1
        text = f"{text[:place]}ParameterValue={value}\n{text[place:]}"
    return text


def test_what_was_heard_is_the_scale(scaled, bench, tmp_path):
    node = described(EDS.read_text(encoding="utf-8"), tmp_path, "drive.eds")
    node.values |= SCALES
    node.heard |= set(SCALES)
    assert scaled(node, bench) == pytest.approx((2.0 * math.pi / COUNTS, RATED_MNM * 1e-6))


def test_the_default_of_a_description_is_no_scale(scaled, bench, tmp_path):
    node = described(EDS.read_text(encoding="utf-8"), tmp_path, "drive.eds")
    assert node.value(0x608F, 1) == 1 << 17  # how it was delivered
    assert scaled(node, bench) == (None, None)


def test_a_parameters_value_that_a_dcf_states_is_the_scale(scaled, bench, tmp_path):
    node = described(dcf(EDS.read_text(encoding="utf-8")), tmp_path, "drive.dcf")
    assert scaled(node, bench) == pytest.approx((2.0 * math.pi / COUNTS, RATED_MNM * 1e-6))


def test_what_was_heard_goes_before_what_a_dcf_states(scaled, bench, tmp_path):
    node = described(dcf(EDS.read_text(encoding="utf-8")), tmp_path, "drive.dcf")
    heard = {(0x608F, 1): 2 * COUNTS, (0x6092, 1): 2 * COUNTS}
    node.values |= heard
    node.heard |= set(heard)
    assert scaled(node, bench)[0] == pytest.approx(math.pi / COUNTS)


def test_a_drive_that_may_count_by_its_feed_has_no_scale_by_the_standard(scaled, tmp_path):
    node = described(dcf(EDS.read_text(encoding="utf-8")), tmp_path, "drive.dcf")
    node.values[0x6092, 1] = 360_000
    node.heard.add((0x6092, 1))
    assert scaled(node, None)[0] is None


@pytest.mark.parametrize(
    ("content", "kind", "read"),
    [
        (-1, None, 0xFFFFFFFF),
        (-1, DataType.INTEGER32, -1),
        (0xFFFFFFFF, DataType.INTEGER32, -1),
        (0xFF, DataType.INTEGER8, -1),
        (0x1_0000_0000, None, 0x1_0000_0000),
    ],
)
def test_a_number_has_the_sign_that_its_type_says_as_where_the_master_reads_it(content, kind, read):
    node = Node(2, {(0x608F, 1): content}, {(0x608F, 1)})
    asked = OverheardQuestions(node)
    assert asked.number(Need((0x608F, 1), "increments", ""), kind) == read
    assert asked.missing == []


def test_what_nobody_has_said_is_missing_unless_it_is_optional():
    asked, need = OverheardQuestions(Node(2, {(0x608F, 1): 4096})), Need((0x608F, 1), "increments", "")
    assert asked.number(need, is_optional=True) is None
    assert asked.missing == []
    assert asked.number(need) is None
    assert asked.missing == [need]
