"""Loop of one axis on the arm of its bench.

The module chooses the postures in which margins are required, and notes how far the arm is known.

Where the bench file's links have bodies, the arm is frozen at places of its line motion: mass matrix by the links, gears and
motors by the models of the axes. Where they have none, masses that were identified from several postures serve (`hil identify
arm`); else the modes of the model file stand for the one posture in which they were identified.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.arm.kinematics import Kinematics
from hil.arm.line import arm_line
from hil.arm.masses import check_masses, mass_matrix
from hil.arm.regressor import regressor
from hil.arm.straight_line import LineError
from hil.arm.tables import ArmTable
from hil.bench.bench import AxisTable, Bench
from hil.bench.model import Identified, IdentifiedArm, IdentifiedAxis, IdentifiedPlant, stiffness_of
from hil.control.arrays import Real
from hil.control.notch import NOTCH_OFF
from hil.counting import axes_in_words
from hil.design.coupled.loops import POLE_SPEEDS, ArmCase, ArmLoops, Other
from hil.design.coupled.structure import Structure
from hil.design.frequency import Loop, TwoInertia
from hil.design.uncertainty import CORNER_SIGMAS, Member
from hil.robot_tables import Control

LINE_FRACTIONS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Accuracy: fractions of the way at which the arm is frozen: 9 or 17 change no M_s of the reference arm, and a phase margin by
0.1°."""


@dataclass(frozen=True)
class KnownLoops:
    """Loop of an axis on its arm, with notes on its validity.

    Attributes:
        loops: The loop; None if nothing is known of the arm but the axis by itself.
        notes: What the margins hold for, and what they do not.
    """

    loops: ArmLoops | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Posture:
    """Posture with a name for messages."""

    label: str
    joints_rad: Real


def arm_loops(bench: Bench, axis: int, law: Loop, members: Sequence[Member], identified: Identified | None = None) -> KnownLoops:
    """Find the loop of an axis on its arm.

    Args:
        bench: The bench, with the models of its axes.
        law: Gains, sampling time and delay of its loop; its plant does not count.
        members: Plants that the axis by itself might have; their spread is the uncertainty of the arm's frequencies.
    """
    if bench.arm is None:
        return KnownLoops(None)
    away = max(abs(each.plant.antiresonance_hz / members[0].plant.antiresonance_hz - 1.0) for each in members)
    factors = [1.0] if away == 0.0 else [1.0, 1.0 - away, 1.0 + away]
    identified_axes = {} if identified is None else identified.axis
    lacking = _lacking_masses(bench.arm)
    if lacking is None:
        joints = {number: _joint(bench.axis[number], identified_axes.get(number)) for number in bench.arm.axes}
        return _by_masses(_Masses(bench.arm, joints), bench, axis, law, factors)
    known = None if identified is None else identified.arm
    if known is not None and axis in known.axes:
        away = max(away, CORNER_SIGMAS * known.dip_error)
        masses = _Masses.identified(bench, known, identified_axes)
        if all(masses.is_known_at(posture.joints_rad) for posture in _postures(bench, bench.arm, axis)[0]):
            return _by_masses(masses, bench, axis, law, [1.0, 1.0 - away, 1.0 + away])
        lacking = "the masses of the model file give an invalid mass matrix in some posture of the line"
    own = identified_axes.get(axis, IdentifiedAxis()).plant
    if own is None or not own.modes:
        note = f"axis {axis}: {lacking}, so margins are those of the single axis; on the arm they are unknown"
        return KnownLoops(None, (note,))
    modes = [(mode.inertia_kg_m2, mode.antiresonance_hz, mode.damping) for mode in own.modes]
    motor = TwoInertia(reduction_ratio=bench.axis[axis].reduction_ratio, **own.values.model_dump())
    whole = Structure.of_modes(motor, modes)
    label = "where its plant was identified, other motors held"
    cases = tuple(ArmCase(label + _factor_words(factor), whole.stiffened(factor), 0) for factor in factors)
    note = (
        f"axis {axis}: {lacking}; margins on the arm hold in the posture in which the modes of the model file "
        "were identified, with other motors held; elsewhere on the line they are unknown"
    )
    return KnownLoops(ArmLoops(law, cases), (note,))


