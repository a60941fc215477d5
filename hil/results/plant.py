"""Result of `hil identify plant`: plant, standard errors, and responses."""

from typing import Literal

from pydantic import Field

from hil.bench.model import IdentifiedPlant
from hil.design.estimation import EstimatedMode, EstimatedParameter
from hil.design.frequency import TwoInertia
from hil.results.base import MeasuredResult, ResultPart


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
        crest_factor: Peak over root mean square.
        bias_rps: Motor speed under the excitation.
        period_s: Period of the excitation.
        periods: Number of periods that were averaged.
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
        frequency_hz: Frequencies of the lines.
        real: Real part.
        imaginary: Imaginary part.
        deviation: Standard error of either part.
        radius: Radius of the circle that holds the true value with a probability of 95 %.
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

    Attributes:
        residual_nm: Residual of the fit.
        arm_span_deg: Angle through which the arm turned.
        speed_rad_s: Motor speed.
        arm_angle_rad: Arm angle.
        torque_nm: Motor torque.
        model_nm: Motor torque of the fit.
        gravity_nm: Gravity's part of the fit.
    """

    residual_nm: float
    arm_span_deg: float
    speed_rad_s: tuple[float, ...]
    arm_angle_rad: tuple[float, ...]
    torque_nm: tuple[float, ...]
    model_nm: tuple[float, ...]
    gravity_nm: tuple[float, ...]


class PlantCheck(ResultPart):
    """One check of the data; the fields are those of `hil.experiments.plant.checks.DataCheck`."""

    name: str
    value: float
    needed: float
    unit: str
    holds: bool
    remedy: str


class PlantResult(MeasuredResult):
    """Result of a plant identification.

    Attributes:
        axis: Axis number.
        request: Request of the identification.
        plan: The excitation; None, like all down to `identified`, where nothing was identified.
        plant: Plant that was fitted.
        parameters: Every number with its standard error, by name.
        modes: Modes of an arm with several, from the lowest; empty for one.
        misfit: Residual in standard deviations of the scatter.
        cannot_tell: Sentences on the limits of these data.
        response: Motor angle per torque.
        tip_response: Tip acceleration per motor angle; None without an accelerometer.
        friction: Friction and gravity of the slow turns.
        identified: Entry of the model file.
        model_file: Path of the model file.
        not_identified: Reasons why nothing was identified, a sentence each.
        checks: Checks of the data.
        remarks: Sentences for the engineer.
        recordings: Paths of the CSV files by name of the run.
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
