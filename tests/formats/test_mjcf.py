"""Descriptions in MJCF: bodies with several joints, anchors next to their origins, reference values and followers."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.runs.test_robot_description import _textbook
from tests.tolerance import assert_close
from truing.formats import mjcf
from truing.formats.mjcf import of_model, read_mjcf
from truing.formats.raw import Unusable

XML = """<mujoco><compiler angle="radian"/><worldbody>
<body name="column" pos="0.1 0.2 0.5" euler="0.3 0 0.4">
  <inertial pos="0 0 0.1" mass="3" diaginertia="0.1 0.1 0.1"/>
  <joint name="lift" type="slide" axis="0 0 1" ref="0.05"/>
  <joint name="turn" type="hinge" axis="0 1 0" pos="0.02 0 0.03" ref="0.2" range="-1 1" limited="true"/>
  <body name="hand" pos="0.3 0 0" quat="0.8 0 0.6 0">
    <inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
    <joint name="wrist" type="hinge" axis="1 0 0"/>
    <body name="tool" pos="0 0 0.1"><inertial pos="0 0 0" mass="0.1" diaginertia="0.1 0.1 0.1"/></body>
  </body>
</body>
</worldbody>
<equality><joint joint1="wrist" joint2="turn" polycoef="0.01 0.5 0 0 0"/></equality></mujoco>
"""


def _named(names: list[str]) -> Any:
    return lambda k: SimpleNamespace(name=names[k])


def _model(kind: int = 3) -> SimpleNamespace:
    """The compiled model of the text above, as mujoco has it, written by hand."""
    tilted, turned = np.array([np.cos(0.15), np.sin(0.15), 0, 0]), np.array([np.cos(0.2), 0, 0, np.sin(0.2)])
    (w, x, _, _), (a, _, _, d) = tilted, turned  # first about x, then about the turned z
    return SimpleNamespace(
        nbody=4,
        body=_named(["world", "column", "hand", "tool"]),
        body_parentid=[0, 0, 1, 2],
        body_pos=np.array([[0, 0, 0], [0.1, 0.2, 0.5], [0.3, 0, 0], [0, 0, 0.1]]),
        body_quat=np.array([[1, 0, 0, 0], [w * a, x * a, -x * d, w * d], [0.8, 0, 0.6, 0], [1, 0, 0, 0]]),
        body_mass=np.array([0, 3.0, 1.0, 0.1]),
        body_ipos=np.array([[0, 0, 0], [0, 0, 0.1], [0, 0, 0], [0, 0, 0]]),
        body_jntnum=[0, 2, 1, 0],
        body_jntadr=[-1, 0, 2, -1],
        joint=_named(["lift", "turn", "wrist"]),
        jnt_type=[2, kind, 3],
        jnt_pos=np.array([[0, 0, 0], [0.02, 0, 0.03], [0, 0, 0]]),
        jnt_axis=np.array([[0, 0, 1.0], [0, 1, 0], [1, 0, 0]]),
        jnt_range=np.array([[0, 0], [-1.0, 1.0], [0, 0]]),
        jnt_limited=[0, 1, 0],
        jnt_qposadr=[0, 1, 2],
        qpos0=np.array([0.05, 0.2, 0.0]),
        neq=1,
        eq_type=[2],
        eq_active0=[1],
        eq_obj1id=[2],
        eq_obj2id=[1],
        eq_data=np.array([[0.01, 0.5, 0, 0, 0, 0]]),
    )


def _about(axis: int, angle: float) -> np.ndarray:
    """Rigid motion (4, 4) by a turn about one of the axes."""
    one, other = [k for k in range(3) if k != axis]
    sign = -1.0 if axis == 1 else 1.0
    whole = np.eye(4)
    whole[one, one] = whole[other, other] = np.cos(angle)
    whole[one, other], whole[other, one] = -sign * np.sin(angle), sign * np.sin(angle)
    return whole


def _by(x: float, y: float, z: float) -> np.ndarray:
    whole = np.eye(4)
    whole[:3, 3] = x, y, z
    return whole


def test_the_joints_of_a_body_act_one_after_the_other_about_their_anchors() -> None:
    robot = of_model(_model())
    lift, turn = 0.12, 0.7
    column = _by(0.1, 0.2, 0.5) @ _about(0, 0.3) @ _about(2, 0.4) @ _by(0, 0, lift - 0.05)
    column = column @ _by(0.02, 0, 0.03) @ _about(1, turn - 0.2) @ _by(-0.02, 0, -0.03)
    hand = column @ _by(0.3, 0, 0) @ _about(1, 2.0 * np.arctan2(0.6, 0.8)) @ _about(0, 0.01 + 0.5 * (turn - 0.2))
    assert_close(_textbook(robot, {"lift": lift, "turn": turn}, "tool"), hand @ _by(0, 0, 0.1), atol=1e-12)
    assert robot.links["column"].mass == 3.0
    assert robot.joints["turn"].limits == (-1.0, 1.0)
    assert robot.joints["lift"].kind == "prismatic"


def test_a_free_joint_is_refused() -> None:
    with pytest.raises(Unusable, match="no free or ball joint"):
        of_model(_model(kind=0))


def test_without_mujoco_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ImportError(name)

    (tmp_path / "robot.xml").write_text(XML, encoding="utf-8")
    monkeypatch.setattr(mjcf, "importlib", SimpleNamespace(import_module=missing))
    with pytest.raises(Unusable, match="pip install mujoco"):
        read_mjcf(tmp_path / "robot.xml")
    (tmp_path / "two.xml").write_text(XML.replace("<worldbody>", '<include file="a.xml"/><worldbody>'), "utf-8")
    with pytest.raises(Unusable, match="one file"):
        read_mjcf(tmp_path / "two.xml")


def test_mujoco_itself_says_the_same(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    file = tmp_path / "robot.xml"
    file.write_text(XML, encoding="utf-8")
    robot, by_hand = read_mjcf(file), of_model(_model())
    for name, joint in by_hand.joints.items():
        for key in ("xyz", "rpy", "axis", "factor", "shift"):
            assert_close(np.array(getattr(robot.joints[name], key)), np.array(getattr(joint, key)), atol=1e-9)
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.12, 0.7, 0.01 + 0.5 * (0.7 - 0.2)
    mujoco.mj_kinematics(model, data)
    assert_close(_textbook(robot, {"lift": 0.12, "turn": 0.7}, "tool")[:3, 3], data.body("tool").xpos, atol=1e-9)
    file.write_text(XML.replace("pos=", "position="), encoding="utf-8")
    with pytest.raises(Unusable, match="mujoco compiles"):
        read_mjcf(file)
