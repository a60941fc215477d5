"""Homing methods as data, and a sequence that runs them.

The module is pure: the drive's owner moves the motor.

A method names a switch, the edge of it that counts, and whether the index pulse behind that edge is the zero instead. All
methods with a switch then have the same phases, at any position of the axis:

1. search, fast, until the switch is active; a limit switch in the way turns the search round once, after a stop;
2. pass the edge, fast, to find on which side of the switch it is; stop;
3. return to where the edge can be passed in the method's own direction;
4. pass the edge slowly: the counts latched there are what the method finds;
5. with the index pulse: go on in this direction to the first one behind the edge;
6. go to the found position, and stop there.

The owner holds the motor and the switches::

    homing = Homing(17, present=NEGATIVE_SWITCH | POSITIVE_SWITCH, counts_per_rev=131072, travel_counts=4e7)
    demand = homing.start(counts, inputs)
    while isinstance(demand, Move | GoTo):
        ...                     # let the motor turn at the demanded speed, or go to the demanded position
        demand = homing.step(inputs, edges, latches, counts, is_at_rest)

`inputs`, `edges` and `latches` are `inputs`, `edges` and `latch_counts` of the axis' row of `MOTION`; the owner clears `edges`
after each step and at the start, and calls `step` at least once per SYNC period. `is_at_rest` is whether the motor is at rest
where the last demand sends it: at speed 0 after a `Move` of direction 0, at its position after a `GoTo`. At the end comes
`HomingAttained` with the `counts` of the encoder that are 607Ch in the user's count (`offset_counts` = 607Ch - counts), or
`HomingFailed`: then the owner stops the motor.

A limit switch ahead that is not the searched one acts in every phase. Methods that it turns round brake hard, on 6085h instead
of 609Ah, and lead away from it. With other methods, and if the motor must go on towards it, homing has failed.

Source: CiA 402-2, homing mode: methods 1 to 14, 17 to 30, 33, 34, 35 and 37; 6098h, 6099h, 607Ch.
"""

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

from plant_emulator.drive.dictionary.cia402_objects import HOMING_METHODS
from plant_emulator.motion.record import (
    HOME_FALLING,
    HOME_RISING,
    HOME_SWITCH,
    INDEX,
    NEGATIVE_FALLING,
    NEGATIVE_RISING,
    NEGATIVE_SWITCH,
    POSITIVE_FALLING,
    POSITIVE_RISING,
    POSITIVE_SWITCH,
)

TURNS_TO_INDEX = 1.5
"""Within so many motor revolutions behind the edge an index pulse must come."""


class Move(NamedTuple):
    """Turn at a speed until the next step.

    Args:
        direction: +1, -1, or 0 for a ramp to rest.
        is_fast: 6099h sub 1, speed during search for switch; else sub 2, during search for zero.
        is_hard: True if a limit switch asks for the ramp of 6085h instead of 609Ah.
    """

    direction: int
    is_fast: bool = False
    is_hard: bool = False


class GoTo(NamedTuple):
    """Demand to go slowly to a position and stop there."""

    counts: float
    is_hard: bool = False


class HomingAttained(NamedTuple):
    """Homing is attained: the motor is at rest at the zero."""

    counts: float


class HomingFailed(NamedTuple):
    """Homing error."""

    reason: str


Demand = Move | GoTo
HomingStep = Demand | HomingAttained | HomingFailed


class Method(NamedTuple):
    """The goal of a method with a switch or an index pulse.

    Args:
        switch: Bit of the switch; 0 if the index pulse alone counts.
        search: Direction in which the switch is looked for.
        is_entered: True if the edge is passed into the switch, False if out of it.
        direction: Direction in which the edge is passed, and the index pulse follows.
        has_index: True if the index pulse behind the edge is the zero.
        turns_round: True if a limit switch turns the search round; else it ends it.
    """

    switch: int
    search: int
    is_entered: bool
    direction: int
    has_index: bool = False
    turns_round: bool = False


_INDEX_METHODS = {
    1: Method(NEGATIVE_SWITCH, -1, False, +1),
    2: Method(POSITIVE_SWITCH, +1, False, -1),
    # a home switch that is active all the way up, or all the way down
    3: Method(HOME_SWITCH, +1, False, -1),
    4: Method(HOME_SWITCH, +1, True, +1),
    5: Method(HOME_SWITCH, -1, False, +1),
    6: Method(HOME_SWITCH, -1, True, -1),
    # a home switch somewhere between the limit switches
    7: Method(HOME_SWITCH, +1, False, -1, turns_round=True),
    8: Method(HOME_SWITCH, +1, True, +1, turns_round=True),
    9: Method(HOME_SWITCH, +1, True, -1, turns_round=True),
    10: Method(HOME_SWITCH, +1, False, +1, turns_round=True),
    11: Method(HOME_SWITCH, -1, False, +1, turns_round=True),
    12: Method(HOME_SWITCH, -1, True, -1, turns_round=True),
    13: Method(HOME_SWITCH, -1, True, +1, turns_round=True),
    14: Method(HOME_SWITCH, -1, False, -1, turns_round=True),
}

