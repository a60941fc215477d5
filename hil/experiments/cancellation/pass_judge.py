"""Verdicts on the orders that a pass of the learning cancelled.

They compare the pass with the first one, which has no cancellation.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from hil.analysis import TipScale
from hil.bench.bench import Bench
from hil.bench.model import Identified
from hil.design.ate.identification import JointEstimate
from hil.design.ate.model import Arm
from hil.experiments.ate.motion import Ramps
from hil.experiments.cancellation.effect import AxisWaves, Part, Response, refined
from hil.experiments.cancellation.ramp_trial import seen_by_direction
from hil.experiments.cancellation.verdict import PartVerdict, Seen, judge
from hil.experiments.cancellation.waves import response_of, waves_of
from hil.recording import Recording


class PassJudge:
    """Judge of the passes of one axis.

    A pass may be to another speed than the first, so each is read with its own waves; and each direction for itself, since an
    unknown delay turns one against the other.
    """

    def __init__(self, bench: Bench, identified: Identified | None, axis: int, known: Collection[float] = ()) -> None:
        """Keep the bench, the axis and its known orders.

        The response is that of the model file, or of the first pass' arm.
        """
        self._known_orders = tuple(known)
        self._bench, self._axis, self._known = bench, axis, response_of(bench, identified, axis)
        self._response: Response | None = None
        self._without: dict[float, list[Seen]] = {}

    def begin(self, recording: Recording, motion: Ramps, estimate: JointEstimate, scale: TipScale) -> None:
        """Read the first pass, with which the others are compared."""
        self._response = self._first(recording, motion, estimate, scale)
        fitted = tuple({*estimate.error.amplitude_arcsec, *self._known_orders})
        self._without = self.read(recording, motion, fitted, 0.0, scale)

    def read(
        self, recording: Recording, motion: Ramps, orders: Sequence[float], gain: float, scale: TipScale
    ) -> dict[float, list[Seen]]:
        """Read what is left of each order in each direction."""
        assert self._response is not None  # noqa: S101 - made by the first pass
        waves = self._waves(recording, motion, tuple({*orders, *self._without}), self._response)
        return seen_by_direction(recording, motion, waves, orders, gain, scale)

    def verdicts(self, seen: Mapping[float, Sequence[Seen]], gain: float) -> tuple[PartVerdict, ...]:
        """Verdict on each order of a pass, against the first one."""
        axis = self._axis
        return tuple(judge(Part(axis, k), gain, [*self._without[k], *sights]) for k, sights in seen.items())

    def _first(self, recording: Recording, motion: Ramps, estimate: JointEstimate, scale: TipScale) -> Response:
        """The response, refined on the first pass."""
        arm = estimate.arm
        bare = Response(Arm(arm.resonance_hz, arm.damping, gear_fraction=arm.gear_fraction))
        start = replace(self._known or bare, delay_s=arm.delay_s)
        waves = self._waves(recording, motion, tuple(estimate.error.amplitude_arcsec), start)
        rows = motion.direction() != 0
        return refined([recording], waves, [rows], scale.band_hz)[0].response

    def _waves(self, recording: Recording, motion: Ramps, orders: Sequence[float], response: Response) -> tuple[AxisWaves, ...]:
        return waves_of(self._bench, {self._axis: response}, {self._axis: orders}, motion.motion, recording)
