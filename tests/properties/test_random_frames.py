"""A hundred thousand frames in each test run, a million in `make test-all`: no exception, no torque without right, no growth."""

import gc
import math
import os
import random
import tracemalloc
from collections import Counter
from itertools import islice

import pytest

from drive_profiles.standard.cia301 import NmtState
from plant_emulator.drive.inputs import INPUTS
from plant_emulator.motion import record
from plant_emulator.motion.axes import live
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.slave.sdo.server import SdoState
from plant_emulator.world import World
from tests.plant_emulator.rig import GAINS
from tests.properties.random_frames import RandomFrames
from tests.properties.watched import WatchedWorld

FRAMES = int(os.environ.get("HIL_RANDOM_FRAMES", "100000"))
OTHERS = 100_000
POWERED = {"OPERATION_ENABLED", "QUICK_STOP_ACTIVE", "FAULT_REACTION_ACTIVE"}
STATES = {"SWITCH_ON_DISABLED", "READY_TO_SWITCH_ON", "SWITCHED_ON", "FAULT", *POWERED}
UNDER_TORQUE = {
    *(
        (1, record.PROFILE),
        (3, record.PROFILE_VELOCITY),
        (4, record.PROFILE_TORQUE),
        (6, record.PROFILE),
        (6, record.PROFILE_VELOCITY),
    ),
    *((7, record.POSITION), (8, record.POSITION), (9, record.VELOCITY), (10, record.TORQUE)),
    *((mode, record.STOPPING) for mode in (1, 3, 4, 7, 8, 9, 10)),
}
"""Mode of operation and mode of the law: each that there is, homing at rest and in search, and stops."""
LONGEST_ANSWER = 127 + 64
"""Frames: the segments of one block of an upload, and what a node sends of its own besides."""

_reference = load_robot("reference").axis
ROBOT = Robot(
    axis={
        2: _reference[2].model_copy(update={"control": GAINS}),
        3: _reference[3].model_copy(update={"profile": "maxon_epos4"}),
    }
)
"""Our drive, a vendor's, and the accelerometer."""


