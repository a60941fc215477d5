"""Fault confinement and queues of a bus by themselves, without a wire: who counts, who goes, and what is lost with it."""

import pytest

from hil.can.frame import Frame
from plant_emulator.bus.attempt import Attempt, Port, QueuedFrame
from plant_emulator.bus.confinement import RECOVERY_BITS, SUSPEND_BITS, Confinement
from plant_emulator.bus.controller import ErrorState
from plant_emulator.bus.queues import Queues
from plant_emulator.bus.rates import Rates
from plant_emulator.bus.traffic import Statistics

RATES = Rates(1_000_000)
BIT_NS = 1000
ROOM = 3


class Bus:
    """Two ports, their queues and their confinement."""

    def __init__(self):
        self.ports = {number: Port(number) for number in (1, 2)}
        self.counts = Statistics()
        self.queues = Queues(self.ports, RATES, self.counts, ROOM)
        self.confinement = Confinement(self.ports, RATES, self.counts, self.queues)

    def offer(self, number, can_id=0x181):
        return self.queues.accept(self.ports[number], 0, 0, Frame(can_id, b"\1"))

    def counters(self, number):
        controller = self.ports[number].controller
        return controller.tec, controller.rec

    def begun(self):
        """An attempt of port 1's frame."""
        attempt = Attempt(0, (self.ports[1].queue[0],), RATES)
        self.queues.take(attempt)
        return attempt

    def failed(self):
        """The attempt of port 1's frame, destroyed on its way."""
        attempt = self.begun()
        attempt.senders[0].destroyed = 1
        attempt.disturb(self.ports.values(), RATES)
        self.confinement.judge(attempt)


@pytest.fixture
def bus():
    return Bus()


def test_a_full_queue_takes_no_more(bus):
    assert all(bus.offer(1) for _ in range(ROOM))
    assert not bus.offer(1)
    assert bus.counts.longest_queue == ROOM


def test_a_destroyed_frame_costs_its_sender_eight_and_its_hearer_one_and_goes_back(bus):
    bus.offer(1)
    bus.failed()
    assert bus.counters(1) == (8, 0)
    assert bus.counters(2) == (0, 1)
    assert bus.confinement.is_troubled
    assert set(bus.queues.waiting) == {1}
    assert bus.counts.errors == 1


def test_a_passive_sender_waits_eight_bits_longer(bus):
    bus.ports[1].controller.transmit_failed(17)
    bus.offer(1)
    attempt = bus.begun()
    bus.confinement.judge(attempt)
    assert bus.ports[1].not_before == attempt.idle + SUSPEND_BITS * BIT_NS


def test_bus_off_is_noted_and_loses_the_queue_and_a_restart_brings_the_port_back(bus):
    bus.offer(1)
    bus.offer(1)
    bus.confinement.switch_off(bus.ports[1])
    assert bus.ports[1].controller.state is ErrorState.OFF
    assert not bus.queues.waiting
    assert bus.counts.lost == 2
    assert [*bus.confinement.switched] == [(1, True)]
    assert not bus.offer(1)
    bus.confinement.restart(bus.ports[1], 10)
    assert [*bus.confinement.switched] == [(1, True), (1, False)]
    assert bus.ports[1].not_before == 10 + RECOVERY_BITS * BIT_NS


def test_a_restart_of_a_port_that_is_not_off_does_nothing(bus):
    bus.confinement.restart(bus.ports[1], 10)
    assert not bus.confinement.switched


def test_a_stuck_bus_fails_the_frame_on_it_and_raises_all_counters(bus):
    attempt = Attempt(0, (QueuedFrame(Frame(0x181, b""), bus.ports[1], 0, RATES),), RATES)
    bus.confinement.stick(attempt, 0, 30 * BIT_NS, 40 * BIT_NS)
    assert bus.counters(1) == (8 * (1 + 2), 0)  # at once, after the 14th dominant bit of the 29 that follow, and after eight more
    assert bus.counters(2) == (0, 1 + 8 * 2)
    assert set(bus.queues.waiting) == {1}
