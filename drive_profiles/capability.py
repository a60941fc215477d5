"""What a drive can do for the paper's loop, and how its own loop and filters are laid out."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import pydantic

from drive_profiles.files import Table
from drive_profiles.parameter import Fact, ObjectAddress

Positive = Annotated[float, pydantic.Field(gt=0)]

NEEDED_START_HZ = 8.0
"""The paper's notch begins at k f_s = 2 · 4 rps."""
NEEDED_ZETA_RN = 0.028
"""Its zeros are this lightly damped, Table 3."""


class Capability(Table):
    """Whether the device can do a thing, and why that is said."""

    answer: Literal["exact", "yes", "approximate", "no", "unknown"]
    reason: str = pydantic.Field(min_length=1)


class Capabilities(Table):
    """Where the loop and the notch can live.

    Attributes:
        p_pi_inside: The drive closes position P and velocity PI itself.
        notch_inside: It holds the notch; exact when it is the paper's filter rather than a fit to it.
        notch_variable_while_moving: The notch follows the speed during a motion, and by what: the drive, PDO or SDO.
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
    """How a gain of the law, in SI, is held: ``held = gain / factor``, and per torque constant where the drive works in amperes.

    Attributes:
        parameter: Name of the parameter that holds it.
        factor: SI per unit of that parameter (with ``times_torque_constant``: per N·m/A as well); None where the scaling is not
            known.
        times_torque_constant: The unit is a current: the gain is ``held · factor · K_t``.
    """

    parameter: str
    factor: Positive | None = None
    times_torque_constant: bool = False


class Loop(Fact):
    """How the drive closes its loop.

    Attributes:
        structure: ``P-PI`` is the paper's; a ``PID`` takes gains converted from it.
        period_s: Of the velocity loop; a filter inside runs at it.
        gains: By role: ``position_gain_per_s``, ``velocity_gain_nm_s_rad``, ``velocity_integral_gain_nm_rad`` or
            ``velocity_integral_time_s``; of a PID ``proportional_nm_rad``, ``integral_nm_rad_s``, ``derivative_nm_s_rad``.
        note: What else one must know.
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


class Section(Table):
    """One filter of the drive: which parameter plays which part.

    Attributes:
        parts: ``zero_frequency``, ``zero_q``, ``zero_damping``, ``pole_frequency``, ``pole_q``, ``pole_damping`` (zero-pole);
            ``frequency`` and ``q``, ``damping`` or ``bandwidth`` (symmetric); ``gain``, ``b0`` … ``b4``, ``a1`` … ``a4``
            (coefficients).
        settings: Parameters that must hold a certain value for the filter to act, such as its type.
    """

    parts: dict[str, str]
    settings: dict[str, float] = pydantic.Field(default_factory=dict)


class NotchFacts(Fact):
    """The drive's filter, where it has one.

    Attributes:
        form: ``variable``: the paper's, it follows the speed by itself. ``zero-pole``: frequency and damping of zeros and poles
            apart, F(s) = (s²/ω_z² + 2 ζ_z s/ω_z + 1) / (s²/ω_p² + 2 ζ_p s/ω_p + 1). ``symmetric``: one frequency for both.
            ``coefficients``: y = Σ b_i u(n−i) + a_sign Σ a_i y(n−i).
        place: Where in the loop it sits.
        period_s: At which it runs; None where that is not known.
        discretisation: How the drive makes it discrete, where the form is continuous.
        min_frequency_hz: Lowest frequency that it takes; None: not known.
        max_frequency_hz: Highest.
        frequency_step_hz: Grid of the frequency; 0: as fine as its data type.
        min_zero_damping: Smallest ζ of the zeros; 0: infinitely deep. Of a symmetric form, the depth that it has.
        min_pole_damping: Smallest ζ of the poles.
        max_pole_damping: Largest.
        word: How a coefficient is held.
        fraction_bits: Of a fixed-point coefficient.
        a_sign: Sign of the feedback coefficients in the drive's difference equation.
        changed_by: How its frequency can be changed while the motor moves.
        sections: The filters.
        note: What else one must know.
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
    sections: tuple[Section, ...] = pydantic.Field(min_length=1)
    note: str = ""

    @pydantic.model_validator(mode="after")
    def _complete(self) -> Self:
        if (self.word == "fixed point") != (self.fraction_bits is not None):
            raise ValueError("fraction_bits goes with word = 'fixed point', and only with it")
        return self


class Torque(Fact):
    """How torques cross the bus.

    Attributes:
        rated_torque: Object that torques are per mille of.
        rated_torque_step_nm: What one step of it is worth.
        target: Cyclic torque, where the drive has one.
        actual: Torque actual value.
        offset: Torque offset of the cyclic modes.
        limit: Largest torque.
        note: What else one must know.
    """

    rated_torque: ObjectAddress | None = None
    rated_torque_step_nm: Positive = 0.001
    target: ObjectAddress | None = None
    actual: ObjectAddress | None = None
    offset: ObjectAddress | None = None
    limit: ObjectAddress | None = None
    note: str = ""


class Encoder(Fact):
    """How positions are counted.

    Attributes:
        increments: Increments per ``revolutions`` motor revolutions (608Fh:1).
        revolutions: 608Fh:2.
        gear_motor_revs: 6091h:1.
        gear_shaft_revs: 6091h:2.
        feed: Position units per ``feed_shaft_revs`` revolutions of the shaft (6092h:1), where positions are counted by it.
        feed_shaft_revs: 6092h:2.
        zero: Objects that choose other units (607Eh, 60A8h to 60AAh): what the profile says of units holds while they are 0.
        counts_per_rev: Where no object says it.
        note: What else one must know.
    """

    increments: ObjectAddress | None = None
    revolutions: ObjectAddress | None = None
    gear_motor_revs: ObjectAddress | None = None
    gear_shaft_revs: ObjectAddress | None = None
    feed: ObjectAddress | None = None
    feed_shaft_revs: ObjectAddress | None = None
    zero: tuple[ObjectAddress, ...] = ()
    counts_per_rev: Annotated[int, pydantic.Field(gt=0)] | None = None
    note: str = ""


class Store(Fact):
    """How the drive keeps its parameters over a loss of power.

    Attributes:
        object: The store command; None where there is none, and ``note`` says what to do instead.
        signature: What is written to it, "save".
        wait_s: How long the drive may take to answer.
        restore: The command that puts the factory's values back after a reset.
        restore_signature: "load".
        note: What else one must know.
    """

    object: ObjectAddress | None = None
    signature: Annotated[int, pydantic.Field(ge=0, le=0xFFFF_FFFF)] = 0x6576_6173
    wait_s: Positive = 2.0
    restore: ObjectAddress | None = None
    restore_signature: Annotated[int, pydantic.Field(ge=0, le=0xFFFF_FFFF)] = 0x6461_6F6C
    note: str = ""

    @pydantic.model_validator(mode="after")
    def _complete(self) -> Self:
        if self.object is None and not self.note:
            raise ValueError("a drive without a store command needs a note that says what to do instead")
        return self


class Abort(Fact):
    """An abort code of the vendor's own, in words."""

    code: Annotated[int, pydantic.Field(ge=0, le=0xFFFF_FFFF)]
    text: str = pydantic.Field(min_length=1)
