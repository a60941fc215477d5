"""The emulated nodes that the suite runs against by itself: our drive, the accelerometer and a vendor's drive."""

import configparser
import functools
import tempfile
from pathlib import Path

from drive_profiles import eds
from hil.robot_tables import Control
from plant_emulator.data_sheets import data_sheet_of
from plant_emulator.robots.robot import Robot, load_robot, with_drives
from plant_emulator.world import World
from tests.conformance.device import Device
from tests.conformance.ports import EmulatedPort

AXIS = 2
VENDOR = "maxon_epos4"
NAMES = ("drive", "accelerometer", VENDOR)
GAINS = Control(position_gain_per_s=25.0, velocity_gain_nm_s_rad=0.196, velocity_integral_gain_nm_rad=3.92)
"""A drive without gains does not enable."""


@functools.cache
def robot_of(name):
    """One axis of the reference robot, with gains and, where a vendor is named, with its drive."""
    reference = load_robot("reference")
    if name == VENDOR:
        reference = with_drives(reference, {AXIS: VENDOR})
    return Robot(axis={AXIS: reference.axis[AXIS].model_copy(update={"control": GAINS})})


def emulated_device(name):
    """A node that has just booted, and a port to its world."""
    world = World(robot_of(name))
    node = world.accelerometer if name == "accelerometer" else world.drives[AXIS]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.eds"
        text = data_sheet_of(node.slave.dictionary, path.name, name)
        path.write_text(text, encoding="latin-1")
        description = eds.load(path, node_id=node.node_id)
        info = device_info(path)
    assert not description.refused
    port = EmulatedPort(world, node)
    return Device(name, node.node_id, port, description, patience_s=6.0, boot_s=1.0, world=world, device_info=info, eds_text=text)


def device_info(path):
    """The keys of [DeviceInfo] and [DummyUsage], in lower case."""
    parser = configparser.RawConfigParser(strict=False, inline_comment_prefixes=(";",))
    parser.read_string(path.read_bytes().decode("latin-1"))
    keys = {}
    for section in parser.sections():
        if section.lower() in {"deviceinfo", "dummyusage"}:
            keys |= dict(parser[section])
    return keys
