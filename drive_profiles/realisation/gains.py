"""The paper's gains in a drive's units, and as a PID."""

from dataclasses import dataclass

from drive_profiles.errors import NotRealisableError, OutOfRangeError
from drive_profiles.family.capability import Gain
from drive_profiles.family.profile import Profile
from drive_profiles.standard.units import Scaling

ROUNDING = 0.05
"""Largest change of a gain by rounding, as a fraction of it. Two of the reference robot's gains 5 % off shift its crossover by as
much; its phase margin and the effect of the notch hardly change. A larger change is for the designer to decide."""


@dataclass(frozen=True)
class PidGains:
    """The paper's P-PI as a PID with corrected reference path.

    τ = P (r − θ) + I ∫(r − θ) + D d(r − θ)/dt, with the difference of the reference paths.

    Attributes:
        reference_lag_s: 1/K_p, time constant of the low-pass that makes the PID on the error the P-PI without feed-forward.
        reference_velocity_nm_s_rad: Torque per ṙ that is added instead of the low-pass.
        reference_position_nm_rad: Torque per r that is added with it.
    """

    proportional_nm_rad: float
    integral_nm_rad_s: float
    derivative_nm_s_rad: float
    reference_lag_s: float
    reference_velocity_nm_s_rad: float
    reference_position_nm_rad: float


def pid_gains(position_gain_per_s: float, velocity_gain_nm_s_rad: float, velocity_integral_gain_nm_rad: float) -> PidGains:
    """Return the PID with the feedback path of the paper's P-PI.

    With K_p, K_v, K_vi = K_v/T_i the law is τ = (K_v + K_vi/s) (K_p (r − θ) + θ̇_ff − sθ). In θ:

        −τ/θ = (K_v + K_vi/s)(K_p + s) = D s + P + I/s,   D = K_v,   P = K_v K_p + K_vi,   I = K_vi K_p.

    The reference path: a PID on the error gives (K_v + K_vi/s)(K_p + s)(r − θ), which is the law with full velocity feed-forward,
    θ̇_ff = ṙ. The law without feed-forward has (K_v + K_vi/s) s r = K_v ṙ + K_vi r less. Two ways to have it exactly:

    - low-pass the reference with K_p/(s + K_p), i.e. `PidGains.reference_lag_s`; the host can do that;
    - add −K_v ṙ − K_vi r to the torque: a velocity feed-forward of −K_v (none at all where the drive takes its derivative
      from the position alone) and a position term that drives do not offer, but that a torque offset can carry.

    A fraction φ of feed-forward, θ̇_ff = φ ṙ, takes (1 − φ) of these terms. F_lp, which the law has on sθ alone, must
    then stand before D.

    Args:
        position_gain_per_s: K_p, 1/s.
        velocity_gain_nm_s_rad: K_v, N·m·s/rad.
        velocity_integral_gain_nm_rad: K_vi = K_v/T_i, N·m/rad.

    Raises:
        ValueError: K_p is not positive.

    Source: the paper, section 4.2, Fig. 9; the conversion is the identity above.
    """
    if not position_gain_per_s > 0.0:
        raise ValueError(f"position_gain_per_s = {position_gain_per_s} must be positive")
    return PidGains(
        proportional_nm_rad=velocity_gain_nm_s_rad * position_gain_per_s + velocity_integral_gain_nm_rad,
        integral_nm_rad_s=velocity_integral_gain_nm_rad * position_gain_per_s,
        derivative_nm_s_rad=velocity_gain_nm_s_rad,
        reference_lag_s=1.0 / position_gain_per_s,
        reference_velocity_nm_s_rad=-velocity_gain_nm_s_rad,
        reference_position_nm_rad=-velocity_integral_gain_nm_rad,
    )


