"""Result of `hil identify plant`: plant, standard errors, and responses."""

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field

from hil.bench.model import IdentifiedPlant
from hil.design.estimation import EstimatedMode, EstimatedParameter
from hil.design.frequency import TwoInertia
from hil.errors import RefusalCause
from hil.results.base import MeasuredResult, ResultPart

Floats = Annotated[tuple[float, ...], BeforeValidator(lambda given: given.tolist() if isinstance(given, np.ndarray) else given)]


class PlantParameter(NamedTuple):
    """A number of an identified plant on a page.

    Attributes:
        name: Name in result.json.
        title: Name on a page.
        page_unit: Unit on a page.
        scale: How many of those make one of the result's.
    """

    name: str
    title: str
    page_unit: str
    scale: float


PARAMETERS = tuple(
    PlantParameter(*row)
    for row in (
        ("motor_inertia_kg_m2", "J_m, motor", "kg·cm²", 1e4),
        ("arm_inertia_kg_m2", "J_l, arm", "kg·m²", 1.0),
        ("gear_stiffness_nm_rad", "K_g, gear", "kN·m/rad", 1e-3),
        ("gear_damping_nm_s_rad", "D_g, gear", "N·m·s/rad", 1.0),
        ("motor_damping_nm_s_rad", "D_m, motor", "mN·m·s/rad", 1e3),
        ("arm_damping_nm_s_rad", "D_l, arm", "N·m·s/rad", 1.0),
        ("viscous_damping_nm_s_rad", "D_m + D_l/N²", "mN·m·s/rad", 1e3),
        ("antiresonance_hz", "f_a, anti-resonance", "Hz", 1.0),
        ("resonance_hz", "f_r, resonance", "Hz", 1.0),
        ("damping", "ζ of the arm on its gear", "", 1.0),
        ("friction_coulomb_nm", "Coulomb friction, from slow turns", "N·m", 1.0),
        ("friction_viscous_nm_s_rad", "Slope of the friction, from slow turns", "mN·m·s/rad", 1e3),
        ("gravity_moment_nm", "m g l, gravity at the arm", "N·m", 1.0),
        ("gravity_phase_deg", "q_0 in m g l cos(θ_l + q_0)", "°", 1.0),
        ("lever_ratio", "Tip lever, measured over the bench file's", "", 1.0),
        ("torque_age_s", "Age of the reported torque", "µs", 1e6),
        ("torque_lag_s", "Lag of the current loop", "µs", 1e6),
        ("accelerometer_delay_s", "Delay of the tip's signal", "µs", 1e6),
    )
)
"""Numbers of an identified plant in the order in which they are shown."""


class PlantRequestEntry(ResultPart):
    """Request of a plant identification; the fields are those of `hil.experiments.plant.motion.PlantRequest`."""

    axis: int
    amplitude_nm: float | None
    low_hz: float | None
    high_hz: float | None
    bias_rps: float | None
    periods: int
    excitation: str
    shape: str
    with_accelerometer: bool
    posture_deg: dict[int, float] = Field(default_factory=dict)


class ExcitationPlan(ResultPart):
    """Excitation that was chosen.

    Attributes:
        excitation: Signal to which it was added: `torque` or `reference`.
        amplitude_nm: Peak of the excitation, as a torque at the motor.
        travel_rev: Ends of the travel, in motor revolutions.
    """

    excitation: str
    amplitude_nm: float
    crest_factor: float
    bias_rps: float
    period_s: float
    periods: int
    travel_rev: tuple[float, float]


class FrequencyResponseEntry(ResultPart):
    """Frequency response on the excited lines; all of shape (n,).

    Attributes:
        deviation: Standard error of either part.
        coherence: Fraction of the motion in a period that follows the excitation.
    """

    frequency_hz: tuple[float, ...]
    real: tuple[float, ...]
    imaginary: tuple[float, ...]
    deviation: tuple[float, ...]
    radius: tuple[float, ...]
    coherence: tuple[float, ...]


class FrictionCurve(ResultPart):
    """Slow turns, each a mean over a motor revolution.

    The arrays are all of shape (n,).
    """

    residual_nm: float
    arm_span_deg: float
    speed_rad_s: Floats
    arm_angle_rad: Floats
    torque_nm: Floats
    model_nm: Floats
    gravity_nm: Floats


@dataclass(frozen=True)
class PlantCheck:
    """One check of the data."""

    name: str
    value: float
    needed: float
    unit: str
    holds: bool
    remedy: str = ""
    causes: tuple[RefusalCause, ...] = ()

    @property
    def sentence(self) -> str:
        """Check in words."""
        unit = f" {self.unit}" if self.unit else ""
        tail = f"; {self.remedy}" if self.remedy else ""
        bound = "most" if (self.value <= self.needed) == self.holds else "least"
        return f"{self.name}: {self.value:.3g}{unit} (at {bound} {self.needed:.3g}{unit}){tail}"


class PlantResult(MeasuredResult):
    """Result of a plant identification.

    Attributes:
        plan: The excitation; None, like all down to `identified`, where nothing was identified.
        modes: Modes of an arm with several, from the lowest; empty for one.
        misfit: Residual in standard deviations of the scatter.
        tip_response: Tip acceleration per motor angle; None without an accelerometer.
    """

    kind: Literal["identify-plant"] = "identify-plant"
    axis: int
    request: PlantRequestEntry
    plan: ExcitationPlan | None = None
    plant: TwoInertia | None = None
    parameters: dict[str, EstimatedParameter] | None = None
    modes: tuple[EstimatedMode, ...] = ()
    misfit: float | None = None
    cannot_tell: tuple[str, ...] | None = None
    response: FrequencyResponseEntry | None = None
    tip_response: FrequencyResponseEntry | None = None
    friction: FrictionCurve | None = None
    identified: IdentifiedPlant | None = None
    model_file: str | None = None
    not_identified: tuple[str, ...] | None = None
    checks: tuple[PlantCheck, ...] = ()
    remarks: tuple[str, ...] = ()
    recordings: dict[str, str] = Field(default_factory=dict)

    def _note_other_failure(self, text: str) -> None:
        self.not_identified = self.not_identified or (text,)
