"""Arm of a robot: the arrays of `advance_arm`, and its tip."""

import numpy as np
from numpy.typing import NDArray

from hil.arm.mounting import Mounting
from hil.arm.tables import ArmTable
from plant_emulator.core import CORE
from plant_emulator.physics.articulated import (
    ACCELERATION,
    POSITION,
    ROWS,
    SPECIFIC_FORCE,
    VELOCITY,
    holding_torques,
    link_rows,
    sensor_rows,
    tool_rows,
)
from plant_emulator.physics.axis import synchronous_error

Real = NDArray[np.float64]

MOST_ROUNDS = 200
"""Rounds in which the arm sinks into its gears; each takes away what the gears are softer than gravity, some hundredth."""
STILL_RAD = 1e-15


class CoupledArm:
    """Axes whose arms are the links of one arm.

    Attributes:
        rows: `AXIS` array of the robot, by axis number.
        joints: `JOINT` array, from the base on.
        links: `LINK` array, the base first.
        shared: The arm in C, an `arm`.
        felt_by: Pointer to what the sensor feels, without noise, steps and filters.
        moved: Position, velocity, acceleration of the tip and specific force as `tool_motion` writes them.
    """

    def __init__(self, arm: ArmTable, numbers: tuple[int, ...], rows: NDArray[np.void], mounting: Mounting | None = None) -> None:
        """Lay out the arrays for the axes of `rows`.

        The arm hangs at rest at home, all brakes closed.
        """
        count = len(arm.link)
        self.rows, self.order = rows, [numbers.index(number) for number in arm.axes]
        self.links = link_rows(arm, numbers)
        self.joints, near = np.zeros(count, CORE.dtype("constants")), np.zeros(count, CORE.dtype("grid_point"))
        for joint, row in enumerate(self.order):
            of = CORE.pointer(self.joints[joint], "constants"), CORE.pointer(near[joint], "grid_point")
            CORE.call.joint_constants(CORE.pointer(rows["plant"][row], "plant"), *of)
        stages = np.zeros((CORE.call.PLANES, count), CORE.dtype("axis_state"))
        self._turning = np.zeros((CORE.call.JOINT_ROWS, count))
        self._tool, self.moved = tool_rows(arm), np.zeros((ROWS, 3))
        self._sensor, self._felt = sensor_rows(arm, mounting), np.zeros((1, 3))
        self.felt_by = CORE.pointer(self._felt)
        self.shared, joints = CORE.new("arm"), {
            "joints": CORE.pointer(self.joints, "constants"), "links": CORE.pointer(self.links, "link"),
            "near": CORE.pointer(near, "grid_point"), "commands": CORE.pointer(np.zeros(count)),
            "brakes": CORE.pointer(np.zeros(count)), "turning": CORE.pointer(self._turning),
            "stages": CORE.pointer(stages, "axis_state"),
        }  # fmt: skip
        tool = {"tool": self._tool, "moved": self.moved, "sensor": self._sensor, "room": np.zeros((ROWS, 3))}
        self._kept = joints, {name: CORE.pointer(array) for name, array in tool.items()}
        for of, pointers in zip((self.shared.joints, self.shared), self._kept, strict=True):
            for name, pointer in pointers.items():
                setattr(of, name, pointer)
        self.shared.joints.count = count
        self.hang_at_rest()

    def hang_at_rest(self) -> None:
        """Put the arm at rest under gravity.

        The gears carry the links, which hang below θ_m/N + θ_sync.
        """
        plants, states = [self.rows["plant"][row] for row in self.order], [self.rows["plant_state"][row] for row in self.order]
        angles = [float(state["motor_angle_rad"]) for state in states]
        rigid = np.array(
            [
                angle / plant["reduction_ratio"] + synchronous_error(plant, angle)[0]
                for plant, angle in zip(plants, angles, strict=True)
            ]
        )
        stiffness = np.array([plant["gear_stiffness_nm_rad"] for plant in plants])
        soft = np.array([plant["wind_up_softness"] for plant in plants])
        reach = np.array([plant["wind_up_torsion_rad"] for plant in plants])
        wound = np.array([state["hysteresis_nm"] for state in states])
        home, arm = self.links["home_rad"][1:], rigid.copy()
        for _ in range(MOST_ROUNDS):
            self._turning[0] = home + arm
            holding_torques(self.links, self._turning)
            stiff = stiffness * (1.0 - soft * np.exp(-(((rigid - arm) / reach) ** 2)))
            before, arm = arm, rigid - (self._turning[2] - wound) / stiff
            if np.max(np.abs(arm - before)) < STILL_RAD:
                break
        for state, angle in zip(states, arm, strict=True):
            state["arm_angle_rad"], state["motor_speed_rad_s"], state["arm_speed_rad_s"] = angle, 0.0, 0.0
            state["arm_acceleration_rad_s2"], state["torque_nm"] = 0.0, 0.0
        last = self.links[-1]
        self.moved[POSITION] = last["position"] + last["frame"] @ self._tool[0]
        self.moved[VELOCITY], self.moved[ACCELERATION] = 0.0, 0.0
        self.moved[SPECIFIC_FORCE] = self._tool[1:].T @ last["frame"].T @ self.links[0]["acceleration"][3:]
        carrier, weight = self.links[int(self._sensor[4, 0])], self._sensor[4, 1]
        self._felt[0] = weight * self._sensor[1:4].T @ carrier["frame"].T @ self.links[0]["acceleration"][3:]

    def acceleration(self) -> tuple[float, float, float]:
        """Return the acceleration (X, Y, Z) of the tip in m/s².

        It is in the frame of the base, without gravity, after the last period.
        """
        x, y, z = self.moved[ACCELERATION].tolist()
        return x, y, z
