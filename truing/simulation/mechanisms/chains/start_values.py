"""Start values of a chain's unknown places: base in each frame of the measurement, targets and tools in their links."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.rotation import exp_so3, inverse_left_jacobian_so3, log_so3, skew
from truing.simulation.mechanisms.chains.conditions import ChainConditions, MeasuredChannels
from truing.simulation.mechanisms.chains.tree import TWIST, Tree, TreeFrames

_ROUNDS = 60
_SETTLED = 1e-10  # largest step, m and rad
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
    is_observed: Mask,
    surveyed: NDArray,
    base: tuple[NDArray, NDArray] | None = None,
) -> StartValues:
    """Return the best places for channels (B, K, 3) of the nominal chain; ``surveyed`` (K, 3) is NaN where unknown.

    ``base``, R (S, 3, 3) and t (S, 3), is kept if given. Raises ValueError if too few positions were seen.
    """
    is_known = np.isfinite(surveyed).all(1)
    shape = np.where(is_known[:, None], surveyed, 0.0)
    tool = np.tile(np.eye(3), (len(shape), 1, 1))
    problem = _Problem(tree, channels, conditions, values, is_observed, np.flatnonzero(~is_known), base is None)
    R, t = problem.aligned(shape) if base is None else base
    for k in np.flatnonzero(channels.is_rotation):
        tool[k] = problem.mean_tool(R, int(k))
    return problem.refined(_Geometry(R, t, shape, tool))


def errors_at(
    tree: Tree,
    channels: MeasuredChannels,
    conditions: ChainConditions,
    values: NDArray,
    is_observed: Mask,
    start: StartValues,
) -> Array:
    """Errors (B, K, 3), m and rad, of channels at places that were fitted to other poses; NaN where not seen."""
    start_places = _Geometry(start.base_R, start.base_t, start.shape, start.tool)
    problem = _Problem(tree, channels, conditions, values, is_observed, np.arange(0), False)
    return problem.refined(start_places).errors


@dataclass(frozen=True)
class _Geometry:
    """Places of the base R (S, 3, 3), t (S, 3), of the channels (K, 3), and tools' orientations (K, 3, 3)."""

    R: Array
    t: Array
    shape: Array
    tool: Array


