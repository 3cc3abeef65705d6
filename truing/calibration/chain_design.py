"""Information of the poses of a chain: its unknowns, hidden combinations, effects of causes and their rivals; choice of
poses.

All of it follows from the derivatives of the diagnosis' own model, whitened by the instrument's noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index
from truing.estimation.design.observability import Observability, inseparable, observe
from truing.estimation.design.pose_selection import (
    DesignBound,
    bound_design,
    efficiency,
    exchange,
    information_of,
    ioops,
    one_by_one,
    rounded_design,
    sum_log_det,
)
from truing.estimation.design.rival_design import Fitted, PointInstrument, PoseCandidates, candidates, narrowed
from truing.inference.observations import whitened_columns
from truing.simulation.cause import OBSERVED
from truing.simulation.mechanisms.chains.causes import ChainCause
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.link_components import along_components
from truing.simulation.mechanisms.chains.model import FREE_TWIST, ChainModel
from truing.simulation.mechanisms.chains.tree import TWIST

_COMPONENTS = ("dx", "dy", "dz", "turn_x", "turn_y", "turn_z")
_MM = 1e-3
# Candidates that exchanges try: those to which the best design is most sensitive.
_POOL = 240
_STARTS = 1
_MOST_NAMED = 3  # poses that are named for one combination
# Share of an effect's square below which the plain unknowns absorb it.
_LEAST_VISIBLE = 1e-8


@dataclass(frozen=True)
class PlannedPoses:
    """B poses of a plain model, as an instrument would measure them; ``candidates``: their whitened derivatives."""

    model: ChainModel
    conditions: ChainConditions
    instrument: PointInstrument

    @property
    def candidates(self) -> PoseCandidates:
        """The poses linearised about the nominal chain."""
        size = self.model.shared_size
        return candidates(Fitted(self.model, np.zeros(size), np.eye(size)), self.conditions, self.instrument)

    @property
    def rows(self) -> Array:
        """Derivatives (B, M, G) per prior sigma, after projection on the poses' own unknowns."""
        candidates = self.candidates
        return np.asarray(candidates.without_pose_unknowns(candidates.rows))

    @property
    def information(self) -> Array:
        """Information (G, G) of the poses, without prior knowledge."""
        flat = self.rows.reshape(-1, self.model.shared_size)
        return np.asarray(flat.T @ flat)


class UnknownKind(StrEnum):
    """Kind of an unknown of a chain."""

    BASE = "base"
    LINK = "link"
    OFFSET = "offset"
    TARGET = "target"
    CAUSE = "cause"


@dataclass(frozen=True)
class ChainUnknown:
    """One unknown, with its prior sigma ``scale`` in ``unit``; without ``is_known`` it only scales the equations."""

    kind: UnknownKind
    subject: str
    parameter: str
    unit: str
    scale: float
    is_known: bool

    @property
    def label(self) -> str:
        """Subject and parameter."""
        return f"{self.subject} {self.parameter}"


def chain_unknowns(model: ChainModel) -> tuple[tuple[ChainUnknown, ...], Array]:
    """Return the G unknowns, and the rotation (G, G) from the model's unknowns to them.

    A number of a link is named by the component of the joint's frame that it changes most.
    """
    turn, unknowns = np.eye(model.shared_size), list[ChainUnknown]()
    series = len(model.known.base_t)
    for s in range(series if model.layout["base"].stop > model.layout["base"].start else 0):
        called = "base" if series == 1 else f"base in series {s + 1}"
        unknowns += [_unknown_of_twist(UnknownKind.BASE, called, c, FREE_TWIST[c], False) for c in range(TWIST)]
    links, start = model.known.modes, model.layout["links"].start
    owner = np.argmax(np.abs(links).max(1), axis=0) if links.size else np.zeros(0, int)
    for node in dict.fromkeys(owner.tolist()):
        indices = np.flatnonzero(owner == node)
        modes, rotation, chosen = along_components(links[node][:, indices])
        turn[np.ix_(start + indices, start + indices)] = rotation
        for index, c in enumerate(chosen):
            size = float(np.abs(modes[c, index]))
            joint = model.tree.nodes[node].joint or model.tree.nodes[node].link
            unknowns.append(_unknown_of_twist(UnknownKind.LINK, joint, c, size, model.known.modes_known))
    for reading in model.free_offsets:
        c = 5 if model.tree.is_revolute[reading] else 0
        zero = _unknown_of_twist(
            UnknownKind.OFFSET, model.tree.readings[reading], c, model.known.offsets[reading], True
        )
        unknowns.append(replace(zero, parameter="offset"))
    unknowns += _unknowns_of_targets(model)
    for cause in model.causes:
        sigma = model.effect_sigma(cause)
        for p, size in zip(cause.parameters(model.part_count), sigma, strict=True):
            called = f"{cause.id} {cause.subject}".strip()
            unknowns.append(ChainUnknown(UnknownKind.CAUSE, called, p.name, p.unit, size / p.si, False))
    return tuple(unknowns), turn


