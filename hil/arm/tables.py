"""Tables of an arm: links from the base on, masses, payload, tip.

The frame of a link is that of the link before it, moved by `origin_m`, turned by `rpy_deg`, then turned by the joint's angle
about `direction`. A joint's angle is `home_deg` at zero of its motor, and grows with the motor's angle.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from drive_profiles.files.toml import Table
from hil.arm.bodies import NOWHERE, Body, Component, Vector, merged
from hil.arm.rotation import rotation
from hil.control.arrays import Real
from hil.robot_tables import MOST_AXES, AxisNumber, Positive

MOST_LINKS = MOST_AXES
"""As many as there can be drives."""


class ArmLink(Table):
    """A link, and the joint by which an axis turns it.

    Attributes:
        axis: Number of the axis that moves it.
        name: A name for messages; left out, the axis' number serves.
        origin_m: Joint in the frame of the link before it; of the first link, in the frame of the base.
        rpy_deg: The same frame's roll, pitch and yaw: turns about fixed x, y and z, in this order.
        direction: Axis about which the joint turns, right-handed; any length.
        body: Mass of all that is fixed to the link; left out, it weighs nothing.
        range_deg: Least and greatest angle of the joint; left out, it has no end.
        speed_limit_deg_s: Greatest speed of the joint.
    """

    axis: AxisNumber
    name: str | None = None
    origin_m: Vector = NOWHERE
    rpy_deg: Vector = NOWHERE
    direction: Vector
    body: Body | None = None
    range_deg: tuple[float, float] | None = None
    speed_limit_deg_s: Positive | None = None

    @model_validator(mode="after")
    def _turns(self) -> Self:
        if math.hypot(*self.direction) < 1e-6:
            raise ValueError(f"direction {list(self.direction)} of {self.label} has length 0")
        if self.range_deg is not None and not self.range_deg[0] < self.range_deg[1]:
            low, high = self.range_deg
            raise ValueError(f"range_deg of {self.label} goes from {low:g} to {high:g}: the first must be the lower")
        return self

    @property
    def label(self) -> str:
        """The link for messages."""
        return f"the link of axis {self.axis}" if self.name is None else f"link {self.name!r} (axis {self.axis})"

    def rotation(self) -> Real:
        """Return the rotation from the preceding frame at 0; shape (3, 3)."""
        return rotation(*map(math.radians, self.rpy_deg))

    def unit_direction(self) -> Real:
        """The joint's axis, of length 1; shape (3,)."""
        direction = np.array(self.direction)
        return np.asarray(direction / np.linalg.norm(direction))


class ArmTable(Table):
    """Links from the base on, in a row, or their URDF file.

    Attributes:
        link: The links; empty as long as the URDF file has not been read.
        urdf: Path of a URDF file, instead of links; `joint` of each axis names its joint.
        tip_link: Name of the link of the URDF file that is the tip's frame; left out, the only one at the arm's end.
        tip_m: Tip in the frame of the last link; of a URDF file, in the frame of `tip_link`.
        tip_rpy_deg: Roll, pitch and yaw of the tool's frame in the same frame.
        payload: Load in the frame of the last link; of a URDF file, in the frame of `tip_link`.
        home_deg: Joint angles at home, with all motors at zero, from the base on; left out, 0.
        gravity_m_s2: Acceleration of free fall in the frame of the base.
    """

    link: Annotated[tuple[ArmLink, ...], Field(max_length=MOST_LINKS)] = ()
    urdf: str | None = None
    tip_link: str | None = None
    tip_m: Vector = NOWHERE
    tip_rpy_deg: Vector = NOWHERE
    payload: Body | None = None
    home_deg: Annotated[tuple[Component, ...], Field(max_length=MOST_LINKS)] = ()
    gravity_m_s2: Vector = (0.0, 0.0, -9.81)

    @model_validator(mode="after")
    def _is_one_arm(self) -> Self:
        if (self.urdf is None) == (not self.link):
            raise ValueError("an arm has either [[arm.link]] tables or urdf, the path of a file")
        if self.urdf is not None:
            return self
        if self.tip_link is not None:
            raise ValueError("tip_link needs a URDF file; an arm with its own links takes tip_m")
        axes = self.axes
        twice = sorted({axis for axis in axes if axes.count(axis) > 1})
        if twice:
            raise ValueError(f"axis {twice[0]} moves two links of the arm; each needs an axis of its own")
        if self.home_deg and len(self.home_deg) != len(self.link):
            raise ValueError(f"home_deg has {len(self.home_deg)} angles for {len(self.link)} links: one each, from the base on")
        for link, angle in zip(self.link, self.home_deg or (0.0,) * len(self.link), strict=True):
            low, high = link.range_deg or (-math.inf, math.inf)
            if not low <= angle <= high:
                raise ValueError(f"{link.label} is at {angle:g}° at home, outside of its range_deg, {low:g} to {high:g}")
        return self

    @property
    def axes(self) -> tuple[int, ...]:
        """Numbers of the axes, from the base on."""
        return tuple(link.axis for link in self.link)

    def home_rad(self) -> Real:
        """Joint angles at home; shape (n_links,)."""
        return np.radians(np.array(self.home_deg or (0.0,) * len(self.link), dtype=np.float64))

    def check_axes(self, present: Sequence[int]) -> None:
        """Refuse an arm whose links and axes are not one to one.

        Raises:
            ValueError: A link has no drive, or a drive no link; with their numbers.
        """
        without = [link.label for link in self.link if link.axis not in present]
        if without:
            raise ValueError(f"{without[0]} has no drive: the file has axes {', '.join(map(str, sorted(present)))}")
        loose = sorted(set(present) - set(self.axes))
        if loose:
            raise ValueError(f"axis {loose[0]} moves no link of the arm; with an [arm] table, every axis must move one")

    def bodies(self) -> tuple[Body, ...]:
        """What each link weighs, the payload with the last."""
        found = [link.body or Body(mass_kg=0.0) for link in self.link]
        if self.payload is not None:
            found[-1] = merged((found[-1], self.payload))
        return tuple(found)
