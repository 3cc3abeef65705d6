"""Load steps of a bench (`LoadSteps`) with their history run by run, and the state of the simulated chain
(`ReadingState`)."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.simulation.air import edlen_index, vapour_pressure_pa
from truing.simulation.inputs import TIME

CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz")
LINEAR = 3  # number of channels of displacements; the others are angles
LOADS = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
IN_RUN = "time_in_run_s"
MATERIAL, AIR, PRESSURE, HUMIDITY = (
    "material_temperature_c",
    "air_temperature_c",
    "air_pressure_hpa",
    "relative_humidity_pct",
)
# Ordinary air, for missing columns: a constant offset has hardly any effect.
_ORDINARY = {AIR: 20.0, PRESSURE: 1013.25, HUMIDITY: 50.0}
# Least length of a break, in usual pauses.
_BREAK = 5.0


@dataclass(frozen=True)
class LegElasticity:
    """Stiffness of the legs' parts with names (P,), at the platform's origin: parts (6, P, 6, 6), SI.

    compliance (6, 6) is that of all legs together.
    """

    names: tuple[str, ...]
    parts: NDArray
    compliance: NDArray


@dataclass(frozen=True)
class LoadSteps:
    """B load steps of some runs, each run's in time order; K channels, the platform's six first. SI.

    load (B, 6) as declared; largest (6,) of each axis; ``motion`` (B, 6) and ``signals`` (B, K - 6), V, without zeros,
    as the plain simulation predicts them; ``sigma`` (K,) the noise; covariates (B,) the columns known at each step.
    """

    run: NDArray  # (B,) labels
    step: NDArray  # (B,) labels
    time_s: NDArray
    load: NDArray
    largest: NDArray
    covariates: Mapping[str, NDArray]
    channels: tuple[str, ...]
    sigma: NDArray
    motion: NDArray
    signals: NDArray
    wavelength_m: float
    legs: LegElasticity | None = None  # if the elements of the legs are known
    arms: Mapping[str, tuple[float, ...]] = field(default_factory=dict)  # m, of the first of two units, by load axis

    @cached_property
    def functions(self) -> dict[Hashable, NDArray]:
        """Values (B, m) of functions of these steps, by the effects that follow them."""
        return {}

    @cached_property
    def code(self) -> NDArray:
        """Number (B,) of each step's run, in order of appearance."""
        _, first, inverse = np.unique(self.run, return_index=True, return_inverse=True)
        return np.asarray(np.argsort(np.argsort(first))[inverse])

    @cached_property
    def _in_run(self) -> list[NDArray]:
        """Steps (n,) at each position in their runs."""
        return [np.flatnonzero(self.rank == index) for index in range(int(self.rank.max(initial=-1)) + 1)]

    @cached_property
    def rank(self) -> NDArray:
        """Position (B,) of each step in its run, from 0."""
        order = np.lexsort((np.arange(len(self.run)), self.code))
        starts = np.flatnonzero(np.diff(self.code[order], prepend=-1))
        rank = np.empty(len(order), int)
        rank[order] = np.arange(len(order)) - np.repeat(starts, np.diff(np.append(starts, len(order))))
        return rank

    @cached_property
    def before(self) -> NDArray:
        """Index (B,) of the previous step in the run; its own for the first."""
        order = np.lexsort((self.rank, self.code))
        before = np.empty(len(order), int)
        before[order] = np.where(self.rank[order] == 0, order, np.roll(order, 1))
        return before

    @cached_property
    def first(self) -> NDArray:
        """Index (B,) of the first step of each step's run."""
        starts = np.flatnonzero(self.rank == 0)
        of_run = np.empty(len(starts), int)
        of_run[self.code[starts]] = starts
        return of_run[self.code]

    @property
    def in_run_s(self) -> NDArray:
        """Time (B,) since the start of the run, s."""
        return np.asarray(self.time_s - self.time_s[self.first])

    @property
    def held_s(self) -> NDArray:
        """Time (B,) since the previous step, for which the load was held, s; 0 for a run's first."""
        return np.asarray(self.time_s - self.time_s[self.before])

    @cached_property
    def since_break_s(self) -> NDArray:
        """Time (B,) since the last break in the run, s; infinite before any.

        A break is a pause of several usual ones.
        """
        hold_times = self.held_s
        usual = float(np.median(hold_times[hold_times > 0.0])) if np.any(hold_times > 0.0) else np.inf
        last = np.where(hold_times > _BREAK * usual, self.time_s, -np.inf)
        for step in self._in_run[1:]:
            last[step] = np.maximum(last[step], last[self.before[step]])
        return np.asarray(self.time_s - last)

    @property
    def is_timed(self) -> bool:
        """True if times were recorded: others only count the steps, and are no seconds."""
        return TIME in self.covariates and bool(np.isfinite(self.time_s).all())

    @property
    def longest_s(self) -> float:
        """Duration of the longest run, s."""
        return float(self.in_run_s.max(initial=0.0))

    @property
    def share(self) -> NDArray:
        """Loads (B, 6) over the largest of their axes, with their signs."""
        return np.asarray(self.load / self.largest)

    @cached_property
    def unloading(self) -> NDArray:
        """Mask (B, 6) of loads smaller in size than at the previous step; a held load keeps the previous value."""
        size = np.abs(self.load)
        is_unloading = size < size[self.before]
        is_equal = size == size[self.before]
        for step in self._in_run[1:]:
            is_unloading[step] |= is_equal[step] & is_unloading[self.before[step]]
        return is_unloading

    @cached_property
    def direction(self) -> NDArray:
        """Sign (B, 6) of the last change of each load in its run, -1 or 1; 0 before any change."""
        sign = np.sign(self.load - self.load[self.before])
        for step in self._in_run[1:]:
            sign[step] = np.where(sign[step] == 0.0, sign[self.before[step]], sign[step])
        return sign

    @cached_property
    def largest_so_far(self) -> NDArray:
        """Largest size (B, 6) of each load so far in its run, N and N m."""
        largest = np.abs(self.load)
        for step in self._in_run[1:]:
            largest[step] = np.maximum(largest[step], largest[self.before[step]])
        return largest

    @property
    def loaded(self) -> NDArray:
        """Mask (6,) of the axes that are ever loaded."""
        return np.any(self.load != 0.0, 0)

    def since_first(self, column: str) -> NDArray:
        """Return the change (B,) of a column since the run's first step."""
        values = np.asarray(self.covariates[column], float)
        return np.asarray(values - values[self.first])

    def varies(self, column: str) -> bool:
        """True if a column is known at all steps and changes within a run."""
        values = self.covariates.get(column)
        return values is not None and bool(np.isfinite(values).all()) and bool(np.any(self.since_first(column) != 0.0))

    @cached_property
    def index_since_first(self) -> NDArray:
        """Change (B,) of the air's refractive index since the run's first step."""
        ordinary = np.ones(len(self.run))
        air = {name: np.asarray(self.covariates.get(name, usual * ordinary)) for name, usual in _ORDINARY.items()}
        vapour = vapour_pressure_pa(air[AIR], 0.01 * air[HUMIDITY])
        index = edlen_index(self.wavelength_m, air[AIR], 100.0 * air[PRESSURE], vapour)
        return np.asarray(index - index[self.first])

    @property
    def air_varies(self) -> bool:
        """True if the air's refractive index is known to change within a run."""
        return any(self.varies(column) for column in (AIR, PRESSURE))

    def lagging(self, threshold: float, *, exercised: bool) -> tuple[NDArray, NDArray]:
        """Return the lag (B, 6) of a play operator behind the loads, over its threshold, and its derivative by log
        threshold.

        The threshold is a share of the largest load. Each run starts from rest without load; ``exercised``: from the
        state that the same run would leave.
        """
        key = threshold, exercised
        if key not in self._lags:
            self._lags[key] = self._lagging(threshold, exercised)
        return self._lags[key]

    @cached_property
    def _lags(self) -> dict[tuple[float, bool], tuple[NDArray, NDArray]]:
        """Cache of `lagging`: every search uses the same few thresholds."""
        return {}

    def _lagging(self, threshold: float, exercised: bool) -> tuple[NDArray, NDArray]:
        share = self.share
        ahead, slope = np.zeros(share.shape), np.zeros(share.shape)
        for again in (False, True) if exercised else (False,):
            for index, rows_of_step in enumerate(self._in_run):
                before, at_rest = (
                    self.before[rows_of_step] if index else self._last_in_run[rows_of_step],
                    not (index or again),
                )
                free = share[rows_of_step] if at_rest else ahead[before] + share[rows_of_step] - share[before]
                slope_before = 0.0 if at_rest else slope[before]
                slope[rows_of_step] = np.where(np.abs(free) < threshold, slope_before, np.sign(free))
                ahead[rows_of_step] = np.clip(free, -threshold, threshold)
        return ahead / threshold, slope - ahead / threshold

    @cached_property
    def _last_in_run(self) -> NDArray:
        """Index (B,) of the last step of each step's run."""
        last = np.empty(int(self.code.max(initial=-1)) + 1, int)
        order = np.lexsort((self.rank, self.code))
        last[self.code[order]] = order
        return last[self.code]

    def filtered(self, values: NDArray, decay: NDArray) -> NDArray:
        """Return values (B, ...) after a first-order lag within each run: y = decay y_before + (1 - decay) value,
        from 0.

        decay (B,) is the factor of the previous state at each step.
        """
        follows = np.zeros(values.shape, np.result_type(values, decay))
        wide = decay.reshape(-1, *([1] * (values.ndim - 1)))
        gain = (1.0 - wide) * values
        for step in self._in_run:
            state_before = follows[self.before[step]] if step is not self._in_run[0] else 0.0
            follows[step] = wide[step] * state_before + gain[step]
        return follows


@dataclass(frozen=True)
class ReadingState:
    """State of the chain at B load steps, SI.

    wrench (B, 6) as truly applied; deflection (B, 6, 6): response by load axis; readings (B, K): the platform's
    displacement and rotation vector, then signals, as recorded so far. Fields of later steps of the chain are empty.
    """

    steps: LoadSteps
    wrench: NDArray
    deflection: NDArray
    readings: NDArray
