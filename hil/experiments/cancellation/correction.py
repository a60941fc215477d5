"""Correction of an axis that silences its tip.

The delay of its set-points is learnt beside it, and how much of a correction the motor makes. With z_k = A_k e^{jφ_k} of the
transmission error order k shakes the tip no more where the motor makes the correction as calculated.

A pass with the whole correction c_k leaves in direction d = ±1 of turning

    s_k = z_k + g c_k − c_k + j d ω c_k (δ − δ_c) + q_k (r − r_c),

where g is the part of the corrections that the motor does not make, δ is the delay of the set-points, δ_c the one that the
correction was made for, ω that of the resonance, r the reaction of the gear on its motor, r_c the one that the set-points
compensate, and q_k what a whole reaction shakes the tip by (`reaction_watch`). Orders and directions tell g, δ and r together.
A gear reacts (r ≈ 1) or does not (r = 0), and the motor's torque says how likely either is. The prior of z_k is what the
model file knows, or what the passes without the whole correction show; z_k + g c_k silences the tip. s_k is off by its noise, and
by the fraction by which the arm's response may be wrong: the less vibration a pass leaves, the more it counts.
"""

import cmath
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from hil.bench.model import Correlation, IdentifiedError, significant
from hil.control.arrays import Real
from hil.control.order_keys import order_keys
from hil.design.ate.identification import JointEstimate
from hil.design.ate.reaction import REACTS, Reaction
from hil.design.estimate import Estimate
from hil.design.estimation import FAR_SIGMAS, PROBABILITY
from hil.design.transmission_error import TransmissionError
from hil.experiments.ate.order_scan import is_significant
from hil.experiments.cancellation.effect import LEAK
from hil.experiments.cancellation.verdict import MOST_LEFT, PartVerdict, Seen

Source = Literal["known", "learnt"]
"""`known` before the first pass, or `learnt` from the passes."""

OFF_ERROR = 0.2
"""Measured: standard error of the arm's response as a fraction: first passes of soft gears are off by up to 15 % (13 bits)."""
MADE_ALIKE, MADE_ALONG, MADE_ACROSS = 0.0013, 0.0007, 0.0003
"""Measured: standard errors of the motor's motion by the correction: in all amplitudes alike, in each, and in each phase.

On 17 drawn robots (50201 to 50228) whose plant leaves less than 0.15 % open, the corrections that silence the tip differ from the
true amplitudes by 0.13 % (rms of the mean; 0.25 % at most), and from their mean by 0.07 %."""
DELAY_PERIODS = 0.1
"""Measured: error of the set-points' delay in SYNC periods before a pass: drawn drives were late by 0.2 of 8 ms at most."""
CONTRADICTED_S = 3e-3
"""Bound: the same where passes contradict it: answers that come late are some milliseconds late."""
SAME = 0.1
"""Difference as a fraction up to which a value is the one that was refused."""
DELAY, REACTION, GAIN = "delay", "reaction", "gain"
UNKNOWN_YET = Estimate((), np.zeros(0), np.zeros((0, 0)))


