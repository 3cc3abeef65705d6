"""Start values of a chain's unknown places: base in each frame of the measurement, targets and tools in their links."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.chains.conditions import ChainConditions, MeasuredChannels
from truing.simulation.mechanisms.chains.model import FREE_PLACE, FREE_TWIST, ChainModel, KnownChain
from truing.simulation.mechanisms.chains.tree import TWIST, Tree

_ROUNDS = 60
_SETTLED = 1e-9  # largest step, in prior sigmas of 0.05 m and rad
_LEVER_M = 0.1  # weight of an orientation against a position
_WEAK = 1e-7  # of a free place's prior, against residuals in m


@dataclass(frozen=True)
class StartValues:
    """Places of the base R (S, 3, 3), t (S, 3), of the channels (K, 3), and tools' orientations (K, 3, 3); m.

    ``rms`` is the misfit of the chain as described, and ``spread`` that of the measured positions about their mean, m.
    ``errors`` (B, K, 3): measured less predicted, m and rad; NaN where not seen,
    empty where not computed.
    """

    base_R: Array
    base_t: Array
    shape: Array
    tool: Array
    rms: float
    spread: float
    errors: Array = field(default_factory=lambda: np.zeros((0, 0, 3)))


def start_values(
    tree: Tree,
    channels: MeasuredChannels,
    conditions: ChainConditions,
    values: NDArray,
    seen: Mask,
    surveyed: NDArray,
    base: tuple[NDArray, NDArray] | None = None,
) -> StartValues:
    """Return the best places for channels (B, K, 3) of the nominal chain; ``surveyed`` (K, 3) is NaN where unknown.

    ``base``, R (S, 3, 3) and t (S, 3), is kept if given. Raises ValueError if too few positions were seen.
    """
    is_known = np.isfinite(surveyed).all(1)
    shape = np.where(is_known[:, None], surveyed, 0.0)
    tool = np.tile(np.eye(3), (len(shape), 1, 1))
    R, t = _aligned(tree, channels, conditions, values, seen, shape) if base is None else base
    for k in np.flatnonzero(channels.is_rotation):
        tool[k] = _tool(tree, channels, conditions, R, seen, int(k))
    free = np.flatnonzero(~is_known)
    modes = np.zeros((*shape.shape, 3 * len(free)))
    for column, k in enumerate(free):
        modes[k, :, 3 * column : 3 * column + 3] = FREE_PLACE * np.eye(3)
    known = KnownChain(
        base_R=R,
        base_t=t,
        is_base_free=base is None,
        modes=np.zeros((tree.size, TWIST, 0)),
        modes_known=False,
        offsets=np.zeros(len(tree.readings)),
        shape=shape,
        shape_modes=modes,
        shape_known=np.zeros(modes.shape[-1], bool),
        tool=tool,
        reading_sigma=np.zeros(len(tree.readings)),
    )
    return _refined(ChainModel(tree, channels, known, conditions), values, seen)


def _aligned(
    tree: Tree,
    channels: MeasuredChannels,
    conditions: ChainConditions,
    values: NDArray,
    seen: Mask,
    shape: NDArray,
) -> tuple[Array, Array]:
    """Return R (S, 3, 3), t (S, 3) of the base that align the nominal positions with the measured ones."""
    frames = tree.frames(conditions.readings, conditions.deviations)
    own = np.flatnonzero(~channels.is_rotation)
    nodes = channels.node[own]
    places = frames.t[:, nodes] + np.einsum("bkij,kj->bki", frames.R[:, nodes], shape[own])
    R, t = np.empty((conditions.series.max() + 1, 3, 3)), np.empty((conditions.series.max() + 1, 3))
    for s in range(len(R)):
        used = seen[:, own] & (conditions.series == s)[:, None]
        if used.sum() < 3:
            raise ValueError(f"needs at least 3 measured positions in each frame, found {int(used.sum())}")
        fit = umeyama(places[used][None], values[:, own][used][None])
        R[s], t[s] = fit.R[0], fit.t[0]
    return R, t


def _tool(
    tree: Tree, channels: MeasuredChannels, conditions: ChainConditions, base: NDArray, seen: Mask, k: int
) -> Array:
    """Return the mean orientation (3, 3) of a measured tool in its link."""
    turned = tree.frames(conditions.readings, conditions.deviations).R[:, channels.node[k]]
    inner = np.swapaxes(base[conditions.series] @ turned, -1, -2)
    total = np.sum((inner @ conditions.reference[:, k])[seen[:, k]], 0)
    left, _, right = np.linalg.svd(total)
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def _refined(model: ChainModel, values: NDArray, seen: Mask) -> StartValues:
    """Return the places after damped Gauss-Newton steps over all of them."""
    turned, known = model.channels.is_rotation, model.known
    weight = seen[..., None] * np.where(turned, _LEVER_M, 1.0)[:, None]
    shared, local = settled(model, values, weight), np.zeros((len(values), 0))
    places = known.shape + known.shape_modes @ shared[model.layout["shape"]]
    tool = known.tool @ np.where(turned[:, None, None], exp_so3(places), np.eye(3))
    R, t = known.base_R, known.base_t
    if known.is_base_free:
        moved = shared[model.layout["base"]].reshape(-1, TWIST) * FREE_TWIST
        t = t + np.einsum("sij,sj->si", R, moved[:, :3])
        R = R @ exp_so3(moved[:, 3:])
    count = max(3 * int(seen[:, ~turned].sum()), 1)
    left = np.where(seen[..., None], values - model.points(shared, local), np.nan)
    misfit = float(np.sqrt(np.nansum(left[:, ~turned] ** 2) / count))
    return StartValues(
        R, t, np.where(turned[:, None], 0.0, places), tool, misfit, _spread(values[:, ~turned], seen[:, ~turned]), left
    )


def settled(model: ChainModel, values: NDArray, weight: NDArray) -> Array:
    """Return the shared unknowns (G,) of the least-squares fit to values (B, K, d) of given weight, by damped steps."""
    shared, local = np.zeros(model.shared_size), np.zeros((len(values), model.local_size))
    damping, best = 1e-6, _misfit(model, shared, values, weight)
    for _ in range(_ROUNDS if model.shared_size else 0):
        found = model.predict(shared, local)
        rows = (found.by_shared * weight[..., None]).reshape(-1, model.shared_size)
        gap = ((values - found.values) * weight).ravel()
        normal = rows.T @ rows + _WEAK**2 * np.eye(model.shared_size)
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), rows.T @ gap)
        now = _misfit(model, shared + step, values, weight)
        if now > best:
            damping *= 10.0
        else:
            shared, best, damping = shared + step, now, max(damping / 10.0, 1e-12)
        if np.abs(step).max() < _SETTLED or damping > 1e6:
            break
    return shared


def _spread(values: NDArray, seen: Mask) -> float:
    """Return the root mean square of positions (B, K, 3) about the mean of each channel."""
    count = np.maximum(seen.sum(0), 1)[:, None]
    apart = np.where(seen[..., None], values - np.sum(values * seen[..., None], 0) / count, 0.0)
    return float(np.sqrt(np.sum(apart**2) / max(3 * int(seen.sum()), 1)))


def _misfit(model: ChainModel, shared: NDArray, values: NDArray, weight: NDArray) -> float:
    return float(np.sum(((values - model.points(shared, np.zeros((len(values), model.local_size)))) * weight) ** 2))
