"""The filter that a drive runs with its objects' values."""

import math
from collections.abc import Mapping

from drive_profiles.errors import NotRealisableError
from drive_profiles.family.capability import FilterSection, NotchFacts
from drive_profiles.family.parameter import Parameter
from drive_profiles.family.profile import Profile
from drive_profiles.realisation.biquad import Biquad, Quadratic, Rule, biquad_of, factors

COEFFICIENTS = ("b0", "b1", "b2", "a1", "a2")
HIGHER = ("b3", "b4", "a3", "a4")


def held_filter(profile: Profile, values: Mapping[str, float], period_s: float | None = None) -> tuple[Biquad, ...]:
    """Return the filter that a drive runs with its objects' values.

    All active sections are in series, in the drive's own discretisation, DC gain included; a filter of order 4 is two biquads. It
    is empty where the filters are off, or follow the speed by themselves (form ``variable``).

    A section is active when its settings hold. For a missing value the factory setting is taken, where the profile has it. Names
    of other parameters do no harm. `period_s` is needed where the profile does not know it.

    Raises:
        NotRealisableError: The scaling, the period or a value is not known.
        OutOfRangeError: An object cannot hold its value.
    """
    notch = profile.notch
    if notch is None or notch.form == "variable":
        return ()
    held = HeldValues(profile, values)
    active = [
        section
        for section in notch.sections
        if all(held[name] == hold(profile.parameter(name), value) for name, value in section.settings.items())
    ]
    if not active:
        return ()
    period = period_of(profile, period_s)
    return tuple(biquad for section in active for biquad in filter_of(held, notch, section, period))


class HeldValues:
    """Values as a drive's objects hold them, by default the factory settings."""

    def __init__(self, profile: Profile, values: Mapping[str, float]) -> None:
        self.profile = profile
        self._values = values

    def __getitem__(self, name: str) -> float:
        """Return the value in the parameter's unit.

        Raises:
            NotRealisableError: The value is neither given nor known, or is not a number.
        """
        parameter = self.profile.parameter(name)
        if parameter.is_bytes:
            raise NotRealisableError(self.profile.label, (_no_number(name, parameter),))
        if name in self._values:
            return hold(parameter, float(self._values[name]))
        if parameter.default is None:
            raise NotRealisableError(self.profile.label, (f"{name} ({parameter.written_address}) has no value; give one",))
        return parameter.value(float(parameter.default))


def filter_of(held: HeldValues, notch: NotchFacts, section: FilterSection, period_s: float) -> tuple[Biquad, ...]:
    """Return the biquads of one section, in series.

    Raises:
        NotRealisableError: As for `held_filter`.
    """
    if reasons := obstacles(held.profile, notch, section):
        raise NotRealisableError(held.profile.label, reasons)
    if notch.form == "coefficients":
        return _from_coefficients(held, notch, section)
    zero, pole = _quadratics(held, notch, section)
    try:
        return (biquad_of(zero, pole, period_s, rule_of(notch)),)
    except ValueError as error:
        raise NotRealisableError(held.profile.label, (str(error),)) from None


def obstacles(profile: Profile, notch: NotchFacts, section: FilterSection) -> tuple[str, ...]:
    """Return reasons why a section's filter cannot be computed, whatever the values."""
    parts = section.parts
    reasons = [_no_number(n, p) for n in parts.values() if (p := profile.parameter(n)).is_bytes]
    if reasons:
        return tuple(reasons)
    if notch.form == "coefficients":
        needed: tuple[tuple[str, ...], ...] = tuple((name,) for name in COEFFICIENTS)
        if notch.word == "integer, scaling not known":
            reasons.append("the scaling of its integer coefficients is not known")
    elif notch.form == "zero-pole":
        needed = (("zero_frequency",), ("zero_q", "zero_damping"), ("pole_frequency",), ("pole_q", "pole_damping"))
    elif notch.form == "symmetric":
        needed = (("frequency",), ("q", "damping", "bandwidth"))
    else:
        needed = (("offset",), ("zero_damping",), ("pole_damping",))
    reasons += [f"no parameter is known for {' or '.join(any_of)}" for any_of in needed if not set(any_of) & set(parts)]
    for part, unit in (("frequency", "Hz"), ("bandwidth", "Hz"), ("damping", ""), ("q", "")):
        for name in (name for key, name in parts.items() if key.removeprefix("zero_").removeprefix("pole_") == part):
            if (actual := profile.parameter(name).unit) != unit:
                reasons.append(
                    f"{name} is in {actual or 'plain numbers'}: its relation to {unit or 'a plain number'} is not known"
                )
    return tuple(reasons)


