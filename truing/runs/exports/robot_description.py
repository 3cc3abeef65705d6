"""Export of an identified chain: a URDF with the identified transforms, and corrections of its joints."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3
from truing.runs.exports.controller import IMPLAUSIBLE_PULL, reasons_for_caution
from truing.runs.exports.csv_text import csv_bytes
from truing.runs.recorded_run import Run
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.cause import Effect
from truing.simulation.mechanisms.chains.causes import ChainCause, JointCause, JointOffset
from truing.simulation.mechanisms.chains.extended_model import ExtendedChain
from truing.simulation.mechanisms.chains.harmonics import JointEccentricity, JointHarmonic, JointPitchError
from truing.simulation.mechanisms.chains.joint_curves import JointErrorCurve
from truing.simulation.mechanisms.chains.joint_table import joint_column
from truing.simulation.mechanisms.chains.loads import JointSag
from truing.simulation.mechanisms.chains.settling import JointSettling
from truing.simulation.mechanisms.chains.tree import JointKind, Node, Tree, axis_twist

if TYPE_CHECKING:
    import pandas as pd

_OFFSET, _WHOLE = "offset", ("model", "")
_HEAD = ("joint", "correction", "order", "value", "sigma", "unit", "in_urdf", "caution")
_MM = 1e-3
_WITHIN_ORDER = "order_distance"  # column order has it
_OF_CURVES = ("joint", "reading", "deviation", "sigma", "unit", "determined", "caution")
_EXACT = 1e-15  # m and rad: a smaller sigma is rounding


def urdf(run: Run) -> Iterator[tuple[str, bytes]]:
    """Yield ``robot.urdf``, ``joint_corrections.csv``, ``joint_curves.csv`` if joints have error curves, and
    ``tip_errors.csv`` if errors of the tip were measured.

    Raises CampaignFaults where the run has no chain's model.
    """
    model = run.model
    if not isinstance(model, ExtendedChain):
        expected = 'the run of an open chain ([mechanism] type = "chain") whose diagnosis gave a model'
        missing_model = "no model" if model is None else "the model of another machine"
        raise CampaignFaults([Fault(str(run.folder), expected, value=missing_model)])
    limits = _limits(run, model.tree)
    warned = reasons_for_caution(run)
    yield "robot.urdf", urdf_text(model, limits, _notes(model, run.get("chain_parameters"), warned)).encode()
    yield "joint_corrections.csv", _corrections(model, warned)
    if curves := list(_curves(model, warned)):
        yield "joint_curves.csv", csv_bytes([_OF_CURVES, *curves])
    if (errors := _tip_errors(run, model)) is not None:
        yield "tip_errors.csv", csv_bytes([tuple(errors.columns), *errors.itertuples(index=False)])


def _tip_errors(run: Mapping[str, pd.DataFrame], model: ExtendedChain) -> pd.DataFrame | None:
    """Return the errors that the model leaves at each measured pose, with the place of the tip in the base.

    None without errors of the tip, or without readings. Places are those of the identified chain.
    """
    errors, table = run.get("component_errors"), run.get("configurations")
    if errors is None or table is None or not len(errors):
        return None
    columns = [joint_column(model.tree, joint, map(str, table.columns)) for joint in model.tree.readings]
    readings = np.column_stack([table[c.name].astype(float) * c.si for c in columns if c is not None])
    if readings.shape[1] < len(columns):
        return None
    places = model.identified.frames(readings).t[:, model.tip] / _MM
    place_of = dict(zip(table["pose"], places, strict=True))
    names = errors["component"] + "_" + errors["unit"]
    wide = errors.assign(component="d" + names).pivot_table(
        index=["pose", "role"], columns="component", values="missed", sort=False
    )
    wide = wide.reset_index()
    at = np.array([place_of[pose] for pose in wide["pose"]])
    for k, name in enumerate(("x_mm", "y_mm", "z_mm")):
        wide.insert(2 + k, name, at[:, k])
    return wide


def _limits(run: Mapping[str, pd.DataFrame], tree: Tree) -> dict[str, tuple[float, float]]:
    """Return the limits of the joints; of a joint that slides the range of its readings, where it has none.

    The format demands limits of a joint that slides.
    """
    joints, readings = run.get("joints"), run.get("configurations")
    known = {} if joints is None else {row.joint: (row.lower_si, row.upper_si) for row in joints.itertuples()}
    limits = {joint: limit for joint, limit in known.items() if all(map(math.isfinite, limit))}
    if readings is None:
        return limits
    for joint, turns in zip(tree.readings, tree.is_revolute, strict=True):
        column = joint_column(tree, joint, map(str, readings.columns))
        if column is not None and not turns and joint not in limits:
            readings_si = readings[column.name].dropna() * column.si
            limits[joint] = float(readings_si.min()), float(readings_si.max())
    return limits


def urdf_text(
    model: ExtendedChain,
    limits: Mapping[str, tuple[float, float]] | None = None,
    notes: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """Return the identified chain as URDF, m and rad; ``limits`` and ``notes`` (comments) by joint.

    A zero of a joint becomes a change of its origin, so that every joint value is still the reading.
    """
    tree, notes = model.identified, notes or {}
    names = _joint_names(tree)
    lines = ['<?xml version="1.0" encoding="utf-8"?>']
    lines += [f"<!-- {_comment_text(note)} -->" for note in notes.get("", ())]
    lines += [f"<robot name={quoteattr(model.context.get('campaign') or 'robot')}>"]
    for k, node in enumerate(tree.nodes):
        if k and node.parent < 0:
            continue  # the ground of measuring stations is no link of the robot
        lines += _link_lines(node)
        if node.parent >= 0:
            lines += [f"  <!-- {_comment_text(note)} -->" for note in notes.get(node.joint, ()) if node.joint]
            lines += _joint_lines(tree, k, names, (limits or {}).get(node.joint))
    return "\n".join([*lines, "</robot>", ""])


def _joint_names(tree: Tree) -> list[str]:
    """Return a name for every node's joint; a fixed end without one is named after its link."""
    used_names = {node.joint for node in tree.nodes}
    names = []
    for node in tree.nodes:
        name = node.joint or f"{node.link}_fixed"
        while not node.joint and name in used_names:
            name += "_"
        used_names.add(name)
        names.append(name)
    return names


