"""A hundred thousand frames in each test run, ten million before a release: no exception, no torque without right, no growth."""

import gc
import math
import os
import random
import tracemalloc
from itertools import islice

import pytest

from drive_profiles.cia301 import NmtState
from drive_profiles.cia402 import State
from plant_emulator import motion as law
from plant_emulator.robot import Robot, load_robot
from plant_emulator.world import World
from tests.plant_emulator.rig import GAINS
from tests.properties.random_frames import RandomFrames

FRAMES = int(os.environ.get("HIL_RANDOM_FRAMES", "100000"))
MANY = 1_000_000
POWERED = {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}
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
        self.powered = 0

    def play(self, frames: int, seed: int) -> None:
        """Send so many frames, with time between them, and sometimes a loss of power."""
        chance, world = self.chance, self.world
        for frame in islice(RandomFrames(seed, self.places), frames):
            answers = world.receive(frame)
            assert len(answers) <= LONGEST_ANSWER, frame
            draw = chance.random()
            if draw < 0.05:
                world.settle()
                assert len(world.advance(world.now + chance.choice((1, 250_000, 1_000_000, 30_000_000)))) <= 8 * LONGEST_ANSWER
            elif draw > 0.9999:
                world.settle()
                world.power_cycle(chance.choice(list(self.places)))
            self.look(frame)
        world.settle()

    def look(self, frame: object) -> None:
        for number, drive in self.world.drives.items():
            if drive.slave.nmt_state is NmtState.OPERATIONAL:
                self.entitled[number] = True
            mode = self.world.axes.motion["mode"][drive.row]
            if mode != law.BRAKED:
                self.powered += 1
                assert drive.state in POWERED, frame
                assert self.entitled[number], frame
            if drive.state not in POWERED:
                assert self.world.axes.motion["torque_nm"][drive.row] == 0.0, frame
                self.entitled[number] = drive.slave.nmt_state is NmtState.OPERATIONAL

    def is_finite(self) -> bool:
        state = self.world.axes.plant_state
        return all(math.isfinite(value) for name in state.dtype.names for value in state[name])


def test_no_frame_of_a_hundred_thousand_breaks_anything():
    bus = Bus(seed=1)
    bus.play(FRAMES, seed=2)
    assert bus.is_finite()
    assert bus.powered > FRAMES / 1000  # else nothing was shown of a drive under torque


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_million_frames_fill_no_memory():
    bus = Bus(seed=3)
    bus.play(MANY // 10, seed=4)
    gc.collect()
    tracemalloc.start()
    try:
        bus.play(MANY // 20, seed=5)
        gc.collect()
        before = tracemalloc.get_traced_memory()[0]
        bus.play(MANY // 10, seed=6)
        gc.collect()
        after = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert after - before < 200_000
    bus.play(MANY - MANY // 4, seed=7)
    assert bus.is_finite()
