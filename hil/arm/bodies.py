"""Rigid bodies of an arm: mass, centre and inertia, in any frame."""

from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from drive_profiles.files.toml import Table
from hil.control.arrays import Real

LARGEST = 1e4
"""Bound of every number of an arm, in m, °, kg, kg·m² and m/s²: larger numbers are not an arm's, and could overflow."""
Component = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
NotBelow = Annotated[float, Field(ge=0.0, le=LARGEST)]
Vector = tuple[Component, Component, Component]

ROUNDED_MASS = 1e-5
"""By how much of the largest moment of inertia the others may miss the triangle inequality: files round their numbers."""

NOWHERE: Vector = (0.0, 0.0, 0.0)


class Inertia(Table):
    """Moments and products of inertia about the centre of mass.

    The products are elements of the tensor, with its sign, as in URDF.
    """

    xx: NotBelow = 0.0
    yy: NotBelow = 0.0
    zz: NotBelow = 0.0
    xy: Component = 0.0
    xz: Component = 0.0
    yz: Component = 0.0

    def tensor(self) -> Real:
        """The tensor; shape (3, 3)."""
        return np.array([[self.xx, self.xy, self.xz], [self.xy, self.yy, self.yz], [self.xz, self.yz, self.zz]])

    @model_validator(mode="after")
    def _is_of_a_body(self) -> Self:
        low, middle, high = np.linalg.eigvalsh(self.tensor()).tolist()
        if low < -ROUNDED_MASS * high:
            raise ValueError(f"the tensor has a principal moment of {low:g} kg·m²; it must be at least 0")
        if low + middle < high * (1.0 - ROUNDED_MASS):
            raise ValueError(
                f"principal moments {low:g}, {middle:g} and {high:g} kg·m²; any two must add up to the third or more "
                "(triangle inequality)"
            )
        return self


class Body(Table):
    """A rigid body in the frame of the link that carries it.

    Attributes:
        mass_kg: Mass.
        centre_m: Centre of mass.
        inertia_kg_m2: Inertia about the centre of mass, along the axes of the link's frame.
    """

    mass_kg: NotBelow
    centre_m: Vector = NOWHERE
    inertia_kg_m2: Inertia = Inertia.model_construct()

    @model_validator(mode="after")
    def _nothing_turns_without_a_mass(self) -> Self:
        if self.mass_kg == 0.0 and self.inertia_kg_m2 != Inertia.model_construct():
            raise ValueError("mass_kg is 0, but inertia_kg_m2 is not; set both or neither")
        return self


def moved(body: Body, turn: Real, origin_m: Real) -> Body:
    """Return a body in the frame that carries its own frame.

    `turn`, shape (3, 3), and `origin_m`, shape (3,), are rotation and origin of its own frame in the other.
    """
    centre = origin_m + turn @ np.array(body.centre_m)
    tensor = turn @ body.inertia_kg_m2.tensor() @ turn.T
    # validated once, as it was written: rounding here can make a lamina miss the triangle inequality
    return body.model_copy(update={"centre_m": tuple(centre.tolist()), "inertia_kg_m2": _tabled(tensor)})


def merged(bodies: Sequence[Body]) -> Body:
    """Several bodies of one frame as one: the parallel axis theorem."""
    mass = sum(body.mass_kg for body in bodies)
    if mass == 0.0:
        return Body(mass_kg=0.0)
    centre = np.asarray(sum(body.mass_kg * np.array(body.centre_m) for body in bodies)) / mass
    tensor = np.zeros((3, 3))
    for body in bodies:
        away = np.array(body.centre_m) - centre
        tensor += body.inertia_kg_m2.tensor() + body.mass_kg * (float(away @ away) * np.eye(3) - np.outer(away, away))
    return Body(mass_kg=mass).model_copy(update={"centre_m": tuple(centre.tolist()), "inertia_kg_m2": _tabled(tensor)})


def _tabled(tensor: Real) -> Inertia:
    s = (0.5 * (tensor + tensor.T)).tolist()
    return Inertia.model_construct(xx=s[0][0], yy=s[1][1], zz=s[2][2], xy=s[0][1], xz=s[0][2], yz=s[1][2])
