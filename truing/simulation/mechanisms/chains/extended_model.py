"""Class `ExtendedChain`: an identified chain with its effects; its model.toml, and prediction of the tip's pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index
from truing.estimation.rotation import exp_so3, log_so3
from truing.simulation.catalogue import catalogue_of_chains
from truing.simulation.mechanisms.chains.causes import ChainCause, JointOffset
from truing.simulation.mechanisms.chains.closed_tree import ClosedTree, tree_with_loops
from truing.simulation.mechanisms.chains.conditions import ChainConditions, ChainInputs, MeasuredChannels, usual_range
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.tree import TWIST, JointKind, Node, Tree
from truing.simulation.model_text import (
    IdentifiedInSI,
    context_of,
    covariance_from,
    describes,
    effects_of,
    exact,
    model_text,
    read_document,
    toml_value,
)

MECHANISM = "chain"
_AT_ONCE = 500  # poses that are predicted at once, for memory
_COMPONENTS = ("dx", "dy", "dz", "turn_x", "turn_y", "turn_z")
_OWN = (
    "mechanism",
    "tip",
    "readings",
    "closure",
    "gravity",
    "payload_com",
    "payload_kg",
    "reference_temperature_c",
    "lowest",
    "highest",
)


@dataclass(frozen=True)
class ExtendedChain(IdentifiedInSI[ChainCause]):
    """An identified chain: its tree holds the nominal transforms, ``twists`` (N, 6) the identified changes, m and rad.

    The covariance is that of the twists of the nodes ``moved`` (M,), then of the effects. ``tip`` is the node whose
    pose is predicted; the payload of ``payload_kg`` sits at ``payload_com`` (3,) m in its link. ``measured`` (2, n)
    are the ends of the readings of nearly all fitted poses. Beyond them functions of a reading are held, because no
    data show how they continue.
    """

    tree: Tree
    twists: NDArray
    moved: Index
    tip: int
    gravity: NDArray | None
    payload_com: NDArray
    payload_kg: float
    reference_temperature_c: float
    measured: NDArray

    @property
    def identified(self) -> Tree:
        """The tree with identified transforms: links, and joint zeros also beyond their tolerance."""
        twists = self.twists.copy()
        for effect in self.effects:
            if isinstance(effect.cause, JointOffset):
                unit = self.tree.axis_twists[self.tree.readings.index(effect.cause.joint)]
                twists += unit * effect.cause.with_known_part(effect.values)
        return self.tree.with_twists(twists)


def extended_chain(
    model: ChainModel, shared: NDArray, covariance: NDArray, tip: int, context: dict[str, str]
) -> ExtendedChain:
    """Convert a fit, unknowns (G,) with covariance (G, G) in prior sigmas, to the extended model in SI."""
    twists, twists_by_shared = identified_twists(model, shared)
    moved = np.flatnonzero(twists_by_shared.any((1, 2)))
    scales = [twists_by_shared[moved].reshape(TWIST * len(moved), -1)]
    for cause in model.causes:
        part = np.zeros((len(model.effect_sigma(cause)), model.shared_size))
        part[:, model.layout[cause.key]] = np.diag(model.effect_sigma(cause))
        scales.append(part)
    linear = np.concatenate(scales)
    known = model.known
    chain = model.tree.nodes if model.tree.nodes[-1].parent >= 0 else model.tree.nodes[:-1]  # without the stations
    return ExtendedChain(
        replace(model.tree, nodes=chain),
        twists[: len(chain)],
        moved,
        tip,
        known.gravity,
        known.payload[1],
        float(np.median(model.conditions.payload_kg)),
        known.reference_temperature_c,
        usual_range(model.own_conditions.readings),
        effects=model.effects(shared),
        covariance=linear @ covariance @ linear.T,
        context=context,
    )


def identified_twists(model: ChainModel, shared: NDArray) -> tuple[Array, Array]:
    """Return the constant twists (N, 6) of links, their ends and joint zeros, and their derivatives (N, 6, G) by the
    unknowns."""
    slopes = np.zeros((model.tree.size, TWIST, model.shared_size))
    slopes[..., model.layout["links"]] = model.known.modes
    slopes[..., model.layout["shape"]] = model.known.end_twists(model.tree.size)
    zeros = model.tree.axis_twists[model.free_offsets] * model.known.offsets[model.free_offsets][:, None, None]
    slopes[..., model.layout["zeros"]] += np.moveaxis(zeros, 0, -1)
    return np.asarray(slopes @ shared), slopes


@dataclass(frozen=True)
class PredictedTip:
    """Poses R (B, 3, 3), p (B, 3) m of the tip in the base, with the covariance (B, 6, 6) of (p, theta), SI."""

    R: Array
    p: Array
    covariance: Array


def predict_tip(extended: ExtendedChain, conditions: ChainConditions) -> PredictedTip:
    """Return the predicted poses of the tip relative to the base; effects that end with the campaign are omitted."""
    conditions = _corrected(extended, conditions)
    count = len(conditions.readings)
    parts = [
        _predicted(extended, conditions.subset(np.arange(count) // _AT_ONCE == part))
        for part in range(-(-count // _AT_ONCE))
    ]
    return PredictedTip(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("R", "p", "covariance")))


@dataclass(frozen=True)
class _Motions:
    """Motions by one effect: twists (B, N, 6, P) of the nodes per unit, deviations (B, n) of the joints and their
    derivatives (B, n, P); None where none moves."""

    twists: NDArray | None
    deviation: NDArray | None
    slopes: NDArray | None


def _predicted(extended: ExtendedChain, conditions: ChainConditions) -> PredictedTip:
    tree, count = extended.tree, len(conditions.readings)
    motions = _persistent_motions(extended, conditions)
    frames = tree.frames(conditions.readings, _twists(extended, motions, count))
    tip = np.array([extended.tip])
    by_twist = np.concatenate(
        [tree.point_slopes(frames, tip, frames.t[:, tip]), tree.rotation_slopes(frames, tip)], 2
    ).reshape(count, TWIST, -1)
    by_joint = by_twist @ tree.axis_twists.reshape(len(tree.readings), -1).T
    of_effects = []
    for effect, motion in zip(extended.effects, motions, strict=True):
        slopes = np.zeros((count, TWIST, len(effect.values)))
        if motion.twists is not None:
            slopes += by_twist @ motion.twists.reshape(count, by_twist.shape[-1], -1)
        if motion.slopes is not None:
            slopes += by_joint @ motion.slopes
        of_effects.append(slopes)
    design = np.concatenate([by_twist @ _moved_node_slopes(extended), *of_effects], -1)
    covariance = design @ extended.covariance @ np.swapaxes(design, -1, -2)
    return PredictedTip(frames.R[:, extended.tip], frames.t[:, extended.tip], np.asarray(covariance))


def tip_by_joints(extended: ExtendedChain, conditions: ChainConditions) -> Array:
    """Return the derivatives (B, 6, n) of the tip's pose (p, theta) in the base by the readings, m and rad."""
    tree, tip = extended.tree, np.array([extended.tip])
    right = identified_conditions(extended, conditions)
    frames = tree.frames(right.readings, right.deviations)
    return np.asarray(tree.reading_slopes(frames, tip, frames.t[:, tip])[:, 0])