def _unknown_of_twist(kind: UnknownKind, subject: str, component: int, size: float, is_known: bool) -> ChainUnknown:
    unit, si = ("mm", _MM) if component < TWIST // 2 else ("rad", 1.0)
    return ChainUnknown(kind, subject, _COMPONENTS[component], unit, float(size) / si, is_known)


def _unknowns_of_targets(model: ChainModel) -> list[ChainUnknown]:
    unknowns: list[ChainUnknown] = []
    modes = model.known.shape_modes
    for w, known in enumerate(model.known.shape_known):
        indices = np.flatnonzero(np.abs(modes[..., w]).any(1))
        if not len(indices):  # a rotation about the only target of its link
            unknowns.append(_without_effect(model, w, bool(known)))
            continue
        k, axis = int(indices[0]), int(np.argmax(np.abs(modes[indices[0], :, w])))
        size, name, turned = float(np.linalg.norm(modes[k, :, w])), model.channels.names[k], model.channels.is_rotation
        unit, si = ("rad", 1.0) if turned[k] else ("mm", _MM)
        if w < 3 * len(model.channels.names):
            subject = f"target {name}" if name not in ("position", "orientation") else f"{name} of tool"
            unknowns.append(ChainUnknown(UnknownKind.TARGET, subject, "xyz"[axis], unit, size / si, bool(known)))
            continue
        c = (w - 3 * len(model.channels.names)) % TWIST
        subject = f"targets of {model.channels.links[k]}"
        scale = size if c < TWIST // 2 else _angle_of(model, w, k)
        unknowns.append(_unknown_of_twist(UnknownKind.TARGET, subject, c, scale, bool(known)))
    return unknowns


def _without_effect(model: ChainModel, w: int, known: bool) -> ChainUnknown:
    """Unknown twist of a link's end that moves none of its targets."""
    twist = model.known.end_twists(model.tree.size)[..., w]
    node, c = np.unravel_index(int(np.argmax(np.abs(twist))), twist.shape)
    subject = f"targets of {model.tree.nodes[node].link}"
    return _unknown_of_twist(UnknownKind.TARGET, subject, int(c), max(float(np.abs(twist[node, c])), 1e-300), known)


def _angle_of(model: ChainModel, w: int, k: int) -> float:
    """Angle, rad, of a rotation of targets whose channel k moves by its place in the link."""
    arm = np.delete(model.known.shape[k], (w - 3 * len(model.channels.names)) % TWIST - 3)
    reach = float(np.linalg.norm(arm))
    return float(np.linalg.norm(model.known.shape_modes[k, :, w])) / reach if reach > 0.0 else 1.0


class Remedy(StrEnum):
    """Measurement that would show a hidden combination or separate two causes."""

    POSES = "other poses"
    PAYLOAD = "another payload"
    BASE = "targets of known place on the base"
    TARGETS = "known places of the targets"
    NOTHING = "nothing of these"


@dataclass(frozen=True)
class HiddenCombination:
    """Unknowns that data determine less well than prior knowledge does; ``poses``: candidates that would show it, with
    the number of times that each has to be measured. ``members``: the unknowns, each with its change in its unit."""

    text: str
    sigma: float
    remedy: Remedy
    members: tuple[tuple[ChainUnknown, float], ...]
    poses: tuple[int, ...] = ()
    times: tuple[int, ...] = ()


def observability_of(poses: PlannedPoses) -> tuple[tuple[ChainUnknown, ...], Observability]:
    """Return the unknowns, and how the data of the poses alone determine them."""
    unknowns, turn = chain_unknowns(poses.model)
    return unknowns, _observed(poses.rows, unknowns, turn)


