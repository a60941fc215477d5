"""Tables of an arm: what is refused, and what a link with its load weighs."""

import numpy as np
import pytest

from drive_profiles.errors import FileError
from drive_profiles.files.toml import loads
from hil.arm.bodies import Body, Inertia, merged, moved
from hil.arm.tables import ArmTable
from tests.hil.arm.arms import any_arm, body

LINK = "[[link]]\naxis = 1\ndirection = [0.0, 0.0, 1.0]\n"


def point_masses(mass_kg, points):
    """Centre and inertia of equal point masses, by their definition."""
    each = mass_kg / len(points)
    centre = np.mean(points, axis=0)
    away = points - centre
    return centre, sum(each * (a @ a * np.eye(3) - np.outer(a, a)) for a in away)


def test_bodies_put_together_are_what_their_points_of_mass_are():
    rng = np.random.default_rng(3)
    first, second = rng.uniform(-1.0, 1.0, (5, 3)), rng.uniform(-1.0, 1.0, (7, 3))
    parts = []
    for points, mass in ((first, 5.0), (second, 7.0)):
        centre, tensor = point_masses(mass, points)
        xx, yy, zz, xy, xz, yz = (float(tensor[at]) for at in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
        inertia = Inertia(xx=xx, yy=yy, zz=zz, xy=xy, xz=xz, yz=yz)
        parts.append(Body(mass_kg=mass, centre_m=tuple(centre.tolist()), inertia_kg_m2=inertia))
    whole = merged(parts)
    centre, tensor = point_masses(12.0, np.vstack([first, second]))
    np.testing.assert_allclose(whole.centre_m, centre, atol=1e-15)
    np.testing.assert_allclose(whole.inertia_kg_m2.tensor(), tensor, atol=1e-14)


def test_a_body_seen_from_another_frame_has_the_same_principal_moments():
    one = body(np.random.default_rng(4), 3.0)
    turn = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))[0]
    other = moved(one, turn, np.array([1.0, 2.0, 3.0]))
    moments = [np.linalg.eigvalsh(each.inertia_kg_m2.tensor()) for each in (one, other)]
    np.testing.assert_allclose(*moments, rtol=1e-12)
    np.testing.assert_allclose(turn.T @ (np.array(other.centre_m) - (1.0, 2.0, 3.0)), one.centre_m, atol=1e-15)


def test_the_payload_belongs_to_the_last_link():
    arm = any_arm(1, 4)
    without = arm.model_copy(update={"payload": None})
    assert arm.bodies()[:-1] == without.bodies()[:-1]
    assert arm.bodies()[-1] == merged((without.bodies()[-1], arm.payload))
    assert arm.bodies()[-1].mass_kg == pytest.approx(without.bodies()[-1].mass_kg + 5.0)


def test_a_link_without_a_body_weighs_nothing():
    assert any_arm(1, 5).bodies()[2].mass_kg == 0.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "either"),
        (f'urdf = "a.urdf"\n{LINK}', "either"),
        (f'tip_link = "tool0"\n{LINK}', "tip_link"),
        (LINK + LINK, "axis 1 moves two links"),
        (f"home_deg = [1.0, 2.0]\n{LINK}", "2 angles for 1 links"),
        (f"home_deg = [100.0]\n{LINK}range_deg = [-90.0, 90.0]\n", "is at 100° at home"),
        (f"{LINK}range_deg = [90.0, -90.0]\n", "the first must be the lower"),
        ("[[link]]\naxis = 1\ndirection = [0.0, 0.0, 0.0]\n", "has length 0"),
        (f"{LINK}speed_limit_deg_s = 0.0\n", "more than 0"),
        (f"{LINK}body = {{ mass_kg = -1.0 }}\n", "at least 0"),
        (f"{LINK}body = {{ mass_kg = 1.0, inertia_kg_m2 = {{ xx = 1.0, yy = 1.0, zz = 2.1 }} }}\n", "triangle"),
        (f"{LINK}body = {{ mass_kg = 1.0, inertia_kg_m2 = {{ xx = 1.0, yy = 1.0, zz = 1.0, xy = 1.5 }} }}\n", "at least 0"),
        (f"{LINK}body = {{ mass_kg = 0.0, inertia_kg_m2 = {{ xx = 1.0, yy = 1.0, zz = 1.0 }} }}\n", "mass_kg is 0"),
    ],
)
def test_what_is_no_arm_is_refused_with_the_reason(text, said):
    with pytest.raises(FileError, match=said):
        loads(text, ArmTable)


def test_a_thin_plate_and_a_thin_rod_are_bodies_even_with_rounded_numbers():
    for moments in ((0.333333, 0.666667, 0.999999), (0.0, 0.1, 0.1), (0.333, 0.667, 1.000001)):
        xx, yy, zz = moments
        assert Inertia(xx=xx, yy=yy, zz=zz).tensor()[2, 2] == zz


def test_links_and_axes_are_one_to_one():
    arm = any_arm(1, 3)
    arm.check_axes((1, 2, 3))
    with pytest.raises(ValueError, match="the link of axis 3 has no drive: the file has axes 1, 2"):
        arm.check_axes((1, 2))
    with pytest.raises(ValueError, match="axis 4 moves no link"):
        arm.check_axes((1, 2, 3, 4))