def identified_conditions(extended: ExtendedChain, conditions: ChainConditions) -> ChainConditions:
    """Return conditions whose readings and deviations include identified corrections and persistent effects."""
    right = _corrected(extended, conditions)
    return replace(right, deviations=_twists(extended, _persistent_motions(extended, right), len(right.readings)))


def _corrected(extended: ExtendedChain, conditions: ChainConditions) -> ChainConditions:
    """Return the conditions with the zeros that are known to be far off."""
    readings = conditions.readings
    for cause in extended.causes:
        readings = cause.corrected(readings, extended.tree.readings) if cause.is_persistent else readings
    return replace(conditions, readings=readings)


def _twists(extended: ExtendedChain, motions: Sequence[_Motions], count: int) -> Array:
    twists = np.tile(extended.twists, (count, 1, 1))
    for effect, motion in zip(extended.effects, motions, strict=True):
        if motion.twists is not None:
            twists += motion.twists @ effect.values
        if motion.deviation is not None:
            twists += np.tensordot(motion.deviation, extended.tree.axis_twists, 1)
    return twists


def _persistent_motions(extended: ExtendedChain, conditions: ChainConditions) -> list[_Motions]:
    """Return the motions by each effect; none of an effect that ends with its campaign."""
    tree = extended.tree
    channels = MeasuredChannels(("tip",), (tree.nodes[extended.tip].link,), np.array([extended.tip]), np.zeros(1, bool))
    unloaded = ChainInputs.weightless(
        tree, channels, conditions, extended.reference_temperature_c, np.zeros((1, 3)), np.zeros(0, int)
    )
    machine = replace(unloaded, payload=(extended.tip, extended.payload_com)).under(extended.gravity)
    held = replace(machine, conditions=replace(conditions, readings=np.clip(conditions.readings, *extended.measured)))
    result = []
    for effect in extended.effects:
        cause, inputs = effect.cause, held if effect.cause.is_held_beyond else machine
        motions = (
            cause.twists(inputs),
            cause.deviation(inputs, effect.values),
            cause.deviation_slopes(inputs, effect.values),
        )
        result.append(_Motions(*motions) if cause.is_persistent else _Motions(None, None, None))
    return result