def _observed(rows: NDArray, unknowns: Sequence[ChainUnknown], turn: NDArray) -> Observability:
    scale = np.array([unknown.scale for unknown in unknowns])
    flat = rows.reshape(-1, rows.shape[-1]) @ turn
    return observe(flat / scale, scale, [unknown.label for unknown in unknowns])


def hidden_combinations(poses: PlannedPoses, possible: PlannedPoses) -> list[HiddenCombination]:
    """Return the combinations of unknowns that the poses leave less certain than before, the least certain first.

    ``possible`` are candidates that could be measured in addition.
    """
    unknowns, turn = chain_unknowns(poses.model)
    observability, offered = _observed(poses.rows, unknowns, turn), possible.candidates
    every = _observed(offered.without_pose_unknowns(offered.rows), unknowns, turn)
    values, vectors = np.linalg.eigh(np.eye(len(unknowns)) + poses.information)
    covariance = (vectors / np.maximum(values, 1.0)) @ vectors.T
    with np.errstate(divide="ignore", invalid="ignore"):  # of what the groups determine, which is not used here
        groups = inseparable(observability)
    texts = [text for group in groups for text in group.texts]
    ordered = [change for group in groups for change in group.changes]
    known = {label: k for k, label in enumerate(observability.labels)}
    members = [group.labels for group in groups for _ in group.changes]
    combinations = []
    for text, change, labels in zip(texts, ordered, members, strict=True):
        direction = np.zeros(len(unknowns))
        direction[[known[label] for label in labels]] = (
            change / observability.scales[[known[label] for label in labels]]
        )
        own = zip(labels, change, strict=True)
        changes = tuple((unknowns[known[label]], float(size)) for label, size in own if size != 0.0)
        sight = float(observability.sensitivity(direction))
        sigma = 1.0 / sight if sight > observability.rounding else np.inf
        if float(every.sensitivity(direction)) > every.least:
            fitted = replace(offered, fitted=Fitted(poses.model, np.zeros(len(turn)), covariance))
            choice = narrowed(fitted, turn @ direction / np.linalg.norm(direction), 0.5, _MOST_NAMED)
            if choice.is_enough:
                combinations.append(HiddenCombination(text, sigma, Remedy.POSES, changes, choice.chosen, choice.times))
                continue
        remedy = _knowledge_that_shows(observability, unknowns, direction)
        combinations.append(HiddenCombination(text, sigma, remedy, changes))
    return sorted(combinations, key=lambda combination: -combination.sigma)


def _knowledge_that_shows(observability: Observability, unknowns: Sequence[ChainUnknown], direction: NDArray) -> Remedy:
    """Return the numbers that must be known before the rest of a direction (G,) shows."""
    for kind, remedy in ((UnknownKind.BASE, Remedy.BASE), (UnknownKind.TARGET, Remedy.TARGETS)):
        is_of_kind = np.array([unknown.kind is kind for unknown in unknowns])
        remaining = np.where(is_of_kind, 0.0, direction)
        if (
            direction[is_of_kind].any()
            and remaining.any()
            and float(observability.sensitivity(remaining)) > observability.least
        ):
            return remedy
    return Remedy.NOTHING


@dataclass(frozen=True)
class CauseSight:
    """Information of poses on a cause: standard deviation (P,) of its parameters, in plausible scales, and the share of
    its square that the chain's own unknowns do not absorb; ``left`` (N, P): what they leave, whitened."""

    cause: ChainCause
    sigma: Array
    visible: float
    left: Array

    @property
    def signal(self) -> float:
        """Signal of an effect of plausible size that remains after the fit, in sigma of the data."""
        return float(np.linalg.norm(self.left))


