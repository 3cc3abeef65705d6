"""A robot's description among raw files of `truing init`: its joints, and [mechanism] of the chain."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.formats.urdf import Urdf

SUFFIX = ".urdf"
_NUMBERED = re.compile(r"joint(\d+)_deg")


@dataclass(frozen=True)
class Robot:
    """A chain of joints: file of the description, link at its tip, and joints that move, from the base on."""

    file: str
    tip: str
    joints: tuple[str, ...]


def robot_of(folder: Path, files: Sequence[Path]) -> Robot | None:
    """Return the longest chain of the only robot described among files, up to its gripper; None without one that can be
    read."""
    from truing.formats.raw import Unusable
    from truing.formats.urdf import read_urdf

    found = [path for path in files if path.suffix.lower() == SUFFIX]
    if len(found) != 1:
        return None
    try:
        urdf = read_urdf(found[0])
        (root,) = urdf.roots
        ends = dict.fromkeys(_without_gripper(urdf, root, end) for end in urdf.ends(root))
        paths = {end: urdf.path(root, end) for end in ends}
    except (Unusable, ValueError):
        return None
    moving = {end: tuple(j.name for j in path if j.kind != "fixed" and not j.mimics) for end, path in paths.items()}
    if not moving:
        return None
    tip = max(moving, key=lambda end: len(moving[end]))
    return Robot(found[0].relative_to(folder).as_posix(), tip, moving[tip])


def _without_gripper(urdf: Urdf, root: str, end: str) -> str:
    """Return the last link of a chain before its gripper: a joint that joints of other branches mimic."""
    path = urdf.path(root, end)
    others = {joint.mimics for joint in urdf.joints.values() if joint.mimics and joint not in path}
    return next((joint.parent for joint in path if joint.name in others), end)


def guess_of_description(path: Path, robot: Robot | None) -> Guess:
    """Return the note on a robot's description, which is no table."""
    from truing.formats.guess import Guess
    from truing.formats.raw import Unusable
    from truing.formats.urdf import read_urdf

    if robot is not None:
        joints = f"joints {', '.join(robot.joints)}, tip {robot.tip}"
        return Guess(notes=(f"description of a robot, for [mechanism]: {joints}",), known=True)
    try:
        read_urdf(path)
    except Unusable as error:
        return Guess(notes=(f"description of a robot that cannot be read: expected {error.expected}",), known=True)
    return Guess(notes=("description of a robot: name it under [mechanism], urdf",), known=True)


def named_as_joints(guess: Guess, robot: Robot | None) -> Guess:
    """Return a guess whose numbered columns of joints in a split have the names of the robot's joints."""
    split = guess.mapping.get("split", {})
    pattern = split.get("line", "")
    numbers = _NUMBERED.findall(pattern)
    if robot is None or len(numbers) != len(robot.joints) or not all(name.isidentifier() for name in robot.joints):
        return guess
    named = _NUMBERED.sub(lambda match: f"{robot.joints[int(match[1]) - 1]}_deg", pattern)
    return replace(guess, mapping={**guess.mapping, "split": {"line": named}}, columns=robot.joints)


def mechanism_of(robot: Robot | None, guesses: Sequence[Guess]) -> Iterator[tuple[str, str]]:
    """Yield lines and remarks of [mechanism] for a chain whose joints a file gives; none for other campaigns."""
    numbered = any("joint1_rad" in _columns(guess) or "joint1_deg" in _columns(guess) for guess in guesses)
    if robot is None and not numbered:
        return
    mark = "" if robot is not None and has_joints(robot, guesses) else "# "
    yield f"{mark}[mechanism]", "needed: the chain of joints" if mark else ""
    yield f'{mark}type = "chain"', ""
    if robot is None:
        yield '# urdf = "robot.urdf"', "needed: or rows of Denavit and Hartenberg, dh; columns are named as its joints"
    else:
        yield f"{mark}urdf = {json.dumps(robot.file, ensure_ascii=False)}", ""
        yield f"{mark}tip = {json.dumps(robot.tip, ensure_ascii=False)}", ""
        yield f"{mark}joints = {json.dumps(list(robot.joints), ensure_ascii=False)}", ""
    yield "# gravity = [0.0, 0.0, -1.0]", "in the base frame; absent: effects of weight are not tested"
    yield "# [mechanism.tolerance]", "one standard deviation; absent: joint zeros exact, links free"
    yield "# offset_deg = 0.05", ""


def has_joints(robot: Robot, guesses: Sequence[Guess]) -> bool:
    """True if a file gives readings of all joints."""
    given = [column for guess in guesses if guess.table == "configurations" for column in _columns(guess)]
    return all(any(column.startswith(f"{joint}_") for column in given) for joint in robot.joints)


def _columns(guess: Guess) -> tuple[str, ...]:
    groups = [
        name for pattern in guess.mapping.get("split", {}).values() for name in re.findall(r"\(\?P<(\w+)>", pattern)
    ]
    return (*guess.columns, *guess.mapping.get("columns", {}), *groups)
