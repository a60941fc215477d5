"""Search for the filter values that come nearest to a target."""

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from drive_profiles.errors import NotRealisableError, OutOfRangeError
from drive_profiles.family.capability import FilterSection, NotchFacts
from drive_profiles.family.parameter import LIMITS, Parameter
from drive_profiles.family.profile import Profile
from drive_profiles.realisation.biquad import Biquad, NotchTarget, Quadratic, Shape, biquad_of, shape_of, stated
from drive_profiles.realisation.sections import COEFFICIENTS, HIGHER, HeldValues, coefficient_per_value, filter_of, hold, rule_of

_SMALLEST_DAMPING = 1e-4
_SLACK = 1e-3
"""A frequency that the discretisation puts outside the parameter's range by less than this fraction is set to its limit."""


@dataclass(frozen=True)
class Fit:
    """Search for the values of one filter nearest to a target.

    `distance` measures how far a shape is from the target, 0 for none; `reasons` has objections, added while fitting.
    """

    profile: Profile
    notch: NotchFacts
    section: FilterSection
    target: NotchTarget
    period_s: float
    distance: Callable[[Shape], float]
    reasons: list[str] = field(default_factory=list)

    def values(self) -> dict[str, float]:
        """Return the parameter values by name, settings first.

        Raises:
            NotRealisableError: An object cannot hold its frequency or coefficient.
        """
        settings = {name: hold(self.profile.parameter(name), value) for name, value in self.section.settings.items()}
        try:
            if self.notch.form == "coefficients":
                return settings | _coefficients(self)
            if self.notch.form != "variable":
                return settings | _frequencies(self)
            wanted = {
                "offset": self.target.offset_hz,
                "zero_damping": self.target.zeta_zero,
                "pole_damping": self.target.zeta_pole,
            }
            return settings | {self.section.parts[part]: hold(self.parameter(part), value) for part, value in wanted.items()}
        except OutOfRangeError as error:
            raise NotRealisableError(self.profile.label, (str(error),)) from None

    def filter(self, values: dict[str, float]) -> tuple[Biquad, ...]:
        """Return the filter that the drive runs, evaluated at the target's speed."""
        if self.notch.form != "variable":
            return filter_of(HeldValues(self.profile, values), self.notch, self.section, self.period_s)
        parts, zero_hz = self.section.parts, self.target.zero_hz
        zero = Quadratic(zero_hz, values[parts["zero_damping"]])
        pole = Quadratic(zero_hz + values[parts["offset"]], values[parts["pole_damping"]])
        return (biquad_of(zero, pole, self.period_s, rule_of(self.notch)),)

    def parameter(self, part: str) -> Parameter:
        """Return the parameter that holds a part of the filter."""
        return self.profile.parameter(self.section.parts[part])


def design(target: NotchTarget, period_s: float) -> Biquad:
    """Return the bilinear discretisation of the target, as in the paper."""
    return biquad_of(Quadratic(target.zero_hz, target.zeta_zero), Quadratic(target.pole_hz, target.zeta_pole), period_s)


def _frequencies(fit: Fit) -> dict[str, float]:
    """Return the frequencies and dampings whose discretisation gives those of the target."""
    target, rule = fit.target, rule_of(fit.notch)
    zero = stated(Quadratic(target.zero_hz, target.zeta_zero), fit.period_s, rule)
    pole = stated(Quadratic(target.pole_hz, target.zeta_pole), fit.period_s, rule)
    _question_rule(fit)
    low, high = fit.notch.min_pole_damping, fit.notch.max_pole_damping or math.inf
    if fit.notch.form == "symmetric":
        if fit.distance(Shape(target.zero_hz, target.zeta_zero, target.zero_hz, target.zeta_pole, 1.0, is_stable=True)) > 1.0:
            there = f"{target.offset_hz:g} Hz from the zeros at {target.zero_hz:g} Hz"
            fit.reasons.append(f"its filter has one frequency for zeros and poles, so it cannot hold the poles {there}")
        fixed = fit.notch.min_zero_damping
        if fit.distance(Shape(target.zero_hz, fixed, target.pole_hz, target.zeta_pole, 1.0, is_stable=True)) > 1.0:
            fit.reasons.append(f"the damping of its zeros is fixed at {fixed:g}")
        f = _frequency(fit, "frequency", zero.frequency_hz)
        return f | _damping(fit, "", pole.zeta, low, high, next(iter(f.values())))
    zero_f, pole_f = _frequency(fit, "zero_frequency", zero.frequency_hz), _frequency(fit, "pole_frequency", pole.frequency_hz)
    dampings = _damping(fit, "zero_", zero.zeta, fit.notch.min_zero_damping, math.inf)
    return zero_f | pole_f | dampings | _damping(fit, "pole_", pole.zeta, low, high)


def _question_rule(fit: Fit) -> None:
    """Object to an unknown discretisation: bilinear and Euler differ by ωT/2."""
    if fit.notch.discretisation != "not known":
        return
    doubt = math.pi * fit.target.zero_hz * fit.period_s
    shape = Shape(fit.target.zero_hz, fit.target.zeta_zero + doubt, fit.target.pole_hz, fit.target.zeta_pole, 1.0, is_stable=True)
    if fit.distance(shape) > 1.0:
        percent = 100.0 * doubt / fit.target.zeta_zero
        fit.reasons.append(
            f"its discretisation is not known: the damping of the zeros may be off by {doubt:.2g}, {percent:.0f} %"
        )


