"""A robot's description among raw files of `truing init`: its joints, and [mechanism] of the chain."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.init_machine import OF_ANY_CHAIN, columns_of, of_table, rows_of_table, slides_of_log

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.formats.urdf import Urdf
    from truing.pipeline.init_entries import RawGroup

SUFFIX = ".urdf"
_LONG = 20  # lines
_NUMBERED = re.compile(r"joint(\d+)_deg")
TIP = "tip"  # last link of a chain without a description
_JOINT_ANGLE = re.compile(r"(joint\d+|\w+_joint)_(?:deg|rad)")
_NUMBERED_JOINT = re.compile(r"joint1_|\w+_joint_")


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
        moving = {end: tuple(_named(urdf, joint) for joint in urdf.drivers(root, end)) for end in ends}
    except (Unusable, ValueError):
        return None
    if not moving:
        return None
    tip = max(moving, key=lambda end: len(moving[end]))
    return Robot(found[0].relative_to(folder).as_posix(), tip, moving[tip])


def _named(urdf: Urdf, joint: str) -> str:
    from truing.formats.named_joints import SlideName

    return SlideName(joint) if urdf.joints[joint].kind == "prismatic" else joint


def _without_gripper(urdf: Urdf, root: str, end: str) -> str:
    """Return the last link of a chain before its gripper: last joints that joints of other branches mimic, or that
    mimic one of them."""
    path = urdf.path(root, end)
    on_path = {joint.name for joint in path}
    mimicked = {joint.mimics for joint in urdf.joints.values() if joint.mimics and joint.name not in on_path}
    for joint in reversed([joint for joint in path if joint.kind != "fixed"]):
        if joint.name not in mimicked and (not joint.mimics or joint.mimics in on_path):
            break
        end = joint.parent
    return end


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
    """Return a guess whose numbered joints of a robot's program have the names of the robot's joints."""
    split = guess.mapping.get("split", {})
    pattern = split.get("line", "")
    numbers = _NUMBERED.findall(pattern)
    if robot is not None and guess.mapping.get("format") == "fanuc" and len(robot.joints) == len(guess.columns) - 1:
        columns = {f"{joint}_deg": raw for joint, raw in zip(robot.joints, guess.columns[1:], strict=True)}
        return replace(guess, mapping={**guess.mapping, "columns": columns})
    if robot is None or len(numbers) != len(robot.joints) or not all(name.isidentifier() for name in robot.joints):
        return guess
    named = _NUMBERED.sub(lambda match: f"{robot.joints[int(match[1]) - 1]}_deg", pattern)
    return replace(guess, mapping={**guess.mapping, "split": {"line": named}}, columns=robot.joints)


def with_reflector(files: Sequence[tuple[RawGroup, Guess]], robot: Robot | None) -> list[Guess]:
    """Return the guesses; a long list of named places next to a log of a robot's joints becomes points of one
    reflector."""
    guesses = [guess for _, guess in files]
    tables = [guess.table for guess in guesses]
    if robot is None or not has_joints(robot, guesses) or {"points", "poses"} & set(tables):
        return guesses
    return [
        _of_reflector(guess, robot) if guess.table == "targets" and _is_long(group.example) else guess
        for group, guess in files
    ]


def on_tip(guesses: Sequence[Guess], robot: Robot | None) -> list[Guess]:
    """Return the guesses; points in the rows of joint readings get the last link of the robot's description as body."""
    from truing.formats.named_chain import LINK

    if robot is None:
        return list(guesses)
    return [
        replace(one, mapping={**one.mapping, "constants": {**one.mapping["constants"], "body": robot.tip}})
        if one.mapping.get("constants", {}).get("body") == LINK
        else one
        for one in guesses
    ]