METHODS: dict[int, Method] = {
    **{number: method._replace(has_index=True) for number, method in _INDEX_METHODS.items()},
    **{number + 16: method for number, method in _INDEX_METHODS.items()},
    33: Method(0, -1, False, -1, has_index=True),
    34: Method(0, +1, False, +1, has_index=True),
}
"""All methods with a motion; 35 and 37 take the motor's present position."""

_HERE = (35, 37)
_LIMIT_AHEAD = {+1: POSITIVE_SWITCH, -1: NEGATIVE_SWITCH}
_RISING = {+1: POSITIVE_RISING, -1: NEGATIVE_RISING}
_NAMES = {NEGATIVE_SWITCH: "negative limit switch", POSITIVE_SWITCH: "positive limit switch", HOME_SWITCH: "home switch"}
_FALLING = {NEGATIVE_SWITCH: NEGATIVE_FALLING, POSITIVE_SWITCH: POSITIVE_FALLING, HOME_SWITCH: HOME_FALLING}


class _Phase(Enum):
    SEARCH = "search"
    TURN = "stop at the limit switch"
    AT_SWITCH = "stop at the switch"
    REGAIN = "back onto the switch"
    CROSS = "pass the edge"
    BEYOND = "stop behind the edge"
    RETURN = "back over the edge"
    FINAL = "pass the edge slowly"
    TO_INDEX = "to the index pulse"
    GO = "to the zero"


_TO_REST = (_Phase.AT_SWITCH, _Phase.TURN, _Phase.BEYOND, _Phase.GO)
_MAY_TURN = (_Phase.CROSS, _Phase.FINAL)
"""Phases that may begin while the motor still moves the other way."""


