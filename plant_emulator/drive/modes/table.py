"""All modes of the emulator, by number."""

from plant_emulator.drive.family.base import DriveFamily
from plant_emulator.drive.inputs import DigitalInputs
from plant_emulator.drive.modes.cyclic import CyclicPosition, CyclicTorque, CyclicVelocity, MakersPosition
from plant_emulator.drive.modes.homing_mode import HomingMode
from plant_emulator.drive.modes.interpolated_position import InterpolatedPosition
from plant_emulator.drive.modes.mode import ModeOfOperation, NoMode
from plant_emulator.drive.modes.profile_position import ProfilePosition
from plant_emulator.drive.modes.profile_torque import ProfileTorque
from plant_emulator.drive.modes.profile_velocity import ProfileVelocity
from plant_emulator.drive.power_stage import PowerStage
from plant_emulator.robots.behaviour import Behaviour


def modes_of(stage: PowerStage, inputs: DigitalInputs, behaviour: Behaviour, family: DriveFamily) -> dict[int, ModeOfOperation]:
    """Return one drive's modes: its family's, its maker's own, and 0, none."""
    modes: list[ModeOfOperation] = [
        ProfilePosition(stage, behaviour.pp_handshake_cycles),
        ProfileVelocity(stage),
        ProfileTorque(stage),
        HomingMode(stage, inputs),
        InterpolatedPosition(stage),
        CyclicPosition(stage),
        CyclicVelocity(stage),
        CyclicTorque(stage),
    ]
    modes = [mode for mode in modes if mode.number in family.modes]
    if family.position_mode is not None:
        modes.append(MakersPosition(stage, *family.position_mode))
    if not behaviour.needs_mode_to_enable:
        modes.append(NoMode(stage))
    return {mode.number: mode for mode in modes}
