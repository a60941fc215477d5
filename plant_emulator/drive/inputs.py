"""A drive's digital inputs and outputs.

Switches and probes are at the positions of the robot file; safe torque off is set by the drive's owner.

The control period evaluates the switches and latches their edges (`supervision.h`). This module
passes the edges to their listeners. 60FDh shows the levels: bits 0 to 2 as in CiA 402, bit 3 (interlock) while safe torque
off is active, and in the manufacturer's half bits 16 and 17 for the touch probes and bit 18 for safe torque off.

Source: CiA 402-2, 60FDh and 60FEh.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

from drive_profiles.standard.cia402 import Object
from plant_emulator.motion import record
from plant_emulator.motion.axes import Axes, live
from plant_emulator.robots.behaviour import Switches
from plant_emulator.slave.dictionary import Dictionary

INTERLOCK, PROBE_1_INPUT, PROBE_2_INPUT, SAFE_TORQUE_OFF = 1 << 3, 1 << 16, 1 << 17, 1 << 18
"""Bits of 60FDh beside those of the switches, which are the bits of `inputs` in `MOTION`."""

SWITCHES = record.NEGATIVE_SWITCH | record.POSITIVE_SWITCH | record.HOME_SWITCH
_PROBE_SHIFT = 13
INPUTS = SWITCHES | record.PROBE_1 | record.PROBE_2

_RANGES = {"home": record.HOME_SWITCH, "probe_1": record.PROBE_1, "probe_2": record.PROBE_2}
"""Inputs that are active between two positions, as the fields of `MOTION` name them."""

EdgeListener = Callable[[int, Sequence[float]], None]
"""Takes the bits of the edges that were seen, and the counts at the last of each."""


class DigitalInputs:
    """The inputs of one drive.

    Attributes:
        is_sto_active: True while safe torque off holds the power stage off.
        on_sto: Called when that changes.
        on_forced: Called when inputs are forced or released.
    """

    def __init__(self, axes: Axes, number: int, dictionary: Dictionary) -> None:
        """Set the switches of the robot file, and bind 60FDh."""
        row = axes.row(number)
        self.is_sto_active = False
        self.on_sto: Callable[[bool], None] = lambda _: None
        self.on_forced: Callable[[], None] = lambda: None
        self._motion: Any = axes.motion[row]
        self._row, self._levels = row, live(axes.motion, "inputs")
        self._listeners: dict[str, tuple[int, EdgeListener]] = {}
        axis = axes.robot.axis[number]
        if axis.switches is not None:
            self._set_switches(axis.switches, axis.reduction_ratio)
        self._look_at(axes.counts(row))
        dictionary.on_read(Object.DIGITAL_INPUTS, 0, self._digital_inputs)

    def _set_switches(self, switches: Switches, ratio: float) -> None:
        """Write the first and last active count of each switch.

        Switches have angles of the joint, the index pulse has one of the motor.
        """
        motion = self._motion
        per_degree = motion["counts_per_rev"] / 360.0
        joint = ratio * per_degree
        mask = 0
        if switches.negative_limit_deg is not None:
            motion["negative_switch_counts"] = math.floor(switches.negative_limit_deg * joint)
            mask |= record.NEGATIVE_SWITCH
        if switches.positive_limit_deg is not None:
            motion["positive_switch_counts"] = math.ceil(switches.positive_limit_deg * joint)
            mask |= record.POSITIVE_SWITCH
        for name, bit in _RANGES.items():
            range_deg = getattr(switches, f"{name}_deg")
            if range_deg is not None:
                motion[f"{name}_low_counts"] = math.ceil(range_deg[0] * joint)
                motion[f"{name}_high_counts"] = math.floor(range_deg[1] * joint)
                mask |= bit
        motion["index_counts"] = round(switches.index_deg * per_degree)
        motion["input_mask"] = mask

    def _look_at(self, counts: int) -> None:
        """Find the inputs that are active before the first control period."""
        motion = self._motion
        levels = record.NEGATIVE_SWITCH if counts <= motion["negative_switch_counts"] else 0
        levels |= record.POSITIVE_SWITCH if counts >= motion["positive_switch_counts"] else 0
        for name, bit in _RANGES.items():
            levels |= bit if motion[f"{name}_low_counts"] <= counts <= motion[f"{name}_high_counts"] else 0
        motion["inputs"] = levels & int(motion["input_mask"]) | int(motion["forced_inputs"])

    # -- levels --------------------------------------------------------------------------------------------------------

    @property
    def present(self) -> int:
        """Bits of the existing inputs."""
        return int(self._motion["input_mask"])

    @property
    def levels(self) -> int:
        """Bits of the active inputs."""
        return int(self._levels[self._row])

    def _digital_inputs(self) -> int:
        levels = self.levels
        word = levels & SWITCHES | (levels & ~SWITCHES) << _PROBE_SHIFT
        return word | INTERLOCK | SAFE_TORQUE_OFF if self.is_sto_active else word

    def force(self, inputs: int, *, active: bool = True) -> None:
        """Force inputs to be active, or release them.

        Args:
            inputs: Bits of `plant_emulator.motion.record`: NEGATIVE_SWITCH and so on.

        Raises:
            ValueError: There are no such inputs.
        """
        if not 0 < inputs <= INPUTS:
            raise ValueError(f"inputs {inputs:#x}; expected bits of {INPUTS:#x}")
        motion = self._motion
        motion["input_mask"] = int(motion["input_mask"]) | inputs
        forced = int(motion["forced_inputs"])
        motion["forced_inputs"] = forced | inputs if active else forced & ~inputs
        self.on_forced()

    def set_sto(self, active: bool) -> None:
        """Close or open the contacts of safe torque off."""
        if active != self.is_sto_active:
            self.is_sto_active = active
            self.on_sto(active)

    # -- edges ---------------------------------------------------------------------------------------------------------

    def listen(self, name: str, edges: int, listener: EdgeListener) -> None:
        """Register a listener for edges.

        The edges are bits 1 << HOME_RISING and so on, of `plant_emulator.motion.record`. `dispatch` calls the listener, which
        replaces the one of this name; with `edges` 0 there is none.
        """
        self.dispatch()  # what has been seen so far is not for the new listener
        if edges:
            self._listeners[name] = edges, listener
        else:
            self._listeners.pop(name, None)
        mask = 0
        for each, _ in self._listeners.values():
            mask |= each
        self._motion["edge_mask"] = mask

    def dispatch(self) -> None:
        """Pass the latched edges to their listeners."""
        motion = self._motion
        seen = int(motion["edges"])
        motion["edges"] = motion["event"] = 0
        if not seen:
            return
        latches: Sequence[float] = motion["latch_counts"].tolist()
        for edges, listener in tuple(self._listeners.values()):
            if seen & edges:
                listener(seen & edges, latches)