def _lacking_masses(arm: ArmTable) -> str | None:
    """Reason why an arm's mass matrix is not known, or None."""
    if all(link.body is None for link in arm.link) and arm.payload is None:
        return "the links of the bench's arm have no bodies"
    try:
        check_masses(arm)
    except ValueError as error:
        return str(error)
    return None


@dataclass(frozen=True)
class _Masses:
    """Masses of an arm with its gears and motors.

    Attributes:
        joints: Motor and gear of each axis; None if the joint counts as rigid.
        known: Masses that were identified; None for the bodies of the arm's links.
    """

    arm: ArmTable
    joints: Mapping[int, TwoInertia | None]
    known: IdentifiedArm | None = None

    @classmethod
    def identified(cls, bench: Bench, known: IdentifiedArm, axes: Mapping[int, IdentifiedAxis]) -> "_Masses":
        """Take masses and gears from an identified arm."""
        assert bench.arm is not None  # noqa: S101 - or there were no masses of it
        joints: dict[int, TwoInertia | None] = dict.fromkeys(bench.arm.axes)
        for number, stiffness in zip(known.axes, known.stiffness_nm_rad, strict=True):
            joint = _joint(bench.axis[number], axes.get(number))
            joints[number] = None if joint is None else replace(joint, gear_stiffness_nm_rad=stiffness)
        return cls(bench.arm, joints, known)

    @property
    def elastic(self) -> dict[int, TwoInertia]:
        """Motor and gear of the axes that have them."""
        return {number: joint for number, joint in self.joints.items() if joint is not None}

    def is_known_at(self, joints_rad: Real) -> bool:
        """True if the mass matrix is positive definite in a posture.

        Identified masses may fail this far from the postures in which they were identified.
        """
        return bool(np.all(np.linalg.eigvalsh(self.matrix(joints_rad)) > 0.0))

    def matrix(self, joints_rad: Real) -> Real:
        """Mass matrix of the elastic axes in a posture."""
        rows = [self.arm.axes.index(number) for number in self.elastic]
        if self.known is None:
            return mass_matrix(self.arm, joints_rad)[np.ix_(rows, rows)]
        others = [row for row, number in enumerate(self.arm.axes) if number not in self.known.axes]
        joints = np.array(joints_rad)
        joints[others] = np.radians(self.known.joints_deg)[others]
        whole = regressor(Kinematics.of(self.arm), joints) @ np.array(self.known.masses)
        return np.asarray(whole[np.ix_(rows, rows)])


def _by_masses(masses: _Masses, bench: Bench, axis: int, law: Loop, factors: Sequence[float]) -> KnownLoops:
    """Build the loop on an arm with known masses."""
    elastic, numbers = masses.elastic, list(masses.elastic)
    postures, notes = _postures(bench, masses.arm, axis)
    if masses.known is not None:
        known = f"{masses.known.postures} postures, dips to {100.0 * masses.known.dip_error:.1f} %"
        notes.append(f"axis {axis}: the masses come from {known}")
    rigid = [number for number in masses.arm.axes if number not in elastic]
    if rigid:
        notes.append(
            f"axis {axis}: {_are(rigid)} taken as rigid, because no model is given; the arm's real "
            f"resonances are lower than computed"
        )
    laws = _laws(bench, [number for number in numbers if number != axis], elastic, law)
    if len(laws) < len(numbers) - 1:
        unknown = [number for number in numbers if number != axis and number not in laws]
        notes.append(f"axis {axis}: {_are(unknown)} without known gains; margins with their loops closed are not computed")
    cases: list[ArmCase] = []
    filtered: list[ArmCase] = []
    for posture in postures:
        whole = Structure.of_arm(masses.matrix(posture.joints_rad), list(elastic.values()))
        is_end = posture in (postures[0], postures[-1])
        for factor in factors if is_end else factors[:1]:
            cases += _cases(posture.label, whole.stiffened(factor), numbers, axis, laws, _factor_words(factor))
        filtered += _filtered(posture.label, whole, numbers, axis, laws)
    return KnownLoops(ArmLoops(law, tuple(cases), tuple(filtered)), tuple(notes))


