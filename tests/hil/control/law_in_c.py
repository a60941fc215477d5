"""Parts of the law in C, called one by one with records of their arrays."""

import numpy as np

from hil.core.library import CORE


def notch_step(config, state, period_s, speed_rad_s, u):
    of = CORE.pointer(config, "notch_config"), CORE.pointer(state, "notch_state")
    return CORE.call.notch_step(*of, period_s, speed_rad_s, u)


def cascade_start(state, motor_angle, speed_rad_s, torque_nm):
    CORE.call.cascade_start(CORE.pointer(state, "cascade_state"), motor_angle, speed_rad_s, torque_nm)


def observe_speed(config, state, period_s, motor_angle):
    of = CORE.pointer(config, "cascade_config"), CORE.pointer(state, "cascade_state")
    return CORE.call.observe_speed(*of, period_s, motor_angle)


def cascade_step(config, state, period_s, position, velocity_offset):
    of, before = (CORE.pointer(config, "cascade_config"), CORE.pointer(state, "cascade_state")), np.empty(1)
    return CORE.call.cascade_step(*of, period_s, position, velocity_offset, CORE.pointer(before)), float(before[0])


def hold_integrator(state, before, excess_nm):
    CORE.call.hold_integrator(CORE.pointer(state, "cascade_state"), before, excess_nm)
