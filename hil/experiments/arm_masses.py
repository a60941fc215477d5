"""Masses of an arm from the plants of its axes.

The plants are those of several postures; the dips in other postures follow. Nothing is sent to the robot.
"""

import datetime
import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from hil.arm.kinematics import Kinematics
from hil.arm.line import arm_line
from hil.arm.masses import mass_matrix
from hil.arm.regressor import made_up_masses, regressor, workspace
from hil.arm.straight_line import LineError
from hil.arm.tables import ArmTable
from hil.bench.bench import Bench
from hil.bench.model import Identified, IdentifiedArm
from hil.control.arrays import Real
from hil.design.coupled.masses import (
    LEAST_FREQUENCY_ERROR,
    FeltMode,
    MassFit,
    NoMassesError,
    TooFewPosturesError,
    dips_of,
    fit_masses,
)
from hil.design.uncertainty import CORNER_SIGMAS, LEAST_SPREAD
from hil.errors import HilError, NotPossibleError
from hil.results.arm import ArmResult, LineDips, MeasuredDip

FEWEST_POSTURES = 3
"""Bound: postures below which nothing is fitted: fewer leave the masses behind one joint undetermined."""
TRIED_POSTURES = 80
"""Accuracy: postures of the workspace, of which one is named that would tell most: 40 to 160 give the same one on the reference
arm, and the same masses."""
ALONG_LINE = 21
"""Accuracy: points of the line at which dips are predicted, 5 % of it apart."""
NEAR_DEG = 5.0
"""Accuracy: difference of every joint up to which a posture is near to the line: one joint of the reference arm moves dips by 1.9
% (rms) then."""
STAYS_DEG = 0.5
"""Accuracy: turn of a joint that counts as none: the dips of the reference arm move by 0.3 % at most."""
POOR = LEAST_SPREAD / CORNER_SIGMAS
"""Relative standard error of a predicted dip above which a note asks for one more posture: it widens the corners of a design."""


class ArmNotIdentifiedError(HilError):
    """Error: the postures do not determine the masses of the arm."""

    exit_code: ClassVar[int] = 9


def identify_arm(bench: Bench, identified: Identified) -> ArmResult:
    """Fit the masses of a bench's arm to measured modes.

    Raises:
        NotPossibleError: The bench has no arm, the model file is another robot's, or it has too few postures.
        ArmNotIdentifiedError: The postures do not determine the masses, with the posture to add.
    """
    if bench.arm is None:
        raise NotPossibleError(f"bench {bench.name!r} has no [arm], which the masses of an arm need; add it")
    identified.check_robot(bench.name)
    postures = [(number, each) for number, axis in sorted(identified.axis.items()) for each in axis.posture]
    axes = tuple(number for number in bench.arm.axes if number in {each for each, _ in postures})
    count = max((sum(number == axis for number, _ in postures) for axis in axes), default=0)
    if count < FEWEST_POSTURES:
        raise NotPossibleError(
            f"the model file has {count} postures of an axis; at least {FEWEST_POSTURES} are needed; add some "
            "with hil identify plant --posture-deg"
        )
    fitted = _Arm(bench, bench.arm, axes, np.radians([each.joints_deg for _, each in postures]))
    felt = [
        FeltMode(
            row, axes.index(number), mode.antiresonance_hz, mode.standard_error.get("antiresonance_hz", 0.0),
            mode.inertia_kg_m2, mode.standard_error.get("inertia_kg_m2", 0.0),
        )
        for row, (number, each) in enumerate(postures)
        for mode in each.mode
    ]  # fmt: skip
    return fitted.result(felt, count, any(each.emulated for _, each in postures) or None)


