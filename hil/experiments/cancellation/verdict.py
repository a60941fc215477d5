"""Verdict on each order of each axis of a cancellation.

It follows from runs without the cancellation, with parts of it, and with the whole.

In run i a fraction g_i of a part acts, so its complex amplitude at the tip is e − g_i c: e is the amplitude without the
cancellation, c the part that the cancellation removes. Both follow by least squares from all runs. A part is good if the
whole of it leaves at most `MOST_LEFT` of e, and the tried fraction lowers e by at least half of that fraction: a phase error of
45° passes; 60° fail at any amplitude, as do three times the amplitude and the correction of another axis. Where the posterior
leaves that open (`decision`), or the noise hides the order, the part is not judged.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hil.design.estimation import SIGMAS
from hil.experiments.cancellation.effect import Part, Sighting
from hil.experiments.decision import Decision
from hil.results.runs import TrialPart

Verdict = Literal["accepted", "refused", "not judged"]

MOST_LEFT = 0.765
"""Measured: fraction of an order that its whole cancellation may leave, 2 sin(45°/2): 390 of 390 wrong ones on 130 drawn robots
were refused, 51 of 1170 right ones not used (docs/trial.md)."""
DRAWS = 4096
"""Accuracy: draws from a posterior: a probability of 97.5 % comes out with a standard error of 0.25 %."""


@dataclass(frozen=True)
class Seen:
    """One part in one run, in one direction of turning.

    Attributes:
        direction: +1 or −1: an unknown delay turns one against the other, so each is judged beside the other; 0 for a motion
            that is judged beside ramps.
        gain: Fraction of the part's cancellation that acted.
        amplitude: Complex amplitude in arcsec.
        variance: Variance of either of its components.
        bias_variance: Variance of what all runs of the motion add to it alike.
    """

    direction: int
    gain: float
    amplitude: complex
    variance: float
    bias_variance: float = 0.0

    @classmethod
    def of(cls, sighting: Sighting, part: Part, gain: float, direction: int = 1) -> "Seen":
        """The part as one recording shows it."""
        return cls(direction, gain, sighting.amplitude[part], sighting.variance(part), sighting.bias_variance(part))


@dataclass(frozen=True)
class PartVerdict:
    """Verdict on one order of one axis.

    Attributes:
        gain: Fraction of the cancellation that was tried.
        fall: Fraction by which the order fell with it; negative where it rose.
        left: Fraction of the order that the whole cancellation leaves.
        lasting_error: Part of `left_error` that more runs do not lower.
        factor: Factor by which the cancellation should be multiplied; None if nothing of it was seen.
        turn_deg: Angle by which φ_k should be turned.
        verdict: `accepted`; `refused` where it is wrong; `not judged` where it does too little to be seen.
        rise: How the tip's peak rises with it, in words; empty if it does not.
        where: Motion that judged it, in words, if not the one that is to be run.
    """

    part: Part
    gain: float
    fall: float
    fall_error: float
    left: float
    left_error: float
    lasting_error: float
    factor: float | None
    factor_error: float | None
    turn_deg: float | None
    turn_error_deg: float | None
    verdict: Verdict
    rise: str = ""
    where: str = ""

    def could_be_judged(self, more: float) -> bool:
        """True if `more` times as many runs could judge an undecided part."""
        noise = math.sqrt(max(self.left_error**2 - self.lasting_error**2, 0.0))
        least_error = math.hypot(noise / math.sqrt(more), self.lasting_error)
        return self.verdict == "not judged" and _is_seen(least_error)

    @property
    def ratio(self) -> complex | None:
        """Factor and angle of the correction as one complex number.

        The cancellation should be multiplied by it; None if nothing of it was seen.
        """
        if self.factor is None or self.turn_deg is None:
            return None
        return cmath.rect(self.factor, math.radians(self.turn_deg))

    @property
    def words(self) -> str:
        """The verdict as a line of text."""
        change = f"{'fell' if self.fall >= 0.0 else 'rose'} by {100.0 * abs(self.fall):.0f} ± {100.0 * self.fall_error:.0f} %"
        if self.rise:
            return f"{self.part.words}: it falls, but with its cancellation {self.rise}"
        head = f"{self.part.words}: {self.where}with {100.0 * self.gain:g} % of its cancellation it {change}"
        head += f" ({100.0 * self.gain:g} % expected)"
        if self.verdict == "not judged":
            if not _is_seen(self.left_error):
                return f"{self.part.words}: its effect is too small to be seen above the sensor noise ({change})"
            whole = f"the whole leaves {100.0 * self.left:.0f} ± {100.0 * self.left_error:.0f} % of it"
            return f"{self.part.words}: not certain to be right: {whole}, and {100.0 * MOST_LEFT:.0f} % at most are allowed"
        if self.factor is None or self.turn_deg is None:
            return head
        turn = f"{self.turn_deg:+.0f}° ± {self.turn_error_deg:.0f}°".replace("-", "−")
        return f"{head}; the correct cancellation is {self.factor:.2f} ± {self.factor_error:.2f} times as large, turned by {turn}"


def judge(part: Part, gain: float, seen: Sequence[Seen]) -> PartVerdict:
    """Judge a part of a cancellation.

    At least one run is without it and one with it, in each direction; `gain` is the fraction that is tried first.

    Raises:
        ValueError: No run is without the part, or none with it.
    """
    pairs = [_solved(part, [each for each in seen if each.direction == way]) for way in sorted({each.direction for each in seen})]
    there, taken, covariance, bias = (np.array(each) for each in zip(*pairs, strict=True))
    # directions weigh by the inverse variance that noise gives their power: var |e + n|² = 4 σ² (|e|² + σ²)
    spread = covariance[:, 0, 0] + bias - 2.0 * covariance[:, 0, 1] + covariance[:, 1, 1]
    inexact = spread * (np.abs(there[np.argmin(spread)]) ** 2 + spread)
    weight = np.sqrt(np.min(inexact) / inexact)
    there, taken, bias = weight * there, weight * taken, weight**2 * bias
    covariance *= weight[:, np.newaxis, np.newaxis] ** 2
    size = float(np.linalg.norm(there))
    noise_error = _left(there, taken, covariance, 1.0, MOST_LEFT)[1]
    covariance[:, 0, 0] += bias
    left, left_error = _left(there, taken, covariance, 1.0, MOST_LEFT)
    tried, tried_error = _left(there, taken, covariance, gain, 1.0)
    lowers = _lowers(there, taken, covariance, gain)
    safe = max(size, 1e-30)
    verdict: Verdict = "accepted" if lowers.holds else "not judged"
    if lowers.fails and _is_seen(left_error / safe):
        verdict = "refused"
    factor, factor_error, turn_deg, turn_error_deg = _factor(there, taken, covariance)
    lasting_error = math.sqrt(max(left_error**2 - noise_error**2, 0.0)) / safe
    return PartVerdict(
        part, gain, 1.0 - tried / safe, tried_error / safe, left / safe, left_error / safe, lasting_error,
        factor, factor_error, turn_deg, turn_error_deg, verdict,
    )  # fmt: skip


def _solved(part: Part, seen: Sequence[Seen]) -> tuple[complex, complex, np.ndarray, float]:
    """Solve e and c of one direction by weighted least squares.

    Returns also the covariance of either of their components, shape (2, 2), and the variance of what all runs add to e.
    """
    gains = {each.gain for each in seen}
    if len(gains) < 2:
        raise ValueError(
            f"{part.words} was recorded with the gains {sorted(gains)} of its cancellation only; at least 2 gains are needed"
        )
    rows = np.array([[1.0, -each.gain] for each in seen]) / np.sqrt([[each.variance] for each in seen])
    wanted = np.array([each.amplitude for each in seen]) / np.sqrt([each.variance for each in seen])
    covariance = np.linalg.inv(rows.T @ rows)
    there, taken = covariance @ (rows.T @ wanted)
    return complex(there), complex(taken), covariance, float(np.mean([each.bias_variance for each in seen]))


def _is_seen(left_error: float) -> bool:
    """True if a right cancellation, which leaves nothing, could be told from one at the limit."""
    return SIGMAS * left_error <= MOST_LEFT


def _lowers(there: np.ndarray, taken: np.ndarray, covariance: np.ndarray, gain: float) -> Decision:
    """Claim that the whole leaves at most `MOST_LEFT` of the order, and the tried fraction g lowers it by at least g/2.

    Its probability is the fraction of draws from the posterior of e and c, normal in either component and in each direction,
    with ‖e − c‖ ≤ `MOST_LEFT` ‖e‖ and ‖e − g c‖ ≤ (1 − g/2) ‖e‖ over the directions; for g = 1 the first alone counts.
    """
    generator = np.random.default_rng(0)
    before, after, tried = np.zeros(DRAWS), np.zeros(DRAWS), np.zeros(DRAWS)
    for e, c, own in zip(there, taken, covariance, strict=True):
        off = np.linalg.cholesky(own) @ (generator.standard_normal((2, DRAWS)) + 1j * generator.standard_normal((2, DRAWS)))
        before += np.abs(e + off[0]) ** 2
        after += np.abs(e + off[0] - c - off[1]) ** 2
        tried += np.abs(e + off[0] - gain * (c + off[1])) ** 2
    is_lower = after <= MOST_LEFT**2 * before
    if gain < 1.0:
        is_lower &= tried <= (1.0 - 0.5 * gain) ** 2 * before
    return Decision(float(np.mean(is_lower)))


def _left(there: np.ndarray, taken: np.ndarray, covariance: np.ndarray, gain: float, most: float) -> tuple[float, float]:
    """Size of e − g c, and error of its difference from `most` ‖e‖."""
    remainder = there - gain * taken
    left, size = float(np.linalg.norm(remainder)), float(np.linalg.norm(there))
    total = 0.0
    for e, rest, own in zip(there, remainder, covariance, strict=True):
        along_e, along_rest = e / max(size, 1e-30), rest / max(left, 1e-30)
        # d(most ‖e‖ − ‖e − g c‖) by e and by c
        slope_e, slope_c = most * along_e - along_rest, gain * along_rest
        total += abs(slope_e) ** 2 * own[0, 0] + abs(slope_c) ** 2 * own[1, 1]
        total += 2.0 * (slope_e * np.conj(slope_c)).real * own[0, 1]
    noise = sum(float(own[0, 0] - 2.0 * gain * own[0, 1] + gain**2 * own[1, 1]) for own in covariance)
    # noise makes every amplitude larger: by as much as it has power, in both components
    return math.sqrt(max(left**2 - 2.0 * noise, 0.0)), math.sqrt(max(total, 0.0))


def _factor(
    there: np.ndarray, taken: np.ndarray, covariance: np.ndarray
) -> tuple[float, float, float, float] | tuple[None, None, None, None]:
    """Factor and angle of e/c with errors; None of an unseen c."""
    size, effect = float(np.linalg.norm(there)), float(np.linalg.norm(taken))
    error_e, error_c = (math.sqrt(float(np.max(covariance[:, i, i]))) for i in (0, 1))
    if effect < SIGMAS * error_c or size < SIGMAS * error_e:
        return None, None, None, None
    ratio = complex(np.vdot(taken, there)) / effect**2
    relative = math.hypot(error_e / size, error_c / effect)
    return abs(ratio), abs(ratio) * relative, math.degrees(cmath.phase(ratio)), math.degrees(relative)


def part_entry(verdict: PartVerdict) -> TrialPart:
    """Entry of the verdict on one part for the result file."""
    return TrialPart(
        axis=verdict.part.axis, order=verdict.part.order, verdict=verdict.verdict, words=verdict.words,
        expected_fall_fraction=verdict.gain, fall_fraction=verdict.fall, fall_error=verdict.fall_error,
        left_fraction=verdict.left, left_error=verdict.left_error, factor=verdict.factor, factor_error=verdict.factor_error,
        turn_deg=verdict.turn_deg, turn_error_deg=verdict.turn_error_deg,
    )  # fmt: skip
