"""Result of a cancellation's trial."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hil.errors import HilError
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.verdict import PartVerdict, part_entry
from hil.recording import Recording
from hil.results.runs import CancellationRemainder, CancellationTrial, TrialRun

PARTS_TOLD = 4
"""Bound: verdicts that fit in an error message."""


class CancellationRefusedError(HilError):
    """Error: the cancellation failed its trial at the tip, and is not used."""

    exit_code = 9

    def __init__(self, what: str, verdicts: Sequence[PartVerdict], stays: str = "the notch") -> None:
        """Keep cancellation, verdicts and what acts instead."""
        self.what, self.verdicts = what, tuple(verdicts)
        self.causes = ("noise",) if any(verdict.verdict == "not judged" for verdict in self.verdicts) else ()
        told = "; ".join(verdict.words for verdict in self.verdicts[:PARTS_TOLD])
        more = "" if len(self.verdicts) <= PARTS_TOLD else f"; and {len(self.verdicts) - PARTS_TOLD} more"
        super().__init__(f"cancellation refused: no order of {what} passes its trial; {stays} remains. {told}{more}")


@dataclass(frozen=True)
class Trial:
    """One run of a trial.

    Attributes:
        what: Cancellation of this run, in words.
        gains: Fraction of each part that acted.
        rms_m_s2: Vibration of the tip in the rows that are judged, in the band around f_al.
    """

    what: str
    recording: Recording
    gains: Mapping[Part, float]
    rms_m_s2: float


@dataclass(frozen=True)
class Verification:
    """Runs of a trial, and the verdict on each part.

    Attributes:
        gain: Fraction of the cancellation that was tried first.
        trials: All runs, the first without the cancellation.
        remainder: Remainder of the vibration and its cause; None if nothing is used.
    """

    gain: float
    trials: tuple[Trial, ...]
    verdicts: tuple[PartVerdict, ...]
    remainder: CancellationRemainder | None = None

    @property
    def is_good(self) -> bool:
        """True if something of the cancellation may be trusted."""
        return any(verdict.verdict == "accepted" for verdict in self.verdicts)

    @property
    def left_out(self) -> frozenset[Part]:
        """Parts that are wrong or could not be judged, and are not used."""
        return frozenset(verdict.part for verdict in self.verdicts if verdict.verdict != "accepted")

    def entry(self) -> CancellationTrial:
        """Entry of the trial for the result file."""
        before = self.trials[0].rms_m_s2
        runs = tuple(
            TrialRun(what=trial.what, rms_m_s2=trial.rms_m_s2, reduction_fraction=1.0 - trial.rms_m_s2 / max(before, 1e-30))
            for trial in self.trials[1:]
        )
        parts = tuple(part_entry(verdict) for verdict in self.verdicts)
        return CancellationTrial(
            before_m_s2=before, gain=self.gain, is_good=self.is_good, trials=runs, parts=parts, remainder=self.remainder
        )

    def demand(self, stays: str = "the notch") -> None:
        """Refuse a useless cancellation; say what acts instead.

        Raises:
            CancellationRefusedError: No order of any axis passes.
        """
        if not self.is_good:
            raise CancellationRefusedError("it", self.verdicts, stays)
