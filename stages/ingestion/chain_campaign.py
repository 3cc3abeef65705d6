"""Input of a campaign of an open chain: the description of its joints, their columns, and points or poses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pyarrow as pa

from truing.arrays import Mask
from truing.estimation.rotation import exp_so3
from truing.formats.faultlog import FaultLog
from truing.formats.mjcf import read_mjcf
from truing.formats.raw import Unusable
from truing.formats.source import CampaignFiles
from truing.formats.urdf import Urdf, UrdfJoint, read_urdf
from truing.formats.xml_document import read_xml
from truing.report.numbers import count_text
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.near_names import did_you_mean
from truing.simulation.mechanisms.chains.closed_tree import (
    ENTRY_POINTS,
    ClosedTree,
    LoopClosure,
    loop_closures,
)
from truing.simulation.mechanisms.chains.joint_table import ANGLES, LENGTHS, joint_column
from truing.simulation.mechanisms.chains.notations import (
    Screw,
    tree_of_rows,
    tree_of_screws,
)
from truing.simulation.mechanisms.chains.tree import JointKind, Node, Tree
from truing.stages.common.chain_description import rows_of
from truing.stages.common.chain_tables import joint_readings, tree_table
from truing.stages.declaration import Outcome, Progress
from truing.stages.ingestion.distance_table import read_distances
from truing.stages.ingestion.point_campaign import ingest_points
from truing.stages.ingestion.tables import read_configurations, read_survey

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.chain_mechanism import ChainMechanism, HartenbergRow, ScrewRow

_MM, _DEG = 1e-3, np.pi / 180.0
Limits = dict[str, tuple[float, float]]


def ingest(
    tables: Mapping[str, pa.Table], settings: Campaign, source: CampaignFiles, log: FaultLog, progress: Progress
) -> Outcome:
    """The tables of the campaign, and `joints`; raises CampaignFaults with all faults together."""
    try:
        tree, limits = read_chain(settings, source)
    except CampaignFaults as error:
        for fault in error.faults:
            log.add(fault)
        ingest_points(tables, settings, source, log, progress)  # for its faults, reported with those of the description
        log.raise_faults()
        raise
    outcome = ingest_points(tables, settings, source, log, progress, tuple(tree.links))
    table = outcome.artifacts["configurations"]
    assert isinstance(table, pa.Table)
    _check_columns(tree, table, log)
    _check_series(settings, table, log)
    _check_gears(settings, tree, log)
    _check_workspace(settings, tree, log)
    _check_links(tree, outcome.artifacts, log)
    _check_loops(tree, table, log)
    artifacts = {**outcome.artifacts, "joints": tree_table(tree, limits)}
    if source.entries("distances"):
        tip = cast("ChainMechanism", settings.mechanism).tip or tree.nodes[-1].link
        artifacts["distances"] = read_distances(source, settings, table.column("pose"), tip, log)
        read = f"{count_text(artifacts['distances'].num_rows, 'distance')} from distances.csv"
        outcome = replace(outcome, read=read if not outcome.read else f"{outcome.read}; {read}")
    log.raise_faults()
    return replace(outcome, artifacts=artifacts)


def planned_chain(settings: Campaign, source: CampaignFiles) -> dict[str, pa.Table]:
    """`joints`, and the planned places of targets and configurations where there are any; raises CampaignFaults."""
    tree, limits = read_chain(settings, source)
    log = FaultLog()
    survey = read_survey(source, settings, log) if source.entries("targets") else None
    planned = read_configurations(source, settings, log) if source.entries("configurations") else None
    tables = {"joints": tree_table(tree, limits)}
    if survey is not None:
        tables["survey"] = survey.table
    if planned is not None:
        tables["configurations"] = planned.table
        _check_columns(tree, planned.table, log)
    _check_workspace(settings, tree, log)
    _check_links(tree, tables, log)
    log.raise_faults()
    return tables


def read_chain(settings: Campaign, source: CampaignFiles) -> tuple[Tree, Limits]:
    """The chain that [mechanism] describes, and the limits of its joints; raises CampaignFaults if it is unusable."""
    section = cast("ChainMechanism", settings.mechanism)
    if section.dh:
        return _tree_of_rows(section), {}
    if section.screws:
        return _tree_of_screws(section), {}
    file = source.urdf
    assert file is not None
    try:
        if not file.path.is_file():
            raise Unusable("an existing URDF file")
        read = read_mjcf if read_xml(file.path)[0].tag == "mujoco" else read_urdf
        return tree_of_urdf(read(file.path), section.base, section.tip, section.joints, _closure(section))
    except Unusable as error:
        raise CampaignFaults([Fault(file.name, error.expected, row=error.row, value=error.value)]) from None


def _tree_of_rows(section: ChainMechanism) -> Tree:
    tree = tree_of_rows(rows_of(section), section.joint_names, section.base or "base", section.tip or "tip")
    return _with_masses(tree, section.dh)


def _tree_of_screws(section: ChainMechanism) -> Tree:
    screws = [
        Screw(np.array(row.axis) / np.linalg.norm(row.axis), np.array(row.point_mm) * _MM, JointKind(row.kind))
        for row in section.screws
    ]
    home = exp_so3(np.array(section.home.rotation_rad, float)), np.array(section.home.position_mm) * _MM
    tree = tree_of_screws(screws, home, section.joint_names, section.base or "base", section.tip or "tip")
    return _with_masses(tree, section.screws)


def _with_masses(tree: Tree, rows: Sequence[HartenbergRow | ScrewRow]) -> Tree:
    moved = [
        replace(node, mass=row.mass_kg, com=np.array(row.com_mm or (0.0, 0.0, 0.0)) * _MM)
        for node, row in zip(tree.nodes[1:-1], rows, strict=True)
    ]
    return replace(tree, nodes=(tree.nodes[0], *moved, tree.nodes[-1]))


def tree_of_urdf(
    robot: Urdf, base: str | None, tip: str | None, joints: Sequence[str], closure: LoopClosure | None
) -> tuple[Tree, Limits]:
    """The links that the base carries, with every joint between them, and limits by joint, rad or m.

    A joint that is neither read nor moved by a closure stands at zero. Raises Unusable for names that are not there.
    """
    base = _link(base, robot, "base") if base else _only(robot.roots, "base")
    carried = robot.carried(base)
    tip = _link(tip, robot, "tip") if tip else _only(robot.ends(base), "tip")
    drivers = robot.drivers(base, tip)
    names = tuple(joints or drivers)
    for name in names:
        if name not in robot.joints or robot.joints[name].kind == "fixed" or robot.joints[name].mimics:
            movable = [j.name for j in robot.joints.values() if j.kind != "fixed" and not j.mimics]
            hint = did_you_mean(name, movable) or f"; there are {', '.join(movable)}"
            raise Unusable(f"a joint that moves and mimics no other, as [mechanism] joints names it{hint}", value=name)
    moving = (*names, *(() if closure is None else closure.passive))
    if unread := [name for name in drivers if name not in moving]:
        raise Unusable(f"every joint that moves {tip} on {base} in [mechanism] joints", value=unread[0])
    indices = {base: 0}
    mass = robot.links[base]
    nodes = [Node("", base, -1, np.eye(3), np.zeros(3), mass=mass.mass, com=np.array(mass.com))]
    for joint in carried:
        indices[joint.child] = len(nodes)
        nodes.append(_node(joint, indices[joint.parent], robot, moving))
    limits = {joint.name: joint.limits for joint in carried if joint.limits is not None}
    if closure is None:
        return Tree(tuple(nodes), names), limits
    try:
        return ClosedTree(tuple(nodes), names, closure), limits
    except ValueError as error:
        raise Unusable(str(error)) from None


def _closure(section: ChainMechanism) -> LoopClosure | None:
    """The installed closure that [mechanism] names; raises CampaignFaults if there is none of its name."""
    if section.closure is None:
        return None
    known = loop_closures()
    if section.closure not in known:
        hint = did_you_mean(section.closure, list(known)) or f"; there are {', '.join(known) or 'none'}"
        text = f"a closure of loops that an installed package names in its entry points {ENTRY_POINTS}{hint}"
        raise CampaignFaults([Fault("campaign.toml", text, column="mechanism.closure", value=section.closure)])
    return known[section.closure]


def _node(joint: UrdfJoint, below: int, robot: Urdf, names: tuple[str, ...]) -> Node:
    roll, pitch, yaw = joint.rpy
    turn = exp_so3(np.array([0, 0, yaw])) @ exp_so3(np.array([0, pitch, 0])) @ exp_so3(np.array([roll, 0, 0]))
    link, reading = robot.links[joint.child], joint.mimics or joint.name
    is_read = joint.kind != "fixed" and reading in names
    return Node(
        joint.name,
        joint.child,
        below,
        turn,
        np.array(joint.xyz),
        JointKind(joint.kind) if is_read else JointKind.FIXED,
        np.array(joint.axis),
        reading if is_read else "",
        joint.factor,
        joint.shift,
        link.mass,
        np.array(link.com),
    )


def _link(name: str, robot: Urdf, key: str) -> str:
    if name in robot.links:
        return name
    hint = did_you_mean(name, list(robot.links)) or f"; there are {', '.join(robot.links)}"
    raise Unusable(f"a link of this file as [mechanism] {key}{hint}", value=name)


def _only(names: list[str], key: str) -> str:
    if len(names) == 1:
        return names[0]
    raise Unusable(f"[mechanism] {key} to name one of {', '.join(names)}")


def _check_columns(tree: Tree, table: pa.Table, log: FaultLog) -> None:
    """Note every joint without readings, or with readings of a unit that does not fit it."""
    names = table.schema.names
    for joint in tree.readings:
        column = joint_column(tree, joint, names)
        if column is not None:
            values = table.column(column.name).to_numpy()
            if not np.isfinite(values.astype(float)).any():
                log.add(Fault("configurations.csv", "a number in some rows: the column is empty", column=column.name))
            continue
        is_angle = tree.is_revolute[tree.readings.index(joint)]
        endings, other_endings = (ANGLES, LENGTHS) if is_angle else (LENGTHS, ANGLES)
        wrong = next((joint + end for end in other_endings if joint + end in names), None)
        wanted = " or ".join(joint + end for end in endings)
        hint = f"; joint {joint} {'turns' if is_angle else 'slides'}" if wrong else did_you_mean(joint, names)
        log.add(Fault("configurations.csv", f"a column {wanted}{hint}", column=wrong or joint))


def _check_links(tree: Tree, artifacts: Mapping[str, Any], log: FaultLog) -> None:
    """Note every body with measured poses or surveyed targets that is no link of the chain."""
    for name, file in (("measured_poses", "poses.csv"), ("survey", "targets.csv")):
        bodies = artifacts[name].column("body").unique().to_pylist() if name in artifacts else []
        for body in (body for body in bodies if body not in tree.links):
            hint = did_you_mean(body, list(tree.links)) or f"; there are {', '.join(tree.links)}"
            log.add(Fault(file, f"a link of the chain as body{hint}", column="body", value=body))


def _check_loops(tree: Tree, table: pa.Table, log: FaultLog) -> None:
    """Note every pose with readings at which the loops of the nominal chain do not close."""
    names = table.schema.names
    if not isinstance(tree, ClosedTree) or any(joint_column(tree, joint, names) is None for joint in tree.readings):
        return
    readings = joint_readings(tree, table)
    is_read: Mask = np.asarray(np.isfinite(readings).all(1))
    is_open = is_read & ~tree.closes(np.nan_to_num(readings))
    for pose in table.column("pose").filter(pa.array(is_open)).to_pylist():
        text = "readings at which the loops of the chain close; check units, signs and zeros of the joints"
        log.add(Fault("configurations.csv", text, column="pose", value=str(pose)))


def _check_gears(settings: Campaign, tree: Tree, log: FaultLog) -> None:
    """Note every joint with orders of gears, or with periods of a screw, that is read by no column or moves the other
    way."""
    by_key = {"gear_orders": ("turns", True), "pitch_mm": ("slides", False)}
    for key, (moves, turns) in by_key.items():
        right = [name for name, rotary in zip(tree.readings, tree.is_revolute, strict=True) if rotary == turns]
        for joint in (name for name in getattr(settings.mechanism, key) if name not in right):
            hint = did_you_mean(joint, right) or f"; there are {', '.join(right) or 'none'}"
            text = f"a joint that {moves} and is read{hint}"
            log.add(Fault("campaign.toml", text, column=f"mechanism.{key}", value=joint))


def _check_workspace(settings: Campaign, tree: Tree, log: FaultLog) -> None:
    """Note every key of [workspace] joints that is no column of a joint, or a second one of the same joint."""
    columns = {joint + unit: joint for joint, units in _columns_of_joints(tree) for unit in units}
    joints = settings.workspace.joints
    for name, ends in joints.items():
        joint = columns.get(name)
        others = [other for other in joints if other != name and joint is not None and columns.get(other) == joint]
        if joint is not None and not others:
            continue
        hint = did_you_mean(name, list(columns)) or f"; there are {', '.join(columns)}"
        text = f"one column for joint {joint}; {others[0]} is one too" if others else f"the column of a joint{hint}"
        value = f"[{ends[0]:g}, {ends[1]:g}]"
        log.add(Fault("campaign.toml", text, column=f"workspace.joints.{name}", value=value))


def _columns_of_joints(tree: Tree) -> Iterator[tuple[str, Iterable[str]]]:
    """Yield every joint that is read, with the unit endings of its possible columns."""
    for joint, turns in zip(tree.readings, tree.is_revolute, strict=True):
        yield joint, ANGLES if turns else LENGTHS


def _check_series(settings: Campaign, table: pa.Table, log: FaultLog) -> None:
    if settings.measurement.frame == "series" and "series" not in table.schema.names:
        text = 'a column series, because [measurement] frame = "series"'
        log.add(Fault("configurations.csv", text, column="series"))
