"""Chain of revolute joints and links, from a URDF file.

Links that are fixed to another one are merged into it. A file that describes no such chain is refused, each time with the
element's name: loops, branches, joints that slide or mimic, negative masses, joints without a drive. Frames and units are those
of URDF: m, kg, rad, roll, pitch and yaw about fixed axes.

Source: the URDF XML specification of ROS, http://wiki.ros.org/urdf/XML.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np
from pydantic import ValidationError

from drive_profiles.errors import FileError, Problem
from drive_profiles.files.reading import read_file
from drive_profiles.files.toml import wrong_value
from drive_profiles.files.xml_tree import Element, parse
from hil.arm.bodies import LARGEST, Body, Inertia, Vector, merged, moved
from hil.arm.rotation import roll_pitch_yaw, rotation
from hil.arm.tables import MOST_LINKS, ArmLink, ArmTable
from hil.control.arrays import Real

MAX_BYTES = 4 << 20
KIND = "a URDF file"
TURNING = ("revolute", "continuous")


@dataclass(frozen=True)
class UrdfChain:
    """The arm of a URDF file.

    Attributes:
        tip: The frame of the tip in that of the last link: rotation, shape (3, 3), and origin, shape (3,).
        reductions: Reduction ratio of each axis for which the file has a transmission.
    """

    links: tuple[ArmLink, ...]
    tip: tuple[Real, Real]
    reductions: Mapping[int, float]


@dataclass
class _Joint:
    name: str
    kind: str
    parent: str
    child: str
    element: Element
    origin: tuple[Real, Real]


@dataclass
class _File:
    path: Path
    links: dict[str, Element] = field(default_factory=dict)
    joints: list[_Joint] = field(default_factory=list)

    def refuse(self, element: Element, what: str, message: str, expected: str) -> NoReturn:
        """Raise a `FileError` that names an element."""
        raise FileError(self.path, (Problem(element.line, what, message, expected),))


def with_links(arm: ArmTable, folder: Path, joints: Mapping[str, int]) -> tuple[ArmTable, Mapping[int, float]]:
    """Return an arm with links and reduction ratios of its URDF file.

    An arm with links of its own is returned unchanged. The path of the URDF file counts from `folder`. `joints` has the number
    of the axis that moves each turning joint, by its name.

    Raises:
        FileError: The file describes no arm of these axes; with the element.
        ValueError: Another value of the table contradicts the file.
    """
    if arm.urdf is None:
        return arm, {}
    chain = read_urdf(folder / arm.urdf, joints, arm.tip_link)
    turn, origin = chain.tip
    tip_m = origin + turn @ np.array(arm.tip_m)
    tool = turn @ rotation(*map(math.radians, arm.tip_rpy_deg))
    try:
        found = ArmTable(
            link=chain.links,
            tip_m=_vector(tip_m),
            tip_rpy_deg=_vector(np.degrees(roll_pitch_yaw(tool))),
            home_deg=arm.home_deg,
            gravity_m_s2=arm.gravity_m_s2,
        )
    except ValidationError as error:
        raise ValueError("; ".join(wrong_value(each)[0] for each in error.errors(include_url=False))) from None
    payload = None if arm.payload is None else moved(arm.payload, turn, origin)
    return found.model_copy(update={"payload": payload}), chain.reductions


def turning_joints(path: Path) -> tuple[str, ...]:
    """Return the names of a URDF file's joints that need a drive.

    From the base on; the file has at most 4 MiB.

    Raises:
        FileError: The file describes no arm; with line and name of the element.
    """
    return tuple(joint.name for joint, _ in _chain(_parsed(path)[0])[1:] if joint is not None)


def read_urdf(path: Path, joints: Mapping[str, int], tip_link: str | None = None) -> UrdfChain:
    """The arm of a URDF file of at most 4 MiB.

    `joints` has the number of the axis that moves each turning joint, by its name; `tip_link` is by default the only one at the
    end of the arm.

    Raises:
        FileError: The file describes no arm of these axes; with line and name of the element.
    """
    file, root = _parsed(path)
    groups = _chain(file)
    return _arm(file, groups, _reductions(file, root), joints, tip_link)


def _parsed(path: Path) -> tuple[_File, Element]:
    """Links and joints of a file, and its outermost element."""
    root = parse(read_file(path, KIND, max_bytes=MAX_BYTES), path, KIND)
    file = _File(path)
    if root.tag != "robot":
        file.refuse(root, f"<{root.tag}>", "is not a robot", "a URDF file, whose outermost element is <robot>")
    _read_links(file, root)
    _read_joints(file, root)
    return file, root


def _read_links(file: _File, root: Element) -> None:
    for element in root.children:
        if element.tag == "link":
            name = _name(file, element)
            if name in file.links:
                file.refuse(element, f"link {name!r}", f"is in line {file.links[name].line} already", "each name once")
            file.links[name] = element
    if not file.links:
        file.refuse(root, "<robot>", "has no link", "an arm")
    if all(each.child("inertial") is None for each in file.links.values()):
        first = next(iter(file.links))
        file.refuse(file.links[first], f"link {first!r}", "has no <inertial>, nor has any other link", "masses and inertias")


def _read_joints(file: _File, root: Element) -> None:
    names: dict[str, int] = {}
    for element in root.children:
        if element.tag != "joint":
            continue
        name = _name(file, element)
        what = f"joint {name!r}"
        if name in names:
            file.refuse(element, what, f"is in line {names[name]} already", "each name once")
        names[name] = element.line
        kind = element.attributes.get("type", "")
        if kind not in (*TURNING, "fixed"):
            file.refuse(element, what, f"has the type {kind!r}", "joints that turn, or are fixed: revolute, continuous or fixed")
        if element.child("mimic") is not None:
            file.refuse(element, what, "moves with another joint (<mimic>)", "joints with a drive of their own")
        ends = []
        for end in ("parent", "child"):
            found = element.child(end)
            link = "" if found is None else found.attributes.get("link", "")
            if link not in file.links:
                file.refuse(element, what, f"has the {end} {link!r}", "a link of the file")
            ends.append(link)
        file.joints.append(_Joint(name, kind, ends[0], ends[1], element, _origin(file, element, what)))


def _chain(file: _File) -> list[tuple[_Joint | None, list[tuple[str, Real, Real]]]]:
    """Return the base and each turning joint, with links fixed behind.

    Each link with its name, and rotation and origin of its frame.
    """
    above: dict[str, _Joint] = {}
    for joint in file.joints:
        if joint.child in above:
            first = above[joint.child].name
            file.refuse(
                joint.element,
                f"joint {joint.name!r}",
                f"closes a loop: joint {first!r} carries link {joint.child!r} too",
                "a chain",
            )
        above[joint.child] = joint
    roots = [name for name in file.links if name not in above]
    if not roots:
        joint = file.joints[0]
        file.refuse(joint.element, f"joint {joint.name!r}", "is part of a loop: no link is the base", "a chain")
    if len(roots) > 1:
        loose = roots[1]
        file.refuse(file.links[loose], f"link {loose!r}", f"has no parent joint, and neither has {roots[0]!r}", "one base")
    groups: list[tuple[_Joint | None, list[tuple[str, Real, Real]]]] = []
    joint_above: _Joint | None = None
    start, reached = roots[0], 0
    while True:
        fixed, onwards = _fixed_to(file, start)
        groups.append((joint_above, fixed))
        reached += len(fixed)
        if len(onwards) > 1:
            second = onwards[1][0]
            file.refuse(
                second.element, f"joint {second.name!r}", f"branches off beside {onwards[0][0].name!r}", "an arm without branches"
            )
        if not onwards:
            break
        joint, (turn, origin) = onwards[0]
        joint_above, start = _Joint(joint.name, joint.kind, joint.parent, joint.child, joint.element, (turn, origin)), joint.child
    if reached < len(file.links):
        seen = {name for _, fixed in groups for name, _, _ in fixed}
        joint = next(each for each in file.joints if each.child not in seen)
        file.refuse(joint.element, f"joint {joint.name!r}", "is part of a loop, away from the base", "a chain")
    if len(groups) == 1:
        file.refuse(file.links[roots[0]], f"link {roots[0]!r}", "carries no joint that turns", "an arm")
    if len(groups) - 1 > MOST_LINKS:
        file.refuse(file.links[roots[0]], f"link {roots[0]!r}", f"carries {len(groups) - 1} joints", f"{MOST_LINKS} at most")
    return groups


def _fixed_to(file: _File, start: str) -> tuple[list[tuple[str, Real, Real]], list[tuple[_Joint, tuple[Real, Real]]]]:
    """Return a link's fixed links, and the turning joints on them."""
    children: dict[str, list[_Joint]] = {}
    for joint in file.joints:
        children.setdefault(joint.parent, []).append(joint)
    fixed, onwards = [(start, np.eye(3), np.zeros(3))], []
    for name, turn, origin in fixed:  # which grows
        for joint in children.get(name, []):
            own_turn, own_origin = joint.origin
            frame = turn @ own_turn, origin + turn @ own_origin
            if joint.kind == "fixed":
                fixed.append((joint.child, *frame))
            else:
                onwards.append((joint, frame))
    return fixed, onwards


