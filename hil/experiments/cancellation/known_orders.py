"""Known orders of a transmission error before it is learnt.

The module decides which of them learning keeps.

The ramps of a learning may end below an order's resonance, or show it worse than an identification did. The known value of
such an order holds until a pass has shown it to be wrong: a learnt value is never worse than the value at the start.

The learnt value of an order comes from the fit of all passes, or from a pass in which its cancellation acted, by the factor
and angle of the error there. The value that is known better counts. On a gear that is no spring this is the latter: it needs
no model of the gear, and it becomes more exact as less vibration is left.
"""

import cmath
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from hil.bench.model import Identified, IdentifiedError, significant
from hil.design.ate.identification import JointEstimate
from hil.design.transmission_error import TransmissionError
from hil.experiments.ate.order_scan import is_significant
from hil.experiments.cancellation.verdict import MOST_LEFT, PartVerdict
from hil.robot_tables import amplitude_key, phase_key

Source = Literal["known", "learnt"]
"""`known` before the first pass, or `learnt` from the passes."""

OFF_ERROR = 0.2
"""Error of what a pass shows of a cancellation, as a fraction of what it is off: so far may the arm's response be wrong."""
AGREE_SIGMAS = 3.0
"""Standard errors of their difference up to which two values of an order are the same one, and the more exact of them holds."""


@dataclass(frozen=True)
class OrderValue:
    """Amplitude and phase of an order.

    Attributes:
        source: Origin of the values.
        amplitude_arcsec: A_k.
        phase_deg: φ_k.
        amplitude_error: Standard error of A_k in arcsec; None if none is known.
        phase_error: Standard error of φ_k in degrees; None if none is known.
        why: Reason why it is this one, of one that was known.
    """

    source: Source
    amplitude_arcsec: float
    phase_deg: float
    amplitude_error: float | None
    phase_error: float | None
    why: str = ""

    @property
    def phasor(self) -> complex:
        """A_k e^{jφ_k} in arcsec."""
        return cmath.rect(self.amplitude_arcsec, math.radians(self.phase_deg))

    @property
    def sigma_arcsec(self) -> float:
        """Standard error of the phasor; infinite if none is known."""
        if self.amplitude_error is None or self.phase_error is None:
            return math.inf
        return math.hypot(self.amplitude_error, self.amplitude_arcsec * math.radians(self.phase_error))

    def agrees(self, other: "OrderValue") -> bool:
        """True if two values agree within their standard errors."""
        return abs(self.phasor - other.phasor) <= AGREE_SIGMAS * math.hypot(self.sigma_arcsec, other.sigma_arcsec)

    def words(self, order: float) -> str:
        """The value in words."""
        a, phi = (f" ± {each:.2f}" if each is not None else "" for each in (self.amplitude_error, self.phase_error))
        return f"A_{order:g} = {self.amplitude_arcsec:.2f}{a}″, φ_{order:g} = {self.phase_deg:.1f}{phi}°"


