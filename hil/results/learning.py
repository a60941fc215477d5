"""Result of `hil learn`: every pass of every axis, and the transmission errors that were learnt."""

from typing import Literal

from pydantic import Field

from hil.bench.model import IdentifiedError
from hil.results.base import MeasuredResult, ResultPart
from hil.results.runs import TrialPart
from hil.robot_tables import TransmissionErrorTable


class LearningRun(ResultPart):
    """One pass as it was run.

    Attributes:
        axis: Axis number.
        number: Number of the pass, from 1.
        acceleration_rps_s: Acceleration of the ramps.
        end_rps: Speed at the end of the ramps.
        cycles: SYNCs of the motion.
        missed_cycles: Cycles that lack an answer.
        wall_s: Duration of the whole run on the wall clock.
        recording: Path of the CSV file, from the result's directory.
        stopped: Reason of a stop.
    """

    axis: int
    number: int
    acceleration_rps_s: float
    end_rps: float
    cycles: int
    missed_cycles: int
    wall_s: float
    recording: str
    stopped: str | None = None


class LearningPass(ResultPart):
    """Estimate after a pass.

    Attributes:
        gain: Fraction of the cancellation that acted.
        vibration_m_s2: Vibration of the tip around f_al, at the speeds that excite the arm.
        set_point_delay_s: Delay of the set-points as estimated after this pass.
        following: Motor's motion over the intended one; None where it was not measured.
        values: Amplitudes A_k and phases φ_k.
        parts: Verdict on each order that was cancelled in the pass.
    """

    gain: float
    vibration_m_s2: float
    set_point_delay_s: float
    following: float | None
    values: TransmissionErrorTable
    parts: tuple[TrialPart, ...] = ()


class LearntAxis(ResultPart):
    """Transmission error that the passes of one axis gave.

    Attributes:
        axis: Axis number.
        reduction_fraction: Fraction by which the last pass' vibration is below the first's.
        passes: Passes in their order.
        ate: Entry of the model file.
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
    """Result of adaptive cancellation.

    Attributes:
        model: Path of the model file.
        runs: Passes as they were run.
        learnt: Axes that are in the model file.
        not_learnt: Reason why not all axes are.
    """

    kind: Literal["learn"] = "learn"
    model: str
    runs: list[LearningRun] = Field(default_factory=list)
    learnt: list[LearntAxis] = Field(default_factory=list)
    not_learnt: str | None = None

    def _note_other_failure(self, text: str) -> None:
        self.not_learnt = text
