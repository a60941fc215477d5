"""SDO transfers that are overheard: contents, refusals, silence, and two clients on one channel."""

from pathlib import Path

import numpy as np

from hil.logs.log import Damage, LogBuilder
from hil.logs.nodes import nodes_of
from hil.logs.overheard import AbortedTransfer, OverheardValue, OverlappingRequest, UnansweredRequest, overheard


def log_of(*frames):
    builder = LogBuilder(Path("made.log"))
    for time_s, can_id, data in frames:
        builder.add(
            np.array([round(time_s * 1e9)]), np.array([can_id], np.uint32), np.array([len(data)], np.uint8),
            np.array([int.from_bytes(data, "little")], np.uint64),
        )  # fmt: skip
    return builder.log(Damage())


def hexed(text):
    return bytes.fromhex(text.replace(" ", ""))


def test_expedited_transfers_of_every_length():
    log = log_of(
        (0.0, 0x602, hexed("2F 60 60 00 08 00 00 00")), (0.001, 0x582, hexed("60 60 60 00 00 00 00 00")),
        (0.01, 0x602, hexed("40 41 60 00 00 00 00 00")), (0.011, 0x582, hexed("4B 41 60 00 31 02 00 00")),
        (0.02, 0x602, hexed("40 64 60 00 00 00 00 00")), (0.021, 0x582, hexed("43 64 60 00 FF FF FF FF")),
    )  # fmt: skip
    assert [(each.address, each.data, each.is_write) for each in overheard(log) if isinstance(each, OverheardValue)] == [
        ((0x6060, 0), b"\x08", True), ((0x6041, 0), b"\x31\x02", False), ((0x6064, 0), b"\xff\xff\xff\xff", False),
    ]  # fmt: skip


def test_a_segmented_upload_is_put_together():
    log = log_of(
        (0.0, 0x602, hexed("40 08 10 00 00 00 00 00")), (0.001, 0x582, hexed("41 08 10 00 0A 00 00 00")),
        (0.002, 0x602, hexed("60 00 00 00 00 00 00 00")), (0.003, 0x582, b"\x00servo d"),
        (0.004, 0x602, hexed("70 00 00 00 00 00 00 00")), (0.005, 0x582, b"\x19riv\0\0\0\0"),
    )  # fmt: skip
    [access] = overheard(log)
    assert isinstance(access, OverheardValue)
    assert access.data == b"servo driv"[: len(access.data)]
    assert len(access.data) == 10


def test_a_segmented_download_is_put_together():
    log = log_of(
        (0.0, 0x602, hexed("21 18 20 00 09 00 00 00")), (0.001, 0x582, hexed("60 18 20 00 00 00 00 00")),
        (0.002, 0x602, b"\x00abcdefg"), (0.003, 0x582, hexed("20 00 00 00 00 00 00 00")),
        (0.004, 0x602, b"\x1bhi\0\0\0\0\0"), (0.005, 0x582, hexed("30 00 00 00 00 00 00 00")),
    )  # fmt: skip
    [access] = overheard(log)
    assert isinstance(access, OverheardValue)
    assert (access.data, access.is_write) == (b"abcdefghi", True)


def test_an_abort_is_a_refusal_with_its_code():
    log = log_of((0.0, 0x602, hexed("23 40 60 00 00 00 00 00")), (0.001, 0x582, hexed("80 40 60 00 02 00 01 06")))
    [refusal] = overheard(log)
    assert isinstance(refusal, AbortedTransfer)
    assert (refusal.code, refusal.address, refusal.by_server) == (0x06010002, (0x6040, 0), True)


def test_a_request_that_nobody_answers_and_two_clients_at_once():
    request = hexed("40 41 60 00 00 00 00 00")
    [silent] = overheard(log_of((0.0, 0x602, request), (2.0, 0x080, b"")))
    assert isinstance(silent, UnansweredRequest)
    events = overheard(log_of((0.0, 0x602, request), (0.001, 0x602, hexed("40 64 60 00 00 00 00 00"))))
    assert isinstance(events[0], OverlappingRequest)


def test_what_was_put_back_behind_the_motion_does_not_count():
    syncs = [(1.0 + 0.01 * k, 0x080, b"") for k in range(100)]
    write = hexed("2F 60 60 00 08 00 00 00"), hexed("60 60 60 00 00 00 00 00")
    back = hexed("2F 60 60 00 01 00 00 00"), hexed("60 60 60 00 00 00 00 00")
    read = hexed("40 98 60 00 00 00 00 00"), hexed("4F 98 60 00 23 00 00 00")
    log = log_of(
        (0.0, 0x602, write[0]), (0.001, 0x582, write[1]), *syncs, (3.0, 0x602, back[0]), (3.001, 0x582, back[1]),
        (3.1, 0x602, read[0]), (3.101, 0x582, read[1]),
    )  # fmt: skip
    node = nodes_of(log, overheard(log), {})[2]
    assert node.value(0x6060) == 8
    assert node.value(0x6098) == 0x23  # what was only read held all the time