class Bus:
    """A world that is told to survive, and is looked at after every frame."""

    def __init__(self, seed: int) -> None:
        self.world = World(ROBOT)
        self.world.power_on()
        self.chance = random.Random(seed)
        nodes = {d.node_id: d.slave for d in self.world.drives.values()} | {
            self.world.accelerometer.node_id: self.world.accelerometer.slave
        }
        self.places = {node: [(entry.index, entry.subindex) for entry in slave.dictionary] for node, slave in nodes.items()}
        self.slaves = list(nodes.values())
        self.entitled = dict.fromkeys(self.world.drives, False)
        self.drives = [(number, drive, drive.row) for number, drive in self.world.drives.items()]
        self.modes = live(self.world.axes.motion, "mode")
        self.torques = live(self.world.axes.motion, "torque_nm")
        self.states, self.under_torque, self.sdo_states, self.nmt_states = (Counter() for _ in range(4))

    @property
    def powered(self) -> int:
        """How many frames have met a drive under torque."""
        return self.under_torque.total()

    def play(self, frames: int, seed: int) -> None:
        """Send so many frames, with time between them, and sometimes a loss of power or a hand on the switches."""
        chance, world = self.chance.random, self.world
        for frame in islice(RandomFrames(seed, self.places), frames):
            answers = world.receive(frame)
            assert len(answers) <= LONGEST_ANSWER, frame
            draw = chance()
            if draw < 0.05:
                world.finish_period()
                time = self.chance.choice((1, 250_000, 1_000_000, 30_000_000))
                assert len(world.advance(world.now + time)) <= 8 * LONGEST_ANSWER
                self.look_at_the_torque()
            elif draw > 0.999:
                world.finish_period()
                self.interfere()
            self.look(frame)
        world.finish_period()

    def interfere(self) -> None:
        chance = self.chance
        drive = chance.choice(list(self.world.drives.values()))
        match chance.randrange(5):
            case 0 | 1:
                drive.inputs.set_sto(True)
                drive.inputs.set_sto(chance.random() < 0.1)
            case 2:
                drive.inputs.force(chance.randint(1, INPUTS), active=chance.random() < 0.3)
            case 3:
                drive.stage.motion["trip"] |= chance.choice((record.FOLLOWING, record.OVERSPEED, record.SET_POINT_LATE))
            case _ if chance.random() < 0.5:
                self.world.power_cycle(chance.choice(list(self.places)))

    def look(self, frame: object) -> None:
        """Judge every drive, and count where all have been: by names, whose hash is known, since this is done for every frame."""
        modes, torques = self.modes, self.torques
        for number, drive, row in self.drives:
            state, is_operational = drive.state._name_, drive.slave.nmt_state is NmtState.OPERATIONAL
            self.states[state] += 1
            if is_operational:
                self.entitled[number] = True
            if (mode := modes[row]) != record.BRAKED:
                assert state in POWERED, frame
                assert self.entitled[number], frame
                self.under_torque[0 if drive.mode is None else drive.mode._value_, mode] += 1
            if state not in POWERED:
                assert torques[row] == 0.0, frame
                self.entitled[number] = is_operational
        for slave in self.slaves:
            self.sdo_states[slave._sdo._predefined.state._name_] += 1
            self.nmt_states[slave.nmt_state._name_] += 1

    def look_at_the_torque(self) -> None:
        for number, drive in self.world.drives.items():
            assert abs(self.torques[drive.row]) <= self.world.robot.axis[number].torque_limit_nm

    def has_been_everywhere(self) -> bool:
        """Whether the frames have led into every state of the drives, the nodes and the SDO servers, and all modes."""
        missing = [
            STATES - set(self.states),
            UNDER_TORQUE - set(self.under_torque),
            {state.name for state in SdoState} - set(self.sdo_states),
            {"PRE_OPERATIONAL", "OPERATIONAL", "STOPPED"} - set(self.nmt_states),
        ]
        assert not any(missing), missing
        return True

    def is_finite(self) -> bool:
        state = self.world.axes.plant_state
        return all(math.isfinite(value) for name in state.dtype.names for value in state[name])


@pytest.mark.ci
@pytest.mark.timeout(120 + FRAMES // 2000)
def test_no_frame_of_a_hundred_thousand_breaks_anything():
    bus = Bus(seed=1)
    bus.play(FRAMES, seed=2)
    assert bus.is_finite()
    assert bus.powered > FRAMES / 20  # else little was shown of drives under torque
    assert bus.has_been_everywhere()


@pytest.mark.slow
def test_frames_at_random_are_answered_as_the_standards_ask():
    watched, chance = WatchedWorld(ROBOT), random.Random(9)
    watched.power_on()
    places = {port: [(e.index, e.subindex) for e in node.slave.dictionary] for port, node in watched.nodes.items()}
    for frame in islice(RandomFrames(10, places), OTHERS):
        watched.send(*frame)
        draw = chance.random()
        if draw < 0.2:
            watched.wait(chance.choice((1, 250_000, 250_000, 1_000_000, 2_000_000)))
        elif draw > 0.9995:
            watched.wait(chance.choice((300_000_000, 6_000_000_000)))
        elif draw > 0.999:
            watched.power_cycle(chance.choice(list(places)))
        if draw > 0.99:
            watched.judge_memory()
    assert {f"state {state}" for state in STATES} <= watched.reached
    assert all(drive.slope_ticks for number, drive in watched.drives.items() if drive.is_ours)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_hundred_thousand_frames_more_fill_no_memory():
    bus = Bus(seed=3)
    bus.play(OTHERS, seed=4)
    gc.collect()
    tracemalloc.start()
    try:
        bus.play(OTHERS // 2, seed=5)
        gc.collect()
        before = tracemalloc.get_traced_memory()[0]
        bus.play(OTHERS, seed=6)
        gc.collect()
        after = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert after - before < 200_000
