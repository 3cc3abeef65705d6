"""The text of an arm: URDF, or the rows and screws of campaign.toml."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tests.blind.generator.arms.arm import Arm, Joint, Link, Row
from tests.blind.generator.arms.geometry import Design, frames_at_zero
from tests.blind.generator.arms.transforms import Array, roll_pitch_yaw, small_vector

FLOOR = '  <link name="floor"/>\n  <joint name="floor_bolts" type="fixed">\n    <parent link="floor"/>\n'
FLOOR += '    <child link="base_link"/>\n    <origin xyz="1.5 -0.7 0.2" rpy="0 0 0.3"/>\n  </joint>'


def urdf(arm: Arm, name: str, on_floor: bool = False) -> str:
    """URDF of an arm; ``on_floor`` adds a link below its base link."""
    lines = ['<?xml version="1.0"?>', f'<robot name="{name}">', *([FLOOR] if on_floor else [])]
    for link in arm.links:
        lines += _link_lines(link)
    for number, joint in enumerate(arm.joints):
        lines += _joint_lines(arm, number, joint)
    return "\n".join([*lines, "</robot>"]) + "\n"


def _link_lines(link: Link) -> list[str]:
    if link.mass == 0.0:
        return [f'  <link name="{link.name}"/>']
    inertia = f"{0.01 * link.mass:.6g}"
    return [
        f'  <link name="{link.name}">',
        "    <inertial>",
        f'      <origin xyz="{_three(link.com)}" rpy="0 0 0"/>',
        f'      <mass value="{link.mass:.12g}"/>',
        f'      <inertia ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/>',
        "    </inertial>",
        "  </link>",
    ]


def _joint_lines(arm: Arm, number: int, joint: Joint) -> list[str]:
    lines = [
        f'  <joint name="{joint.name}" type="{joint.kind}">',
        f'    <parent link="{arm.links[joint.parent].name}"/>',
        f'    <child link="{arm.links[joint.child].name}"/>',
        f'    <origin xyz="{_three(joint.origin[:3, 3])}" rpy="{_three(roll_pitch_yaw(joint.origin[:3, :3]))}"/>',
    ]
    if joint.kind != "fixed":
        low, high = joint.limits
        lines.append(f'    <axis xyz="{_three(joint.axis)}"/>')
        lines.append(f'    <limit lower="{low:.12g}" upper="{high:.12g}" effort="500" velocity="2"/>')
    if arm.mimics(number):
        leader = arm.joints[arm.actuated[joint.source]].name
        lines.append(f'    <mimic joint="{leader}" multiplier="{joint.factor:.12g}" offset="{joint.shift:.12g}"/>')
    return [*lines, "  </joint>"]


def mechanism_lines(design: Design) -> list[str]:
    """Lines of ``[mechanism]`` that hold the geometry."""
    if design.notation == "urdf":
        return ['urdf = "robot.urdf"']
    if design.notation == "screws":
        return _screw_lines(design.arm)
    return ["dh = [", *(f"  {_row_text(row, design.notation)}," for row in design.rows), "]"]


def _row_text(row: Row, convention: str) -> str:
    numbers = {
        "a_mm": 1e3 * row.a,
        "alpha_deg": np.degrees(row.alpha),
        "d_mm": 1e3 * row.d,
        "theta_deg": np.degrees(row.theta),
    }
    parts = [f"{name} = {_number(float(value))}" for name, value in numbers.items()]
    return "{ " + ", ".join([*parts, f'kind = "{row.kind}"', f'convention = "{convention}"']) + " }"


def _screw_lines(arm: Arm) -> list[str]:
    """Axes and points in the base frame with all joints at zero, and the tip's pose there."""
    home, lines = frames_at_zero(arm), ["screws = ["]
    for joint in (arm.joints[n] for n in arm.actuated):
        axis = home[joint.child][:3, :3] @ joint.axis
        point = 1e3 * home[joint.child][:3, 3]
        lines.append(f'  {{ axis = {_list(axis)}, point_mm = {_list(point)}, kind = "{joint.kind}" }},')
    tip = home[arm.tips[0]]
    turn = half_turn_vector(tip[:3, :3])
    return [*lines, "]", f"home = {{ position_mm = {_list(1e3 * tip[:3, 3])}, rotation_rad = {_list(turn)} }}"]


def half_turn_vector(turned: Array) -> Array:
    """Rotation vector (3,) of a rotation matrix, up to half a turn."""
    if np.trace(turned) > -0.99:
        return small_vector(turned)
    values, vectors = np.linalg.eigh((turned + turned.T) / 2.0)
    axis = vectors[:, np.argmax(values)]
    twice = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    return np.asarray(axis * np.arctan2(axis @ twice / 2.0, (np.trace(turned) - 1.0) / 2.0))


def _three(values: Array) -> str:
    return " ".join(f"{value + 0.0:.12g}" for value in np.round(values, 14))


def _number(value: float) -> str:
    return repr(round(value, 9) + 0.0)


def _list(values: Sequence[float] | Array) -> str:
    return "[" + ", ".join(_number(float(value)) for value in values) + "]"
