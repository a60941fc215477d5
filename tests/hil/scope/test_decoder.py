"""Frames become signals by what is heard, and none is lost between two pieces of a bus."""

import struct

import numpy as np
import pytest

from hil.bench.bench import load_bench
from hil.can.listening import FRAME_RECORD
from hil.scope.decoder import SignalDecoder
from hil.scope.past import Past
from tests.hil.scope.traffic import COUNTS_PER_REV, FAULT, Traffic


def decoded(heard, *, pieces=1, bench=None, bitrate=None):
    """All rows by signal, with their times and events, of frames that come in pieces."""
    decoder, past, events = SignalDecoder(bench, {}, bitrate), Past(kept_s=1e9), []
    for piece in np.array_split(heard, pieces):
        rows = decoder.feed(piece)
        past.add(rows.time_s, rows.values)
        events += rows.events
    _, time_s, values = past.since(0)
    return time_s, {signal.name: values[:, column] for column, signal in enumerate(decoder.signals)}, events, decoder


def test_signals_are_scaled_by_what_the_master_read():
    time_s, found, _, decoder = decoded(Traffic().set_up().run(100).heard())
    assert len(time_s) == 99  # the last row is whole with the next SYNC
    units = {signal.name: signal.unit for signal in decoder.signals}
    assert units["node 2 position"] == "rev"
    assert units["node 2 torque"] == "N·m"
    assert found["node 2 position"] == pytest.approx(np.arange(99) / COUNTS_PER_REV)
    assert found["node 2 torque"] == pytest.approx(np.full(99, 0.2))
    assert found["node 2 status word"][50] == 0x1637


def test_speed_and_following_error_follow_from_positions_and_set_points():
    _, found, _, _ = decoded(Traffic().set_up().run(100).heard())
    assert found["node 2 speed"][5:] == pytest.approx(np.full(94, 1000.0 / COUNTS_PER_REV))  # one count a millisecond
    # the set-point before SYNC n is n + 11 and is reached at SYNC n + 1, where the position is n + 1
    assert found["node 2 following error"][2:] == pytest.approx(np.full(97, 10.0 / COUNTS_PER_REV))


@pytest.mark.parametrize("pieces", [2, 7, 300])
def test_it_is_the_same_in_whatever_pieces_the_frames_come(pieces):
    heard = Traffic((2, 3, 5)).set_up().run(300, missing={(50, 3)}).heard()
    whole_s, whole, _, _ = decoded(heard)
    time_s, found, _, _ = decoded(heard, pieces=pieces)
    assert time_s.tolist() == whole_s.tolist()
    assert set(found) == set(whole)
    for name, values in whole.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-12, atol=1e-15, err_msg=name)


def test_an_answer_that_does_not_come_is_a_miss_in_its_cycle_and_no_value():
    _, found, _, _ = decoded(Traffic((2, 3)).set_up().run(100, missing={(40, 3), (41, 3), (41, 2)}).heard())
    assert np.flatnonzero(found["misses"]).tolist() == [40, 41]
    assert found["misses"][40:42].tolist() == [1.0, 2.0]
    assert np.flatnonzero(np.isnan(found["node 3 position"])).tolist() == [40, 41]


def test_a_node_that_was_told_to_stop_is_not_missed():
    traffic = Traffic((2, 3)).set_up().run(20)
    traffic.put(0x000, bytes([128, 0]))
    heard = traffic.run(20, missing={(cycle, node) for cycle in range(40) for node in (2, 3)}).heard()
    _, found, events, _ = decoded(heard, pieces=40)
    assert found["misses"][:19].sum() == 0
    assert found["misses"][21:].sum() == 0
    assert "NMT: enter pre operational" in [event.words for event in events]


def test_bus_load_is_that_of_the_frames_in_a_cycle():
    _, found, _, _ = decoded(Traffic().set_up().run(100).heard(), bitrate=1_000_000)
    # RPDO of 6 bytes, SYNC, TPDO of 8 bytes: 3 frames of 47 bits and 14 bytes, a tenth more for stuff bits, in 1 ms
    assert found["bus load"][10:90] == pytest.approx(np.full(80, 100.0 * 1.1 * (3 * 47 + 8 * 14) / 1000.0))


def test_an_emergency_is_told_in_words():
    traffic = Traffic().set_up().run(10)
    _, _, events, _ = decoded(traffic.emergency(2, 0x3310).run(5, status=FAULT).heard())
    [event] = [each for each in events if each.kind == "emcy"]
    assert (event.node, event.words) == (2, "emergency 3310h: output over-voltage")


