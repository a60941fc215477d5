"""Result of `hil identify ate`: transmission error, passes, standard errors."""

from typing import Literal

from pydantic import Field

from hil.bench.model import IdentifiedError
from hil.design.ate.identification import Agreement
from hil.design.ate.model import Arm, OtherMode, Sensing
from hil.results.base import MadeRun, MeasuredResult, ResultPart
from hil.results.runs import RunTiming


class KnownArm(ResultPart):
    """Arm that was known before the passes.

    Attributes:
        start: Arm from which the fit started; None if it was searched for.
    """

    source: str
    start: Arm | None
    resonance_error_hz: float | None = None
    damping_error: float | None = None

    @property
    def others(self) -> tuple[OtherMode, ...]:
        """Modes of a coupled arm beside the one that was fitted."""
        return () if self.start is None else self.start.others


class AteRun(MadeRun):
    """One pass as it was run.

    Attributes:
        forward_from_s: Beginning of the ramp forwards, in the recording's time.
        backward_from_s: Beginning of the ramp back, in the recording's time.
        timing: Punctuality of the cycles; None in lock-step.
    """

    acceleration_rps_s: float
    end_rps: float
    ramp_s: float
    forward_from_s: float
    backward_from_s: float
    low_rev: float
    high_rev: float
    sync_period_s: float
    sensor_missed: int
    motion_s: float
    timing: RunTiming | None = None


class AteFit(ResultPart):
    """Fit of all passes together; the fields are those of `hil.design.ate.identification.JointEstimate`.

    Attributes:
        arm_hz: Resonance of the linear arm that comes nearest to the vibration.
        carried: Fraction of the vibration's power by order; orders overlap, so that the sum is only nearly the explained one.
    """

    delay_s: float
    delay_error_s: float
    gear_fraction: float
    residual: float
    explained: float
    explained_by_error: float
    motion_scale: float
    motion_scale_error: float
    band_hz: tuple[float, float]
    agreement: tuple[Agreement, ...]
    miss: float | None = None
    arm_hz: float | None = None
    arm_damping: float | None = None
    carried: dict[str, float] | None = None


class AteStandardErrors(ResultPart):
    """Standard errors of the transmission error after a pass.

    Attributes:
        standard_error: Standard errors by the names of the model file: `a2_arcsec`, `phi2_deg` ….
    """

    standard_error: dict[str, float]


class AteResult(MeasuredResult):
    """Result of an identification of the transmission error.

    Attributes:
        sensorless: True if motor torque and encoder alone were used.
        ate: Entry of the model file; None, like all below, where nothing was identified.
        is_within_goal: True if the standard errors reach the goal, or are at most 3 times what is asked (more of a gear
            that is not a spring: `hil.experiments.ate.request.Miss.is_usable`); orders out of the ramps' reach do not count.
            The notes list those that are larger than asked.
    """

    kind: Literal["identify-ate"] = "identify-ate"
    axis: int
    sensorless: bool
    known_before: KnownArm
    sensing: Sensing
    passes: list[AteRun] = Field(default_factory=list)
    ate: IdentifiedError | None = None
    fit: AteFit | None = None
    history: tuple[AteStandardErrors, ...] | None = None
    is_within_goal: bool | None = None
    notes: tuple[str, ...] | None = None
    not_identified: str | None = None

    def _note_other_failure(self, text: str) -> None:
        self.not_identified = text
