"""The second encoder of a drive, on the load side."""

import math
from collections.abc import Callable

import numpy as np

from drive_profiles.standard.cia402 import Object
from drive_profiles.standard.object_address import ObjectAddress
from hil.control.angles import ARCSEC
from plant_emulator.drive.dictionary.additional_encoder import FIRST
from plant_emulator.drive.dictionary.counting import INT32_MAX, clip
from plant_emulator.motion.axes import Axes, live
from plant_emulator.robots.load_encoder import LoadEncoder
from plant_emulator.slave.dictionary import Dictionary


def bind_load_encoder(dictionary: Dictionary, axes: Axes, number: int, position: ObjectAddress) -> None:
    """Bind the objects of an axis' second encoder to its joint."""
    encoder = axes.robot.axis[number].load_encoder
    if encoder is None:
        return
    row = axes.row(number)
    speeds, way = live(axes.plant_state, "arm_speed_rad_s"), -1.0 if encoder.is_reversed else 1.0
    counts_per_rad = encoder.counts_per_rev / math.tau
    dictionary.on_read(*position, reading(encoder, axes, number))
    if position != FIRST:
        return
    dictionary.on_read(Object.ADDITIONAL_VELOCITY_ACTUAL, 1, lambda: clip(round(way * speeds[row] * counts_per_rad), INT32_MAX))


def reading(encoder: LoadEncoder, axes: Axes, number: int) -> Callable[[], int]:
    """Return a function that reads the encoder, in counts.

    The reading is the joint's angle with the encoder's own error and noise, rounded.
    """
    angles, row, way = live(axes.plant_state, "arm_angle_rad"), axes.row(number), -1.0 if encoder.is_reversed else 1.0
    counts_per_rad, offset = encoder.counts_per_rev / math.tau, math.radians(encoder.offset_deg)
    lines = [(line.order, line.a_arcsec * ARCSEC, math.radians(line.phi_deg)) for line in encoder.eccentricity]
    sigma, draw = (
        encoder.noise_arcsec * ARCSEC,
        np.random.default_rng([axes.robot.seed, Object.ADDITIONAL_POSITION_ACTUAL, number]),
    )

    def read() -> int:
        angle: float = angles[row]
        for order, size, phase in lines:
            angle += size * math.cos(order * angles[row] + phase)
        if sigma:
            angle += sigma * float(draw.standard_normal())
        return clip(math.floor((way * angle + offset) * counts_per_rad + 0.5), INT32_MAX)

    return read
