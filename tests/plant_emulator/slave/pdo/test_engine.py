"""What PDOs do at SYNC, on arrival, on change and by their timers."""

import struct

import pytest

from drive_profiles.standard.cia301 import NmtCommand, SdoAbortCode
from plant_emulator.slave.objects import PdoDefault

MS = 1_000_000
STATUS, CONTROL = ((0x6041, 0, 16),), ((0x6040, 0, 16),)
INVALID = 0x80000000


def status(value):
    return (0x185, struct.pack("<H", value))


# At SYNC


def test_at_sync_the_tpdo_is_sampled_before_the_rpdo_is_in_force_and_the_owner_comes_last(running):
    seen = []
    running.dictionary.on_read(0x6041, 0, lambda: seen.append("sampled") or 1)
    running.dictionary.on_write(0x6040, 0, lambda value: seen.append(f"control {value}"))
    running.slave.on_sync = lambda now: seen.append(f"sync {now}")
    running.now = 7
    running.send(0x205, struct.pack("<Hi", 15, -1))
    assert seen == []
    assert running.sync() == [(0x185, struct.pack("<Hih", 1, 0, 0))]
    assert seen == ["sampled", "control 15", "sync 7"]


def test_live_values_are_those_of_the_instant_of_sync(running):
    values = iter(range(10))
    running.dictionary.on_read(0x6064, 0, lambda: next(values))
    assert [running.sync()[0].data[2] for _ in range(3)] == [0, 1, 2]


@pytest.mark.parametrize("data", [b"", b"\x01", b"\xf0"])
def test_sync_comes_with_or_without_its_counter(running, data):
    assert len(running.sync(data)) == 1


def test_a_sync_that_is_too_long_is_an_error_until_the_next_right_one(running):
    syncs = []
    running.slave.on_sync = syncs.append
    assert [frame.data[:3] for frame in running.sync(b"\1\2")] == [b"\x40\x82\x11"]
    assert running.sync(b"\1\2") == []
    assert syncs == []
    assert [frame.can_id for frame in running.sync()] == [0x085, 0x185]


def test_of_several_frames_the_last_one_counts(running):
    for target in (1, 2, 3):
        running.send(0x205, struct.pack("<Hi", 0, target))
    running.sync()
    assert running.dictionary.get(0x607A) == 3


def test_a_frame_is_put_in_force_once(running):
    written = []
    running.dictionary.on_write(0x6040, 0, written.append)
    running.send(0x205, struct.pack("<Hi", 15, 0))
    for _ in range(3):
        running.sync()
    assert written == [15]


@pytest.mark.parametrize("transmission_type", [1, 2, 3, 240])
def test_types_1_to_240_are_sent_every_nth_sync(make_bench, transmission_type):
    bench = make_bench(tpdos=[PdoDefault(STATUS, transmission_type)])
    bench.start()
    sent = [bool(bench.sync()) for _ in range(2 * transmission_type)]
    assert sent == ([False] * (transmission_type - 1) + [True]) * 2


def test_type_0_is_sent_at_sync_and_only_after_a_change(make_bench):
    bench = make_bench(tpdos=[PdoDefault(STATUS, 0)])
    assert bench.start() == []
    assert bench.sync() == [status(0)]
    assert bench.sync() == []
    bench.dictionary.set(0x6041, 0, 7)
    assert bench.slave.advance(bench.now) == []
    assert bench.sync() == [status(7)]
    assert bench.sync() == []


@pytest.mark.parametrize("transmission_type", [0, 1, 240])
def test_synchronous_rpdos_wait_for_sync(make_bench, transmission_type):
    bench = make_bench(rpdos=[PdoDefault(CONTROL, transmission_type)])
    bench.start()
    bench.send(0x205, b"\x0f\x00")
    assert bench.dictionary.get(0x6040) == 0
    bench.sync()
    assert bench.dictionary.get(0x6040) == 15


def test_the_cob_id_of_sync_can_be_changed(running):
    assert running.write_value(0x1005, 0, 0x90) is None
    assert running.sync() == []
    assert len(running.send(0x090)) == 1
    for refused in (0x40000080, 0x20000080, 0x800, 0x605, 0):
        assert running.write_value(0x1005, 0, refused) is SdoAbortCode.INVALID_VALUE
    running.nmt(NmtCommand.RESET_COMMUNICATION)
    running.start()
    assert len(running.sync()) == 1


# On arrival


