"""Capabilities of a drive for the paper's loop, and further facts."""

from typing import Annotated, Literal, Self

import pydantic

from drive_profiles.family.parameter import Fact
from drive_profiles.files.toml import Table
from drive_profiles.standard.object_address import WrittenAddress

Positive = Annotated[float, pydantic.Field(gt=0)]


class Capability(Table):
    """An answer to one question about the device, with its reason.

    `exact`, `approximate` and `lost` are the verdicts of `drive_profiles.realisation` on the paper's notch.
    """

    answer: Literal["exact", "yes", "approximate", "lost", "no", "unknown"]
    reason: str = pydantic.Field(min_length=1)


class Capabilities(Table):
    """Capabilities that decide where loop and notch can run.

    Either can run in the drive or in the host.

    Attributes:
        p_pi_inside: The drive closes position P and velocity PI itself.
        notch_inside: The drive holds the notch; exact when it is the paper's filter rather than a fit to it.
        notch_variable_while_moving: The notch follows the speed during a motion, changed by the drive, by PDO or by SDO.
        host_closed: The host can close the loop over the bus by torque, cyclically.
        reference_correction: The host can correct the reference cyclically (CSP).
        torque_offset: The host can add a torque to the drive's own (60B2h).
    """

    p_pi_inside: Capability
    notch_inside: Capability
    notch_variable_while_moving: Capability
    host_closed: Capability
    reference_correction: Capability
    torque_offset: Capability


class Gain(Table):
    """Conversion of one gain of the control law from SI.

    ``held = gain / factor``, and also ``/ K_t`` if the drive works in amperes.

    Attributes:
        parameter: Name of the parameter that holds it.
        factor: SI units per unit of that parameter (with ``times_torque_constant``: per N·m/A as well); None if the scaling is
            not known.
        times_torque_constant: True if the drive's unit is a current: the gain is ``held · factor · K_t``.
    """

    parameter: str
    factor: Positive | None = None
    times_torque_constant: bool = False


_ROLE_UNITS = {
    "position_gain_per_s": "1/s",
    "velocity_gain_nm_s_rad": "N·m·s/rad",
    "velocity_integral_gain_nm_rad": "N·m/rad",
    "velocity_integral_time_s": "s",
    "lowpass_hz": "Hz",
    "proportional_nm_rad": "N·m/rad",
    "integral_nm_rad_s": "N·m/(rad·s)",
    "derivative_nm_s_rad": "N·m·s/rad",
}
_PREFIXES = {1e-9: "n", 1e-6: "µ", 1e-3: "m", 1.0: "", 1e3: "k"}


def gain_unit(role: str, gain: Gain) -> str:
    """Return a gain's unit in the drive, such as µA/rad, or ""."""
    if gain.factor is None:
        return ""
    unit = _ROLE_UNITS[role].replace("N·m", "A") if gain.times_torque_constant else _ROLE_UNITS[role]
    prefix = _PREFIXES.get(gain.factor)
    if prefix is None or (prefix and unit.startswith("1/")):
        return f"{gain.factor:.4g} {unit}"
    return f"{prefix}{unit}"


class LoopFacts(Fact):
    """Facts about the drive's own control loop.

    Attributes:
        structure: ``P-PI`` is the paper's; a ``PID`` takes gains converted from it.
        period_s: Period of the velocity loop, s; a filter inside runs at it.
        gains: Gains by role: ``position_gain_per_s``, ``velocity_gain_nm_s_rad``, ``velocity_integral_gain_nm_rad`` or
            ``velocity_integral_time_s``; of a PID ``proportional_nm_rad``, ``integral_nm_rad_s``, ``derivative_nm_s_rad``.
        note: Further facts that matter.
    """

    structure: Literal["P-PI", "PID", "not accessible"]
    period_s: Positive | None = None
    gains: dict[
        Literal[
            "position_gain_per_s",
            "velocity_gain_nm_s_rad",
            "velocity_integral_gain_nm_rad",
            "velocity_integral_time_s",
            "lowpass_hz",
            "proportional_nm_rad",
            "integral_nm_rad_s",
            "derivative_nm_s_rad",
        ],
        Gain,
    ] = pydantic.Field(default_factory=dict)
    note: str = ""


