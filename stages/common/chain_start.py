"""Fit of the nominal chain to measured links: the frames of the poses, and the unknown places of base and targets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.start_values import StartValues, errors_at, start_values
from truing.simulation.mechanisms.chains.tree import JointKind, Tree
from truing.stages.common.chain_measurements import MeasuredLinks, pose_frames, reference_link

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.chain_mechanism import ChainMechanism


_TOLERATED = 3.0  # misfit over that of one standard deviation of every tolerance


def tolerated_misfit(tree: Tree, node: Index, readings: Array, settings: Campaign) -> float:
    """Return the misfit, m, that its tolerances may give a nominal chain before any calibration.

    node (K,): links on which was measured; readings (B, n), rad or m. A number without a tolerance counts as exact.
    """
    tolerance = cast("ChainMechanism", settings.mechanism).tolerance
    angle, zero = np.radians([tolerance.angle_deg or 0.0, tolerance.offset_deg or 0.0])
    shift, slide = 1e-3 * np.array([tolerance.length_mm or 0.0, tolerance.offset_mm or 0.0])
    t, square = tree.frames(readings).t, 0.0
    for k, tree_node in enumerate(tree.nodes):
        if tree_node.kind is not JointKind.FIXED:
            lever = float(np.mean(np.sum((t[:, node] - t[:, k, None]) ** 2, axis=-1)))
            moved = zero**2 * lever if tree_node.kind is JointKind.REVOLUTE else slide**2
            square += 2.0 * angle**2 * lever + 2.0 * shift**2 + moved
    return float(_TOLERATED * np.sqrt(square))


class StartOf(Protocol):
    """Fit of places to some poses."""

    def __call__(self, chosen: Mask, conditions: ChainConditions, /, other: Array | None = None) -> StartValues:
        """Places fitted to poses ``chosen`` (B,), under conditions of all poses; ``other`` replaces the values."""
        ...


@dataclass(frozen=True)
class NominalFit:
    """Frames R (B, 3, 3), t (B, 3) of all poses, the channels of the link that defines them, and the fit.

    Without such a link (``reference`` None) the instrument stood still.

    ``start_of`` fits places to some poses, a mask (B,), under given conditions of all poses, and to other values
    (B, K, 3) if given. ``errors_at``: errors (B, K, 3) of all poses at such places. ``is_base_known``: the reference
    link is the base, with surveyed targets. ``values`` (B, K, 3) are the channels in the frames of the poses,
    ``is_position`` (K,) those in m.
    """

    R: Array
    t: Array
    reference: Index | None
    is_base_known: bool
    start_of: StartOf
    errors_at: Callable[[StartValues, ChainConditions, Array], Array]
    values: Array
    is_position: Mask


def nominal_fit(
    tree: Tree, settings: Campaign, measured: MeasuredLinks, conditions: ChainConditions, fitted: Mask
) -> NominalFit:
    """The fit of the nominal chain; in frames of single poses a measured link is the reference."""
    count, channels = len(measured.values), measured.channels
    values, surveyed = measured.values, measured.surveyed
    R, t = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    base = None
    reference = reference_link(settings, measured)
    if reference is not None:
        R, t = pose_frames(measured, reference, fitted)
        R, t = np.where(np.isfinite(R), R, np.eye(3)), np.nan_to_num(t)
        values = np.einsum("bji,bkj->bki", R, values - t[:, None])
        if channels.node[reference[0]] == 0 and np.isfinite(surveyed[reference]).all():
            base = np.eye(3)[None], np.zeros((1, 3))

    def start_of(chosen: Mask, given: ChainConditions, other: Array | None = None) -> StartValues:
        used, observations = fitted & chosen, values if other is None else other
        return start_values(
            tree, channels, given.subset(used), observations[used], measured.is_observed[used], surveyed, base
        )

    def errors(start: StartValues, given: ChainConditions, observations: Array) -> Array:
        return errors_at(tree, channels, given, observations, measured.is_observed, start)

    return NominalFit(R, t, reference, base is not None, start_of, errors, values, measured.is_position)
