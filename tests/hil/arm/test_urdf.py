"""URDF files: the links are those that pinocchio reads, and what describes no arm is refused with the element's name."""

from pathlib import Path

import numpy as np
import pinocchio
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drive_profiles.errors import FileError
from drive_profiles.files.toml import loads
from hil.arm.rotation import rotation
from hil.arm.tables import ArmTable
from hil.arm.urdf import MAX_BYTES, read_urdf, with_links
from tests.hil.arm.arms import LIMIT, SIX_JOINTS, body, joint_xml, link_xml, six_axis_urdf

HEAVY = body(np.random.default_rng(1), 2.0)


def written(folder, text):
    path = folder / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("seed", range(3))
def test_frames_and_masses_are_those_of_pinocchio(tmp_path, seed):
    text = six_axis_urdf(seed)
    chain = read_urdf(written(tmp_path, text), SIX_JOINTS)
    model = pinocchio.buildModelFromXML(text)
    assert [link.axis for link in chain.links] == [1, 2, 3, 4, 5, 6]
    for i, link in enumerate(chain.links):
        frame, inertia = model.jointPlacements[i + 1], model.inertias[i + 1]
        assert link.name == model.names[i + 1]
        np.testing.assert_allclose(link.origin_m, frame.translation, atol=1e-14)
        np.testing.assert_allclose(link.rotation(), frame.rotation, atol=1e-14)
        assert link.body.mass_kg == pytest.approx(inertia.mass, rel=1e-14)
        np.testing.assert_allclose(link.body.centre_m, inertia.lever, atol=1e-14)
        np.testing.assert_allclose(link.body.inertia_kg_m2.tensor(), inertia.inertia, atol=1e-14)
    tool = model.frames[model.getFrameId("tool0")]
    np.testing.assert_allclose(chain.tip[0], tool.placement.rotation, atol=1e-14)
    np.testing.assert_allclose(chain.tip[1], tool.placement.translation, atol=1e-14)


def test_limits_speeds_and_reductions_are_read(tmp_path):
    chain = read_urdf(written(tmp_path, six_axis_urdf()), SIX_JOINTS)
    np.testing.assert_allclose(chain.links[0].range_deg, np.degrees([-3.0, 3.0]))
    assert chain.links[0].speed_limit_deg_s == pytest.approx(np.degrees(2.5))
    assert chain.links[5].range_deg is None
    assert chain.reductions == {2: 120.0}


def test_tip_and_payload_of_the_table_count_from_the_frame_of_the_tool(tmp_path):
    written(tmp_path, six_axis_urdf())
    table = loads(
        'urdf = "arm.urdf"\ntip_m = [0.01, 0.02, 0.03]\ntip_rpy_deg = [10.0, 20.0, 30.0]\npayload = { mass_kg = 2.0 }\n', ArmTable
    )
    arm, reductions = with_links(table, tmp_path, SIX_JOINTS)
    turn, origin = read_urdf(tmp_path / "arm.urdf", SIX_JOINTS).tip
    np.testing.assert_allclose(arm.tip_m, origin + turn @ (0.01, 0.02, 0.03), atol=1e-15)
    tool = rotation(*np.radians(arm.tip_rpy_deg))
    np.testing.assert_allclose(tool, turn @ rotation(*np.radians((10.0, 20.0, 30.0))), atol=1e-12)
    np.testing.assert_allclose(arm.payload.centre_m, origin, atol=1e-15)
    assert arm.bodies()[-1].mass_kg == pytest.approx(arm.link[-1].body.mass_kg + 2.0)
    assert reductions == {2: 120.0}
    assert with_links(arm, Path("nowhere"), {}) == (arm, {})


def test_the_tip_may_be_any_frame_at_the_arms_end(tmp_path):
    chain = read_urdf(written(tmp_path, six_axis_urdf()), SIX_JOINTS, "flange")
    np.testing.assert_allclose(chain.tip[1], [0.0, 0.0, 0.05])
    with pytest.raises(FileError, match=r"link 'link_2': is not at the arm's end; expected one of 'link_6', 'flange'"):
        read_urdf(tmp_path / "arm.urdf", SIX_JOINTS, "link_2")