@dataclass(frozen=True)
class OrderValue:
    """Amplitude and phase of an order.

    Attributes:
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
        """Standard error of the phasor; A_k itself if none is known."""
        along, across = self.sigmas_arcsec
        return self.amplitude_arcsec if self.amplitude_error is None else math.hypot(along, across)

    @property
    def sigmas_arcsec(self) -> tuple[float, float]:
        """Standard errors of the phasor along itself and across; A_k/√2 if none is known."""
        if self.amplitude_error is None or self.phase_error is None:
            return (self.amplitude_arcsec / math.sqrt(2.0),) * 2
        return self.amplitude_error, self.amplitude_arcsec * math.radians(self.phase_error)

    def agrees(self, other: "OrderValue") -> bool:
        """True if two values agree within their standard errors."""
        return abs(self.phasor - other.phasor) <= FAR_SIGMAS * math.hypot(self.sigma_arcsec, other.sigma_arcsec)

    def words(self, order: float) -> str:
        """The value in words."""
        a, phi = (f" ± {each:.2f}" if each is not None else "" for each in (self.amplitude_error, self.phase_error))
        return f"A_{order:g} = {self.amplitude_arcsec:.2f}{a}″, φ_{order:g} = {self.phase_deg:.1f}{phi}°"


@dataclass
class Correction:
    """Correction of an axis from pass to pass.

    Attributes:
        part: What was known; None if nothing was.
        known: Significant orders of what was known.
        acted: Values that the last pass cancelled.
        acted_delay_s: Delay that it was made for.
        acted_reaction: Reaction r_c that it was made for.
        made_error: Standard error of the part that the motor makes of all corrections, by the errors of its plant.
        torque_shows: Reaction as the motor's torque shows it; None if it is not known.
        contradicted: Orders whose known value the passes contradict, with the known value.
        passed: Orders whose resonance the ramps have passed.
    """

    part: IdentifiedError | None = None
    period_s: float = 1e-3
    made_error: float = 0.0
    known: dict[float, OrderValue] = field(default_factory=dict, init=False)
    acted: dict[float, OrderValue] = field(default_factory=dict)
    acted_delay_s: float = 0.0
    acted_reaction: float = 0.0
    torque_shows: Reaction | None = None
    contradicted: dict[float, OrderValue] = field(default_factory=dict)
    _begun: dict[float, OrderValue] = field(default_factory=dict)
    _fits: dict[float, OrderValue] = field(default_factory=dict)
    passed: frozenset[float] = frozenset()
    _returned: dict[float, OrderValue] = field(default_factory=dict)
    _refused: dict[float, list[OrderValue]] = field(default_factory=dict)
    _left: list["_Left"] = field(default_factory=list)
    _prior: Estimate = UNKNOWN_YET
    _posterior: Estimate = UNKNOWN_YET
    _turned: dict[float, complex] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Find the significant orders of what was known."""
        if self.part is not None:
            table, errors = significant(self.part), self.part.standard_error
            phases = table.phases_deg()
            for order, amplitude in table.amplitudes_arcsec().items():
                along, turned = (errors.get(key) for key in order_keys([order]))
                self.known[order] = OrderValue("known", amplitude, phases[order] % 360.0, along, turned)

    @property
    def _made_alike(self) -> float:
        """Standard error of the motor's motion by a correction, in all amplitudes alike."""
        return math.hypot(MADE_ALIKE, self.made_error)

    @property
    def _made(self) -> tuple[float, float]:
        """Standard errors of one order's correction as the motor makes it, along and across."""
        return math.hypot(self._made_alike, MADE_ALONG), MADE_ACROSS

    def begin(self, estimate: JointEstimate, passed: Collection[float]) -> set[float]:
        """Take each order's prior from what was known and a fit.

        A fit that contradicts what was known holds, with their difference for its standard error. An order of which a pass has
        already shown the rest keeps its prior.

        `passed` are the orders whose resonance the ramps pass.

        Returns:
            Orders that have begun so: what the last pass left of them is in the fit.
        """
        self.passed = frozenset(passed)
        delay = self.set_point_delay_s, self.delay_error_s
        # r before its two priors: as wide as they are apart, and either as likely
        values = {} if self._prior.names else {DELAY: delay, REACTION: (REACTS, 1.0), GAIN: (0.0, self._made_alike)}
        shown = {each.order for each in self._left}
        self._fits |= {order: _fitted(order, estimate) for order in estimate.error.amplitude_arcsec}
        begun = {*self.known, *estimate.error.amplitude_arcsec} - shown
        for order in sorted(begun):
            is_seen = order in estimate.error.amplitude_arcsec and is_significant(estimate, order)
            value = self._first_value(order, is_seen=is_seen)
            self._begun[order] = value
            values |= self._prior_of(order, value)
        prior = self._prior.with_others(values)
        self._prior = self._posterior = self._correlated(prior, begun, estimate)
        if self._left:
            self._posterior = self._learnt()
        return begun

    def _correlated(self, prior: Estimate, begun: Collection[float], estimate: JointEstimate) -> Estimate:
        """A prior whose values correlate as the model file, or the fit, says that their errors do."""
        known, fitted = (
            [k for k in sorted(begun) if self._begun[k] is of.get(k) and self._begun[k].amplitude_error is not None]
            for of in (self.known, self._fits)
        )
        if known and self.part is not None:
            prior = _with_correlation(prior, {k: self._begun[k] for k in known}, self.part.correlations(order_keys(known)))
        fitted = [k for k in fitted if k in estimate.orders and k not in self.contradicted]
        if fitted:
            errors = estimate.values.part(order_keys(fitted))
            prior = _with_correlation(prior, {k: self._begun[k] for k in fitted}, errors.correlation)
        return prior

    def _first_value(self, order: float, *, is_seen: bool) -> OrderValue:
        self.contradicted.pop(order, None)
        known, fitted = self.known.get(order), self._fits.get(order)
        if order in self._returned:
            return self._returned[order]
        if known is None or fitted is None:
            value = known or fitted
            assert value is not None  # noqa: S101 - the order is of one of both
            return value
        if order not in self.passed or not is_seen:
            return known
        if known.agrees(fitted):
            return min(known, fitted, key=lambda each: each.sigma_arcsec)
        self.contradicted[order] = known
        return fitted

    def _prior_of(self, order: float, value: OrderValue) -> dict[str, tuple[float, float]]:
        """Prior of both components of an order's correction, by name.

        They are those along its value and across: the motor makes the phase better than the amplitude.
        """
        self._turned[order] = cmath.rect(1.0, math.radians(value.phase_deg))
        other, size = self.contradicted.get(order), value.amplitude_arcsec
        least = 0.0 if other is None else abs(value.phasor - other.phasor) / math.sqrt(2.0)
        along, across = (max(sigma, least) for sigma in value.sigmas_arcsec)
        return {
            _along(order): (size, math.hypot(along, MADE_ALONG * size)),
            _across(order): (0.0, math.hypot(across, MADE_ACROSS * size)),
        }

    @property
    def is_known(self) -> bool:
        """True if every order begins as it was known."""
        return bool(self._begun) and all(each.source == "known" for each in self._begun.values())

    def values(self) -> dict[float, OrderValue]:
        """Value of each order to cancel and store."""
        return {order: self._value(order) for order in self._begun}

    def _value(self, order: float) -> OrderValue:
        begun, prior, found = self._begun[order], self._prior, self._posterior
        # what says less than the prior leaves more than half of its variance, and of a known value's expected error squared
        error = self.error_arcsec(order)
        says_less = error > math.sqrt(0.5) * math.hypot(*_errors_of(prior, order, begun.amplitude_arcsec))
        if says_less and abs(self._phasor(order) - begun.phasor) < error:
            return replace(begun, why=self._why(order)) if begun.source == "known" else begun
        z = self._phasor(order)
        # of the transmission error it is known as well as the motor makes a correction
        off = abs(z - begun.phasor) / math.sqrt(2.0) if self._is_made_otherwise(order) else 0.0
        along, across = (
            math.hypot(error, max(made * abs(z), off))
            for error, made in zip(_errors_of(found, order, begun.amplitude_arcsec), self._made, strict=True)
        )
        turned_deg = math.degrees(cmath.phase(z)) % 360.0
        return OrderValue("learnt", abs(z), turned_deg, along, math.degrees(across / max(abs(z), across)))

    def correlation(self, values: Mapping[float, OrderValue]) -> Correlation | None:
        """Correlation of the errors of some values, of the delay and of the reaction."""
        found = self._posterior
        if not found.names:
            return None
        learnt = [k for k, value in values.items() if value.source == "learnt" and value is not self._begun[k]]
        kept = [k for k, value in values.items() if value.source == "known" and value.amplitude_error is not None]
        at = {name: np.eye(len(found.names))[row] for row, name in enumerate(found.names)}
        shared = {"set_point_delay_s": DELAY} | ({"gear_reaction": REACTION} if self._left else {})
        shared = {key: name for key, name in shared.items() if found.standard_error(name) > 0.0}
        rows: list[Real] = []
        errors: list[float] = []
        for order in learnt:
            rows += [at[_along(order)] + self._begun[order].amplitude_arcsec * at[GAIN], at[_across(order)]]
            errors += values[order].sigmas_arcsec
        rows += [at[name] for name in shared.values()]
        errors += [found.standard_error(name) for name in shared.values()]
        names = (*order_keys(learnt), *shared)
        square = np.array(rows) @ found.covariance @ np.array(rows).T
        np.fill_diagonal(square, np.square(errors))
        together = Estimate(names, np.zeros(len(names)), square).with_others(dict.fromkeys(order_keys(kept), (0.0, 1.0)))
        if kept and self.part is not None:
            together = together.correlated(order_keys(kept), self.part.correlations(order_keys(kept)))
        return Correlation.of(together)

    def _why(self, order: float) -> str:
        """Reason why a known value stays."""
        if order not in self.passed:
            return "the ramps end below its resonance"
        if not any(each.order == order for each in self._left):
            return "no pass cancelled the whole of it"
        return "the passes show it less exactly"

    def _is_made_otherwise(self, order: float) -> bool:
        """True if the correction differs from the error that began."""
        begun, found = self._begun[order], self._posterior
        off = (self._phasor(order) - begun.phasor) * self._turned[order].conjugate()
        size = begun.amplitude_arcsec
        errors = zip(begun.sigmas_arcsec, _errors_of(found, order, size), self._made, strict=True)
        return _differ(off, *(math.hypot(known, shown, made * size) for known, shown, made in errors))

    def error_arcsec(self, order: float) -> float:
        """Standard error of an order's correction: of both components together."""
        return math.hypot(*_errors_of(self._posterior, order, self._begun[order].amplitude_arcsec))

    def _phasor(self, order: float) -> complex:
        along = self._posterior.value(_along(order)) + self._posterior.value(GAIN) * self._begun[order].amplitude_arcsec
        return complex(along, self._posterior.value(_across(order))) * self._turned[order]

    @property
    def set_point_delay_s(self) -> float:
        """Delay of the set-points as it is known so far."""
        known_s = 0.0 if self.part is None else self.part.set_point_delay_s
        return self._posterior.value(DELAY) if self._posterior.names else known_s

    @property
    def delay_error_s(self) -> float:
        """Standard error of the delay."""
        return self._posterior.standard_error(DELAY) if self._posterior.names else DELAY_PERIODS * self.period_s

    @property
    def reaction(self) -> Reaction | None:
        """Reaction of the gear as it is known so far; None if it is not."""
        if not self._left:
            return self.torque_shows
        return Reaction(self._posterior.value(REACTION), self._posterior.standard_error(REACTION))

    def take(
        self,
        seen: Mapping[float, Sequence[Seen]],
        resonance_hz: float,
        per_reaction: Mapping[tuple[float, int], complex] | None = None,
    ) -> None:
        """Learn from what a pass with the whole correction leaves.

        Only orders whose resonance is passed count. Where it contradicts the prior of an order, that is as uncertain as the
        contradiction is large.

        `per_reaction` is q_k/z_k by order and direction.
        """
        made = self.acted_delay_s, self.acted_reaction
        for order, sights in seen.items():
            if order in self.passed and order in self.acted:
                acted, omega = self.acted[order].phasor, 2.0 * math.pi * resonance_hz
                by = per_reaction or {}
                self._left += [
                    _Left(order, each, acted, *made, omega, acted * by.get((order, each.direction), 0.0)) for each in sights
                ]
        if self._left:
            self._posterior = self._learnt()

    def _learnt(self) -> Estimate:
        """Posterior of everything that passes have left.

        What the directions differ by beyond a delay is not noise, and returns in each pass, as the motion's own vibration does:
        each direction has a bias of its own.
        """
        known_s, error_s = (of(DELAY) for of in (self._prior.value, self._prior.standard_error))
        self._prior = self._prior.replaced(DELAY, known_s, CONTRADICTED_S)
        first = self._observed()
        # a motor cannot lead its set-points: what looks like it is a bias of the directions
        late_s, reaction = max(first.value(DELAY), known_s - error_s), first.value(REACTION)
        for order in {each.order for each in self._left}:
            sides = [[each for each in self._left if each.order == order and each.seen.direction == way] for way in (1, -1)]
            shown = [complex(np.mean([each.shown(late_s, reaction) for each in side])) for side in sides if side]
            noise = float(np.mean([_variance(each.seen) for side in sides for each in side])) / max(len(side) for side in sides)
            own = float(np.mean([each.seen.bias_variance for side in sides for each in side]))
            bias = math.sqrt(max(0.25 * abs(shown[0] - shown[-1]) ** 2 - noise, own))
            self._prior = self._prior.with_others({name: (0.0, bias) for way in (1, -1) for name in _bias(order, way)})
            self._widen(order, complex(np.mean(shown)), math.sqrt(0.5 * (bias**2 + noise)))
        found = self._observed()
        if found.value(DELAY) - known_s > FAR_SIGMAS * math.hypot(error_s, found.standard_error(DELAY)):
            return found
        self._prior = self._prior.replaced(DELAY, known_s, error_s)
        return self._observed()

    def _observed(self) -> Estimate:
        """Posterior of z_k, g, δ and r after what passes have left."""
        at = {name: index for index, name in enumerate(self._prior.names)}
        rows, values, variances = [], [], []
        for each in self._left:
            back = self._turned[each.order].conjugate()
            shown, late, bias = back * each.shown(0.0, 0.0), back * each.late, _bias(each.order, each.seen.direction)
            by = {DELAY: late, REACTION: back * each.per_reaction, GAIN: self._begun[each.order].amplitude_arcsec + 0j}
            for is_across, name in enumerate((_along(each.order), _across(each.order))):
                row, bias_name = np.zeros(len(at)), bias[is_across]
                row[at[name]] = 1.0
                for shared, change in by.items():
                    row[at[shared]] = change.imag if is_across else change.real
                if bias_name in at:
                    row[at[bias_name]] = 1.0
                rows.append(row)
                values.append(shown.imag if is_across else shown.real)
                variances.append(_variance(each.seen))
        return self._with_reaction(self._prior.observed(np.array(rows), np.array(values), np.array(variances)))

    def _with_reaction(self, found: Estimate) -> Estimate:
        """Posterior with the reaction that torque and tip show together."""
        known = self.torque_shows or Reaction(0.0, 0.0)
        free = found.standard_error(REACTION)
        if free > math.sqrt(0.5) * self._prior.standard_error(REACTION):  # less than the prior says: the tip shows nothing of it
            return found.with_marginal(REACTION, known.value, known.standard_error)
        before = REACTS if self.torque_shows is None else min(max(known.value, 1.0 - PROBABILITY), PROBABILITY)
        shown = Reaction(found.value(REACTION), free).posterior(before)
        return found.with_marginal(REACTION, shown.value, shown.standard_error)

    def _widen(self, order: float, shown: complex, noise: float) -> None:
        """Widen the prior of an order that passes contradict."""
        prior = self._prior
        known = complex(prior.value(_along(order)), prior.value(_across(order)))
        surprise = shown * self._turned[order].conjugate() - known
        if _differ(surprise, *(math.hypot(error, noise) for error in _errors_of(prior, order, abs(known)))):
            for name in (_along(order), _across(order)):
                prior = prior.replaced(name, prior.value(name), abs(surprise))
            self._prior = prior

    def left_fraction(self, resonance_hz: float) -> float:
        """Expected fraction of the vibration that the last correction leaves.

        √(Σ (E|z_k − c_k e^{−jω(δ − δ_c)}|² + |q_k (r − r_c)|²) / Σ|c_k|²) over the orders whose resonance is passed.
        """
        values = self.values()
        omega, late_s = 2.0 * math.pi * resonance_hz, self.set_point_delay_s - self.acted_delay_s
        reacts = 0.0 if self.reaction is None else self.reaction.value - self.acted_reaction
        left = whole = 0.0
        for order, acted in self.acted.items():
            if order in values and order in self.passed:
                size = abs(acted.phasor) ** 2
                whole += size
                left += abs(values[order].phasor - acted.phasor) ** 2 + self.error_arcsec(order) ** 2
                left += omega**2 * (late_s**2 + self.delay_error_s**2) * size
                left += reacts**2 * max((abs(each.per_reaction) ** 2 for each in self._left if each.order == order), default=0.0)
        return math.sqrt(left / max(whole, 1e-30))

    def is_open(self, verdicts: Sequence[PartVerdict], wanted: Collection[float], resonance_hz: float) -> bool:
        """True if another pass with the whole correction is worth its time.

        `wanted` are the orders that are to be cancelled.
        """
        is_undecided = any(
            each.verdict == "refused" or (each.verdict == "not judged" and self._is_new(each.part.order)) for each in verdicts
        )
        return is_undecided or not set(wanted) <= self.acted.keys() or self.left_fraction(resonance_hz) >= LEAK

    def _is_new(self, order: float) -> bool:
        """True if an order has a value that was not known."""
        return order not in self.known or order in self.contradicted

    def judged(self, verdicts: Sequence[PartVerdict], *, is_last: bool) -> dict[float, PartVerdict]:
        """Orders to leave out after a pass, with the verdicts on them.

        A refused value gives way to another one that the pass does not speak against: that which was known, or a fit. The foot of
        a resonance refuses nothing that was known: there the motion's own jolt weighs as much.

        Args:
            verdicts: Verdicts on the orders that it cancelled.
            is_last: True after the last pass: then of an order that could not be judged, and of which no pass with the whole
                correction shows the rest, the known value stays, or none.
        """
        left_out = {}
        for verdict in verdicts:
            order = verdict.part.order
            known, acted = self.known.get(order), self.acted[order]
            if verdict.verdict == "refused" and (known is None or order in self.passed):
                self._refused.setdefault(order, []).append(acted)
                other = self._other(order, verdict)
                if other is None:
                    left_out[order] = verdict
                else:
                    self._return_to(order, other)
            elif is_last and verdict.verdict == "not judged" and self._is_new(order):
                if known is None:
                    left_out[order] = verdict
                elif not any(each.order == order for each in self._left):
                    self._return_to(order, known)
        return left_out

    def _other(self, order: float, verdict: PartVerdict) -> OrderValue | None:
        """Another value of a refused order that may pass; None without one."""
        for each in (self.known.get(order), self._fits.get(order)):
            if each is None or any(abs(each.phasor - old.phasor) <= SAME * abs(old.phasor) for old in self._refused[order]):
                continue
            if verdict.ratio is None or _would_leave(each, self.acted[order], verdict.ratio) <= MOST_LEFT:
                return each
        return None

    def _return_to(self, order: float, value: OrderValue) -> None:
        """Return to another value of an order."""
        self._begun[order] = self._returned[order] = value
        self.contradicted.pop(order, None)
        self._left = [each for each in self._left if each.order != order]
        prior = self._prior_of(order, value)
        self._posterior, self._prior = (each.with_others(prior) for each in (self._posterior, self._prior))

    def notes(self) -> list[str]:
        """Sentences on what is not as it was known or expected."""
        found, torque, reaction = [], self.torque_shows, self.reaction
        if torque is not None and reaction is not None and (torque.value > REACTS) != (reaction.value > REACTS):
            found.append(
                f"the gear {'reacts' if reaction.value > REACTS else 'does not react'} on its motor, as the tip shows "
                f"(gear_reaction {reaction.value:.2f}); the motor's torque alone would make that {torque.value:.2f}"
            )
        for order, value in self.values().items():
            known, begun = self.contradicted.get(order), self._begun[order]
            if known is not None and not known.agrees(value):
                found.append(
                    f"order {order:g} differs from its known value ({known.words(order)}): the passes show {value.words(order)}"
                )
            elif value.source == "learnt" and value is not begun and self._is_made_otherwise(order):
                found.append(
                    f"order {order:g} needs {value.amplitude_arcsec:.2f}″ at {value.phase_deg:.1f}° to be silent, but learning "
                    f"began with {begun.words(order)}: that value is wrong, or the motor does not make the calculated correction"
                )
        return found


