"""Record of learning on a motion."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from hil.analysis import TipScale
from hil.control.arrays import Real
from hil.design.probing import RunScatter, scatter_of
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.probing.motion import GearReaction, PartOutcome, peak_and_rms
from hil.experiments.cancellation.waves import ProbedRows
from hil.master.motion import Motion, RunResult
from hil.recording import Recording

RunKind = Literal["base", "probe", "applied"]
MotionRunKeeper = Callable[[int, RunKind, RunResult], object]
"""What keeps a run, counted from 1; it may have been stopped."""


@dataclass(frozen=True)
class MotionRun:
    """One run of the motion.

    Attributes:
        values: Cancelled A e^{jφ} in arcsec, by part.
        felt_m_s2: Acceleration of the tip in the rows that count; shape (3, rows).
        moved_mm: Displacement of the tip there; shape (3, rows).
        pace: Multiple of the motion's time in which it was run.
    """

    kind: RunKind
    values: Mapping[Part, complex]
    recording: Recording
    felt_m_s2: Real
    moved_mm: Real
    pace: float = 1.0

    @property
    def peak_mm(self) -> float:
        """Largest displacement in any direction."""
        return peak_and_rms(self.moved_mm)[0]

    @property
    def rms_mm(self) -> float:
        """Root mean square of the displacement."""
        return peak_and_rms(self.moved_mm)[1]


@dataclass
class MotionLearning:
    """Result of learning on a motion.

    Attributes:
        inertias: J_m by axis, as it was given, where no file has a plant.
        probed: Rows that count; None before the first run.
        reactions: Reactions of the gears, as the motors' torque shows them.
        applied: Run with what is kept; None if nothing is.
        probe_arcsec: Amplitude of the probes; 0 before them.
        noise_m_s2: Root mean square of one run's noise, by which equal runs differ.
        left_m_s2: Root mean square of what no order explains: the motion's own, and noise.
        pace: Multiple of the bench file's time in which the motion is run.
        all_runs: These runs and those of the same line at another pace, in their order.
    """

    motion: Motion
    scale: TipScale
    inertias: Mapping[int, float | None]
    probed: ProbedRows | None = None
    runs: list[MotionRun] = field(default_factory=list)
    outcomes: dict[Part, PartOutcome] = field(default_factory=dict)
    reactions: dict[int, GearReaction] = field(default_factory=dict)
    applied: MotionRun | None = None
    probe_arcsec: float = 0.0
    noise_m_s2: float = 0.0
    left_m_s2: float = 0.0
    pace: float = 1.0
    all_runs: list[MotionRun] = field(default_factory=list)

    def of_kind(self, kind: RunKind) -> list[MotionRun]:
        """Runs of a kind."""
        return [run for run in self.runs if run.kind == kind]

    @property
    def base_mm(self) -> tuple[float, float]:
        """Peak and root mean square of the mean of the base runs."""
        return peak_and_rms(np.mean([run.moved_mm for run in self.of_kind("base")], axis=0))

    @property
    def noise_mm(self) -> RunScatter:
        """Scatter of the base runs."""
        return scatter_of(np.stack([run.moved_mm for run in self.of_kind("base")]))