def gains_for(
    profile: Profile,
    *,
    position_gain_per_s: float,
    velocity_gain_nm_s_rad: float,
    velocity_integral_gain_nm_rad: float,
    torque_constant_nm_a: float | None = None,
    scaling: Scaling | None = None,
) -> dict[str, float]:
    """Convert the paper's gains, motor side, to the drive's parameters.

    held = gain / factor, and / K_t where the drive's unit is a current; then rounded as the object holds it. `scaling` is needed
    where a parameter counts in steps of the drive's encoder or rated torque.

    Returns:
        Values by parameter name, in the parameters' units.

    Raises:
        NotRealisableError: Facts are missing, or values out of range; the error has all of them.
        ValueError: A gain is not positive.
    """
    wanted = {
        "position_gain_per_s": position_gain_per_s,
        "velocity_gain_nm_s_rad": velocity_gain_nm_s_rad,
        "velocity_integral_gain_nm_rad": velocity_integral_gain_nm_rad,
    }
    for role, gain in wanted.items():
        if not gain > 0.0:
            raise ValueError(f"{role} = {gain} must be positive")
    roles, reasons = _in_roles(profile, wanted)
    values: dict[str, float] = {}
    entries: dict[str, Gain] = dict(profile.loop.gains.items()) if profile.loop else {}
    for role, gain in roles.items():
        entry = entries.get(role)
        if entry is None:
            reasons.append(f"no parameter of its loop is known to hold {role}")
            continue
        try:
            values[entry.parameter] = _held(profile, role, entry, gain, torque_constant_nm_a, scaling)
        except NotRealisableError as error:
            reasons += error.reasons
    if reasons:
        raise NotRealisableError(profile.label, tuple(reasons))
    return values


def _in_roles(profile: Profile, wanted: dict[str, float]) -> tuple[dict[str, float], list[str]]:
    """Return the gains by the roles of the drive's loop, and objections."""
    loop = profile.loop
    if loop is None or loop.structure == "not accessible":
        return {}, ["its loop's gains are not accessible as objects" + (f" ({loop.note})" if loop and loop.note else "")]
    if loop.structure == "PID":
        pid = pid_gains(*wanted.values())
        names = ("proportional_nm_rad", "integral_nm_rad_s", "derivative_nm_s_rad")
        return {name: getattr(pid, name) for name in names}, []
    roles = dict(wanted)
    if "velocity_integral_time_s" in loop.gains:
        roles["velocity_integral_time_s"] = wanted["velocity_gain_nm_s_rad"] / roles.pop("velocity_integral_gain_nm_rad")
    return roles, []


def _held(
    profile: Profile, role: str, entry: Gain, gain: float, torque_constant_nm_a: float | None, scaling: Scaling | None
) -> float:
    name, parameter = entry.parameter, profile.parameter(entry.parameter)
    if entry.factor is None:
        raise NotRealisableError(profile.label, (f"the scaling of {name} ({parameter.written_address}) is not known",))
    if parameter.access == "ro":
        raise NotRealisableError(profile.label, (f"{name} ({parameter.written_address}) is read only",))
    if entry.times_torque_constant and torque_constant_nm_a is None:
        raise NotRealisableError(profile.label, (f"{name} is in amperes: the motor's torque constant is needed",))
    if torque_constant_nm_a is not None and not torque_constant_nm_a > 0.0:
        raise ValueError(f"torque_constant_nm_a = {torque_constant_nm_a} must be positive")
    if isinstance(parameter.scale, str) and scaling is None:
        raise NotRealisableError(profile.label, (f"{name} counts in {parameter.scale}: the drive's scaling is needed",))
    per_value = entry.factor * ((torque_constant_nm_a or 1.0) if entry.times_torque_constant else 1.0)
    value = gain / per_value
    try:
        held = parameter.value(parameter.raw(value, scaling), scaling)
    except OutOfRangeError as error:
        raise NotRealisableError(profile.label, (f"{role} {gain:g}: {name} {error}",)) from None
    if abs(held - value) > ROUNDING * value:
        off = f"{role} {gain:g}: {name} would hold {held:g} instead of {value:.4g} {parameter.unit}".rstrip()
        raise NotRealisableError(profile.label, (f"{off}, {100 * (held / value - 1):+.0f} %",))
    return held
