"""Reaction of a gear on its motor, from passes of a learning.

With the error cancelled, the torque has little else.

Without a cancellation the arm's own part of the motor's torque, which rises towards its resonance, may be taken for a reaction,
or hide it. A pass with the whole cancellation leaves next to nothing of it, and the torque that is left is the reaction's.

The tip shows it as well: a reaction that the set-points do not compensate turns the motor, and with it the gear's input.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from hil.bench.model import IdentifiedError
from hil.design.ate.model import Signs
from hil.design.ate.reaction import REACTS, MotorSide, Reaction, Turning, felt_as, gear_reaction
from hil.design.estimation import PROBABILITY
from hil.design.frequency import Loop
from hil.design.transmission_error import TransmissionError
from hil.recording import Recording


@dataclass
class ReactionWatch:
    """Passes with the whole cancellation, and the reaction that they show.

    Attributes:
        side: Motor and arm as identified; None without a plant: then what was known stays.
        value: Posterior mean of r.
        standard_error: Its standard deviation; None if none is known.
        before: Probability that the gear reacts, without the passes.
    """

    axis: int
    side: MotorSide | None
    value: float = 0.0
    standard_error: float | None = None
    before: float = REACTS
    turnings: list[Turning] = field(default_factory=list)

    @classmethod
    def of(cls, axis: int, side: MotorSide | None, known: IdentifiedError | None) -> "ReactionWatch":
        """Begin a watch with the reaction of the transmission error as it was known before."""
        if known is None:
            return cls(axis, side)
        error = known.standard_error.get("gear_reaction")
        before = REACTS if error is None else min(max(known.gear_reaction, 1.0 - PROBABILITY), PROBABILITY)
        return cls(axis, side, known.gear_reaction, error, before)

    @property
    def known(self) -> Reaction | None:
        """Reaction as it is known; None if nothing has told it."""
        if self.standard_error is None:
            return Reaction(self.value, 0.0) if self.value else None
        return Reaction(self.value, self.standard_error)

    def per_error(
        self, recording: Recording, direction: Signs, loop: Loop, orders: Collection[float], resonance_hz: float
    ) -> dict[tuple[float, int], complex]:
        """What a whole reaction adds to each order, relative to it.

        q_k/z_k at the arm's resonance: less the correction that it is felt as, with the load as the order passes it.

        The direction is +1 or −1 in the ramps, 0 elsewhere; shape (n,).

        Returns:
            The fraction by order and direction.
        """
        if self.side is None:
            return {}
        slow = self._turning(recording).slow(self.side)
        found, at = {}, np.array([resonance_hz])
        for way in (1, -1):
            rows = np.flatnonzero(direction == way)
            for order in orders if len(rows) else ():
                off = np.abs(order * np.abs(slow.speed_rad_s[rows]) - 2.0 * math.pi * resonance_hz)
                load_nm = slow.load_nm[rows[[np.argmin(off)]]]
                found[order, way] = -complex(felt_as(loop, order, at, np.array([way]), load_nm)[0])
        return found

    def _turning(self, recording: Recording) -> Turning:
        angle, torque = recording.axis(self.axis, "position_rad"), recording.axis(self.axis, "torque_nm")
        return Turning(angle, torque, recording.period_s)

    def take(self, recording: Recording, error: TransmissionError) -> None:
        """Add a pass with the whole cancellation."""
        if self.side is None:
            return
        self.turnings.append(self._turning(recording))
        found = gear_reaction(self.turnings, self.side, error)
        if found is not None:
            posterior = found.posterior(self.before)
            self.value, self.standard_error = posterior.value, posterior.standard_error
