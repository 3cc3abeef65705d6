"""Reading of robot descriptions (URDF): joints and links as plain numbers, in SI.

The readers on the market load meshes and build scenes; a calibration needs the transforms, axes and masses alone, with
the line of every fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from truing.formats.raw import Unusable, finite_numbers
from truing.formats.xml_document import Lines, read_xml

KINDS = ("revolute", "continuous", "prismatic", "fixed")
_XYZ, _ALONG_X = "0 0 0", "1 0 0"


@dataclass(frozen=True)
class UrdfJoint:
    """A joint: its place (m) and roll, pitch, yaw (rad) in the parent link, its axis there, and the joint it mimics."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: tuple[float, ...]
    rpy: tuple[float, ...]
    axis: tuple[float, ...]
    line: int
    mimics: str = ""
    factor: float = 1.0
    shift: float = 0.0
    limits: tuple[float, float] | None = None


@dataclass(frozen=True)
class UrdfLink:
    """A link: its mass, kg, and its centre of mass, m; 0 where the file gives none."""

    name: str
    mass: float = 0.0
    com: tuple[float, ...] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Urdf:
    """Joints and links of a robot, by name."""

    joints: dict[str, UrdfJoint]
    links: dict[str, UrdfLink]

    @property
    def roots(self) -> list[str]:
        """Links that no joint carries."""
        carried = {joint.child for joint in self.joints.values()}
        return [name for name in self.links if name not in carried]

    def carried(self, base: str) -> list[UrdfJoint]:
        """Return the joints of all links that a base carries, each after the joint below it."""
        joints, waiting = [], [base]
        while waiting:
            joints_of_link = [joint for joint in self.joints.values() if joint.parent == waiting[0]]
            joints += joints_of_link
            waiting = [*waiting[1:], *(joint.child for joint in joints_of_link)]
            if len(joints) > len(self.joints):
                raise Unusable("joints without a loop", row=joints_of_link[0].line, value=joints_of_link[0].name)
        return joints

    def ends(self, base: str) -> list[str]:
        """Return the links above a base that carry no other."""
        below = {joint.parent for joint in self.joints.values()}
        return [joint.child for joint in self.carried(base) if joint.child not in below]

    def path(self, base: str, link: str) -> list[UrdfJoint]:
        """Return the joints from a base link to another link, in order; raises Unusable if there is no such way."""
        by_child = {joint.child: joint for joint in self.joints.values()}
        joints: list[UrdfJoint] = []
        while link != base:
            if link not in by_child or len(joints) > len(by_child):
                raise Unusable(f"a chain of joints from link {base}", value=link)
            joints.insert(0, by_child[link])
            link = by_child[link].parent
        return joints

    def drivers(self, base: str, link: str) -> list[str]:
        """Return the names of the joints that move a link on its base: those between them that mimic no other, and
        those that the others mimic, wherever they are."""
        moving = [joint.mimics or joint.name for joint in self.path(base, link) if joint.kind != "fixed"]
        return list(dict.fromkeys(moving))


def read_urdf(path: Path) -> Urdf:
    """Return the joints and links of a URDF file; raises Unusable with the line of the first fault."""
    root, lines = read_xml(path)
    if root.tag != "robot":
        raise Unusable("a URDF file, whose first element is <robot>", row=lines[root], value=f"<{root.tag}>"[:80])
    if any("xacro" in element.tag for element in root.iter()):
        raise Unusable("a URDF without macros: run `xacro robot.urdf.xacro > robot.urdf` first", row=lines[root])
    links = [_link(element, lines) for element in root.findall("link")]
    joints = [_joint(element, lines) for element in root.findall("joint")]
    _check_unique([joint.name for joint in joints], "joint")
    _check_unique([link.name for link in links], "link")
    named = {link.name: link for link in links}
    for joint in joints:
        for name in (joint.parent, joint.child):
            if name not in named:
                raise Unusable(f"a link of the file, as joint {joint.name} names it", row=joint.line, value=name)
    return Urdf({joint.name: joint for joint in joints}, named)


def _check_unique(names: Sequence[str], what: str) -> None:
    for name in names:
        if names.count(name) > 1:
            raise Unusable(f"one {what} of each name", value=name)


def _joint(element: ElementTree.Element, lines: Lines) -> UrdfJoint:
    line, kind = lines[element], element.get("type", "")
    name = _attribute(element, "name", lines)
    if kind not in KINDS:
        raise Unusable(f"joint {name} of type {', '.join(KINDS)}", row=line, value=kind)
    origin, axis, mimic = element.find("origin"), element.find("axis"), element.find("mimic")
    along = _numbers(axis, "xyz", _ALONG_X, lines)
    length = float(np.sqrt(sum(x * x for x in along)))
    if kind != "fixed" and not length > 0.0:
        raise Unusable(f"an axis of joint {name}: three numbers, not all zero", row=line)
    mimics, factor, shift = "", 1.0, 0.0
    if mimic is not None:
        mimics = _attribute(mimic, "joint", lines)
        factor, shift = _number(mimic, "multiplier", 1.0, lines), _number(mimic, "offset", 0.0, lines)
    turn = _numbers(origin, "rpy", _XYZ, lines)
    if max(map(abs, turn)) > 2.0 * np.pi:
        angles_text = " ".join(f"{angle:g}" for angle in turn)
        raise Unusable(f"rpy of joint {name} in rad, within a turn (degrees?)", row=line, value=angles_text)
    limit = element.find("limit")
    limits = None
    if kind != "continuous" and limit is not None and {"lower", "upper"} <= set(limit.keys()):
        limits = _number(limit, "lower", 0.0, lines), _number(limit, "upper", 0.0, lines)
    return UrdfJoint(
        name,
        "revolute" if kind == "continuous" else kind,
        _link_name(element, "parent", lines),
        _link_name(element, "child", lines),
        _numbers(origin, "xyz", _XYZ, lines),
        turn,
        tuple(x / length for x in along) if length else along,
        line,
        mimics,
        factor,
        shift,
        limits,
    )


def _link(element: ElementTree.Element, lines: Lines) -> UrdfLink:
    inertial = element.find("inertial")
    name = _attribute(element, "name", lines)
    mass = None if inertial is None else inertial.find("mass")
    if inertial is None or mass is None:
        return UrdfLink(name)
    value = _number(mass, "value", 0.0, lines)
    if value < 0.0:
        raise Unusable(f"a mass of link {name} of at least 0 kg", row=lines[mass], value=f"{value:g}")
    return UrdfLink(name, value, _numbers(inertial.find("origin"), "xyz", _XYZ, lines))


def _attribute(element: ElementTree.Element, name: str, lines: Lines) -> str:
    value = element.get(name)
    if not value:
        raise Unusable(f"an attribute {name} of <{element.tag}>", row=lines[element])
    return value


def _link_name(element: ElementTree.Element, which: str, lines: Lines) -> str:
    link_element = element.find(which)
    if link_element is None:
        raise Unusable(f"a <{which} link=.../> of joint {element.get('name')}", row=lines[element])
    return _attribute(link_element, "link", lines)


def _number(element: ElementTree.Element, name: str, default: float, lines: Lines) -> float:
    text = element.get(name)
    if text is None:
        return default
    return float(finite_numbers(text, f"a number as {name} of <{element.tag}>", lines[element], 1)[0])


def _numbers(element: ElementTree.Element | None, name: str, default: str, lines: Lines) -> tuple[float, ...]:
    if element is None:
        return tuple(map(float, default.split()))
    text, line = element.get(name, default), lines[element]
    return tuple(finite_numbers(text, f"three numbers as {name} of <{element.tag}>", line, 3).tolist())