def _link_lines(node: Node) -> list[str]:
    if not node.mass > 0.0:
        return [f"  <link name={quoteattr(node.link)}/>"]
    nothing = " ".join(f'i{pair}="0"' for pair in ("xx", "xy", "xz", "yy", "yz", "zz"))
    return [
        f"  <link name={quoteattr(node.link)}>",
        "    <inertial>",
        f'      <origin xyz="{_three(node.com)}" rpy="0 0 0"/>',
        f'      <mass value="{float(node.mass)!r}"/>',
        f"      <inertia {nothing}/>",
        "    </inertial>",
        "  </link>",
    ]


def _joint_lines(tree: Tree, k: int, names: Sequence[str], limit: tuple[float, float] | None) -> list[str]:
    node = tree.nodes[k]
    R, t, shift = node.R, node.t, node.shift
    mimics = node.kind is not JointKind.FIXED and node.reading != node.joint
    if node.kind is JointKind.REVOLUTE and not mimics:
        R = R @ exp_so3(shift * node.axis)
    elif node.kind is JointKind.PRISMATIC and not mimics:
        t = t + R @ (shift * node.axis)
    known = limit is not None and all(map(math.isfinite, limit))
    kind = "continuous" if node.kind is JointKind.REVOLUTE and not known else str(node.kind)
    lines = [
        f'  <joint name={quoteattr(names[k])} type="{kind}">',
        f'    <origin xyz="{_three(t)}" rpy="{_three(_roll_pitch_yaw(R))}"/>',
        f"    <parent link={quoteattr(tree.nodes[node.parent].link)}/>",
        f"    <child link={quoteattr(node.link)}/>",
    ]
    if node.kind is not JointKind.FIXED:
        lines.append(f'    <axis xyz="{_three(node.axis)}"/>')
    if limit is not None and known and node.kind is not JointKind.FIXED:
        low, high = map(float, limit)
        lines.append(f'    <limit lower="{low!r}" upper="{high!r}" effort="0" velocity="0"/>')
    if mimics:
        factor = f'multiplier="{float(node.factor)!r}" offset="{float(shift)!r}"'
        lines.append(f"    <mimic joint={quoteattr(node.reading)} {factor}/>")
    return [*lines, "  </joint>"]


