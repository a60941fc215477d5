"""Profile torque: 6071h on the slope of 6087h."""

from drive_profiles.standard.cia402 import TARGET_REACHED, Mode
from plant_emulator.drive.modes.mode import ModeOfOperation
from plant_emulator.motion import record


class ProfileTorque(ModeOfOperation):
    """TQ: a target torque takes effect when written, or when enabled."""

    number, motion = Mode.TQ, record.PROFILE_TORQUE
    needs_gains = False

    def start(self) -> None:
        """Continue from the present torque to 6071h."""
        super().start()
        self.stage.motion["target_torque_nm"] = self.targets.torque_nm()

    def status(self) -> int:
        """Return bit 10; bits 12 and 13 are reserved.

        Bit 10: the torque is at its target, or (halted) the motor is at rest.
        """
        if self.is_halted:
            return super().status()
        motion = self.stage.motion
        missing = abs(float(motion["torque_demand_nm"]) - float(motion["target_torque_nm"]))
        return TARGET_REACHED if missing <= 0.5 * self.data.counting.scaling.torque_quantum_nm else 0