class _Arm:
    """Arm of a bench, with the axes whose modes are measured."""

    def __init__(self, bench: Bench, arm: ArmTable, axes: tuple[int, ...], joints_rad: Real) -> None:
        self.bench, self.arm, self.axes, self.joints_rad = bench, arm, axes, joints_rad
        self.rows = [arm.axes.index(number) for number in axes]
        self.kinematics = Kinematics.of(arm)

    def regressors(self, joints_rad: Real) -> Real:
        """Y of the axes in some postures; shape (postures, n, n, parameters)."""
        return np.asarray(regressor(self.kinematics, joints_rad)[..., self.rows, :, :][..., :, self.rows, :])

    def around(self) -> Real:
        """Postures all over the workspace, the other joints unchanged."""
        low, high = self.joints_rad[0].copy(), self.joints_rad[0].copy()
        home = self.arm.home_rad()
        for row, number in zip(self.rows, self.axes, strict=True):
            table, link = self.bench.axis[number], self.arm.link[row]
            turn = 2.0 * math.pi / table.reduction_ratio
            ends = np.radians(link.range_deg or (-180.0, 180.0))
            low[row] = max(ends[0], home[row] + table.limits.position_min_rev * turn)
            high[row] = min(ends[1], home[row] + table.limits.position_max_rev * turn)
        return workspace(low, high, TRIED_POSTURES)

    def result(self, felt: Sequence[FeltMode], count: int, emulated: bool | None) -> ArmResult:
        """Fit, and predict."""
        around, rigid = self.around(), [number for number in self.arm.axes if number not in self.axes]
        at = self.regressors(self.joints_rad)
        try:
            fit = fit_masses(at, felt, self.regressors(around), made_up_masses(self.kinematics))
        except NoMassesError as error:
            raise ArmNotIdentifiedError(f"no masses explain the measured modes: {_misfit_words(error.misfit, rigid)}") from None
        except TooFewPosturesError as error:
            there = _posture_words(self._posture_of(around[error.best]))
            raise ArmNotIdentifiedError(f"{error}; measure one more posture, such as --posture-deg {there}") from None
        following = self._posture_of(around[fit.best])
        line, notes = self._line(fit, following)
        worst = max((e / hz for each in line for hz, e in zip(each.dips_hz, each.standard_error_hz, strict=True)), default=0.0)
        if fit.misfit > CORNER_SIGMAS:
            notes.append(f"the masses do not explain the measured modes well: {_misfit_words(fit.misfit, rigid)}")
        if worst > POOR:
            notes.append(
                f"dips along the line are known to {100.0 * worst:.1f} % only; measure one more posture, best "
                f"--posture-deg {_posture_words(following)}"
            )
        measured = self._measured(fit, felt, at)
        notes += _bodies_words(measured)
        if rigid:
            notes.append(f"axes {', '.join(map(str, rigid))} were not identified: they count as rigid, and keep their positions")
        return ArmResult(
            bench=self.bench.name,
            started_utc=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            arm=IdentifiedArm(
                axes=self.axes, joints_deg=tuple(np.degrees(self.joints_rad[0]).round(4).tolist()),
                masses=tuple(fit.masses.tolist()), stiffness_nm_rad=tuple(fit.stiffness_nm_rad.tolist()),
                standard_error_nm_rad=tuple(fit.stiffness_error_nm_rad.tolist()), misfit=fit.misfit, postures=count,
                dip_error=max(worst, self._error_at(fit, at)), emulated=emulated,
            ),
            measured=measured,
            line=tuple(line),
            next_posture_deg=following,
            notes=tuple(notes),
        )  # fmt: skip

    @staticmethod
    def _error_at(fit: MassFit, at: Real) -> float:
        values, errors = fit.dips_hz(at)
        return float(np.max(errors / values))

    def _posture_of(self, joints_rad: Real) -> dict[int, float]:
        return {number: round(math.degrees(joints_rad[row])) for number, row in zip(self.axes, self.rows, strict=True)}

    def _by_bodies(self, fit: MassFit, joints_rad: Real) -> tuple[float, ...]:
        """Dips of the bench file's bodies, if any, on the fitted gears."""
        if all(link.body is None for link in self.arm.link):
            return ()
        inertia = mass_matrix(self.arm, joints_rad)[np.ix_(self.rows, self.rows)]
        return tuple(dips_of(inertia, fit.stiffness_nm_rad).tolist())

    def _measured(self, fit: MassFit, felt: Sequence[FeltMode], at: Real) -> tuple[MeasuredDip, ...]:
        values, _ = fit.dips_hz(at)
        bodies = [self._by_bodies(fit, joints) for joints in self.joints_rad]
        return tuple(
            MeasuredDip(
                axis=self.axes[mode.joint], joints_deg=tuple(np.degrees(self.joints_rad[mode.posture]).round(3).tolist()),
                measured_hz=mode.frequency_hz, standard_error_hz=mode.frequency_error_hz,
                fitted_hz=_nearest(mode.frequency_hz, values[mode.posture].tolist()),
                bodies_hz=_nearest(mode.frequency_hz, bodies[mode.posture]) if bodies[mode.posture] else None,
                way_fraction=self._way_fraction(self.joints_rad[mode.posture]),
            )
            for mode in felt
        )  # fmt: skip

    def _line_joints(self) -> tuple[Real, Real]:
        """Fractions of the way along the bench's line, with joint angles.

        Raises:
            LineError: The arm cannot follow the line.
        """
        if self.bench.line_motion is None:
            return np.zeros(0), np.zeros((0, len(self.arm.axes)))
        return arm_line(self.arm, self.bench.line_motion).line.joints_along

    def _way_fraction(self, joints_rad: Real) -> float | None:
        """Fraction of the line's way to which a posture is near."""
        try:
            fractions, line_rad = self._line_joints()
        except LineError:
            return None
        away = np.degrees(np.max(np.abs(line_rad - joints_rad), axis=1))
        return float(fractions[np.argmin(away)]) if len(away) and np.min(away) < NEAR_DEG else None

    def _line(self, fit: MassFit, following: Mapping[int, float]) -> tuple[list[LineDips], list[str]]:
        """Dips along the bench's line motion, or why they are not known."""
        try:
            fractions, line_rad = self._line_joints()
        except LineError as error:
            return [], [f"dips along the line are not predicted: {error}"]
        if not len(line_rad):
            return [], []
        others = [row for row in range(len(self.arm.axes)) if row not in self.rows]
        away = np.degrees(np.abs(line_rad[:, others] - self.joints_rad[0, others]).max(axis=0, initial=0.0))
        turning = [str(self.arm.axes[row]) for row, deg in zip(others, away, strict=True) if deg > STAYS_DEG]
        if turning:
            words = f"the line turns axis {', '.join(turning)}, which has no identified modes"
            return [], [f"dips along the line are not predicted: {words}"]
        at = [int(np.argmin(np.abs(fractions - each))) for each in np.linspace(0.0, 1.0, ALONG_LINE)]
        values, errors = fit.dips_hz(self.regressors(line_rad[at]))
        if not (np.all(np.isfinite(values)) and np.all(np.isfinite(errors))):
            words = "dips along the line are not predicted: these postures do not determine the masses there"
            return [], [f"{words}; measure one more posture, best --posture-deg {_posture_words(following)}"]
        return [
            LineDips(
                way_fraction=float(fractions[row]), dips_hz=tuple(dips.tolist()), standard_error_hz=tuple(off.tolist()),
                bodies_hz=self._by_bodies(fit, line_rad[row]),
            )
            for row, dips, off in zip(at, values, errors, strict=True)
        ], []  # fmt: skip


