"""Results of `hil compare`, and of a tour with a comparison."""

from typing import Literal

from pydantic import Field

from hil.results.base import Result, ResultPart, aftermath
from hil.results.runs import ShaperEntry


class ComparisonRequestEntry(ResultPart):
    """Request of a comparison.

    Attributes:
        named: Treatments that the user has named.
    """

    experiments: tuple[str, ...]
    axes: tuple[int, ...]
    treatments: tuple[str, ...]
    named: tuple[str, ...]


class ComplianceFactors(ResultPart):
    """Factors by which a treatment makes the motor more compliant.

    Attributes:
        slow: Factor at 1 Hz.
        peak: Factor at the largest compliance.
    """

    slow: float
    peak: float


class AxisCompliance(ResultPart):
    """Compliance of one axis with one treatment, in rad/(N·m) at the motor."""

    axis: int
    treatment: str
    loop: str
    slow: float
    peak: float
    peak_hz: float


class ComparisonRow(ResultPart):
    """One treatment in one experiment.

    Attributes:
        axis: Axis of a constant-acceleration run, else None.
        tip_peak_mm: Largest tip displacement in the judged window; None if the run was not made or not judged.
        spectrum_area: Area of the spectrum in the window in which the untreated run is worst, m/s²·Hz.
        trial: End of the trial of a cancellation, or of designed filters.
        compliance: Compliance that the treatment costs; None without a model.
        recording: Path of the CSV file, from the robot's directory.
        ramp_peak_mm: Largest tip displacement on the whole ramp; None if there is none, or no ramp.
    """

    experiment: str
    axis: int | None
    treatment: str
    loop: str
    tip_peak_mm: float | None
    tip_peak_change_pct: float | None
    spectrum_area: float | None
    spectrum_area_change_pct: float | None
    within_spec: bool | None
    trial: Literal["accepted", "accepted in part", "refused"] | None
    compliance: ComplianceFactors | None
    recording: str | None = None
    not_judged: str | None = None
    left_out: str | None = None
    ramp_peak_mm: float | None = None
    shaper: ShaperEntry | None = None


class ComparisonRobot(ResultPart):
    """One robot of a comparison.

    Attributes:
        directory: Directory of its runs, below the comparison's.
        versions: Versions by package; None if nothing was run.
        emulated: True if any of its nodes is emulated; None if that is not known.
        emulated_parts: Its parts that are emulated, where others are not.
    """

    name: str
    source: str
    directory: str
    bus: str
    tip_mm: float
    rows: tuple[ComparisonRow, ...]
    compliance: tuple[AxisCompliance, ...]
    not_restored: tuple[str, ...]
    versions: dict[str, str] | None = None
    ended: str | None = None
    emulated: bool | None = None
    emulated_parts: tuple[str, ...] | None = None
    all_disabled: bool | None = None
    line_axes: tuple[int, ...] | None = None

    @property
    def aftermath(self) -> tuple[str, ...]:
        """One sentence per setting that was not restored on its drives."""
        return aftermath(self.all_disabled, self.not_restored)


class TourStep(ResultPart):
    """One step of a tour.

    Attributes:
        link: Path of its report, from the tour's directory; empty for none.
    """

    name: str
    what: str
    holds: bool
    link: str
    seconds: float


class TourFact(ResultPart):
    """A drawn number of an emulated robot, and the identified one.

    Attributes:
        estimate: Number that was identified; None if it was not, or nothing identifies it.
    """

    axis: int
    symbol: str
    name: str
    unit: str
    truth: float
    estimate: float | None = None
    standard_error: float | None = None


class TourClaim(ResultPart):
    """A number of a tour, and its required bound.

    Attributes:
        is_above: True if the number is to be above the bound, else it is to be at most that.
        found: The number; None if it was not judged.
    """

    claim: str
    asked: float
    is_above: bool = False
    found: float | None
    unit: str

    @property
    def holds(self) -> bool | None:
        """True if the number keeps its bound; None if not judged."""
        return None if self.found is None else self.found > self.asked if self.is_above else self.found <= self.asked


class TourNotch(ResultPart):
    """Prediction of a design for its own notch and the bench file's.

    Attributes:
        designed_mm: Predicted tip peak of the designed notch on the ramp.
        given_mm: That of the bench file's notch.
        missed: Margins that the bench file's notch misses, in words, the worst first.
    """

    axis: int
    designed_mm: float
    given_mm: float
    missed: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Reason in a sentence why the designed notch is used."""
        if self.missed:
            misses = f"misses {self.missed[0]}"
            if len(self.missed) > 1:
                misses = f"misses {len(self.missed)} requirements. The worst: {self.missed[0]}"
            return f"Axis {self.axis}: the design does not keep the bench file's notch, since it {misses}."
        given = f"{self.given_mm:.3f} mm for the bench file's notch"
        return f"Axis {self.axis}: the design predicted {self.designed_mm:.3f} mm, and {given}."


class TourPart(ResultPart):
    """Steps of a tour up to its comparison.

    Attributes:
        bench_file: Path of the bench file, from the tour's directory.
        failure: Reason why it ended early, or None.
        robot_file: Path of the robot file that was kept aside, from the tour's directory; None of a robot that has none.
        notches: Predictions of the designs, by axis; None for a tour without any.
    """

    bench_file: str
    steps: tuple[TourStep, ...]
    failure: str | None
    robot_file: str | None = None
    seed: int | None = None
    facts: tuple[TourFact, ...] | None = None
    heading: str = "Your own robot"
    claims: tuple[TourClaim, ...] | None = None
    notches: tuple[TourNotch, ...] | None = None


class TreatmentTable(Result):
    """Base of the results that put treatments side by side.

    Attributes:
        emulated: True if any robot is emulated, even in part; None if that is not known of one, and of none that it is.
    """

    started_utc: str
    request: ComparisonRequestEntry
    robots: list[ComparisonRobot] = Field(default_factory=list)
    emulated: bool | None = None


class ComparisonResult(TreatmentTable):
    """Result of a comparison."""

    kind: Literal["compare"] = "compare"


class TourResult(TreatmentTable):
    """Result of a tour: its steps, and the comparison at its end."""

    kind: Literal["tour"] = "tour"
    tour: TourPart
