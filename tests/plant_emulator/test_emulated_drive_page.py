"""The pages of the emulated drive: what they show can be loaded, and they name all that a robot file may ask for."""

import re
from pathlib import Path

from drive_profiles.files.toml import load
from plant_emulator.bus.faults import FaultsFile
from plant_emulator.drive.dictionary.cia402_objects import HOMING_METHODS
from plant_emulator.robots.behaviour import Behaviour, Switches
from plant_emulator.robots.encoders import MotorEncoder
from plant_emulator.robots.gear_change import ErrorChange, GearTemperature
from plant_emulator.robots.robot import SDO_DOWNLOAD_BYTES, RobotAccelerometer, load_robot
from plant_emulator.world import World
from tests.plant_emulator.many_axes import robot_file

DOCS = Path(__file__).parents[2] / "docs"


def text_of(page):
    return (DOCS / page).read_text(encoding="utf-8")


def tables_of(page):
    return re.findall(r"```toml\n(.*?)```", text_of(page), re.DOTALL)


OF_EVERY_NODE = {"node_id", "unconfigured", "sdo_download_bytes"}
OF_AN_ARM = {"mounting"}
"""Keys that only a robot with an arm has: docs/arm-motion.md shows them."""


def test_the_tables_of_options_make_a_robot_and_hold_every_key(tmp_path):
    switches, sdo, behaviour, sensor, encoder, gear = tables_of("emulated-drive-options.md")
    text = robot_file([2], more=switches + behaviour + encoder + gear).replace("[accelerometer]\n", sensor)
    assert sdo.startswith("[axis.2]\n")
    (tmp_path / "robot.toml").write_text(text.replace("[axis.2]\n", sdo))
    robot = load_robot(tmp_path / "robot.toml")
    axis = robot.axis[2]
    assert axis.switches is not None
    assert axis.switches.model_fields_set == set(Switches.model_fields)
    assert set(axis.behaviour.given) == set(Behaviour.model_fields)
    assert axis.encoder.model_fields_set == set(MotorEncoder.model_fields)
    [change] = axis.ate_change
    assert change.model_fields_set == set(ErrorChange.model_fields)
    assert axis.temperature.model_fields_set == set(GearTemperature.model_fields)
    for [line] in (axis.eccentricity, axis.cogging):
        assert line.model_fields_set == set(type(line).model_fields)
    elsewhere = OF_EVERY_NODE | OF_AN_ARM
    assert robot.accelerometer.model_fields_set - elsewhere == set(RobotAccelerometer.model_fields) - elsewhere
    assert "[accelerometer.mounting]" in text_of("arm-motion.md")
    assert axis.sdo_download_bytes == SDO_DOWNLOAD_BYTES
    assert [frame.can_id for frame in World(robot).power_on()] == [0x77F]


def test_the_fault_of_the_page_is_one(tmp_path):
    [shown] = tables_of("emulated-drive-faults.md")
    (tmp_path / "faults.toml").write_text(shown)
    [fault] = load(tmp_path / "faults.toml", FaultsFile).faults().faults
    assert (fault.kind, fault.port, fault.to_ns - fault.from_ns) == ("bus_off", 2, 500_000_000)


def test_the_page_lists_the_homing_methods_that_there_are():
    [words] = re.findall(r"\| homing \| methods (.*?);", text_of("emulated-drive.md"))
    spans = [tuple(int(end) for end in text.split(" to ")) for text in re.split(r", | and ", words)]
    assert [method for span in spans for method in range(span[0], span[-1] + 1)] == list(HOMING_METHODS)
