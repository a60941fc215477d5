"""Reaction of a gear on its motor, from passes of a learning.

With the error cancelled, the torque has little else.

Without a cancellation the arm's own part of the motor's torque, which rises towards its resonance, may be taken for a reaction,
or hide it. A pass with the whole cancellation leaves next to nothing of it, and the torque that is left is the reaction's.
"""

from dataclasses import dataclass, field

from hil.bench.bench import Bench
from hil.bench.model import Identified, IdentifiedError
from hil.design.ate.reaction import REACTS, UNLIKELY, MotorSide, Turning, gear_reaction
from hil.design.transmission_error import TransmissionError
from hil.experiments.ate.request import axis_knowledge
from hil.recording import Recording


@dataclass
class ReactionWatch:
    """Passes with the whole cancellation, and the reaction that they show.

    Attributes:
        axis: Axis number.
        side: Motor and arm as identified; None without a plant: then what was known stays.
        value: Posterior mean of r.
        standard_error: Its standard deviation; None if none is known.
        before: Probability that the gear reacts, without the passes.
        turnings: Motions of the passes.
    """

    axis: int
    side: MotorSide | None
    value: float = 0.0
    standard_error: float | None = None
    before: float = REACTS
    turnings: list[Turning] = field(default_factory=list)

    @classmethod
    def of(cls, bench: Bench, identified: Identified | None, axis: int, known: IdentifiedError | None) -> "ReactionWatch":
        """Begin a watch with the known reaction.

        Args:
            bench: The bench file.
            identified: The model file; None without one.
            axis: Axis number.
            known: Transmission error as it was known before; None if it was not.
        """
        side = axis_knowledge(bench, axis, identified, sensorless=False).side
        if known is None:
            return cls(axis, side)
        error = known.standard_error.get("gear_reaction")
        before = REACTS if error is None else min(max(known.gear_reaction, UNLIKELY), 1.0 - UNLIKELY)
        return cls(axis, side, known.gear_reaction, error, before)

    def take(self, recording: Recording, error: TransmissionError) -> None:
        """Add a pass with the whole cancellation.

        Args:
            recording: Recording of the pass.
            error: The error as it is known after it.
        """
        if self.side is None:
            return
        angle, torque = recording.axis(self.axis, "position_rad"), recording.axis(self.axis, "torque_nm")
        self.turnings.append(Turning(angle, torque, recording.period_s))
        found = gear_reaction(self.turnings, self.side, error)
        posterior = None if found is None else found.posterior(self.before)
        if posterior is not None:
            self.value, self.standard_error = posterior.value, posterior.standard_error