def _bodies_words(measured: Sequence[MeasuredDip]) -> list[str]:
    """Describe how far the bench file's bodies are from the measurement."""
    with_bodies = [(row, row.bodies_hz) for row in measured if row.bodies_hz is not None]
    if not with_bodies:
        return []
    off = [(abs(math.log(row.measured_hz / hz)), row.standard_error_hz / row.measured_hz) for row, hz in with_bodies]
    sigmas = [away / math.hypot(error, LEAST_FREQUENCY_ERROR) for away, error in off]
    at = int(np.argmax(sigmas))
    (worst, _), (away, _) = with_bodies[at], off[at]
    words = (
        f"the bench file's bodies: the dip with the largest deviation was measured at {worst.measured_hz:.2f} Hz, but computed "
        f"at {worst.bodies_hz:.2f} Hz"
    )
    found = f"{words}: {100.0 * away:.1f} %, {sigmas[at]:.1f} standard errors"
    return [found + ("" if away < LEAST_SPREAD else "; check that the bodies and the payload are those of this robot")]


def _misfit_words(misfit: float, rigid: Sequence[int]) -> str:
    """Misfit of the fitted masses, and what to check."""
    words = f"misfit of {misfit:.1f} standard errors; check that no load was changed and every posture was kept"
    if rigid:
        words += f", and that axes {', '.join(map(str, rigid))}, which were not identified and count as rigid, do not vibrate"
    return words


def _nearest(hz: float, dips_hz: Sequence[float]) -> float:
    return min(dips_hz, key=lambda each: abs(math.log(each / hz)))


def _posture_words(posture_deg: Mapping[int, float]) -> str:
    return ",".join(f"{number}={angle:g}" for number, angle in posture_deg.items())
