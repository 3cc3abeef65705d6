"""Reading of robot descriptions in MJCF by the optional package mujoco."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from truing.formats.raw import Unusable
from truing.formats.urdf import Urdf, UrdfJoint, UrdfLink

_SLIDE, _HINGE = 2, 3  # mjtJoint
_EQUAL_JOINTS = 2  # mjtEq
_NONE = (0.0, 0.0, 0.0)


def read_mjcf(path: Path) -> Urdf:
    """Return the joints and bodies of an MJCF file; raises Unusable without mujoco, or with what mujoco says of it."""
    if "<include" in path.read_text(encoding="utf-8"):
        raise Unusable("an MJCF file without <include>: one file that holds all bodies")
    try:
        mujoco: Any = importlib.import_module("mujoco")
    except ImportError:
        raise Unusable("a URDF file, or the package mujoco to read MJCF: pip install mujoco") from None
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise Unusable("an MJCF file that mujoco compiles", value=" ".join(str(error).split())[:200]) from None
    return of_model(model)


def of_model(model: Any) -> Urdf:
    """Return a compiled model as joints and links, m and rad; raises Unusable for joints that neither turn nor slide.

    A body with several joints, or with a joint next to its origin, has further links between them, ``BODY:JOINT``. A
    joint moves by its reading less its value in the reference pose.
    """
    names = [str(model.body(k).name or f"body{k}") for k in range(model.nbody)]
    links = {n: UrdfLink(n, float(model.body_mass[k]), _three(model.body_ipos[k])) for k, n in enumerate(names)}
    joints, mimics = dict[str, UrdfJoint](), dict(_mimics(model))
    for k in range(1, model.nbody):
        below, origin, turn = names[model.body_parentid[k]], np.array(model.body_pos[k]), _angles(model.body_quat[k])
        first = int(model.body_jntadr[k])
        for j in range(first, first + int(model.body_jntnum[k])):
            if model.jnt_type[j] not in (_SLIDE, _HINGE):
                raise Unusable("joints that turn or slide; no free or ball joint", value=_joint_name(model, j))
            anchor = np.array(model.jnt_pos[j])
            urdf_joint = _joint(model, j, mimics)
            is_last = j == first + int(model.body_jntnum[k]) - 1 and not anchor.any()
            child = names[k] if is_last else f"{names[k]}:{urdf_joint.name}"
            links.setdefault(child, UrdfLink(child))
            # The frame of the next joint keeps the body's axes, at the anchor of this one.
            rotated = Rotation.from_euler("xyz", turn).as_matrix()
            at = origin + rotated @ anchor
            joints[urdf_joint.name] = replace(urdf_joint, parent=below, child=child, xyz=_three(at), rpy=_three(turn))
            below, origin, turn = child, -anchor, np.zeros(3)
        if below != names[k]:
            fixed = f"{names[k]}:fixed"
            joints[fixed] = UrdfJoint(fixed, "fixed", below, names[k], _three(origin), _three(turn), (1.0, 0.0, 0.0), 0)
    return Urdf(joints, links)


def _joint(model: Any, j: int, mimics: dict[int, tuple[str, float, float]]) -> UrdfJoint:
    zero = float(model.qpos0[model.jnt_qposadr[j]])
    leader, factor, shift = mimics.get(j, ("", 1.0, -zero))
    kind = "revolute" if model.jnt_type[j] == _HINGE else "prismatic"
    low, high = model.jnt_range[j]
    limits = (float(low), float(high)) if model.jnt_limited[j] else None
    axis, name = _three(model.jnt_axis[j]), _joint_name(model, j)
    return UrdfJoint(name, kind, "", "", _NONE, _NONE, axis, 0, leader, factor, shift, limits)


def _mimics(model: Any) -> Iterator[tuple[int, tuple[str, float, float]]]:
    """Yield every joint that follows another one linearly: its leader, factor and shift of its motion."""
    for e in range(model.neq):
        if model.eq_type[e] != _EQUAL_JOINTS or not model.eq_active0[e] or model.eq_obj2id[e] < 0:
            continue
        first, other = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        shift, factor, *higher = map(float, model.eq_data[e][:5])
        if any(higher):
            raise Unusable("joints that follow another one linearly", value=_joint_name(model, first))
        # Both count from their values in the reference pose.
        start = float(model.qpos0[model.jnt_qposadr[other]])
        yield first, (_joint_name(model, other), factor, shift - factor * start)


def _joint_name(model: Any, j: int) -> str:
    return str(model.joint(j).name or f"joint{j}")


def _angles(quaternion: NDArray) -> NDArray:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a pitch of 90 degrees, where roll or yaw alone is enough
        return np.asarray(Rotation.from_quat(np.roll(quaternion, -1)).as_euler("xyz"))


def _three(values: NDArray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