def cause_sights(poses: PlannedPoses, causes: Sequence[ChainCause]) -> list[CauseSight]:
    """Return the visibility of causes in the poses, one at a time, with all unknowns of the plain chain free."""
    candidates, model = poses.candidates, poses.model.at(poses.conditions)
    rows = candidates.without_pose_unknowns(candidates.rows)
    flat = rows.reshape(-1, rows.shape[-1])
    covariance = np.linalg.inv(np.eye(flat.shape[1]) + flat.T @ flat)
    at = np.zeros(model.shared_size), np.zeros((len(poses.conditions.readings), model.local_size))
    design, pathways = model.design_matrix(*at), model.pathways(*at)
    measured, frames = poses.instrument.observations(len(poses.conditions.readings))
    shape, sights = measured.values.shape, []
    for cause in causes:
        moved = sum(
            by.reshape(*shape, -1) if name == OBSERVED else pathways[name] @ by[:, None]
            for name, by in design(cause).items()
        )
        columns = candidates.without_pose_unknowns(whitened_columns(measured, frames, np.asarray(moved)))
        flat_columns = columns.reshape(-1, columns.shape[-1])
        shift = covariance @ (flat.T @ flat_columns)
        left = np.concatenate([flat_columns - flat @ shift, -shift])
        total, visible = float(np.sum(flat_columns**2)), float(np.sum(left**2))
        sights.append(CauseSight(cause, _sigma(left), visible / total if total > 0.0 else 0.0, left))
    return sights


def _sigma(left: NDArray) -> Array:
    """Standard deviations (P,) of the parameters of columns (N, P); infinite if they are inseparable."""
    values = np.linalg.svd(left, compute_uv=False)
    if not values[-1] > 1e-9 * max(values[0], 1e-300):
        return np.full(left.shape[1], np.inf)
    return np.sqrt(np.diag(np.linalg.inv(left.T @ left)))


def remaining_parts(sights: Sequence[CauseSight]) -> Array:
    """Return the part (N, N) of an effect a of plausible size that each cause b cannot imitate, in sigma of the data;
    infinite between forms of one cause."""
    bases = [
        np.linalg.qr(sight.left / np.linalg.norm(sight.left))[0] if sight.visible > _LEAST_VISIBLE else 0.0 * sight.left
        for sight in sights
    ]
    distance = np.full((len(sights), len(sights)), np.inf)
    for a, sight in enumerate(sights):
        for b, basis in enumerate(bases):
            if a != b and not sight.cause.excludes(sights[b].cause):
                distance[a, b] = np.linalg.norm(sight.left - basis @ (basis.T @ sight.left))
    return distance


@dataclass(frozen=True)
class ChosenChainPoses:
    """Chosen candidates (N,) as indices, their log determinant with all that was known before, and the proven bound
    over the candidates."""

    chosen: Index
    log_det: float
    bound: DesignBound
    size: int

    @property
    def efficiency(self) -> float:
        """D-efficiency relative to the bound."""
        return efficiency(self.log_det, self.bound.upper, self.size)


def choose_chain_poses(
    rows: NDArray, count: int, existing: NDArray | None, method: str, rng: np.random.Generator
) -> ChosenChainPoses:
    """Choose ``count`` of the candidates with rows (C, M, G), per prior sigma, by largest determinant.

    ``existing`` (G, G): information of the poses that stay in the plan. ``method``: exchange, ioops or random. Priors
    count as known.
    """
    information = (np.eye(rows.shape[-1]) + (0.0 if existing is None else existing))[None]
    blocks = rows[:, None]
    bound = bound_design(blocks, count, information, gap=1e-4)
    start = rng.choice(len(rows), count, replace=len(rows) < count)
    if method == "random":
        chosen = start
    elif method == "ioops":
        chosen = ioops(blocks, start, information).chosen
    else:
        chosen = _exchanged(blocks, count, bound, information, rng)
    return ChosenChainPoses(chosen, sum_log_det(information_of(blocks[chosen], information)), bound, rows.shape[-1])


def _exchanged(blocks: NDArray, count: int, bound: DesignBound, existing: NDArray, rng: np.random.Generator) -> Index:
    """Best exchange from the rounded optimum, from a greedy choice, and from random candidates."""
    support = np.flatnonzero(bound.weights > 1e-6)
    pool = np.union1d(support, np.argsort(bound.sensitivity)[::-1][:_POOL])
    index = np.full(len(blocks), -1)
    index[pool] = np.arange(len(pool))
    candidate_blocks = blocks[pool]
    starts = [index[rounded_design(bound, count)], one_by_one(candidate_blocks, count, bound, existing)]
    starts += [rng.choice(len(pool), count, replace=len(pool) < count) for _ in range(_STARTS)]
    best = max(
        (exchange(candidate_blocks, start, existing) for start in starts), key=lambda selection: selection.log_det
    )
    return np.asarray(pool[best.chosen])