def _moved_node_slopes(extended: ExtendedChain) -> Array:
    found = np.zeros((extended.tree.size, TWIST, TWIST * len(extended.moved)))
    for index, node in enumerate(extended.moved):
        found[node, :, TWIST * index : TWIST * (index + 1)] = np.eye(TWIST)
    return found.reshape(extended.tree.size * TWIST, -1)


def write_chain(extended: ExtendedChain) -> str:
    """Return the model as TOML text."""
    tree = extended.tree
    numbers: dict[str, Any] = {"mechanism": MECHANISM, "tip": tree.nodes[extended.tip].link, "readings": tree.readings}
    if isinstance(tree, ClosedTree):
        numbers["closure"] = tree.closure.name
    if extended.gravity is not None:
        numbers["gravity"] = exact(extended.gravity)
    numbers |= {
        "payload_com": exact(extended.payload_com),
        "payload_kg": extended.payload_kg,
        "reference_temperature_c": extended.reference_temperature_c,
        "lowest": exact(extended.measured[0]),
        "highest": exact(extended.measured[1]),
    }
    tables: list[str] = []
    for k, node in enumerate(tree.nodes):
        entries = {
            "joint": node.joint,
            "link": node.link,
            "below": node.parent,
            "kind": str(node.kind),
            "place": exact(node.t),
            "rotation": exact(log_so3(node.R)),
            "axis": exact(node.axis),
            "follows": node.reading,
            "factor": node.factor,
            "zero": node.shift,
            "mass": node.mass,
            "centre": exact(node.com),
            "identified": exact(extended.twists[k]),
        }
        tables += ["", "[[joints]]  # nominal, m and rad; identified: shift and rotation of the joint's frame"]
        tables += [f"{name} = {toml_value(value)}" for name, value in entries.items()]
    names = [f"{tree.nodes[k].joint or tree.nodes[k].link} {c}" for k in extended.moved for c in _COMPONENTS]
    return model_text(extended, numbers, tables, (), names=names, units="SI", legs=len(tree.readings))


def is_chain(document: dict[str, Any]) -> bool:
    """True if a parsed model.toml is that of a chain."""
    return describes(document, MECHANISM)


def read_chain(text: str) -> ExtendedChain:
    """Read the model from a text of `write_chain`; raises ValueError if the text is no such model."""
    return read_document(text, _from_document)


def _from_document(document: dict[str, Any]) -> ExtendedChain:
    about, effects = document["model"], effects_of(document, catalogue_of_chains())
    nodes = tuple(
        Node(
            row["joint"],
            row["link"],
            int(row["below"]),
            exp_so3(np.array(row["rotation"], float)),
            np.array(row["place"], float),
            JointKind(row["kind"]),
            np.array(row["axis"], float),
            row["follows"],
            float(row["factor"]),
            float(row["zero"]),
            float(row["mass"]),
            np.array(row["centre"], float),
        )
        for row in document["joints"]
    )
    tree = tree_with_loops(Tree(nodes, tuple(about["readings"])), about.get("closure", ""))
    twists = np.array([row["identified"] for row in document["joints"]], float)
    sized = sum(len(effect.values) for effect in effects)
    named = document["covariance"]["names"]
    owners = [name.rsplit(" ", 1)[0] for name in named[: len(named) - sized : TWIST]]
    index_of = {node.joint or node.link: k for k, node in enumerate(nodes)}
    gravity = about.get("gravity")
    return ExtendedChain(
        tree,
        twists,
        np.array([index_of[name] for name in owners], int),
        tree.links[about["tip"]],
        None if gravity is None else np.array(gravity, float),
        np.array(about["payload_com"], float),
        float(about["payload_kg"]),
        float(about["reference_temperature_c"]),
        np.array([about.get("lowest", [-np.inf]), about.get("highest", [np.inf])], float),
        effects=effects,
        covariance=covariance_from(document, len(named)),
        context=context_of(document, _OWN),
    )