@dataclass
class KnownOrders:
    """Orders that are known of an axis before its learning.

    Attributes:
        values: Significant orders of what was known.
        refused: Values that a pass has shown to be wrong.
        decided: Sources that the last pass has decided on, and why.
        acted: Values that the last pass cancelled.
        shown: Values that passes have shown, by what their cancellation left.
    """

    values: Mapping[float, OrderValue] = field(default_factory=dict)
    refused: set[tuple[float, Source]] = field(default_factory=set)
    decided: dict[float, tuple[Source, str]] = field(default_factory=dict)
    acted: dict[float, OrderValue] = field(default_factory=dict)
    shown: dict[float, OrderValue] = field(default_factory=dict)

    @classmethod
    def of(cls, part: IdentifiedError | None) -> "KnownOrders":
        """Known orders of a part of a model file."""
        if part is None:
            return cls()
        table, errors = significant(part), part.standard_error
        phases = table.phases_deg()
        return cls({
            order: OrderValue(
                "known", amplitude, phases[order] % 360.0, errors.get(amplitude_key(order)), errors.get(phase_key(order))
            )
            for order, amplitude in table.amplitudes_arcsec().items()
        })  # fmt: skip

    @classmethod
    def of_axis(cls, identified: Identified | None, axis: int) -> "KnownOrders":
        """Known orders of an axis in a model file; none without one."""
        return cls.of(None if identified is None or axis not in identified.axis else identified.axis[axis].ate)

    def acted_error(self) -> TransmissionError:
        """The error that the last pass cancelled."""
        return error_of(self.acted)

    def choices(self, estimate: JointEstimate, passed: Collection[float]) -> dict[float, OrderValue]:
        """Choose the value of each order to cancel and store.

        It is the learnt value, or the one that was known.

        Args:
            estimate: Estimate from the passes.
            passed: Orders whose resonance the passes' ramps pass.
        """
        chosen = {}
        for order in sorted({*self.values, *estimate.error.amplitude_arcsec}):
            value = self._choice(order, estimate, passed)
            if value is not None:
                chosen[order] = value
        return chosen

    def _choice(self, order: float, estimate: JointEstimate, passed: Collection[float]) -> OrderValue | None:
        known, learnt = (self._open(order, each) for each in (self.values.get(order), self._learnt(order, estimate)))
        if known is None or learnt is None:
            return known if learnt is None else learnt
        source, why = self.decided.get(order) or _better(order, known, learnt, estimate, passed)
        return learnt if source == "learnt" else replace(known, why=why)

    def _open(self, order: float, value: OrderValue | None) -> OrderValue | None:
        return None if value is None or (order, value.source) in self.refused else value

    def _learnt(self, order: float, estimate: JointEstimate) -> OrderValue | None:
        """Learnt value of an order; None if it was not fitted.

        It comes from the fit of the passes, or from a pass with a cancellation of it.
        """
        fitted, shown = _fitted(order, estimate), self.shown.get(order)
        return shown if fitted is not None and shown is not None and shown.sigma_arcsec < fitted.sigma_arcsec else fitted

    def _show(self, verdict: PartVerdict, acted: OrderValue) -> None:
        """Keep the value that a pass shows.

        The pass's cancellation must have been accepted and its errors known.
        """
        self.shown.pop(verdict.part.order, None)
        factor_error, turn_error_deg = verdict.factor_error, verdict.turn_error_deg
        if verdict.verdict != "accepted" or verdict.ratio is None or factor_error is None or turn_error_deg is None:
            return
        there, off = verdict.ratio * acted.phasor, OFF_ERROR * abs(verdict.ratio - 1.0)
        self.shown[verdict.part.order] = OrderValue(
            "learnt",
            abs(there),
            math.degrees(cmath.phase(there)) % 360.0,
            math.hypot(factor_error, off) * acted.amplitude_arcsec,
            math.hypot(turn_error_deg, math.degrees(off)),
        )

    def _is_better_learnt(self, order: float, estimate: JointEstimate) -> bool:
        """True if the passes know an order better than before.

        They must agree with the value that was known.
        """
        known, learnt = (self._open(order, each) for each in (self.values.get(order), self._learnt(order, estimate)))
        return known is not None and learnt is not None and known.agrees(learnt) and learnt.sigma_arcsec < known.sigma_arcsec

    def judged(
        self, verdicts: Sequence[PartVerdict], estimate: JointEstimate, passed: Collection[float], *, is_last: bool
    ) -> dict[float, PartVerdict]:
        """Judge the known orders by a pass.

        Args:
            verdicts: Verdicts on the orders that it cancelled.
            estimate: Estimate after it.
            passed: Orders whose resonance the passes' ramps pass.
            is_last: True after the last pass.

        Returns:
            Orders that are to be left out, with the verdicts on them.
        """
        left_out = {}
        for verdict in verdicts:
            order, acted = verdict.part.order, self.acted[verdict.part.order]
            self._show(verdict, acted)
            both = (self._open(order, each) for each in (self.values.get(order), self._learnt(order, estimate)))
            other = next((each for each in both if each is not None and each.source != acted.source), None)
            # the foot of a resonance refuses nothing that was known: there the motion's own jolt weighs as much
            is_refused = verdict.verdict == "refused" and (acted.source == "learnt" or order in passed)
            if is_refused:
                self.refused.add((order, acted.source))
                if other is None or not _would_pass(other, acted, verdict):
                    self.refused |= {(order, "known"), (order, "learnt")}
                    left_out[order] = verdict
            elif is_last and verdict.verdict != "accepted":
                if order in passed and self._is_better_learnt(order, estimate):
                    self.decided[order] = ("learnt", "")
                elif order not in self.values or (order, "known") in self.refused:
                    left_out[order] = verdict
                else:
                    self.decided[order] = ("known", "the passes do not show the effect of its cancellation")
            elif is_last and acted.source == "learnt" and other is not None and not acted.agrees(other):
                left, of_other = (_left(each, acted, verdict) for each in (acted, other))
                if left is None or of_other is None or of_other <= left:
                    self.decided[order] = ("known", "the learnt values do not reduce it further")
        return left_out


def error_of(values: Mapping[float, OrderValue]) -> TransmissionError:
    """Transmission error of the values of some orders."""
    amplitudes = {order: value.amplitude_arcsec for order, value in values.items()}
    return TransmissionError(amplitudes, {order: value.phase_deg for order, value in values.items()})


def _fitted(order: float, estimate: JointEstimate) -> OrderValue | None:
    """Value of an order by the fit of the passes, or None.

    None if the order was not fitted.
    """
    error = estimate.error
    if order not in error.amplitude_arcsec:
        return None
    errors = estimate.amplitude_error_arcsec[order], estimate.phase_error_deg[order]
    return OrderValue("learnt", error.amplitude_arcsec[order], error.phase_deg[order], *errors)


def _better(
    order: float, known: OrderValue, learnt: OrderValue, estimate: JointEstimate, passed: Collection[float]
) -> tuple[Source, str]:
    """Choose the better of two values before a pass has compared them.

    Returns also the reason if it is the known one.
    """
    if order not in passed:
        return "known", "the ramps end below its resonance"
    if not is_significant(estimate, order):
        return "known", "the passes do not show it"
    if known.agrees(learnt) and known.sigma_arcsec <= learnt.sigma_arcsec:
        return (
            "known",
            f"the passes identify it to {learnt.sigma_arcsec:.2f}″ only; it was known to {known.sigma_arcsec:.2f}″",
        )
    return "learnt", ""


def _left(value: OrderValue, acted: OrderValue, verdict: PartVerdict) -> float | None:
    """Fraction of an order that a value's cancellation would leave.

    It follows from a pass with another value; None if that pass shows nothing.
    """
    if verdict.ratio is None or acted.amplitude_arcsec <= 0.0:
        return None
    return abs(verdict.ratio - value.phasor / acted.phasor) / max(abs(verdict.ratio), 1e-30)


def _would_pass(value: OrderValue, acted: OrderValue, verdict: PartVerdict) -> bool:
    """True if another value than the refused one may be tried."""
    left = _left(value, acted, verdict)
    return not value.agrees(acted) if left is None else left <= MOST_LEFT