class FilterSection(Table):
    """One filter of the drive, with the parameter for each part.

    Attributes:
        parts: Parameter names by part: ``zero_frequency``, ``zero_q``, ``zero_damping``, ``pole_frequency``, ``pole_q``,
            ``pole_damping`` (zero-pole);
            ``frequency`` and ``q``, ``damping`` or ``bandwidth`` (symmetric); ``gain``, ``b0`` … ``b4``, ``a1`` … ``a4``
            (coefficients).
        settings: Values that parameters must hold for the filter to act, such as its type, by parameter name.
    """

    parts: dict[str, str]
    settings: dict[str, float] = pydantic.Field(default_factory=dict)


class NotchFacts(Fact):
    """Facts about the drive's filter.

    Attributes:
        form: ``variable``: the paper's, it follows the speed by itself. ``zero-pole``: frequency and damping of zeros and poles
            apart, F(s) = (s²/ω_z² + 2 ζ_z s/ω_z + 1) / (s²/ω_p² + 2 ζ_p s/ω_p + 1). ``symmetric``: one frequency for both.
            ``coefficients``: y = Σ b_i u(n−i) + a_sign Σ a_i y(n−i).
        place: Position of the filter in the loop, in words.
        period_s: Period at which it runs, s; None if that is not known.
        discretisation: Rule by which the drive makes a continuous form discrete.
        min_frequency_hz: Lowest frequency that it takes; None: not known.
        max_frequency_hz: Highest frequency that it takes; None: not known.
        frequency_step_hz: Grid of the frequency; 0: as fine as its data type.
        min_zero_damping: Smallest ζ of the zeros; 0: infinitely deep. In a symmetric form it is the fixed depth.
        min_pole_damping: Smallest ζ of the poles.
        max_pole_damping: Largest ζ of the poles.
        word: Number format of a coefficient.
        fraction_bits: Number of fraction bits of a fixed-point coefficient.
        a_sign: Sign of the feedback coefficients in the drive's difference equation.
        changed_by: The drive itself, PDO or SDO: it changes the frequency while the motor moves.
        sections: The filters of this form that the drive has.
        note: Further facts that matter.
    """

    form: Literal["variable", "zero-pole", "symmetric", "coefficients"]
    place: str = pydantic.Field(min_length=1)
    period_s: Positive | None = None
    discretisation: Literal["bilinear", "bilinear prewarped", "backward Euler prewarped", "not known"] = "not known"
    min_frequency_hz: Positive | None = None
    max_frequency_hz: Positive | None = None
    frequency_step_hz: float = pydantic.Field(default=0.0, ge=0)
    min_zero_damping: float = pydantic.Field(default=0.0, ge=0)
    min_pole_damping: float = pydantic.Field(default=0.0, ge=0)
    max_pole_damping: Positive | None = None
    word: Literal["float32", "fixed point", "integer, scaling not known"] = "float32"
    fraction_bits: Annotated[int, pydantic.Field(ge=1, le=62)] | None = None
    a_sign: Literal[-1, 1] = -1
    changed_by: Literal["drive", "PDO", "SDO"]
    sections: tuple[FilterSection, ...] = pydantic.Field(min_length=1)
    note: str = ""

    @pydantic.model_validator(mode="after")
    def _complete(self) -> Self:
        if (self.word == "fixed point") != (self.fraction_bits is not None):
            raise ValueError("word = 'fixed point' and fraction_bits need each other: give both or neither")
        return self


class TorqueFacts(Fact):
    """Facts about torques on the bus.

    Attributes:
        rated_torque: Object with the rated torque, of which torques are per mille.
        rated_torque_step_nm: Torque of one step of that object, N·m.
        target: Object with the cyclic torque, where the drive has one.
        actual: Object with the torque actual value.
        current: Object with the current actual value (INTEGER16), of a drive that reports no torque.
        current_step_a: Current of one step of that object, A.
        offset: Object with the torque offset of the cyclic modes.
        limit: Object with the largest torque.
        note: Further facts that matter.
    """

    rated_torque: WrittenAddress | None = None
    rated_torque_step_nm: Positive = 0.001
    target: WrittenAddress | None = None
    actual: WrittenAddress | None = None
    current: WrittenAddress | None = None
    current_step_a: Positive | None = None
    offset: WrittenAddress | None = None
    limit: WrittenAddress | None = None
    note: str = ""

    @pydantic.model_validator(mode="after")
    def _current_has_a_step(self) -> Self:
        if (self.current is None) != (self.current_step_a is None):
            raise ValueError("current and current_step_a need each other: give both or neither")
        return self


