"""Realisation of the paper's notch in a drive.

A drive's filter is rarely the designed one: its objects hold 15 bits, whole hertz, or a Q of 5 at most. So the values are rounded
exactly as the objects hold them, and zeros, poles and DC gain are recomputed from the rounded values. A filter that is no longer
the designed notch is refused with the numbers.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from drive_profiles.errors import NotRealisableError
from drive_profiles.family.capability import FilterSection, NotchFacts
from drive_profiles.family.profile import Profile
from drive_profiles.realisation.biquad import Biquad, NotchTarget, Shape, shape_of
from drive_profiles.realisation.fitting import Fit
from drive_profiles.realisation.sections import obstacles, period_of


@dataclass(frozen=True)
class Deviations:
    """Deviations of the drive's filter from the target, held minus target.

    Those of the dampings are fractions of them. `offset_share` is the fraction of the poles' offset from the zeros that remains,
    1 for all of it (name in ``--json``); a positive `depth_db` means that the notch is less deep at the target's zero.
    """

    zero_hz: float
    pole_hz: float
    zeta_zero: float
    zeta_pole: float
    dc_gain: float
    offset_share: float
    depth_db: float

    @classmethod
    def between(cls, target: NotchTarget, held: Shape) -> "Deviations":
        """Compare a held filter with its target."""
        offset = held.pole_hz - held.zero_hz
        return cls(
            zero_hz=held.zero_hz - target.zero_hz,
            pole_hz=held.pole_hz - target.pole_hz,
            zeta_zero=held.zeta_zero / target.zeta_zero - 1.0,
            zeta_pole=held.zeta_pole / target.zeta_pole - 1.0,
            dc_gain=held.dc_gain - 1.0,
            offset_share=offset / target.offset_hz if target.offset_hz else 1.0,
            depth_db=held.gain_db(target.zero_hz) - target.shape.gain_db(target.zero_hz),
        )


@dataclass(frozen=True)
class Tolerance:
    """Largest deviations with which a filter still counts as the designed one.

    The paper puts the poles 0.5 or 0.7 Hz above the zeros (Table 3), and that offset is what keeps the phase: a tenth of it on
    either frequency is the most that leaves the offset recognisable; on the zeros at 11.84 Hz it costs 0.1 dB of depth. A
    twentieth of ζ_rn = 0.028 is 0.4 dB of depth. The gain at DC is the loop's gain.

    Attributes:
        offset_fraction: Deviation of either frequency, as a fraction of the offset, or of the zeros' half-width ζ_z f_z where
            that is more (a target without offset has this alone).
        damping_fraction: Deviation of either damping, as a fraction of it.
    """

    offset_fraction: float = 0.1
    damping_fraction: float = 0.05
    dc_gain: float = 1e-3

    def frequency_hz(self, target: NotchTarget) -> float:
        """Return the largest deviation of the frequencies of zeros and poles, Hz."""
        return self.offset_fraction * max(abs(target.offset_hz), target.zeta_zero * target.zero_hz)

    def excess(self, target: NotchTarget, held: Shape) -> dict[str, float]:
        """Return each deviation as a multiple of the tolerance."""
        off, f = Deviations.between(target, held), self.frequency_hz(target)
        return {
            "zero_hz": abs(off.zero_hz) / f,
            "pole_hz": abs(off.pole_hz) / f,
            "zeta_zero": abs(off.zeta_zero) / self.damping_fraction,
            "zeta_pole": abs(off.zeta_pole) / self.damping_fraction,
            "dc_gain": abs(off.dc_gain) / self.dc_gain,
        }

    def objections(self, target: NotchTarget, held: Shape) -> tuple[str, ...]:
        """Return the deviations beyond the tolerance, in words with the numbers."""
        excess, f = self.excess(target, held), self.frequency_hz(target)
        tolerance = f"tolerance {100 * self.damping_fraction:g} %"
        said = {
            "zero_hz": f"zeros at {held.zero_hz:.2f} Hz instead of {target.zero_hz:.2f} (tolerance {f:.2g} Hz)",
            "pole_hz": f"poles at {held.pole_hz:.2f} Hz instead of {target.pole_hz:.2f} (tolerance {f:.2g} Hz)",
            "zeta_zero": f"damping of the zeros {held.zeta_zero:.4g} instead of {target.zeta_zero:g} ({tolerance})",
            "zeta_pole": f"damping of the poles {held.zeta_pole:.4g} instead of {target.zeta_pole:g} ({tolerance})",
            "dc_gain": f"gain {held.dc_gain:.4f} at DC instead of 1 (tolerance {self.dc_gain:g})",
        }
        return tuple(text for name, text in said.items() if not excess[name] <= 1.0)


PAPER = Tolerance()
"""Tolerance that Table 3 of the paper leaves room for."""


@dataclass(frozen=True)
class Realisation:
    """A target as a drive holds it.

    `values` are to be written, in the parameters' units, selectors included; `biquads` is the filter that the drive then runs,
    and `held` its zeros, poles and DC gain, recomputed. It is exact if there are no `reasons`. `is_verified` tells that the
    profile's facts about the filter are more than a guess.
    """

    profile: str
    target: NotchTarget
    values: dict[str, float]
    biquads: tuple[Biquad, ...]
    period_s: float
    held: Shape
    deviations: Deviations
    reasons: tuple[str, ...]
    is_verified: bool

    @property
    def is_exact(self) -> bool:
        """True if the filter is the designed notch, within the tolerance."""
        return not self.reasons

    @property
    def verdict(self) -> Literal["exact", "approximate", "lost"]:
        """Verdict in a word: `lost` if less than half of the depth, in dB, is left."""
        if self.is_exact:
            return "exact"
        wanted_db, held_db = (shape.gain_db(self.target.zero_hz) for shape in (self.target.shape, self.held))
        return "lost" if held_db > 0.5 * wanted_db else "approximate"


def realise(
    profile: Profile,
    target: NotchTarget,
    *,
    section: int = 0,
    period_s: float | None = None,
    tolerance: Tolerance = PAPER,
    allow_approximate: bool = False,
) -> Realisation:
    """Find the values nearest to the target, and recompute the filter.

    Frequencies and dampings are stated such that the drive's own discretisation gives the target. Of fixed or floating
    point coefficients the neighbours of each are tried too: Σb = 1 + Σa, the DC gain, then holds to the last bit. A
    ``variable`` form takes offset and dampings; order and speed range are not in the target and stay the caller's.

    Args:
        section: Number of the drive's filter, from 0.
        period_s: Period at which the filter runs, s; needed where the profile does not know it.
        allow_approximate: Accept the nearest filter that the drive holds. A frequency out of range, an unknown scaling, or a
            filter that is not a stable notch is refused all the same.

    Raises:
        NotRealisableError: The drive cannot hold the target; the error has all reasons with their numbers.
    """
    notch = profile.notch
    if notch is None:
        raise NotRealisableError(profile.label, ("its profile has no filter",))
    if not 0 <= section < len(notch.sections):
        raise NotRealisableError(
            profile.label, (f"it has no filter section {section + 1}; its sections are 1 to {len(notch.sections)}",)
        )
    filter_section = notch.sections[section]
    hard = [*obstacles(profile, notch, filter_section), *_read_only(profile, filter_section), *_out_of_range(notch, target)]
    if hard:
        raise NotRealisableError(profile.label, tuple(hard))
    period = period_of(profile, period_s)
    fit = Fit(profile, notch, filter_section, target, period, lambda shape: max(tolerance.excess(target, shape).values()))
    values = fit.values()
    biquads = fit.filter(values)
    held = shape_of(biquads[0], period)
    reasons = (*fit.reasons, *tolerance.objections(target, held))
    if reasons and (not allow_approximate or not held.is_notch):
        raise NotRealisableError(profile.label, reasons if held.is_notch else (*reasons, "the result is not a stable notch"))
    deviations = Deviations.between(target, held)
    return Realisation(profile.label, target, values, biquads, period, held, deviations, reasons, notch.is_verified)


def _read_only(profile: Profile, section: FilterSection) -> Iterator[str]:
    for name in (*section.parts.values(), *section.settings):
        if (parameter := profile.parameter(name)).access == "ro":
            yield f"{name} ({parameter.written_address}) is read only"


def _out_of_range(notch: NotchFacts, target: NotchTarget) -> Iterator[str]:
    for what, needed in (("zeros", target.zero_hz), ("poles", target.pole_hz)):
        if notch.min_frequency_hz is not None and needed < notch.min_frequency_hz:
            yield f"its filter starts at {notch.min_frequency_hz:g} Hz; the {what} need {needed:g} Hz"
        if notch.max_frequency_hz is not None and needed > notch.max_frequency_hz:
            yield f"its filter ends at {notch.max_frequency_hz:g} Hz; the {what} need {needed:g} Hz"