def _of_reflector(guess: Guess, robot: Robot) -> Guess:
    columns = {key: raw for key, raw in guess.mapping.get("columns", {}).items() if key not in ("target", "body")}
    names = [raw for key, raw in guess.mapping.get("columns", {}).items() if key in ("target", "body")]
    mapping = {key: value for key, value in guess.mapping.items() if key not in ("columns", "constants")}
    mapping |= {"columns": columns, "number_rows": {"pose": 1}, "constants": {"body": robot.tip, "target": "reflector"}}
    mapping |= {"ignore": "|".join(re.escape(name).replace("\\ ", " ") for name in names)} if names else {}
    doubt = f"each row is assumed to be a pose, in the order of the joints' log, of one reflector on {robot.tip}"
    return replace(guess, table="points", mapping=mapping, doubts=(*guess.doubts, doubt))


def _is_long(path: Path) -> bool:
    """True if a file has more lines than a body has targets."""
    with path.open("rb") as stream:
        return sum(1 for _ in islice(stream, _LONG)) == _LONG


def mechanism_of(robot: Robot | None, guesses: Sequence[Guess]) -> Iterator[tuple[str, str]]:
    """Yield lines and remarks of [mechanism] for a chain whose joints a file gives; none for other campaigns."""
    joints = _logged_joints(guesses)
    if robot is None and (table := of_table(guesses)) is not None:
        yield from rows_of_table(table, guesses)
        return
    if robot is None and (slides := slides_of_log(guesses)):
        yield from slides
        return
    if robot is None and not joints:
        return
    mark = "" if robot is not None and has_joints(robot, guesses) else "# "
    yield f"{mark}[mechanism]", "needed: the chain of joints" if mark else ""
    yield f'{mark}type = "chain"', ""
    if robot is None:
        yield '# urdf = "robot.urdf"', "needed: the robot's description; better: add the file, and truing init again"
        yield "# dh = [", "or: rows of Denavit and Hartenberg, one per joint; the last link is tip"
        yield '#   { a_mm = 0.0, alpha_deg = 90.0, d_mm = 400.0, theta_deg = 0.0, convention = "standard" },', ""
        are_named = joints[0] != "joint1"  # else their numbers give the order
        yield "# ]", f"and joints = {json.dumps(joints, ensure_ascii=False)}" if are_named else ""
    else:
        yield f"{mark}urdf = {json.dumps(robot.file, ensure_ascii=False)}", ""
        yield f"{mark}tip = {json.dumps(robot.tip, ensure_ascii=False)}", ""
        yield f"{mark}joints = {json.dumps(list(robot.joints), ensure_ascii=False)}", ""
    yield from OF_ANY_CHAIN


def _logged_joints(guesses: Sequence[Guess]) -> list[str]:
    """Names of the revolute joints that a log gives, in the order of its columns."""
    columns = [column for guess in guesses if guess.table == "configurations" for column in columns_of(guess)]
    return list(dict.fromkeys(match[1] for column in columns if (match := _JOINT_ANGLE.fullmatch(column))))


def needs_description(robot: Robot | None, guesses: Sequence[Guess]) -> bool:
    """True if files give joint readings, but nothing describes the chain of these joints."""
    is_given = of_table(guesses) is not None or bool(slides_of_log(guesses))
    is_described = is_given if robot is None else has_joints(robot, guesses)
    return any(True for _ in mechanism_of(robot, guesses)) and not is_described


def last_link(robot: Robot | None, guesses: Sequence[Guess]) -> str | None:
    """Name of the link that a log of joints moves; that of a table of Denavit and Hartenberg without a description."""
    if robot is not None:
        return robot.tip if has_joints(robot, guesses) else None
    has_slides = any("screws" in guess.machine for guess in guesses)
    is_numbered = any(_NUMBERED_JOINT.match(column) for guess in guesses for column in columns_of(guess))
    return TIP if is_numbered or has_slides else None


def has_joints(robot: Robot, guesses: Sequence[Guess]) -> bool:
    """True if a file gives readings of all joints."""
    given = [column for guess in guesses if guess.table == "configurations" for column in columns_of(guess)]
    return all(any(column.startswith(f"{joint}_") for column in given) for joint in robot.joints)