class PositionModeFacts(Fact):
    """A maker's own mode that takes a position with every RPDO.

    A drive without CSP may have one.

    Attributes:
        number: Its number in 6060h.
        name: Its name.
        target: Object of the position (INTEGER32), which an RPDO can carry.
        note: Further facts that matter.
    """

    number: Annotated[int, pydantic.Field(ge=-128, le=-1)]
    name: str = pydantic.Field(min_length=1)
    target: WrittenAddress
    note: str = ""


class EncoderFacts(Fact):
    """Facts about the unit of positions on the bus.

    Attributes:
        increments: Object with the increments per ``revolutions`` motor revolutions (608Fh:1).
        revolutions: Object with that number of motor revolutions (608Fh:2).
        gear_motor_revs: Object with the motor revolutions of the gear ratio (6091h:1).
        gear_shaft_revs: Object with the shaft revolutions of the gear ratio (6091h:2).
        feed: Object with the position units per ``feed_shaft_revs`` shaft revolutions (6092h:1), where positions use it.
        feed_shaft_revs: Object with that number of shaft revolutions (6092h:2).
        zero: Objects that choose other units (607Eh, 60A8h to 60AAh): the profile's units hold while they are 0.
        counts_per_rev: Increments per motor revolution, where no object holds them.
        note: Further facts that matter.
    """

    increments: WrittenAddress | None = None
    revolutions: WrittenAddress | None = None
    gear_motor_revs: WrittenAddress | None = None
    gear_shaft_revs: WrittenAddress | None = None
    feed: WrittenAddress | None = None
    feed_shaft_revs: WrittenAddress | None = None
    zero: tuple[WrittenAddress, ...] = ()
    counts_per_rev: Annotated[int, pydantic.Field(gt=0)] | None = None
    note: str = ""

    @property
    def feed_objects(self) -> dict[str, str]:
        """Objects of gear ratio and feed constant, by their names in `Scaling`; empty where positions do not use them."""
        names = ("gear_motor_revs", "gear_shaft_revs", "feed", "feed_shaft_revs")
        return {name: address for name in names if (address := getattr(self, name))} if self.feed and self.feed_shaft_revs else {}


class LoadEncoderFacts(Fact):
    """Facts about a second encoder, which measures the joint's load side.

    Attributes:
        position: Object with its position (60E4h), which a TPDO can carry.
        increments: Object with its steps per ``revolutions`` revolutions of its own (60E6h).
        revolutions: Object with that number of revolutions (60EBh).
        note: Further facts that matter.
    """

    position: WrittenAddress | None = None
    increments: WrittenAddress | None = None
    revolutions: WrittenAddress | None = None
    note: str = ""


class StoreFacts(Fact):
    """Facts about the commands that store and restore parameters.

    Attributes:
        object: Object of the store command; None if there is none, and ``note`` states the alternative.
        signature: Number that is written to it, "save".
        wait_s: Time that the drive may take to answer, s.
        restore: Object of the command that puts the factory's values back after a reset.
        restore_signature: Number that is written to it, "load".
        note: Further facts that matter.
    """

    object: WrittenAddress | None = None
    signature: Annotated[int, pydantic.Field(ge=0, le=0xFFFF_FFFF)] = 0x6576_6173
    wait_s: Positive = 2.0
    restore: WrittenAddress | None = None
    restore_signature: Annotated[int, pydantic.Field(ge=0, le=0xFFFF_FFFF)] = 0x6461_6F6C
    note: str = ""

    @pydantic.model_validator(mode="after")
    def _complete(self) -> Self:
        if self.object is None and not self.note:
            raise ValueError("a drive without a store command needs a note with what to do instead")
        return self


class FaultCode(Fact):
    """A maker's own error code, with its meaning.

    Emergencies, 603Fh and 1003h carry it.
    """

    code: Annotated[int, pydantic.Field(ge=0, le=0xFFFF)]
    text: str = pydantic.Field(min_length=1)


class Abort(Fact):
    """A maker's own abort code, with its meaning."""

    code: Annotated[int, pydantic.Field(ge=0, le=0xFFFF_FFFF)]
    text: str = pydantic.Field(min_length=1)
