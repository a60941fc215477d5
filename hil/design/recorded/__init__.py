"""Transmission errors from recordings of foreign robots.

The package has stretches, slow parts, orders of the motor's angle, and a blind scan.

Time stamps may jitter and samples may lie unevenly: all is fitted in the motor's angle.

>>> import numpy as np
>>> from hil.design.recorded import AngleSection, fit_section, waves_of_angle
>>> angle = np.linspace(0.0, 40.0, 2000)
>>> wound_up = 1e-4 * np.sin(angle / 40.0)
>>> fit = fit_section(AngleSection(angle, wound_up + 5e-5 * np.cos(2.0 * angle + 1.0), waves_of_angle(angle)), (1, 2, 4))
>>> bool(abs(np.hypot(*fit.unknowns[2:4]) / 5e-5 - 1.0) < 1e-3)
True
"""

from hil.design.recorded.fit import AngleSection, SectionFit, fit_section, least_turns, waves_of_angle
from hil.design.recorded.joint import JointFit, RecordedValue, joined, value_of, values_of
from hil.design.recorded.scan import BlindScan, order_scan
from hil.design.recorded.stretches import MotionStretch, parts_of, stretches

__all__ = [
    "AngleSection",
    "BlindScan",
    "JointFit",
    "MotionStretch",
    "RecordedValue",
    "SectionFit",
    "fit_section",
    "joined",
    "least_turns",
    "order_scan",
    "parts_of",
    "stretches",
    "value_of",
    "values_of",
    "waves_of_angle",
]