class Homing:
    """One run of a homing method.

    Args:
        method: 6098h.
        present: Bits of the switches that the axis has.
        travel_counts: Longest search without a switch; without this bound a search for a missing switch would not end.

    Raises:
        ValueError: There is no such method.
    """

    def __init__(self, method: int, present: int, counts_per_rev: float, travel_counts: float) -> None:
        if method not in HOMING_METHODS:
            raise ValueError(f"homing method {method}; expected one of {', '.join(map(str, HOMING_METHODS))}")
        self._here = method in _HERE
        self._method = METHODS.get(method, METHODS[34])
        self._present, self._rev, self._travel = present, counts_per_rev, travel_counts
        self._phase = _Phase.SEARCH
        self._direction = self._searched = 1
        self._origin = self._zero = 0.0
        self._has_turned = False
        self._inside = 0  # of the switches those that it has been on from the start: nothing has led into them
        self._demand = Move(0)

    def start(self, counts: float, inputs: int) -> HomingStep:
        """Begin at the motor's present position."""
        method = self._method
        self._inside = inputs
        if self._here:
            return HomingAttained(counts)
        if method.switch & ~self._present:
            return HomingFailed(f"there is no {_NAMES[method.switch]}")
        if not method.switch:
            return self._to_index(counts, counts)
        return self._move(_Phase.SEARCH, method.search, counts, is_fast=True)

    def step(self, inputs: int, edges: int, latches: Sequence[float], counts: float, is_at_rest: bool) -> HomingStep:
        """Go on to the next demand.

        Args:
            inputs: Bits of the switches that are active.
            edges: Bits of the edges seen since the last step.
            latches: Counts at the last of each edge.
            is_at_rest: True if the motor is at rest where the last demand sends it.
        """
        method = self._method
        is_active = bool(inputs & method.switch)
        self._inside &= inputs
        if self._phase not in _TO_REST:
            return self._moving(inputs, edges, latches, counts, is_active)
        if not is_at_rest:
            return self._coming_to_rest(inputs, edges)
        match self._phase:
            case _Phase.AT_SWITCH:
                # on the switch, or beyond one that is shorter than the way to rest
                return self._pass(counts) if is_active else self._move(_Phase.REGAIN, -self._searched, counts)
            case _Phase.TURN:
                return self._move(_Phase.SEARCH, -self._direction, counts, is_fast=True)
            case _Phase.BEYOND:
                if method.is_entered:
                    return self._move(_Phase.FINAL, method.direction, counts)
                return self._move(_Phase.RETURN, -method.direction, counts)
            case _:
                return HomingAttained(self._zero)

    def _coming_to_rest(self, inputs: int, edges: int) -> HomingStep:
        """Return the demand on the way to rest or to zero."""
        is_hard = self._phase is _Phase.TURN or self._is_limit(inputs & ~self._inside, self._direction)
        if self._phase is _Phase.GO:
            return self._limit_entered(inputs, edges) or GoTo(self._zero, is_hard)
        if is_hard and not self._method.turns_round:
            return self._limit_reached(self._direction)
        return Move(0, is_hard=is_hard)

    def _limit_entered(self, inputs: int, edges: int) -> HomingFailed | None:
        """Return a failure if a limit switch behind the demand activates.

        The motor then runs into it before it has turned round.

        A limit switch that is active and stays so is not an obstacle: the motor is leaving it.
        """
        behind = -self._direction
        if edges >> _RISING[behind] & 1 and self._is_limit(inputs, behind):
            return self._limit_reached(behind)
        return None

    def _is_limit(self, inputs: int, direction: int) -> bool:
        """Return True if a direction's limit switch (not the sought) is active."""
        return bool(inputs & _LIMIT_AHEAD[direction] & ~self._method.switch)

    def _limit_reached(self, direction: int) -> HomingFailed:
        return HomingFailed(f"{_NAMES[_LIMIT_AHEAD[direction]]} reached: {self._phase.value}")

    def _moving(self, inputs: int, edges: int, latches: Sequence[float], counts: float, is_active: bool) -> HomingStep:
        method = self._method
        match self._phase:
            case _Phase.SEARCH if is_active:
                return self._move(_Phase.AT_SWITCH, 0, counts)
            case _Phase.REGAIN if is_active:
                return self._pass(counts)
            case _Phase.CROSS if not is_active:
                return self._move(_Phase.BEYOND, 0, counts)
            case _Phase.RETURN if is_active:
                return self._move(_Phase.FINAL, method.direction, counts)
            case _Phase.FINAL:
                edge = HOME_RISING if method.is_entered else _FALLING[method.switch]
                if edges >> edge & 1:
                    return self._edge_found(float(latches[edge]), edges, latches, counts)
            case _Phase.TO_INDEX:
                if edges >> INDEX & 1 and self._is_behind(float(latches[INDEX])):
                    return self._go(float(latches[INDEX]))
            case _:
                pass
        return self._obstacle(inputs, edges, counts) or self._demand

    def _obstacle(self, inputs: int, edges: int, counts: float) -> HomingStep | None:
        """Return the demand if an obstacle ends or turns a move."""
        method, phase = self._method, self._phase
        if self._is_limit(inputs, self._direction):
            if phase is not _Phase.SEARCH or not method.turns_round or self._has_turned:
                return self._limit_reached(self._direction)
            self._has_turned = True
            self._phase = _Phase.TURN
            return Move(0, is_hard=True)
        if phase in _MAY_TURN and (failed := self._limit_entered(inputs, edges)):
            return failed
        gone = abs(counts - self._origin)
        if gone > (TURNS_TO_INDEX * self._rev if phase is _Phase.TO_INDEX else self._travel):
            return HomingFailed(f"nothing found within {gone / self._rev:.1f} revolutions: {phase.value}")
        return None

    def _pass(self, counts: float) -> HomingStep:
        method = self._method
        return self._move(_Phase.CROSS, -method.direction if method.is_entered else method.direction, counts, is_fast=True)

    def _edge_found(self, edge: float, edges: int, latches: Sequence[float], counts: float) -> HomingStep:
        if not self._method.has_index:
            return self._go(edge)
        demand = self._to_index(edge, counts)
        # the index pulse may have come between the edge and this step
        index = float(latches[INDEX])
        return self._go(index) if edges >> INDEX & 1 and self._is_behind(index) else demand

    def _to_index(self, edge: float, counts: float) -> HomingStep:
        self._zero = edge
        return self._move(_Phase.TO_INDEX, self._method.direction, counts)

    def _is_behind(self, index: float) -> bool:
        return (index - self._zero) * self._method.direction >= 0.0

    def _go(self, zero: float) -> HomingStep:
        self._phase, self._zero = _Phase.GO, zero
        return GoTo(zero)

    def _move(self, phase: _Phase, direction: int, counts: float, *, is_fast: bool = False) -> HomingStep:
        if direction:
            self._direction, self._origin = direction, counts
        if phase is _Phase.SEARCH:
            self._searched = direction
        self._phase = phase
        self._demand = Move(direction, is_fast)
        return self._demand