def _roll_pitch_yaw(R: NDArray) -> NDArray:
    """Return the angles (3,) about fixed x, y, z, rad, of a rotation (3, 3), in full precision at any pitch."""
    pitch, yaw = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0])), math.atan2(R[1, 0], R[0, 0])
    roll = (exp_so3(np.array([0.0, 0.0, yaw])) @ exp_so3(np.array([0.0, pitch, 0.0]))).T @ R
    return np.array([math.atan2(roll[2, 1], roll[1, 1]), pitch, yaw])


def _three(values: NDArray) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)


def _comment_text(words: str) -> str:
    """Return words as XML allows them in a comment: without two hyphens in sequence."""
    while "--" in words:
        words = words.replace("--", "- -")
    return words.removesuffix("-")


def _notes(
    model: ExtendedChain, parameters: pd.DataFrame | None, warned: Mapping[tuple[str, str], str]
) -> dict[str, list[str]]:
    """Return comments by joint, "" for the whole robot: numbers that the data determine, and effects that the file
    leaves out.
    """
    campaign = model.context.get("campaign", "")
    notes = {
        "": [
            f"Identified by truing in campaign {campaign}. Units: m and rad. Joint values are readings: zeros are in "
            "the origins.",
            "Every transform holds only together with all others. A number that is not determined, or is far from "
            "nominal, is no physical property of the machine.",
            "Inertia, effort and velocity are unknown here and set to 0. A joint that slides has the range of its "
            "readings as limits, if no others are known. Joints that the campaign did not read are fixed at zero.",
        ]
    }
    if _WHOLE in warned:
        notes[""].append("The model does not hold as a whole: something acts that none of its numbers describes.")
    lasting = [cause for cause in model.causes if cause.is_persistent and not isinstance(cause, JointOffset)]
    if left := [f"{cause.id} {cause.subject}".strip() for cause in lasting]:
        notes[""].append(f"Found and not in this file, because no origin expresses it: {'; '.join(left)}.")
    for joint, rows_of_joint in parameters.groupby("joint", sort=False) if parameters is not None else ():
        if not joint:
            continue  # the place of the base in the measurement is not in the file
        far = rows_of_joint["identifiable"] & (rows_of_joint["pull"].abs() > IMPLAUSIBLE_PULL)
        for words, rows in (
            ("determined by the data", rows_of_joint[rows_of_joint["identifiable"] & ~far]),
            (
                f"determined, but more than {IMPLAUSIBLE_PULL:g} standard deviations from nominal, no physics",
                rows_of_joint[far],
            ),
            ("not determined by the data, no physics", rows_of_joint[~rows_of_joint["identifiable"]]),
        ):
            if len(rows):
                notes.setdefault(str(joint), []).append(f"{joint}, {words}: {', '.join(rows['parameter'])}")
    return notes


def _corrections(model: ExtendedChain, warned: Mapping[tuple[str, str], str]) -> bytes:
    return csv_bytes([_HEAD, *_offsets(model, warned), *_deviations(model, warned)])