def robot(*lines):
    return "<robot>\n" + "\n".join(lines) + "\n</robot>"


BASE, ONE, TWO = '<link name="base"/>', link_xml("one", HEAVY), link_xml("two", HEAVY)
A = joint_xml("a", "revolute", "base", "one", inside=LIMIT)
B = joint_xml("b", "continuous", "one", "two")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (robot(BASE, '<link name="one"/>', A), "link 'base': has no <inertial>, nor has any other link"),
        (
            robot(BASE, ONE, TWO, A, B, joint_xml("c", "fixed", "base", "two")),
            "joint 'c': closes a loop: joint 'b' carries link 'two' too",
        ),
        (robot(ONE, TWO, B, joint_xml("c", "fixed", "two", "one")), "joint 'b': is part of a loop: no link is the base"),
        (
            robot(
                BASE,
                ONE,
                TWO,
                link_xml("three", HEAVY),
                A,
                joint_xml("c", "fixed", "two", "three"),
                joint_xml("d", "fixed", "three", "two"),
            ),
            "joint 'c': is part of a loop, away from the base",
        ),
        (robot(BASE, ONE, TWO, A), "link 'two': has no parent joint, and neither has 'base'"),
        (robot(BASE, ONE, joint_xml("a", "prismatic", "base", "one", inside=LIMIT)), "joint 'a': has the type 'prismatic'"),
        (robot(BASE, ONE, joint_xml("a", "floating", "base", "one")), "joint 'a': has the type 'floating'"),
        (robot(BASE, ONE, A.replace("</joint>", '<mimic joint="b"/></joint>')), "joint 'a': moves with another joint"),
        (robot(BASE, ONE, joint_xml("a", "revolute", "base", "one")), "joint 'a': is revolute but has no <limit>"),
        (robot(BASE, ONE, joint_xml("a", "revolute", "base", "elsewhere")), "joint 'a': has the child 'elsewhere'"),
        (robot(BASE, ONE, A.replace('lower="-3.0"', 'lower="4.0"')), "joint 'a': goes from 4 to 3 rad"),
        (robot(BASE, ONE, A.replace('xyz="0 0 1"', 'xyz="0 0 0"')), "joint 'a': has an axis of length 0"),
        (robot(BASE, ONE, A.replace('xyz="0 0 1"', 'xyz="0 0"')), "joint 'a': <axis> has xyz='0 0'; expected three numbers"),
        (robot(BASE, ONE, A.replace('xyz="0 0 1"', 'xyz="0 0 nan"')), "three numbers"),
        (robot(BASE, ONE, A.replace('velocity="2.5"', 'velocity="-1"')), "joint 'a': has the velocity -1 rad/s"),
        (robot(BASE, ONE, TWO, A, joint_xml("b", "continuous", "base", "two")), "joint 'b': branches off beside 'a'"),
        (robot(BASE, ONE.replace('value="2.0"', 'value="-2.0"'), A), r"link 'one': mass_kg: found -2\.0; expected at least 0"),
        (robot(BASE, ONE.replace('value="2.0"', 'value="much"'), A), "link 'one': <mass> has value='much'"),
        (robot(BASE, ONE.replace('izz="', 'izz="9'), A), r"link 'one': .*triangle inequality"),
        (robot(BASE, ONE.replace('value="2.0"', 'value="0"'), A), "link 'one': mass_kg is 0"),
        (
            robot(BASE, '<link name="one"><inertial><mass value="1"/></inertial></link>', A),
            "link 'one': lacks <mass> or <inertia>",
        ),
        (robot(BASE, ONE, TWO, A, B), "joint 'b': has no drive; expected an axis of the robot file with joint = \"b\""),
        (robot(BASE, ONE, joint_xml("c", "continuous", "base", "one")), "joint 'c': has no drive"),
        (robot(BASE, ONE, joint_xml("c", "fixed", "base", "one")), "link 'base': carries no joint that turns"),
        (robot(BASE, ONE, ONE, A), "link 'one': is in line 3 already"),
        (robot(BASE, ONE, A, A), "joint 'a': is in line"),
        (robot(BASE, '<link mass="1"/>'), "<link>: has no name"),
        (robot(), "<robot>: has no link"),
        ("<mujoco/>", "<mujoco>: is not a robot"),
        ('<!DOCTYPE robot [<!ENTITY a "aaaa">]><robot/>', "declares a document type or an entity; expected a plain"),
        ("<robot>", "is not XML"),
    ],
)
def test_what_describes_no_arm_is_refused_with_the_elements_name(tmp_path, text, said):
    with pytest.raises(FileError, match=said):
        read_urdf(written(tmp_path, text), {"a": 1})