def test_the_bench_file_tells_the_mapping_to_one_who_comes_late():
    heard = Traffic((2,)).run(50).heard()
    time_s, found, _, decoder = decoded(heard, bench=load_bench("reference"))
    assert len(time_s) == 49
    assert found["axis 2 status word"][10] == 0x1637
    assert {signal.unit for signal in decoder.signals if signal.name == "axis 2 position"} <= {"rev", "counts"}


def test_a_mapping_that_is_not_known_gives_the_bus_signals_alone():
    _, found, _, _ = decoded(Traffic((2,)).run(50).heard())
    assert set(found) == {"bus load", "misses", "SYNC interval"}


@pytest.mark.parametrize("pieces", [1, 30])
def test_a_mapping_that_changes_while_one_looks_on_is_followed(pieces):
    traffic = Traffic().set_up().run(50)
    traffic.write(2, 0x1A00, 0, 0, 1)
    traffic.write(2, 0x1A00, 1, 0x60640020, 4)
    traffic.write(2, 0x1A00, 2, 0x60770010, 4)
    traffic.write(2, 0x1A00, 0, 2, 1)
    for cycle in range(50):
        traffic.put(0x080)
        traffic.put(0x182, struct.pack("<ih", 5000 + cycle, -50))
        traffic.now_ns += 998_000
    _, found, _, _ = decoded(traffic.heard(), pieces=pieces)
    assert found["node 2 position"][:50] == pytest.approx(np.arange(50) / COUNTS_PER_REV)  # by the mapping of then
    assert found["node 2 position"][-1] == pytest.approx(5.048)
    assert found["node 2 torque"][-1] == pytest.approx(-0.1)


def test_a_set_up_is_looked_at_once_and_not_at_each_of_its_writes(monkeypatch):
    """Else who listens is busy for so long that the bus drops what comes behind the set-up."""
    parts, feed = [], SignalDecoder._feed
    monkeypatch.setattr(SignalDecoder, "_feed", lambda self, heard: (parts.append(len(heard)), feed(self, heard))[1])
    _, found, _, _ = decoded(Traffic((2, 3, 5)).set_up().run(10).heard())
    assert len(parts) <= 4  # a part for each drive, which is started between
    assert found["node 5 position"][5] == pytest.approx(5 / COUNTS_PER_REV)


def test_frames_that_are_cut_are_no_values():
    traffic = Traffic().set_up().run(20)
    for _ in range(10):
        traffic.put(0x080)
        traffic.put(0x182, b"\x37\x16\x01")
        traffic.now_ns += 998_000
    _, found, _, _ = decoded(traffic.heard())
    assert np.isnan(found["node 2 position"][20:]).all()


def test_a_bus_without_sync_is_shown_by_what_comes_most_often():
    traffic = Traffic().set_up()
    for cycle in range(200):
        traffic.put(0x182, struct.pack("<Hih", 0x1637, cycle, 0))
        traffic.now_ns += 999_000
    time_s, found, _, _ = decoded(traffic.heard(), pieces=10)
    assert len(time_s) > 100
    assert np.diff(found["node 2 position"]) == pytest.approx(np.full(len(time_s) - 1, 1e-3))


def test_no_bytes_make_it_fail():
    generator = np.random.default_rng(4)
    traffic = Traffic((2, 3)).set_up().run(50)
    noise = np.empty(3000, FRAME_RECORD)
    noise["stamp_ns"] = np.sort(generator.integers(0, 10**9, 3000)) + traffic.now_ns
    noise["can_id"] = generator.choice(
        [0, 0x80, 0x82, 0x182, 0x202, 0x582, 0x602, 0x702, 0x7E4, 0x20000004, 0x80012345, 0x40000182], 3000
    )
    noise["length"] = generator.integers(0, 9, 3000)
    noise["data"] = generator.integers(0, 2**63, 3000, dtype=np.uint64)
    time_s, _, _, _ = decoded(np.concatenate([traffic.heard(), noise]), pieces=50)
    assert len(time_s) > 40


def test_cycles_that_were_not_heard_are_said():
    traffic = Traffic().set_up().run(50)
    traffic.now_ns += 20_000_000
    time_s, _, events, _ = decoded(traffic.run(50).heard(), pieces=40)
    [gap] = [each for each in events if each.kind == "gap"]
    assert gap.words == "nothing heard for 21 ms"
    assert gap.time_s == pytest.approx(time_s[49])