def _arm(
    file: _File,
    groups: list[tuple[_Joint | None, list[tuple[str, Real, Real]]]],
    reductions: Mapping[str, float],
    joints: Mapping[str, int],
    tip_link: str | None,
) -> UrdfChain:
    links = []
    for joint, fixed in groups[1:]:
        assert joint is not None  # noqa: S101 - only the base has none
        what = f"joint {joint.name!r}"
        if joint.name not in joints:
            given = ", ".join(map(repr, joints)) or "none"
            file.refuse(
                joint.element,
                what,
                "has no drive",
                f'an axis of the robot file with joint = "{joint.name}"; those named are {given}',
            )
        bodies = [moved(each, turn, origin) for name, turn, origin in fixed if (each := _body(file, name)) is not None]
        turn, origin = joint.origin
        if np.max(np.abs(origin)) > LARGEST:
            file.refuse(
                joint.element, what, f"is {np.max(np.abs(origin)):g} m from the joint before it", f"{LARGEST:g} m at most"
            )
        limit = None if joint.kind == "continuous" else _limits(file, joint, what)
        links.append(
            ArmLink(
                axis=joints[joint.name],
                name=joint.name,
                origin_m=_vector(origin),
                rpy_deg=_vector(np.degrees(roll_pitch_yaw(turn))),
                direction=_direction(file, joint.element, what),
                range_deg=limit,
                speed_limit_deg_s=_speed(file, joint.element, what),
            ).model_copy(update={"body": merged(bodies) if bodies else None})
        )
    axes = {str(link.name): link.axis for link in links}
    loose = [name for name in joints if name not in axes]
    if loose:
        raise FileError(
            file.path, (Problem(0, f"joint {loose[0]!r}", "is not a joint of the arm", f"one of {', '.join(map(repr, axes))}"),)
        )
    return UrdfChain(
        tuple(links), _tip(file, groups[-1][1], tip_link), {axes[name]: reductions[name] for name in axes if name in reductions}
    )