def test_a_home_that_does_not_fit_the_file_is_refused_in_one_line(tmp_path):
    path = written(tmp_path, robot(BASE, ONE, A))
    with pytest.raises(ValueError, match="home_deg has 2 angles for 1 links: one each, from the base on") as caught:
        with_links(ArmTable(urdf=path.name, home_deg=(0.0, 1.0)), tmp_path, {"a": 1})
    assert "\n" not in str(caught.value)


def test_a_joint_that_the_file_does_not_have_is_named(tmp_path):
    with pytest.raises(FileError, match="joint 'z': is not a joint of the arm; expected one of 'a'"):
        read_urdf(written(tmp_path, robot(BASE, ONE, A)), {"a": 1, "z": 2})


def test_several_ends_need_to_be_told_which_is_the_tip(tmp_path):
    ends = [
        link_xml("left", None),
        joint_xml("l", "fixed", "one", "left"),
        link_xml("right", None),
        joint_xml("r", "fixed", "one", "right"),
    ]
    path = written(tmp_path, robot(BASE, ONE, A, *ends))
    with pytest.raises(FileError, match="link 'right': is one of several ends, 'left' and 'right'; expected tip_link"):
        read_urdf(path, {"a": 1})
    assert read_urdf(path, {"a": 1}, "left").tip[1].tolist() == [0.0, 0.0, 0.0]


def test_a_file_of_more_than_4_mib_is_not_read(tmp_path):
    with pytest.raises(FileError, match="larger than 4 MiB"):
        read_urdf(written(tmp_path, "<robot>" + " " * MAX_BYTES + "</robot>"), {})


WHOLE = six_axis_urdf()
PIECES = ("", "0", "-1", "1e999", "1e300", "nan", "joint_1", "link_3", "prismatic", "<link/>", "</link>", '"', "&amp;", "\x00")


@pytest.mark.ci
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, len(WHOLE)), st.integers(0, 40), st.sampled_from(PIECES))
def test_a_damaged_file_is_an_arm_or_refused_and_nothing_else(tmp_path, place, length, piece):
    try:
        chain = read_urdf(written(tmp_path, WHOLE[:place] + piece + WHOLE[place + length :]), SIX_JOINTS)
    except FileError:
        return
    assert len(chain.links) == 6
    assert all(np.all(np.isfinite(link.origin_m)) for link in chain.links)


def test_numbers_beyond_any_arm_are_refused(tmp_path):
    far = joint_xml("far", "fixed", "base", "middle", "9000 0 0")
    path = written(
        tmp_path,
        robot(
            BASE,
            '<link name="middle"/>',
            ONE,
            far,
            A.replace('parent link="base"', 'parent link="middle"').replace('xyz="0 0 0"', 'xyz="9000 0 0"'),
        ),
    )
    with pytest.raises(FileError, match="joint 'a': is 18000 m from the joint before it"):
        read_urdf(path, {"a": 1})
    with pytest.raises(FileError, match="<mass> has value='1e300'; expected a number within"):
        read_urdf(written(tmp_path, robot(BASE, ONE.replace('value="2.0"', 'value="1e300"'), A)), {"a": 1})