@dataclass(frozen=True)
class _Problem:
    """Least squares over the places of the base, if it is free, and of the channels ``free``."""

    tree: Tree
    channels: MeasuredChannels
    conditions: ChainConditions
    values: NDArray
    is_observed: Mask
    free: Index
    is_base_free: bool

    @cached_property
    def _weight(self) -> Array:
        lever = np.where(self.channels.is_rotation, _LEVER_M, 1.0)
        return np.asarray(self.is_observed[..., None] * lever[:, None], float)

    @cached_property
    def _on_base(self) -> TreeFrames:
        """Frames of all nodes on a base that stands in the frame of the measurement."""
        return self.tree.frames(self.conditions.readings, self.conditions.deviations)

    def aligned(self, shape: NDArray) -> tuple[Array, Array]:
        """Return R (S, 3, 3), t (S, 3) of the base that align nominal positions (K, 3) in links with the measured
        ones."""
        frames, conditions = self._on_base, self.conditions
        rows = np.flatnonzero(~self.channels.is_rotation)
        nodes = self.channels.node[rows]
        positions = frames.t[:, nodes] + np.einsum("bkij,kj->bki", frames.R[:, nodes], shape[rows])
        R, t = np.empty((conditions.series.max() + 1, 3, 3)), np.empty((conditions.series.max() + 1, 3))
        for s in range(len(R)):
            used = self.is_observed[:, rows] & (conditions.series == s)[:, None]
            if used.sum() < 3:
                raise ValueError(f"needs at least 3 measured positions in each frame, found {int(used.sum())}")
            fit = umeyama(positions[used][None], self.values[:, rows][used][None])
            R[s], t[s] = fit.R[0], fit.t[0]
            if not np.isfinite(R[s]).all():  # origins that stand still, as those of first links, show no orientation
                R[s] = np.eye(3)
                t[s] = (self.values[:, rows][used] - positions[used]).mean(0)
        return R, t

    def mean_tool(self, base: NDArray, k: int) -> Array:
        """Return the mean orientation (3, 3) of a measured tool in its link, for a base R (S, 3, 3)."""
        inner = np.swapaxes(base[self.conditions.series] @ self._on_base.R[:, self.channels.node[k]], -1, -2)
        total = np.sum((inner @ self.conditions.reference[:, k])[self.is_observed[:, k]], 0)
        left, _, right = np.linalg.svd(total)
        return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)

    def _links(self, places: _Geometry) -> tuple[Array, Array]:
        """Return R (B, K, 3, 3), t (B, K, 3), m, of the links of the channels: the base moves them all equally."""
        R, t = places.R[self.conditions.series], places.t[self.conditions.series]
        nodes, frames = self.channels.node, self._on_base
        return R[:, None] @ frames.R[:, nodes], t[:, None] + np.einsum("bij,bkj->bki", R, frames.t[:, nodes])

    def _predicted(self, places: _Geometry, links: tuple[Array, Array]) -> Array:
        """Return the channels (B, K, 3), m and rad."""
        (R, t), turned = links, self.channels.is_rotation
        found = t + np.einsum("bkij,kj->bki", R, places.shape)
        if turned.any():
            seen = R[:, turned] @ places.tool[turned]
            found[:, turned] = log_so3(seen @ np.swapaxes(self.conditions.reference[:, turned], -1, -2))
        return np.asarray(found)

    def _by_base(self, places: _Geometry, points: NDArray, unrolled: NDArray | None) -> Array:
        """Return the derivatives (B, K, 3, 6) of channels at points (B, K, 3) by the twist of the base.

        ``unrolled``: the inverse left Jacobian of the channels that are orientations; None if none is.
        """
        R, t = places.R[self.conditions.series], places.t[self.conditions.series]
        frames, turned = self._on_base, self.channels.is_rotation
        before, slope = R @ frames.R_before[:, 0], R @ frames.slope[:, 0]
        arms = points - (t + np.einsum("bij,bj->bi", R, frames.origin[:, 0]))[:, None]
        found = np.empty((*points.shape, TWIST))
        found[..., :3] = before[:, None]
        found[..., 3:] = -skew(arms) @ slope[:, None]
        if unrolled is not None:
            found[:, turned, :, :3] = 0.0
            found[:, turned, :, 3:] = unrolled @ slope[:, None]
        return found * self.tree.above[self.channels.node, 0, None, None]

    def _linearised(self, places: _Geometry, links: tuple[Array, Array], found: Array) -> tuple[Array, Array]:
        """Return the weighted derivatives (M, P) by the places, and the weighted misfit (M,).

        ``links``, ``found``: the links and channels at these places, as `_links` and `_predicted` return them."""
        turned, of_places = self.channels.is_rotation, links[0].copy()
        columns: list[Array] = []
        unrolled = None
        if turned.any():
            unrolled = inverse_left_jacobian_so3(found[:, turned])
            of_places[:, turned] = unrolled @ links[0][:, turned] @ places.tool[turned]
        if self.is_base_free:
            by_base = self._by_base(places, found, unrolled)
            if len(places.t) > 1:
                series = np.eye(len(places.t))[self.conditions.series]
                by_base = np.einsum("bs,bkic->bkisc", series, by_base).reshape(*found.shape, -1)
            columns.append(by_base)
        for k in self.free:
            own_k = np.zeros((*found.shape, 3))
            own_k[:, k] = of_places[:, k]
            columns.append(own_k)
        rows = np.concatenate(columns, -1) if columns else np.zeros((*found.shape, 0))
        weight = self._weight
        return (rows * weight[..., None]).reshape(-1, rows.shape[-1]), ((self.values - found) * weight).ravel()

    def _misfit(self, found: Array) -> float:
        """Return the weighted sum of squares of measured less predicted channels (B, K, 3)."""
        return float(np.sum(((self.values - found) * self._weight) ** 2))

    def _moved(self, places: _Geometry, step: NDArray) -> _Geometry:
        """Return the places after a step (P,), m and rad; orientations turn."""
        R, t, shape, tool = places.R, places.t, places.shape.copy(), places.tool.copy()
        if self.is_base_free:
            moved, step = np.split(step, [TWIST * len(t)])
            twists = moved.reshape(-1, TWIST)
            t = t + np.einsum("sij,sj->si", R, twists[:, :3])
            R = R @ exp_so3(twists[:, 3:])
        for k, shift in zip(self.free, step.reshape(-1, 3), strict=True):
            if self.channels.is_rotation[k]:
                tool[k] = tool[k] @ exp_so3(shift)
            else:
                shape[k] += shift
        return _Geometry(R, t, shape, tool)

    def refined(self, places: _Geometry) -> StartValues:
        """Return the places after damped Gauss-Newton steps over all of them."""
        links = self._links(places)
        found = self._predicted(places, links)
        damping, best, is_linearised = 1e-6, self._misfit(found), False
        for _ in range(_ROUNDS if self.is_base_free or len(self.free) else 0):
            if not is_linearised:
                rows, gap = self._linearised(places, links, found)
                normal, gradient = rows.T @ rows, rows.T @ gap
                diagonal, is_linearised = np.diag(normal) + _WEAK, True
            step = np.linalg.solve(normal + np.diag(damping * diagonal + _WEAK**2), gradient)
            moved = self._moved(places, step)
            links_there = self._links(moved)
            found_there = self._predicted(moved, links_there)
            now = self._misfit(found_there)
            if now > best:
                damping *= 10.0
            else:
                places, links, found, is_linearised = moved, links_there, found_there, False
                best, damping = now, max(damping / 10.0, 1e-12)
            if np.abs(step).max() < _SETTLED or damping > 1e6:
                break
        turned = self.channels.is_rotation
        left = np.where(self.is_observed[..., None], self.values - found, np.nan)
        count = max(3 * int(self.is_observed[:, ~turned].sum()), 1)
        misfit = float(np.sqrt(np.sum(left[:, ~turned][self.is_observed[:, ~turned]] ** 2) / count))
        misfit = misfit if np.isfinite(misfit) else np.inf
        spread = _spread(self.values[:, ~turned], self.is_observed[:, ~turned])
        shape = np.where(turned[:, None], 0.0, places.shape)
        return StartValues(places.R, places.t, shape, places.tool, misfit, spread, left)


def _spread(values: NDArray, is_observed: Mask) -> float:
    """Return the root mean square of positions (B, K, 3) about the mean of each channel."""
    count = np.maximum(is_observed.sum(0), 1)[:, None]
    deviation = np.where(is_observed[..., None], values - np.sum(values * is_observed[..., None], 0) / count, 0.0)
    return float(np.sqrt(np.sum(deviation**2) / max(3 * int(is_observed.sum()), 1)))
