"""The npm package `canopen` as a master, in a process of its own, over the virtualcan port: it shares not a line with us."""

import itertools

import pytest

from drive_profiles.standard.cia301 import SdoAbortCode
from tests.strangers.conftest import forget_node_id

LONG_TEXT = 0x2FF0
"""The drive's rewritable text, the one object that takes a long transfer in both directions."""


def values(found, name):
    return [each[name] for each in found if name in each]


def test_it_reads_and_writes_by_expedited_transfers(master, served):
    found = master("expedited")
    assert values(found, "deviceType") == [0x0002_0192]
    assert values(found, "heartbeat") == [1234]
    assert values(found, "aborted") == [SdoAbortCode.NO_OBJECT, SdoAbortCode.NO_SUBINDEX, SdoAbortCode.READ_ONLY]
    assert served.drive.slave.dictionary.get(0x1017) == 1234


def test_it_reads_by_segments(master):
    assert master("segmented") == [{"name": "Emulated servo drive"}]


def test_it_writes_by_segments(master, served):
    text = "a text of more than seven bytes, and not a multiple of them"
    assert values(master("segmented", index=LONG_TEXT, text=text), "text") == [text]
    assert served.drive.slave.dictionary.get(LONG_TEXT) == text


def test_it_reads_and_writes_by_blocks_of_every_kind_of_length(master):
    sizes = [
        1,
        4,
        7,
        8,
        889,
        890,
        1024,
    ]  # one segment, full segments, one full block, more than a block, all that there is room for
    found = master("block", index=LONG_TEXT, sizes=sizes)
    assert values(found, "name") == ["Emulated servo drive"]
    assert [(each["size"], each["equal"]) for each in found if "size" in each] == [(size, True) for size in sizes]
    assert values(found, "small") == [sizes[-1]]


@pytest.mark.ci
def test_it_commands_every_state_sees_the_heartbeats_and_their_end(master):
    found = master("nmt")
    [states] = values(found, "states")
    assert [state for state, _ in itertools.groupby(states)][-4:] == [5, 4, 127, 0]
    assert values(found, "lost") == [3]  # what the reset has forgotten is the producer's time


def test_it_enables_the_drive_and_hears_it_by_pdo(master, served):
    found = master("pdo")
    assert [(each["word"], each["status"]) for each in found] == [(6, 0x21), (7, 0x23), (15, 0x27), (0, 0x40)]
    assert served.drive.slave.nmt_state.name == "OPERATIONAL"


def test_its_counted_syncs_are_obeyed(master):
    found = master("sync")
    [counters], [pdos], [syncs] = values(found, "counters"), values(found, "pdos"), values(found, "syncs")
    assert counters == [1, 2, 3, 4, 1, 2, 3, 4, 1, 2]
    assert pdos == syncs // 2
    assert values(found, "emergencies") == [0]


def test_it_is_told_of_an_emergency(master):
    found = master("emergency")
    assert values(found, "code") == [0x8210]  # a PDO that is too short
    assert values(found, "register")[0] & 0x11 == 0x11  # generic, communication
    assert values(found, "history") == [0x8210]


def test_its_time_is_taken(master, served):
    master("time", time="2026-01-02T03:04:05.678Z")
    since_1984_s = served.drive.slave.time_of_day / 1e9
    assert since_1984_s == pytest.approx(1_325_559_845.678, abs=5.0)


def test_its_fast_scan_finds_a_node_without_an_id_and_gives_it_one(master, served):
    """Without the package's search for the vendor, which would take seconds of time-outs."""
    drive = served.drive
    forget_node_id(served.join(), drive.slave.dictionary, drive.node_id)
    identity = {name: drive.slave.dictionary.get(0x1018, sub) for sub, name in enumerate(("vendorId", "productCode"), 1)}
    found = master("lss", to=0x20, known=identity)
    [scanned] = values(found, "identity")
    assert scanned == identity | {
        "revisionNumber": drive.slave.dictionary.get(0x1018, 3),
        "serialNumber": drive.slave.dictionary.get(0x1018, 4),
    }
    assert values(found, "serial") == [scanned["serialNumber"]]
    assert values(found, "deviceType") == [0x0002_0192]
    assert drive.node_id == 0x20