def _would_leave(value: OrderValue, acted: OrderValue, ratio: complex) -> float:
    """Fraction that a value would leave, by the verdict on another."""
    return abs(ratio - value.phasor / acted.phasor) / max(abs(ratio), 1e-30)


def _with_correlation(prior: Estimate, values: Mapping[float, OrderValue], correlation: Real) -> Estimate:
    """A prior in which the errors of some orders' values correlate, amplitudes and phases in turn."""
    errors = np.array([sigma for value in values.values() for sigma in value.sigmas_arcsec])
    names = [name(order) for order in values for name in (_along, _across)]
    return prior.correlated(names, correlation * np.outer(errors, errors))


def _along(order: float) -> str:
    return f"along{order:g}"


def _across(order: float) -> str:
    return f"across{order:g}"


def _errors_of(estimate: Estimate, order: float, size: float) -> tuple[float, float]:
    """Standard errors of an order's correction z_k + g c_k, |c_k| being its size: along its value and across."""
    own, gain = (estimate.names.index(name) for name in (_along(order), GAIN))
    square = estimate.covariance
    along = square[own, own] + 2.0 * size * square[own, gain] + size**2 * square[gain, gain]
    return math.sqrt(max(0.0, along)), estimate.standard_error(_across(order))


def _differ(off: complex, along: float, across: float) -> bool:
    """True if a difference along and across is more than its standard errors explain."""
    return (off.real * across) ** 2 + (off.imag * along) ** 2 > 2.0 * (FAR_SIGMAS * along * across) ** 2


