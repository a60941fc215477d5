"""The record of one path."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from hil.errors import RefusalCause
from hil.robot_tables import ORDERS

Cell = str | float | int | bool | None

STEPS = ("plant", "ate", "design", "none", "notch", "notch_designed", "cancellation", "learn", "cancellation_learnt")
"""Steps of the documented path, in their order; runs by the name of their treatment."""

TREATMENTS = ("none", "notch", "notch_designed", "cancellation", "cancellation_learnt")
"""Treatments of which the true tip is measured; `notch` is the copied one of Table 3."""

QUANTITIES = (
    "motor_inertia_kg_m2", "arm_inertia_kg_m2", "gear_stiffness_nm_rad", "antiresonance_hz", "resonance_hz", "damping",
    "motor_damping_nm_s_rad", "arm_damping_nm_s_rad", "coulomb_friction_nm", "gravity_moment_nm", "accelerometer_delay_s",
    "a1_arcsec", "phi1_deg", "a2_arcsec", "phi2_deg", "a4_arcsec", "phi4_deg",
    "learnt_a1_arcsec", "learnt_phi1_deg", "learnt_a2_arcsec", "learnt_phi2_deg", "learnt_a4_arcsec", "learnt_phi4_deg",
)  # fmt: skip
"""Quantities that the path estimates."""

PROBES = (
    *(f"phi{order}_off_{angle}" for order in ORDERS for angle in (60, 90, 180)),
    *(f"a{order}_times_3" for order in ORDERS),
    "another_robot",
)
"""Wrong corrections that the trial must refuse."""

FACTS = (
    "reduction_ratio", "antiresonance_hz", "f_al_hz", "inertia_ratio", "a1_arcsec", "a2_arcsec", "a4_arcsec", "encoder_bits",
    "current_lag_s", "hysteresis_nm", "softness", "gear_reaction", "noise_m_s2", "sensor_delay_s", "mounting_hz",
    "sync_period_s", "late_answers", "bitrate",
)  # fmt: skip
"""Facts of the robot that a table is sorted by."""

Ended = Literal["done", "noted", "refused", "stopped", "crashed", "skipped"]
"""From the best; `noted`: done, with less than was asked; `crashed`: unexpected exception; `skipped`: a prerequisite failed."""
ENDED = get_args(Ended)
IS_DONE = frozenset({"done", "noted"})
TREATED = ("notch_designed", "cancellation", "cancellation_learnt")
"""Treatments that the path chooses by its measurements; it never chooses the copied notch."""

MAX_WORDS = 600
QUIET_MM, FLOOR_FACTOR = 0.010, 1.3
"""The goal: this tip, or so many times the floor, whichever is more."""
WORSE_FRACTION, WORSE_MM = 0.05, 0.002
"""Rise of the true tip that counts as worse; both must be exceeded."""


@dataclass(frozen=True)
class StepRecord:
    """End of a step.

    Attributes:
        words: The error's words, or the note of a step that is done.
    """

    ended: Ended = "skipped"
    error: str = ""
    words: str = ""
    cpu_s: float = 0.0
    causes: tuple[RefusalCause, ...] = ()

    @property
    def is_done(self) -> bool:
        """True if the step has its result."""
        return self.ended in IS_DONE


@dataclass(frozen=True)
class QuantityRecord:
    """One quantity: truth, estimate and standard error.

    A missing one is None. Phases in degrees are compared on the circle.
    """

    true: float | None = None
    estimate: float | None = None
    error: float | None = None

    def z(self, *, is_angle: bool = False) -> float | None:
        """Return the deviation in standard errors."""
        if self.true is None or self.estimate is None or not self.error:
            return None
        off = self.estimate - self.true
        if is_angle:
            off = math.remainder(off, 360.0)
        return off / self.error


@dataclass(frozen=True)
class ProbeRecord:
    """One wrong correction.

    Attributes:
        accepted: True if the trial let it through; None if it was not tried.
        worst_ratio: Largest true tip of any order over that without a treatment; only of an accepted one.
    """

    accepted: bool | None = None
    worst_ratio: float | None = None


@dataclass
class PathRecord:
    """One run of the documented path.

    Attributes:
        facts: Facts of the robot, by `FACTS`.
        steps: End of each step, by `STEPS`.
        quantities: By `QUANTITIES`.
        tips: True tip in mm by treatment, then by order; an order whose resonance the motion does not pass has none,
            unless it passes none at all (`truth`).
        left: Tip's peak in the worst window with each cancellation, in mm, as its own trial saw it.
        hidden: Tip's peak in mm that the noise of that trial may hide.
        floor: The true tip without a transmission error, by order.
        probes: Wrong corrections, by `PROBES`.
        causes: Causes that the run of each cancellation names for what it leaves, and its words.
        without_cause_mm: True tip at the path's end without the causes that were named; None if there are none.
        survey_cpu_s: Processor time of measuring the truth, and of the wrong corrections.
        simulated_s: Time of the robot's world.
    """

    name: str
    seed: int
    axis: int
    over_bus: bool = False
    facts: dict[str, Cell] = field(default_factory=dict)
    steps: dict[str, StepRecord] = field(default_factory=dict)
    quantities: dict[str, QuantityRecord] = field(default_factory=dict)
    tips: dict[str, dict[float, float]] = field(default_factory=dict)
    left: dict[str, float | None] = field(default_factory=dict)
    hidden: dict[str, float] = field(default_factory=dict)
    floor: dict[float, float] = field(default_factory=dict)
    probes: dict[str, ProbeRecord] = field(default_factory=dict)
    causes: dict[str, tuple[tuple[str, ...], str]] = field(default_factory=dict)
    without_cause_mm: float | None = None
    cpu_s: float = 0.0
    survey_cpu_s: float = 0.0
    simulated_s: float = 0.0

    @property
    def end_treatment(self) -> str:
        """Treatment at the path's end.

        It is the learnt cancellation, unless its trial left more at the tip than the other's, by more than the noise; else the
        designed notch, else none.
        """
        done = [name for name in TREATMENTS if self.steps.get(name, StepRecord()).is_done and name in self.tips]
        cancelled = [name for name in ("cancellation_learnt", "cancellation") if name in done]
        if len(cancelled) == 2:
            hidden_mm = max(self.hidden.get(name, 0.0) for name in cancelled)
            return cancelled[self._left_mm("cancellation_learnt") > self._left_mm("cancellation") + hidden_mm]
        if cancelled:
            return cancelled[0]
        return "notch_designed" if "notch_designed" in done else "none"

    def _left_mm(self, name: str) -> float:
        """Return the tip's peak in a cancellation's own trial, mm; infinite without."""
        left_mm = self.left.get(name)
        return math.inf if left_mm is None else left_mm

    @property
    def end_tip_mm(self) -> float | None:
        """True tip of the worst order at the path's end."""
        return max(self.tips.get(self.end_treatment, {}).values(), default=None)

    @property
    def goal_mm(self) -> float:
        """Goal for the tip."""
        return max(QUIET_MM, FLOOR_FACTOR * max(self.floor.values(), default=0.0))

    @property
    def is_quiet(self) -> bool | None:
        """True if the path's end meets the goal; None without measurement."""
        tip = self.end_tip_mm
        return None if tip is None else tip <= self.goal_mm

    @property
    def end_causes(self) -> tuple[tuple[str, ...], str]:
        """Causes of the remaining tip, and the product's words."""
        return self.causes.get(self.end_treatment, ((), ""))

    @property
    def worse(self) -> tuple[str, ...]:
        """Accepted treatments that raise the true tip of any order.

        Each is named with its order: `cancellation k4`. The copied notch is left out.

        A tip that rises at most to the floor is not due to the treatment: it is the jolt of the motion's own start, which
        the ATE reduces by chance.
        """
        return tuple(f"{name} k{order}" for name, order in self._raised() if self._is_above(name, order, self.floor))

    @property
    def raised_to_floor(self) -> tuple[str, ...]:
        """Accepted treatments that raise the tip at most to the floor."""
        return tuple(f"{name} k{order}" for name, order in self._raised() if not self._is_above(name, order, self.floor))

    def _raised(self) -> list[tuple[str, float]]:
        """Return accepted treatments and orders with a raised true tip."""
        return [
            (name, order)
            for name in TREATED
            if self.steps.get(name, StepRecord()).is_done
            for order in sorted(self.tips.get(name, {}).keys() & self.tips.get("none", {}).keys())
            if self._is_above(name, order, self.tips.get("none", {}))
        ]

    def _is_above(self, name: str, order: float, other: Mapping[float, float]) -> bool:
        """Return True if a treatment's tip is significantly above another."""
        rise = self.tips[name][order] - other.get(order, 0.0)
        return rise > max(WORSE_MM, WORSE_FRACTION * other.get(order, 0.0))

    def row(self) -> dict[str, Cell]:
        """Return the record as one row of a table."""
        cells: dict[str, Cell] = {"name": self.name, "seed": self.seed, "axis": self.axis, "over_bus": self.over_bus}
        cells |= {f"robot_{name}": self.facts.get(name) for name in FACTS}
        for name in STEPS:
            step = self.steps.get(name, StepRecord())
            cells |= {f"{name}_ended": step.ended, f"{name}_error": step.error, f"{name}_words": step.words[:MAX_WORDS]}
            cells |= {f"{name}_cpu_s": step.cpu_s, f"{name}_causes": ", ".join(step.causes)}
        for name in QUANTITIES:
            quantity = self.quantities.get(name, QuantityRecord())
            cells |= {f"{name}_true": quantity.true, f"{name}_estimate": quantity.estimate, f"{name}_error": quantity.error}
            cells[f"{name}_z"] = quantity.z(is_angle=name.endswith("_deg"))
        for name in TREATMENTS:
            cells |= {f"tip_{name}_k{order}_mm": self.tips.get(name, {}).get(order) for order in ORDERS}
        cells |= {f"tip_floor_k{order}_mm": self.floor.get(order) for order in ORDERS}
        for name in PROBES:
            probe = self.probes.get(name, ProbeRecord())
            cells[f"probe_{name}_accepted"] = probe.accepted
            cells[f"probe_{name}_worst_ratio"] = probe.worst_ratio
        cells |= {"end_treatment": self.end_treatment, "end_tip_mm": self.end_tip_mm, "goal_mm": self.goal_mm}
        cells |= {"end_causes": ", ".join(self.end_causes[0]), "end_words": self.end_causes[1][:MAX_WORDS]}
        cells |= {f"left_{name}_mm": self.left.get(name) for name in ("cancellation", "cancellation_learnt")}
        cells["without_cause_mm"] = self.without_cause_mm
        cells |= {"is_quiet": self.is_quiet, "worse": ", ".join(self.worse)}
        cells["raised_to_floor"] = ", ".join(self.raised_to_floor)
        cells |= {"cpu_s": self.cpu_s, "survey_cpu_s": self.survey_cpu_s, "simulated_s": self.simulated_s}
        return cells


COLUMNS = tuple(PathRecord(name="", seed=0, axis=0).row())
"""Names of the columns of a row, in their order."""
