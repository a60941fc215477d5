"""Homing mode: bit 4 starts `modes.homing`, on the drive's profiles."""

from collections.abc import Sequence

from drive_profiles.standard.cia402 import HOMING_ATTAINED, HOMING_ERROR, HOMING_START, TARGET_REACHED, Mode, Object
from plant_emulator.drive.dictionary.cia402_objects import HOMING_METHODS
from plant_emulator.drive.inputs import DigitalInputs
from plant_emulator.drive.modes.homing import Demand, GoTo, Homing, HomingAttained, HomingFailed, HomingStep, Move
from plant_emulator.drive.modes.mode import ModeOfOperation
from plant_emulator.drive.power_stage import PowerStage
from plant_emulator.drive.state_machine import Stop
from plant_emulator.motion import record
from plant_emulator.motion.record import (
    HOME_FALLING,
    HOME_RISING,
    INDEX,
    NEGATIVE_FALLING,
    NEGATIVE_RISING,
    POSITIVE_FALLING,
    POSITIVE_RISING,
)

TRAVEL_JOINT_TURNS = 2.0
"""Longest search without a switch, in turns of the joint."""

_EDGES = sum(
    1 << edge for edge in (HOME_RISING, HOME_FALLING, INDEX, NEGATIVE_RISING, NEGATIVE_FALLING, POSITIVE_RISING, POSITIVE_FALLING)
)
_LISTENER = "homing"
_NOWHERE = (0.0,) * record.EDGES


