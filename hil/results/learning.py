"""Results of `hil learn`: passes or runs, and learnt transmission errors."""

from typing import Literal

from pydantic import Field

from hil.bench.model import IdentifiedError
from hil.results.base import MadeRun, MeasuredResult, ResultPart
from hil.results.runs import TrialPart
from hil.robot_tables import TransmissionErrorTable


class LearningRun(MadeRun):
    """One pass as it was run.

    Attributes:
        number: Number of the pass, from 1.
    """

    axis: int
    number: int
    acceleration_rps_s: float
    end_rps: float


class LearningPass(ResultPart):
    """Estimate after a pass.

    Attributes:
        vibration_m_s2: Vibration of the tip around f_al, at the speeds that excite the arm.
    """

    gain: float
    vibration_m_s2: float
    set_point_delay_s: float
    values: TransmissionErrorTable
    parts: tuple[TrialPart, ...] = ()


class LearntAxis(ResultPart):
    """Transmission error that the passes of one axis gave.

    Attributes:
        reduction_fraction: Fraction by which the last pass' vibration is below the first's.
        left_out: Orders that are not in it, in words.
        kept: Orders that were known before, and that the passes did not better, in words.
        notes: Sentences for the engineer: orders that are seen and were not learnt, or are out of reach.
    """

    axis: int
    reduction_fraction: float
    passes: tuple[LearningPass, ...]
    ate: IdentifiedError
    left_out: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


class LearningResult(MeasuredResult):
    """Result of adaptive cancellation."""

    kind: Literal["learn"] = "learn"
    model: str
    runs: list[LearningRun] = Field(default_factory=list)
    learnt: list[LearntAxis] = Field(default_factory=list)
    not_learnt: str | None = None

    def _note_other_failure(self, text: str) -> None:
        self.not_learnt = text


class ProbingRun(MadeRun):
    """One run of a motion on which something is learnt.

    Attributes:
        number: Number of the run, from 1.
        what: `base` without any cancellation, `probe` with small known ones, `applied` with the learnt one.
        tip_peak_mm: Largest displacement of the tip in the band, in any direction; None if the run was not read.
        tip_rms_mm: Root mean square of it, all directions together.
    """

    number: int
    what: Literal["base", "probe", "applied"]
    tip_peak_mm: float | None = None
    tip_rms_mm: float | None = None
    is_kept: bool = False
    pace: float = 1.0


class ProbedPart(ResultPart):
    """Estimate of one order of one axis from all runs.

    Attributes:
        a_arcsec: Amplitude; None if it is left at 0.
        seen_fraction: Fraction of it that the runs show.
    """

    axis: int
    order: float
    outcome: Literal["learnt", "not reached", "not seen", "nothing found"]
    a_arcsec: float | None = None
    a_error_arcsec: float | None = None
    phi_deg: float | None = None
    phi_error_deg: float | None = None
    seen_fraction: float
    words: str


class LearntOnMotion(ResultPart):
    """Transmission error of one axis that was learnt on a motion."""

    axis: int
    ate: IdentifiedError


class MotionLearningResult(MeasuredResult):
    """Result of learning on a motion.

    Attributes:
        axis: Axis of a constant-acceleration motion; None for a line.
        base_peak_mm: Peak of the tip without cancellation, of the mean of the base runs.
        noise_mm: Root mean square of what equal runs differ by.
        noise_m_s2: The same of the acceleration from which is learnt.
        left_m_s2: What of the acceleration no order explains: the motion's own, and noise.
    """

    kind: Literal["learn-motion"] = "learn-motion"
    model: str
    motion: str
    axis: int | None = None
    probe_arcsec: float | None = None
    runs: list[ProbingRun] = Field(default_factory=list)
    parts: list[ProbedPart] = Field(default_factory=list)
    learnt: list[LearntOnMotion] = Field(default_factory=list)
    base_peak_mm: float | None = None
    base_rms_mm: float | None = None
    noise_mm: float | None = None
    noise_m_s2: float | None = None
    left_m_s2: float | None = None
    not_learnt: str | None = None

    def _note_other_failure(self, text: str) -> None:
        self.not_learnt = text