def _curves(model: ExtendedChain, warned: Mapping[tuple[str, str], str]) -> Iterator[tuple[object, ...]]:
    """Yield the error curves of joints, motion minus reading along the reading, in deg or mm."""
    for effect in model.effects:
        if isinstance(effect.cause, JointErrorCurve):
            caution = _caution_of(effect.cause, warned)
            for curve in effect.cause.curves(effect.values, model.covariance_of(effect.cause)):
                unit, si = ("deg", math.pi / 180.0) if curve.is_angle else ("mm", _MM)
                rows = zip(curve.readings, curve.deviation, curve.sigma, curve.is_determined, strict=True)
                for reading, deviation, sigma, known in rows:
                    numbers = (f"{reading / si:.6f}", repr(float(deviation / si)), repr(float(sigma / si)))
                    yield curve.joint, *numbers, unit, "yes" if known else "no", caution


def _offsets(model: ExtendedChain, warned: Mapping[tuple[str, str], str]) -> Iterator[tuple[object, ...]]:
    """Yield the zero of each joint that has one: within its tolerance, and beyond it as a cause of its own."""
    tree = model.tree
    for k, joint in enumerate(tree.readings):
        node, slope = tree.node_of(k), np.zeros(len(model.covariance))
        axis = axis_twist(tree.nodes[node])
        value = float(axis @ model.twists[node])
        index = np.flatnonzero(model.moved == node)
        if len(index):
            slope[6 * index[0] : 6 * index[0] + 6] = axis
        causes = []
        for effect in model.effects:
            if isinstance(cause := effect.cause, JointOffset) and cause.joint == joint:
                causes.append(cause)
                value += float(cause.with_known_part(effect.values)[0])
                slope[model.layout[cause.key]] = 1.0
        sigma = float(np.sqrt(max(slope @ model.covariance @ slope, 0.0)))
        if not sigma > _EXACT:
            continue
        # Data determine a zero that is found, though not its part within the tolerance alone.
        cautions = [] if causes else [warned.get((f"joint {joint}", _OFFSET))]
        codes = [*cautions, *(_caution_of(cause, warned) for cause in causes)]
        caution = next(filter(None, codes), "")
        unit, si = ("rad", 1.0) if tree.is_revolute[k] else ("mm", _MM)
        yield joint, _OFFSET, "", repr(value / si), repr(sigma / si), unit, "yes", caution


def _deviations(model: ExtendedChain, warned: Mapping[tuple[str, str], str]) -> Iterator[tuple[object, ...]]:
    """Yield the parameters of every effect on a joint's motion that no origin of a URDF can express."""
    for effect in model.effects:
        cause = effect.cause
        if (
            not isinstance(cause, JointCause)
            or isinstance(cause, (JointOffset, JointSettling, JointSag))
            or not cause.is_persistent
        ):
            continue
        order = _order(effect)
        caution, legs = _caution_of(cause, warned), len(model.tree.readings)
        spread = np.sqrt(np.diag(model.covariance_of(cause)))
        for size, value, sigma in zip(cause.parameters(legs), effect.values, spread, strict=True):
            if size.name == _WITHIN_ORDER:
                continue
            numbers = repr(float(value) / size.si), repr(float(sigma) / size.si)
            yield cause.joint, size.name, order, *numbers, size.unit, "no", caution


def _order(effect: Effect[ChainCause]) -> str:
    """Return the order of a harmonic, 1 of an eccentricity, 2 pi over the period in mm of a slide; empty for other
    effects."""
    if isinstance(effect.cause, JointPitchError):
        return repr(_MM * effect.cause.order_at(effect.values))
    if isinstance(effect.cause, JointHarmonic):
        order = effect.cause.order_at(effect.values)
        return str(int(order)) if order == int(order) else repr(order)
    return "1" if isinstance(effect.cause, JointEccentricity) else ""


def _caution_of(cause: ChainCause, warned: Mapping[tuple[str, str], str]) -> str:
    return warned.get((f"{cause.id} {cause.subject}".strip(), ""), "")