class HomingMode(ModeOfOperation):
    """HM: 6098h at the speeds of 6099h, acceleration 609Ah, to position 607Ch.

    While it runs, software position limits do not act: they count from the zero that is being searched. Clearing bit 4, a
    halt or another mode interrupts it; it continues after a halt only. An error, or a limit switch in the way, stops the
    motor on the quick-stop ramp (6085h).

    The limits act again when the motor is within them. Outside them, after an interrupted homing or when the drive is
    enabled there, the motor is held without a fault. Two ways lead out: homing, or another 607Dh. Any other mode that acts
    there is a fault, as everywhere. 6065h, 6080h and the switches act all the time.
    """

    number, motion = Mode.HM, record.PROFILE

    def __init__(self, stage: PowerStage, inputs: DigitalInputs) -> None:
        super().__init__(stage)
        self._inputs = inputs
        self._edges = 0
        self._latches: Sequence[float] = _NOWHERE
        self._homing: Homing | None = None
        self._demand: Demand | None = None
        self._is_attained = self._has_failed = False

    @property
    def is_running(self) -> bool:
        """True if the sequence is under way."""
        return self._homing is not None

    def start(self) -> None:
        """Brake to rest, or stay at rest behind the brake."""
        super().start()
        self._suspend_limits()
        self._is_attained = self._has_failed = False
        self.data.limits.halt_profile(False)

    def end(self) -> None:
        """Restore the limits and ramps that homing has changed."""
        self._finish()
        self.watches = False
        self.data.limits.switch_position_limits(on=True)

    def take(self, word: int, rising: int) -> None:
        """Start on the rising edge of bit 4.

        The falling edge interrupts homing. An edge during a halt starts nothing.
        """
        if rising & HOMING_START and not self.is_halted:
            self._begin()
        elif self.is_running and not word & HOMING_START:
            self._finish()
            self.stage.begin(record.PROFILE)

    def _begin(self) -> None:
        self._is_attained = self._has_failed = False
        method = self.data.value(Object.HOMING_METHOD)
        speeds = [self.data.limits.acting_si(Object.HOMING_SPEEDS, sub) for sub in (1, 2)]
        # no method, one that is not known here (a maker's entry may still hold it), or none that would ever end
        if method not in HOMING_METHODS or not min(speeds) > 0.0:
            self._has_failed = True
            return
        motion, axes = self.stage.motion, self.stage.axes
        axis = axes.robot.axis[axes.numbers[self.row]]
        per_rev = float(motion["counts_per_rev"])
        travel = TRAVEL_JOINT_TURNS * axis.reduction_ratio * per_rev
        self._homing = Homing(method, self._inputs.present, per_rev, travel)
        self._edges = 0
        self._inputs.listen(_LISTENER, _EDGES, self._hear)
        self._suspend_limits()
        self._do(self._homing.start(axes.counts(self.row), self._inputs.levels))

    def _suspend_limits(self) -> None:
        self.data.limits.switch_position_limits(on=False)
        self.watches = True

    def look(self) -> None:
        """Continue with the latched edges; restore limits at the end."""
        if self._homing is None:
            if self._is_at_rest() and self.data.limits.is_within_position_limits:
                self.data.limits.switch_position_limits(on=True)
                self.watches = False
            return
        if self.is_halted:
            return
        self._inputs.dispatch()
        edges, self._edges = self._edges, 0
        self._do(
            self._homing.step(self._inputs.levels, edges, self._latches, self.stage.axes.counts(self.row), self._is_at_rest())
        )

    def _hear(self, edges: int, latches: Sequence[float]) -> None:
        self._edges |= edges
        self._latches = latches

    def _is_at_rest(self) -> bool:
        """Return True if the motor rests where the demand sends it."""
        if isinstance(self._demand, GoTo):
            return bool(self.data.is_target_reached)
        return self.stage.motion["reference_speed_rad_s"] == 0.0 and self.stage.is_at_rest

    def _do(self, step: HomingStep) -> None:
        match step:
            case HomingAttained(counts):
                self._finish()
                self.data.set_home(counts)
                self._is_attained = True
                self.stage.begin(record.PROFILE)
            case HomingFailed():
                self._has_failed = True
                self._finish()
                self.stage.stop(Stop.QUICK_STOP_RAMP)
            case _:
                self._move(step)

    def _move(self, demand: Demand) -> None:
        """Apply a demand, and limits that were written meanwhile."""
        motion, is_new = self.stage.motion, demand != self._demand
        self._demand = demand
        acceleration = deceleration = self.data.limits.acting_si(Object.HOMING_ACCELERATION)
        if demand.is_hard:
            deceleration = max(acceleration, self.data.limits.acting_si(Object.QUICK_STOP_DECELERATION))
        motion["profile_acceleration_rad_s2"], motion["profile_deceleration_rad_s2"] = acceleration, deceleration
        fast, slow = self.data.limits.acting_si(Object.HOMING_SPEEDS, 1), self.data.limits.acting_si(Object.HOMING_SPEEDS, 2)
        wanted = record.PROFILE if isinstance(demand, GoTo) else record.PROFILE_VELOCITY
        if self.stage.law_mode != wanted:
            self.stage.begin(wanted)
        match demand:
            case Move(direction, is_fast, _):
                motion["target_speed_rad_s"] = direction * (fast if is_fast else slow)
            case GoTo(counts, _):
                motion["profile_speed_rad_s"] = slow
                if is_new:
                    motion["target_counts"] = counts
                    motion["reached"], motion["position_window_count"] = 0, 0

    def _finish(self) -> None:
        if self._homing is None:
            return
        self._homing = self._demand = None
        self._inputs.listen(_LISTENER, 0, self._hear)
        self.data.apply()

    def resume(self) -> None:
        """Continue with the demand in force, or hold the motor."""
        if self._demand is None:
            self.stage.begin(record.PROFILE)
        else:
            demand, self._demand = self._demand, None
            self._move(demand)

    def status(self) -> int:
        """Return bits 13, 12 and 10 as the standard defines them."""
        word = 0
        if self._has_failed:
            word |= HOMING_ERROR
        elif self._is_attained:
            word |= HOMING_ATTAINED
        is_at_rest = self.stage.motion["demand_speed_rad_s"] == 0.0 and self.stage.is_at_rest
        return word | TARGET_REACHED if is_at_rest and (self.is_halted or not self.is_running) else word