def _frequency(fit: Fit, part: str, wanted_hz: float) -> dict[str, float]:
    step, parameter = fit.notch.frequency_step_hz, fit.parameter(part)
    value = round(wanted_hz / step) * step if step else wanted_hz
    low, high = _limits(parameter)
    inside = min(max(value, low), high)
    return {fit.section.parts[part]: hold(parameter, inside if abs(inside - value) <= _SLACK * value else value)}


def _damping(fit: Fit, prefix: str, zeta: float, low: float, high: float, frequency_hz: float = math.nan) -> dict[str, float]:
    """Return the damping as the drive's parameter states it.

    The parameter is Q = 1/2ζ, ζ, or the bandwidth 2 ζ f; values beyond its limits are set to the limit.
    """
    quantity = next(quantity for quantity in ("damping", "q", "bandwidth") if prefix + quantity in fit.section.parts)
    parameter = fit.parameter(prefix + quantity)
    whose = "zeros'" if prefix == "zero_" else "poles'"

    def value_of(damping: float) -> float:
        return {"damping": damping, "q": 0.5 / damping, "bandwidth": 2.0 * damping * frequency_hz}[quantity]

    inside = min(max(zeta, low, _SMALLEST_DAMPING), high)
    least, most = _limits(parameter)
    value = min(max(value_of(inside), least), most)
    if abs(value / value_of(inside) - 1.0) > 1e-9 or inside != zeta:
        reached = {"damping": value, "q": 0.5 / value, "bandwidth": 0.5 * value / frequency_hz}[quantity]
        held = f"{reached:g} ({fit.section.parts[prefix + quantity]} = {value:g})"
        fit.reasons.append(f"the {whose} damping cannot be {zeta:.3g}; the nearest is {held}")
    return {fit.section.parts[prefix + quantity]: hold(parameter, value)}


def _limits(parameter: Parameter) -> tuple[float, float]:
    """Return the smallest and largest value that an object takes."""
    low, high = -math.inf, math.inf
    if parameter.data_type in LIMITS:
        step = parameter.value_per_step()
        low, high = (step * limit for limit in LIMITS[parameter.data_type])
    return (
        low if parameter.minimum is None else max(low, parameter.minimum),
        high if parameter.maximum is None else min(high, parameter.maximum),
    )


def _coefficients(fit: Fit) -> dict[str, float]:
    """Return the coefficients of the nearest filter.

    Rounded one by one they would lose the DC gain: at 16 kHz Σb is 10⁻⁵, the last bit of a single 6·10⁻⁸.
    """
    parts, wanted = fit.section.parts, design(fit.target, fit.period_s)
    values = {parts[part]: 0.0 for part in HIGHER if part in parts}
    gain = 1.0
    if "gain" in parts:
        parameter = fit.parameter("gain")
        one = coefficient_per_value(fit.notch, parameter)
        values[parts["gain"]] = hold(parameter, _gain(fit, wanted) / one)
        gain = values[parts["gain"]] * one
    signs = {part: -float(fit.notch.a_sign) if part.startswith("a") else 1.0 for part in COEFFICIENTS}
    scaled = [c / gain if part.startswith("b") else c for part, c in zip(COEFFICIENTS, wanted, strict=True)]
    per_value = {part: coefficient_per_value(fit.notch, fit.parameter(part)) for part in COEFFICIENTS}
    tried = [
        list(_neighbours(fit.parameter(part), signs[part] * c / per_value[part]))
        for part, c in zip(COEFFICIENTS, scaled, strict=True)
    ]

    def biquad(chosen: tuple[float, ...]) -> Biquad:
        b0, b1, b2, a1, a2 = (signs[p] * per_value[p] * v for p, v in zip(COEFFICIENTS, chosen, strict=True))
        return Biquad(gain * b0, gain * b1, gain * b2, a1, a2)

    def cost(chosen: tuple[float, ...]) -> tuple[bool, float, float]:
        candidate = biquad(chosen)
        shape = shape_of(candidate, fit.period_s)
        distance = fit.distance(shape)
        bits = sum(abs(a - b) for a, b in zip(candidate, wanted, strict=True))
        return not shape.is_notch, distance if math.isfinite(distance) else math.inf, bits

    best = min(itertools.product(*tried), key=cost)
    return values | {parts[part]: value for part, value in zip(COEFFICIENTS, best, strict=True)}


def _gain(fit: Fit, wanted: Biquad) -> float:
    """Return the smallest numerator gain at which all coefficients fit.

    It is a power of two, at most 8.
    """
    for gain in (1.0, 2.0, 4.0, 8.0):
        try:
            for part, c in zip(COEFFICIENTS[:3], wanted, strict=False):
                parameter = fit.parameter(part)
                hold(parameter, c / gain / coefficient_per_value(fit.notch, parameter))
        except OutOfRangeError:
            continue
        return gain
    return 1.0


def _neighbours(parameter: Parameter, value: float) -> Iterator[float]:
    """Yield the nearest value that an object holds, and its neighbours.

    Raises:
        OutOfRangeError: The object cannot hold the nearest value.
    """
    nearest = hold(parameter, value)
    yield nearest
    if parameter.data_type == "REAL64":
        return
    step = float(np.spacing(np.float32(nearest))) if parameter.type.is_real else parameter.value_per_step()
    for other in (nearest - step, nearest + step):
        try:
            held = hold(parameter, other)
        except OutOfRangeError:
            continue
        if held != nearest:
            yield held