@dataclass(frozen=True)
class _Left:
    """Rest of an order in one direction of a pass.

    Attributes:
        seen: s_k.
        acted: c_k.
        delay_s: δ_c.
        reaction: r_c.
        omega: ω.
        per_reaction: q_k.
    """

    order: float
    seen: Seen
    acted: complex
    delay_s: float
    reaction: float
    omega: float
    per_reaction: complex

    @property
    def late(self) -> complex:
        """Change of s_k with the delay."""
        return 1j * self.seen.direction * self.omega * self.acted

    def shown(self, delay_s: float, reaction: float) -> complex:
        """z_k that it shows with a delay of the set-points and a reaction of the gear."""
        made = self.seen.amplitude + self.acted - self.late * (delay_s - self.delay_s)
        return made - self.per_reaction * (reaction - self.reaction)


def _bias(order: float, direction: int) -> tuple[str, str]:
    """Names of the components of a direction's bias."""
    return f"{_along(order)}{direction:+d}", f"{_across(order)}{direction:+d}"


def _variance(seen: Seen) -> float:
    """Variance of either component of what is left."""
    return seen.variance + 0.5 * (OFF_ERROR * abs(seen.amplitude)) ** 2


def error_of(values: Mapping[float, OrderValue]) -> TransmissionError:
    """Transmission error of the values of some orders."""
    amplitudes = {order: value.amplitude_arcsec for order, value in values.items()}
    return TransmissionError(amplitudes, {order: value.phase_deg for order, value in values.items()})


def _fitted(order: float, estimate: JointEstimate) -> OrderValue:
    """Value of an order by the fit of the passes."""
    error, errors = estimate.error, (estimate.amplitude_error_arcsec[order], estimate.phase_error_deg[order])
    return OrderValue("learnt", error.amplitude_arcsec[order], error.phase_deg[order], *errors)