def _joint(table: AxisTable, known: IdentifiedAxis | None) -> TwoInertia | None:
    """Motor and gear of a joint."""
    plant = table.plant()
    if plant is None:
        return None
    if known is not None and known.plant is not None and known.plant.modes:
        stiffness, damping = gear_of(known.plant)
    elif table.gear_stiffness_nm_rad is not None:
        stiffness = table.gear_stiffness_nm_rad
        damping = plant.gear_damping_nm_s_rad * stiffness / plant.gear_stiffness_nm_rad
    else:
        return plant
    return replace(plant, gear_stiffness_nm_rad=stiffness, gear_damping_nm_s_rad=damping)


def gear_of(plant: IdentifiedPlant) -> tuple[float, float]:
    """Stiffness in N·m/rad and damping in N·m·s/rad of the gear.

    Σ J_i ω_i² and Σ 2 ζ_i ω_i J_i over the modes
    """
    if not plant.modes:
        return plant.values.gear_stiffness_nm_rad, plant.values.gear_damping_nm_s_rad
    damping = sum(2.0 * mode.damping * mode.inertia_kg_m2 * 2.0 * math.pi * mode.antiresonance_hz for mode in plant.modes)
    return stiffness_of(plant.modes), damping


def _postures(bench: Bench, arm: ArmTable, axis: int) -> tuple[list[_Posture], list[str]]:
    """Postures in which margins are computed, and notes on them.

    They are places of the line motion, or home if there is no line motion. The notes say in which postures the margins hold.
    """
    if bench.line_motion is not None:
        try:
            fractions, joints_rad = arm_line(arm, bench.line_motion).line.joints_along
        except LineError as error:
            why = f"the line motion cannot be followed ({error})"
        else:
            found = [_Posture(_along_words(at), joints_rad[int(np.argmin(np.abs(fractions - at)))]) for at in LINE_FRACTIONS]
            return found, [
                f"axis {axis}: margins on the arm hold at {len(found)} places of the line motion, at every motor speed there; "
                f"in other postures they are unknown"
            ]
    else:
        why = "there is no line_motion"
    note = f"axis {axis}: {why}; margins on the arm hold at home, and are unknown elsewhere"
    return [_Posture("at home", arm.home_rad())], [note]


def _laws(bench: Bench, numbers: Sequence[int], joints: dict[int, TwoInertia], law: Loop) -> dict[int, Loop]:
    """Loops of the other axes whose gains are known."""
    made = {}
    for number in numbers:
        table = bench.axis[number]
        if isinstance(table.control, Control):
            notches = tuple(one.notch() for one in table.notch)
            made[number] = Loop(joints[number], table.control.cascade(), notches, law.period_s, law.delay_samples)
    return made


def _cases(label: str, whole: Structure, numbers: Sequence[int], axis: int, laws: dict[int, Loop], more: str) -> list[ArmCase]:
    """Cases of one posture: other motors held, other loops closed."""
    own = numbers.index(axis)
    found = [ArmCase(f"{label}, other motors held{more}", whole, own)]
    if laws and len(laws) == len(numbers) - 1:
        closed = tuple(Other(numbers.index(number), loop) for number, loop in laws.items())
        found.append(ArmCase(f"{label}, other loops closed{more}", whole, own, closed))
    return found


def _filtered(label: str, whole: Structure, numbers: Sequence[int], axis: int, laws: dict[int, Loop]) -> list[ArmCase]:
    """Cases in which the filters of one other axis act."""
    found: list[ArmCase] = []
    if len(laws) < len(numbers) - 1:
        return found
    for number, loop in laws.items():
        speeds = [np.linspace(one.start_rps, one.end_rps, POLE_SPEEDS) for one in loop.notches if one.mode != NOTCH_OFF]
        for speed in np.unique(np.concatenate([np.zeros(0), *speeds])).tolist():
            closed = tuple(Other(numbers.index(each), laws[each], speed if each == number else 0.0) for each in laws)
            words = f"{label}, other loops closed, axis {number} at {speed:.2f} rev/s"
            found.append(ArmCase(words, whole, numbers.index(axis), closed))
    return found


def _along_words(fraction: float) -> str:
    if fraction in (0.0, 1.0):
        return f"at the {'end' if fraction else 'start'} of the line"
    return f"at {100.0 * fraction:g} % of the line"


def _are(numbers: Sequence[int]) -> str:
    return f"{axes_in_words(numbers)} {'is' if len(numbers) == 1 else 'are'}"


def _factor_words(factor: float) -> str:
    if factor == 1.0:
        return ""
    return f", frequencies {100.0 * (factor - 1.0):+.2g} %".replace("-", "−")
