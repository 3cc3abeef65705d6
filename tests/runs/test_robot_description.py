"""The exported robot description moves like the identified chain, for every notation of the chain."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from tests.tolerance import assert_close
from truing.formats.urdf import Urdf, read_urdf
from truing.runs.exports.robot_description import _corrections, _limits, _notes, urdf_text
from truing.simulation.cause import Effect
from truing.simulation.mechanisms.chains.causes import ChainCause, JointBacklash, JointGain, JointOffset
from truing.simulation.mechanisms.chains.extended_model import ExtendedChain
from truing.simulation.mechanisms.chains.harmonics import JointEccentricity, JointHarmonic
from truing.simulation.mechanisms.chains.jumps import BaseJump
from truing.simulation.mechanisms.chains.measured_lines import with_ground
from truing.simulation.mechanisms.chains.notations import (
    MODIFIED,
    DenavitHartenberg,
    Screw,
    tree_of_rows,
    tree_of_screws,
)
from truing.simulation.mechanisms.chains.tree import JointKind, Node, Tree

_TURNS, _SLIDES = JointKind.REVOLUTE, JointKind.PRISMATIC


def _unit(rng: np.random.Generator) -> np.ndarray:
    axis = rng.normal(size=3)
    return axis / np.linalg.norm(axis)


def _branched() -> Tree:
    """A rail, an elbow, a joint that mimics it, one that is not read, a fixed flange, and a second branch."""
    rng = np.random.default_rng(4)

    def node(joint: str, link: str, below: int, kind: JointKind, **more: object) -> Node:
        R = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
        return Node(joint, link, below, R, rng.normal(size=3), kind, _unit(rng), **more)  # type: ignore[arg-type]

    nodes = (
        Node("", "world", -1, np.eye(3), np.zeros(3)),
        node("rail", "cart", 0, _SLIDES, reading="rail"),
        node("elbow", 'fore"arm', 1, _TURNS, reading="elbow", mass=2.5, com=np.array([0.1, 0.2, 0.3])),
        node("follower", "rod", 2, _TURNS, reading="elbow", factor=-0.7, shift=0.3),
        node("grip", "finger", 3, JointKind.FIXED),
        node("", "tip <1>", 4, JointKind.FIXED),
        node("wrist", "camera", 2, _TURNS, reading="wrist"),
    )
    return Tree(nodes, ("rail", "elbow", "wrist"))


def _upright() -> Tree:
    """Frames pitched by exactly and nearly a right angle, where roll and yaw are one."""
    nodes = [Node("", "base", -1, np.eye(3), np.zeros(3))]
    for k, pitch in enumerate((np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, -np.pi / 2 + 1e-7, np.pi), 1):
        R = Rotation.from_euler("xyz", [0.7, pitch, -2.0]).as_matrix()
        nodes.append(Node(f"j{k}", f"l{k}", k - 1, R, np.array([0.0, 0.3, 0.1]), _TURNS, np.eye(3)[2], f"j{k}"))
    return Tree(tuple(nodes), tuple(f"j{k}" for k in range(1, 6)))


def _rows(convention: str) -> Tree:
    rng = np.random.default_rng(8)
    rows = [DenavitHartenberg(*rng.normal(size=4), kind, convention) for kind in (_TURNS, _SLIDES, _TURNS)]
    return tree_of_rows(rows, ("a", "b", "c"))


def _screws() -> Tree:
    rng = np.random.default_rng(9)
    screws = [Screw(_unit(rng), rng.normal(size=3), kind) for kind in (_TURNS, _TURNS, _SLIDES)]
    return tree_of_screws(screws, (Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), rng.normal(size=3)), "abc")


TREES = {
    "urdf": _branched,
    "upright": _upright,
    "standard": lambda: _rows("standard"),
    "modified": lambda: _rows(MODIFIED),
    "screws": _screws,
}


def _extended(tree: Tree, causes: tuple[tuple[ChainCause, list[float]], ...] = (), size: float = 0.01) -> ExtendedChain:
    twists = np.random.default_rng(1).normal(0.0, size, (tree.size, 6))
    twists[0] = 0.0
    effects = tuple(Effect(cause, np.array(values)) for cause, values in causes)
    unknowns = 6 * tree.size + sum(len(effect.values) for effect in effects)
    return ExtendedChain(
        tree,
        twists,
        np.arange(tree.size),
        tree.size - 1,
        None,
        np.zeros(3),
        0.0,
        20.0,
        np.zeros((2, len(tree.readings))),
        effects=effects,
        covariance=1e-8 * np.eye(unknowns),
        context={"campaign": "arm -- 7 -"},
    )


def _read_back(text: str, folder: Path) -> Urdf:
    (folder / "robot.urdf").write_text(text, encoding="utf-8")
    return read_urdf(folder / "robot.urdf")


def _textbook(robot: Urdf, values: dict[str, float], link: str) -> np.ndarray:
    """Pose (4, 4) of a link by the definition of the format, down to the root."""
    whole = np.eye(4)
    for joint in robot.path(robot.roots[0], link):
        step, moved = np.eye(4), np.eye(4)
        step[:3, :3], step[:3, 3] = Rotation.from_euler("xyz", joint.rpy).as_matrix(), joint.xyz
        value = joint.factor * values.get(joint.mimics or joint.name, 0.0) + joint.shift
        if joint.kind == "revolute":
            moved[:3, :3] = Rotation.from_rotvec(value * np.array(joint.axis)).as_matrix()
        elif joint.kind == "prismatic":
            moved[:3, 3] = value * np.array(joint.axis)
        whole = whole @ step @ moved
    return whole


@pytest.mark.parametrize("form", TREES)
def test_the_exported_file_moves_as_the_identified_chain(form: str, tmp_path: Path) -> None:
    tree = TREES[form]()
    revolute = tree.readings[int(np.flatnonzero(tree.is_revolute)[0])]
    model = _extended(tree, ((JointOffset(revolute), [0.02]),))
    robot = _read_back(urdf_text(model), tmp_path)
    readings = np.random.default_rng(2).uniform(-3.0, 3.0, (6, len(tree.readings)))
    frames = model.identified.frames(readings)
    offset = tree.axis_twists[tree.readings.index(revolute)] * 0.02
    assert_close(frames.t, tree.frames(readings, (model.twists + offset)[None]).t, atol=1e-12)
    for b, own in enumerate(readings):
        values = dict(zip(tree.readings, own, strict=True))
        for k, node in enumerate(tree.nodes):
            found = _textbook(robot, values, node.link)
            assert np.abs(found[:3, :3] - frames.R[b, k]).max() < 1e-9
            assert np.abs(found[:3, 3] - frames.t[b, k]).max() < 1e-9
    nominal = np.abs(tree.frames(readings).t - frames.t).max()
    assert nominal > 1e-3  # what was identified is in the file


def test_links_keep_masses_and_joints_their_limits(tmp_path: Path) -> None:
    text = urdf_text(_extended(_branched()), {"rail": (-0.5, 1.5), "elbow": (np.nan, np.nan), "wrist": (-1.0, 2.0)})
    robot = _read_back(text, tmp_path)
    assert robot.links['fore"arm'].mass == 2.5
    assert robot.links['fore"arm'].com == (0.1, 0.2, 0.3)
    assert (robot.joints["rail"].limits, robot.joints["wrist"].limits) == ((-0.5, 1.5), (-1.0, 2.0))
    assert robot.joints["elbow"].limits is None
    assert 'name="elbow" type="continuous"' in text
    assert robot.joints["grip"].kind == "fixed"
    assert robot.joints["tip <1>_fixed"].child == "tip <1>"


def test_a_joint_that_slides_without_limits_has_the_range_of_its_readings() -> None:
    readings = pd.DataFrame({"pose": [1, 2, 3], "rail_mm": [20.0, -5.0, np.nan], "elbow_deg": [0.0, 1.0, 2.0]})
    joints = pd.DataFrame({"joint": ["rail", "wrist"], "lower_si": [np.nan, -1.0], "upper_si": [np.nan, 2.0]})
    found = _limits({"joints": joints, "configurations": readings}, _branched())
    assert found == {"rail": (pytest.approx(-0.005), pytest.approx(0.02)), "wrist": (-1.0, 2.0)}


def test_the_ground_of_measuring_stations_is_no_link_of_the_robot(tmp_path: Path) -> None:
    robot = _read_back(urdf_text(_extended(with_ground(_branched()))), tmp_path)
    assert robot.roots == ["world"]
    assert len(robot.links) == len(_branched().nodes)


def test_numbers_that_are_no_physics_are_named_in_the_file(tmp_path: Path) -> None:
    rows = [("elbow", "offset", True, 0.4), ("elbow", "dx", True, -4.2), ("elbow", "turn_x", False, None)]
    table = pd.DataFrame(rows, columns=["joint", "parameter", "identifiable", "pull"])
    causes = ((JointGain("elbow"), [1e-3]), (BaseJump("7", 3.0), [0.0] * 6), (JointOffset("rail", False), [1e-3]))
    model = _extended(_branched(), causes)
    notes = _notes(model, table, {("model", ""): "inadequate"})
    assert [note.rpartition(": ")[2] for note in notes["elbow"]] == ["offset", "dx", "turn_x"]
    assert "joint-gain joint elbow." in notes[""][-1]
    assert not any("base-jump" in note or "joint-offset" in note for note in notes[""])
    assert any("does not hold as a whole" in note for note in notes[""])
    assert _read_back(urdf_text(model, notes=notes), tmp_path).joints  # hyphens of a name end no comment


def test_corrections_of_joints_hold_sizes_sigmas_and_orders() -> None:
    causes: tuple[tuple[ChainCause, list[float]], ...] = (
        (JointOffset("rail", False), [2e-3]),
        (JointGain("elbow"), [1e-3]),
        (JointBacklash("rail", False), [5e-5]),
        (JointEccentricity("wrist"), [1e-4, -2e-4]),
        (JointHarmonic("wrist", order=4), [3e-5, 4e-5]),
    )
    model = _extended(_branched(), causes)
    warned = {("joint elbow", "offset"): "not-determined", ("joint-gain joint elbow", ""): "suspected"}
    warned["joint rail", "offset"] = "not-determined"  # the part within the tolerance; the found zero is determined
    rows = list(csv.DictReader(io.StringIO(_corrections(model, warned).decode())))
    offsets = {row["joint"]: row for row in rows if row["correction"] == "offset"}
    zero = model.twists[1, :3] @ model.tree.nodes[1].axis
    assert float(offsets["rail"]["value"]) == pytest.approx((zero + 2e-3) * 1e3, rel=1e-12)
    assert float(offsets["rail"]["sigma"]) == pytest.approx(np.sqrt(2.0) * 1e-4 * 1e3, rel=1e-12)
    assert offsets["rail"]["unit"] == "mm"
    assert {row["in_urdf"] for row in offsets.values()} == {"yes"}
    assert (offsets["elbow"]["caution"], offsets["rail"]["caution"]) == ("not-determined", "")
    others = [(r["joint"], r["correction"], r["order"], float(r["value"]), r["unit"], r["caution"]) for r in rows[3:]]
    assert others == [
        ("elbow", "gain", "", 1e-3, "1", "suspected"),
        ("rail", "backlash", "", 0.05, "mm", ""),
        ("wrist", "sine", "1", 1e-4, "rad", ""),
        ("wrist", "cosine", "1", -2e-4, "rad", ""),
        ("wrist", "sine", "4", 3e-5, "rad", ""),
        ("wrist", "cosine", "4", 4e-5, "rad", ""),
    ]
