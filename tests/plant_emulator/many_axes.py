"""A robot file with as many drives as a bus has room for: nodes 1 to 126, and the accelerometer at 127."""

import tomllib

from plant_emulator.robots.robot import Robot

AXES = range(1, 127)
ACCELEROMETER = 127
NODES = [*AXES, ACCELEROMETER]

_AXIS = """
[axis.{number}]
reduction_ratio = 100.0
motor_inertia_kg_m2 = 1.20e-4
motor_damping_nm_s_rad = 4.0e-4
arm_inertia_kg_m2 = 2.80
arm_damping_nm_s_rad = 2.5
gear_stiffness_nm_rad = 16170.0
gear_damping_nm_s_rad = 13.5
torque_limit_nm = 3.8
encoder_counts_per_rev = 131072
tip_lever_m = 0.36
ate = {{ a2_arcsec = 10.0, phi2_deg = 262.0 }}
"""


def robot_file(axes=AXES, *, more=""):
    """The text of such a file; `more` stands behind each axis."""
    head = f'name = "many"\n[accelerometer]\nnode_id = {ACCELEROMETER}\n'
    return head + "".join(_AXIS.format(number=number) + more.format(number=number) for number in axes)


def robot_of(text):
    """The robot of such a text; TOML's keys are texts, which `load_robot` makes numbers of."""
    values = tomllib.loads(text)
    return Robot(**values | {"axis": {int(number): axis for number, axis in values["axis"].items()}})