@pytest.mark.parametrize("transmission_type", [254, 255])
def test_event_driven_rpdos_are_in_force_at_once(make_bench, transmission_type):
    bench = make_bench(rpdos=[PdoDefault(CONTROL, transmission_type)])
    bench.start()
    bench.send(0x205, b"\x0f\x00")
    assert bench.dictionary.get(0x6040) == 15


def test_a_short_frame_is_ignored_and_told_until_a_right_one_comes(running):
    assert [f.data[:3] for f in running.send(0x205, b"\x0f\x00")] == [b"\x10\x82\x11"]
    assert running.send(0x205, b"\x0f\x00") == []
    running.sync()
    assert running.dictionary.get(0x6040) == 0
    assert running.send(0x205, bytes(6)) == [(0x085, bytes(8))]


def test_a_long_frame_is_processed_and_told(running):
    assert [f.data[:3] for f in running.send(0x205, struct.pack("<HiH", 15, 9, 1))] == [b"\x20\x82\x11"]
    running.sync()
    assert (running.dictionary.get(0x6040), running.dictionary.get(0x607A)) == (15, 9)


def test_each_rpdo_has_its_own_length_error(make_bench):
    bench = make_bench(rpdos=[PdoDefault(CONTROL), PdoDefault(((0x607A, 0, 32),))])
    bench.start()
    bench.send(0x205, b"")
    bench.send(0x305, b"")
    assert bench.slave.emergencies.causes == ("RPDO 1 length", "RPDO 2 length")
    assert bench.send(0x205, b"\0\0") == []
    assert bench.slave.emergencies.causes == ("RPDO 2 length",)


def test_values_out_of_range_or_refused_are_not_written(make_bench):
    bench = make_bench(rpdos=[PdoDefault(((0x2000, 0, 16), (0x2003, 1, 32), (0x6040, 0, 16)))])
    bench.start()
    bench.send(0x205, struct.pack("<hfH", 101, float("nan"), 15))
    assert [bench.dictionary.get(*address) for address in ((0x2000, 0), (0x2003, 1), (0x6040, 0))] == [10, 1.5, 15]
    bench.dictionary.on_write(0x6040, 0, lambda value: SdoAbortCode.DEVICE_STATE)
    bench.send(0x205, struct.pack("<hfH", 5, 2.0, 31))
    assert [bench.dictionary.get(*address) for address in ((0x2000, 0), (0x2003, 1), (0x6040, 0))] == [5, 2.0, 15]


def test_one_frame_may_feed_two_rpdos(make_bench):
    bench = make_bench(rpdos=[PdoDefault(CONTROL), PdoDefault(((0x2002, 0, 16),))])
    bench.write_value(0x1401, 1, 0x205 | INVALID)
    bench.write_value(0x1401, 1, 0x205)
    bench.start()
    bench.send(0x205, b"\x0f\x00")
    assert (bench.dictionary.get(0x6040), bench.dictionary.get(0x2002)) == (15, 15)


def test_data_that_waits_does_not_survive_a_new_mapping(running):
    running.send(0x205, struct.pack("<Hi", 15, 9))
    running.write_value(0x1400, 1, 0x205 | INVALID)
    running.write_value(0x1600, 0, 0)
    running.write_value(0x1600, 1, 0x20050040)
    running.write_value(0x1600, 0, 1)
    running.write_value(0x1400, 1, 0x205)
    running.sync()
    assert (running.dictionary.get(0x6040), running.dictionary.get(0x2005)) == (0, 0)


def test_data_that_waits_does_not_survive_leaving_operational(running):
    running.send(0x205, struct.pack("<Hi", 15, 9))
    running.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    running.sync()
    running.start()
    running.sync()
    assert running.dictionary.get(0x6040) == 0


# On change


@pytest.mark.parametrize("transmission_type", [254, 255])
def test_event_driven_tpdos_are_sent_at_the_start_and_on_change(make_bench, transmission_type):
    bench = make_bench(tpdos=[PdoDefault(STATUS, transmission_type)])
    assert bench.start() == [status(0)]
    assert bench.sync() == []
    assert bench.slave.due is None
    assert bench.slave.advance(bench.now) == []
    bench.dictionary.set(0x6041, 0, 7)
    assert bench.slave.advance(bench.now) == [status(7)]
    assert bench.slave.advance(bench.now) == []