def period_of(profile: Profile, period_s: float | None) -> float:
    """Return the period of the drive's filter, s.

    It is the caller's, else the filter's, else the velocity loop's.

    Raises:
        NotRealisableError: None of the three is known.
    """
    notch = profile.notch.period_s if profile.notch else None
    loop = profile.loop.period_s if profile.loop else None
    for period in (period_s, notch, loop):
        if period is not None:
            return period
    raise NotRealisableError(
        profile.label, ("the period of the drive's filter is not known; give --period-us (in Python: period_s)",)
    )


def rule_of(notch: NotchFacts) -> Rule:
    """Return the discretisation of the drive's filter, by default bilinear."""
    return "bilinear" if notch.discretisation == "not known" else notch.discretisation


def coefficient_per_value(notch: NotchFacts, parameter: Parameter) -> float:
    """Return the coefficient per unit of a parameter's value.

    A fixed-point word is stated either by its scale, 2⁻ᶠ, or as a plain integer with f ``fraction_bits``.
    """
    return 2.0**-notch.fraction_bits if notch.fraction_bits is not None and parameter.scale == 1.0 else 1.0


def hold(parameter: Parameter, value: float) -> float:
    """Round a value as the object holds it.

    Raises:
        OutOfRangeError: The object cannot hold the value.
    """
    return parameter.value(parameter.raw(value))


def _no_number(name: str, parameter: Parameter) -> str:
    return f"{name} ({parameter.written_address}) holds all its numbers in one object of bytes; they cannot be written one by one"


def _from_coefficients(held: HeldValues, notch: NotchFacts, section: FilterSection) -> tuple[Biquad, ...]:
    """Return the biquads of the drive's difference equation.

    y = g Σ b_i u(n−i) + a_sign Σ a_i y(n−i); in the biquads the feedback is subtracted.
    """

    def coefficient(part: str) -> float:
        name = section.parts.get(part)
        return 0.0 if name is None else held[name] * coefficient_per_value(notch, held.profile.parameter(name))

    gain = coefficient("gain") if "gain" in section.parts else 1.0
    b = [gain * coefficient(f"b{n}") for n in range(5)]
    a = [1.0, *(-notch.a_sign * coefficient(f"a{n}") for n in range(1, 5))]
    if any(b[3:]) or any(a[3:]):
        return factors(b, a)
    return (Biquad(b[0], b[1], b[2], a[1], a[2]),)


def _quadratics(held: HeldValues, notch: NotchFacts, section: FilterSection) -> tuple[Quadratic, Quadratic]:
    """Return the zeros and poles in s from the values."""

    def damping(prefix: str, frequency_hz: float) -> float:
        parts = section.parts
        if f"{prefix}damping" in parts:
            return held[parts[f"{prefix}damping"]]
        if f"{prefix}q" in parts:
            q = held[parts[f"{prefix}q"]]
            return 0.5 / q if q > 0.0 else math.inf
        return 0.5 * held[parts["bandwidth"]] / frequency_hz

    if notch.form == "symmetric":
        f = held[section.parts["frequency"]]
        _positive(held.profile, f, 1.0)
        pole = Quadratic(f, damping("", f))
        _positive(held.profile, f, pole.zeta)
        return Quadratic(f, notch.min_zero_damping), pole
    zero_hz, pole_hz = held[section.parts["zero_frequency"]], held[section.parts["pole_frequency"]]
    zero, pole = Quadratic(zero_hz, damping("zero_", zero_hz)), Quadratic(pole_hz, damping("pole_", pole_hz))
    for quadratic in (zero, pole):
        _positive(held.profile, *quadratic)
    return zero, pole


def _positive(profile: Profile, frequency_hz: float, zeta: float) -> None:
    if not (frequency_hz > 0.0 and math.isfinite(zeta)):
        why = f"{frequency_hz:g} Hz with a damping of {zeta:g} is not a filter; expected a frequency above 0 and a finite damping"
        raise NotRealisableError(profile.label, (why,))