def _tip(file: _File, fixed: list[tuple[str, Real, Real]], tip_link: str | None) -> tuple[Real, Real]:
    """The frame of the tip among the links at the arm's end."""
    frames = {name: (turn, origin) for name, turn, origin in fixed}
    if tip_link is not None:
        if tip_link not in frames:
            raise FileError(
                file.path,
                (Problem(0, f"link {tip_link!r}", "is not at the arm's end", f"one of {', '.join(map(repr, frames))}"),),
            )
        return frames[tip_link]
    carries = {joint.parent for joint in file.joints}
    ends = [name for name in frames if name not in carries]
    if len(ends) > 1:
        listed = " and ".join(map(repr, ends[:2]))
        file.refuse(file.links[ends[1]], f"link {ends[1]!r}", f"is one of several ends, {listed}", "tip_link in the table [arm]")
    return frames[ends[0]]


def _body(file: _File, link: str) -> Body | None:
    """Return the mass of a link in its frame, or None."""
    element = file.links[link].child("inertial")
    if element is None:
        return None
    what = f"link {link!r}"
    mass = element.child("mass")
    tensor = element.child("inertia")
    if mass is None or tensor is None:
        file.refuse(element, what, "lacks <mass> or <inertia> in its <inertial>", "both")
    turn, origin = _origin(file, element, what)
    moments = {name: _number(file, tensor, f"i{name}", what) for name in ("xx", "yy", "zz", "xy", "xz", "yz")}
    try:
        body = Body(mass_kg=_number(file, mass, "value", what), inertia_kg_m2=Inertia(**moments))
    except ValidationError as error:
        said = error.errors(include_url=False)[0]
        key = ".".join(map(str, said["loc"]))
        found, expected = wrong_value(dict(said))
        file.refuse(element, what, f"{key}: {found}" if key else found, expected or "a body")
    return moved(body, turn, origin)