def test_a_change_that_a_frame_causes_leaves_with_its_answer(make_bench):
    bench = make_bench(tpdos=[PdoDefault(STATUS)], rpdos=[PdoDefault(CONTROL)])
    bench.start()
    bench.dictionary.on_read(0x6041, 0, lambda: bench.dictionary.get(0x6040) + 1)
    assert bench.send(0x205, b"\x0f\x00") == [status(16)]
    bench.slave.on_sync = lambda now: bench.dictionary.set(0x6040, 0, 1)
    assert bench.sync() == [status(2)]


def test_the_inhibit_time_holds_a_change_back(make_bench):
    bench = make_bench(tpdos=[PdoDefault(STATUS, inhibit_time=50)])
    bench.start()
    bench.dictionary.set(0x6041, 0, 1)
    assert bench.slave.advance(bench.now) == []
    assert bench.slave.due == 5 * MS
    bench.dictionary.set(0x6041, 0, 2)
    assert bench.wait(20) == [(5 * MS, status(2))]
    bench.dictionary.set(0x6041, 0, 3)
    assert bench.slave.advance(bench.now) == [status(3)]


def test_a_change_that_went_back_within_the_inhibit_time_is_not_sent(make_bench):
    bench = make_bench(tpdos=[PdoDefault(STATUS, inhibit_time=50)])
    bench.start()
    bench.dictionary.set(0x6041, 0, 1)
    bench.slave.advance(bench.now)
    bench.dictionary.set(0x6041, 0, 0)
    assert bench.wait(20) == []


def test_the_event_timer_sends_without_a_change_and_starts_anew_with_each_frame(make_bench):
    bench = make_bench(tpdos=[PdoDefault(STATUS, event_timer_ms=10)])
    bench.start()
    assert [time for time, _ in bench.wait(25)] == [10 * MS, 20 * MS]
    bench.dictionary.set(0x6041, 0, 1)
    assert bench.slave.advance(bench.now) == [status(1)]
    assert [time for time, _ in bench.wait(15)] == [35 * MS]
    bench.write_value(0x1800, 5, 0)
    assert bench.slave.due is None


def test_an_event_timer_below_the_inhibit_time_waits_for_it(make_bench):
    bench = make_bench(tpdos=[PdoDefault(STATUS, inhibit_time=200, event_timer_ms=10)])
    bench.start()
    assert [time for time, _ in bench.wait(50)] == [20 * MS, 40 * MS]


def test_timers_end_with_operational(make_bench):
    bench = make_bench(tpdos=[PdoDefault(STATUS, event_timer_ms=10)])
    bench.start()
    bench.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert bench.slave.due is None
    assert bench.wait(100) == []


def test_a_valid_pdo_without_objects_sends_nothing(make_bench):
    bench = make_bench()
    assert bench.start() == []
    assert bench.sync() == []
    assert bench.send(0x205, bytes(8)) == []


def test_a_value_that_its_object_cannot_hold_is_the_owners_mistake_and_named(running):
    running.dictionary.on_read(0x6064, 0, lambda: 2**31)
    with pytest.raises(ValueError, match="Position"):
        running.sync()


# The stranger


def test_a_stranger_configures_and_exchanges_pdos(stranger, bench):
    network = stranger.network
    for pdo in (stranger.tpdo[1], stranger.rpdo[1]):
        pdo.read()
    stranger.tpdo[1].clear()
    stranger.tpdo[1].add_variable("Torque")
    stranger.tpdo[1].add_variable("Position")
    stranger.tpdo[1].trans_type = 1
    stranger.tpdo[1].save()
    stranger.rpdo[1].clear()
    stranger.rpdo[1].add_variable("Target")
    stranger.rpdo[1].trans_type = 255
    stranger.rpdo[1].save()
    stranger.tpdo[3].read()
    stranger.tpdo[3].add_variable("Status word")
    stranger.tpdo[3].cob_id = 0x385
    stranger.tpdo[3].trans_type = 255
    stranger.tpdo[3].event_timer = 10
    stranger.tpdo[3].enabled = True
    stranger.tpdo[3].save()

    stranger.nmt.state = "OPERATIONAL"
    bench.dictionary.set(0x6077, 0, -5)
    bench.dictionary.set(0x6064, 0, 123456)
    network.sync.transmit()
    assert stranger.tpdo[1]["Torque"].raw == -5
    assert stranger.tpdo[1]["Position"].raw == 123456
    stranger.rpdo[1]["Target"].raw = -99
    stranger.rpdo[1].transmit()
    assert bench.dictionary.get(0x607A) == -99
    bench.dictionary.set(0x6041, 0, 0x237)
    network.wait(10)
    assert stranger.tpdo[3]["Status word"].raw == 0x237