def _reductions(file: _File, root: Element) -> dict[str, float]:
    """Reduction ratio of each joint with a transmission."""
    found: dict[str, float] = {}
    for element in root.children:
        joint = element.child("joint") if element.tag == "transmission" else None
        name = "" if joint is None else joint.attributes.get("name", "")
        for each in element.walk() if name else ():
            if each.tag == "mechanicalReduction":
                ratio = _float(each.text)
                if ratio is None or ratio == 0.0:
                    file.refuse(each, f"joint {name!r}", f"has the mechanicalReduction {each.text.strip()!r}", "a number")
                found[name] = abs(ratio)
    return found


def _limits(file: _File, joint: _Joint, what: str) -> tuple[float, float]:
    limit = joint.element.child("limit")
    if limit is None:
        file.refuse(joint.element, what, "is revolute but has no <limit>", "lower and upper, or the type continuous")
    low, high = (_number(file, limit, side, what, 0.0) for side in ("lower", "upper"))
    if not low < high:
        file.refuse(limit, what, f"goes from {low:g} to {high:g} rad", "lower below upper")
    return math.degrees(low), math.degrees(high)


def _speed(file: _File, joint: Element, what: str) -> float | None:
    limit = joint.child("limit")
    if limit is None or "velocity" not in limit.attributes:
        return None
    speed = _number(file, limit, "velocity", what)
    if speed < 0.0:
        file.refuse(limit, what, f"has the velocity {speed:g} rad/s", "one above 0")
    return math.degrees(speed) or None  # 0 stands in many files for one that nobody knows


def _direction(file: _File, joint: Element, what: str) -> Vector:
    axis = joint.child("axis")
    if axis is None:
        return 1.0, 0.0, 0.0
    direction = _numbers(file, axis, "xyz", what)
    if math.hypot(*direction) < 1e-6:
        file.refuse(axis, what, "has an axis of length 0", "a direction")
    return direction


def _origin(file: _File, element: Element, what: str) -> tuple[Real, Real]:
    origin = element.child("origin")
    if origin is None:
        return np.eye(3), np.zeros(3)
    nothing = (0.0, 0.0, 0.0)
    return rotation(*_numbers(file, origin, "rpy", what, nothing)), np.array(_numbers(file, origin, "xyz", what, nothing))


def _name(file: _File, element: Element) -> str:
    name = element.attributes.get("name", "")
    if not name:
        file.refuse(element, f"<{element.tag}>", "has no name", "a name")
    return name


def _numbers(file: _File, element: Element, key: str, what: str, default: Vector | None = None) -> Vector:
    """Three numbers of an attribute."""
    text = element.attributes.get(key)
    if text is None and default is not None:
        return default
    found = [_float(word) for word in (text or "").split()]
    if len(found) != 3 or None in found:
        file.refuse(element, what, f"<{element.tag}> has {key}={text!r}", f"three numbers within ±{LARGEST:g}")
    x, y, z = (value for value in found if value is not None)
    return x, y, z


def _number(file: _File, element: Element, key: str, what: str, default: float | None = None) -> float:
    text = element.attributes.get(key)
    if text is None and default is not None:
        return default
    value = _float(text or "")
    if value is None:
        file.refuse(element, what, f"<{element.tag}> has {key}={text!r}", f"a number within ±{LARGEST:g}")
    return value


def _float(text: str) -> float | None:
    """A number that an arm may have; None for any other text."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) <= LARGEST else None


def _vector(values: Real) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
