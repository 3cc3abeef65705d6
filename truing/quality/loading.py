"""Loading campaign for the quality checks: load steps, residual of each channel, simulated readings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.belonging.counted_times import merely_counts
from truing.estimation.interferometry.combined_loads import (
    ShareOfProducts,
    is_combined,
    p_of_products,
    share_of_products,
)
from truing.estimation.interferometry.flexible_response import ChannelFit, fit_channel, fitted_columns, response_columns
from truing.estimation.interferometry.recorded_steps import CHANNELS, READING_SI, RecordedSteps

TEMPERATURES = ("air_temperature_c", "material_temperature_c")
UNITS = ("um",) * 3 + ("arcsec",) * 3
_MAIN = 0.3  # share of a channel's largest expected answer above which its sign is certain
_CLEAR = 10.0  # least range of an expected answer, in sigmas, for a test of its size
_FEWEST = 6  # fewest readings of a channel that is assessed
_FEWEST_STEPS, _LEAST_FREEDOM = 8, 4  # fewest steps and degrees of freedom for the scatter of a signal
_MOST_STEPS = 8000
_MOSTLY = 0.5  # share of the steps
_FEW = 0.1  # share of a run's steps: where more have no value, the value was not meant to be recorded


@dataclass(frozen=True)
class ChannelView:
    """One channel: rows (N,) of the load steps at which it was read, its runs (R,) by number, index run (N,) into
    these.

    ``declared``: declared noise, SI, NaN where there is none; ``fit``: residuals of its readings after a fit of loads
    and time.
    """

    place: int
    rows: Index
    runs: Index
    run: Index
    declared: float
    fit: ChannelFit

    @property
    def name(self) -> str:
        """Name of the channel: dx .. rz."""
        return CHANNELS[self.place]

    @property
    def unit(self) -> str:
        """Unit of its readings in files."""
        return UNITS[self.place]

    @property
    def noise_ratio(self) -> float:
        """Scatter over declared noise, at least 1; 1 where it is unknown."""
        return float(np.sqrt(max(self.fit.chi_square / self.fit.dof, 1.0))) if self.fit.dof > 0 else 1.0

    @cached_property
    def sigma(self) -> float:
        """Typical noise of its readings, SI."""
        return float(np.median(self.fit.sigma))

    @cached_property
    def of_runs(self) -> tuple[Index, ...]:
        """Readings of each run; steps are in the order of runs."""
        return tuple(np.split(np.arange(len(self.run)), np.flatnonzero(np.diff(self.run)) + 1))

    @property
    def in_files(self) -> float:
        """Factor from SI to the unit in files."""
        return float(1.0 / READING_SI[self.place])


@dataclass(frozen=True)
class ExpectedReadings:
    """Expected readings (B, 6), SI, NaN where unknown; ``at_most``: the largest response that such loads
    could cause."""

    value: Array
    at_most: Array | None = None

    @cached_property
    def _span(self) -> Array:
        known = np.isfinite(self.value)
        return np.maximum(
            np.max(self.value, axis=0, where=known, initial=-np.inf)
            - np.min(self.value, axis=0, where=known, initial=np.inf),
            0.0,
        )

    def is_clear(self, channel: int, rows: Index, sigma: float) -> bool:
        """Return True if a channel's answer at some rows is a main one and clearly above the noise sigma."""
        answer = self.value[rows, channel]
        if not np.ptp(answer) > max(_MAIN * self._span[channel], _CLEAR * sigma):
            return False
        # a small cross response may have either sign in a real sensor
        return self.at_most is None or bool(np.abs(answer).max() > _MAIN * self.at_most[rows, channel].max())


@dataclass(frozen=True)
class LoadingView:
    """Load steps of a campaign, and simulated readings (None where there are none).

    The largest possible response follows from the energy that the loads store.
    """

    steps: RecordedSteps
    simulated: ExpectedReadings | None
    load_sigma: Array

    @cached_property
    def channels(self) -> tuple[ChannelView, ...]:
        """All channels that were read, in the order dx .. rz."""
        around = self._around()
        is_observed = np.isfinite(self.steps.reading)
        return tuple(
            self._channel(k, is_observed[:, k], around) for k in range(6) if is_observed[:, k].sum() >= _FEWEST
        )

    def is_combined(self, channel: ChannelView) -> bool:
        """Return True if most steps of a channel load several axes at once."""
        return bool(np.mean(is_combined(self.steps.load[channel.rows])) > _MOSTLY)

    def response(self, channel: ChannelView) -> float:
        """Return the rms of a channel's readings about the mean of each run, SI."""
        reading = self.steps.reading[channel.rows, channel.place]
        about = [reading[mine] - reading[mine].mean() for mine in channel.of_runs]
        return float(np.sqrt(np.mean(np.concatenate(about) ** 2)))

    def p_of_products(self, channels: Sequence[ChannelView]) -> float:
        """Return the p-value of residuals of some channels if they are noise, against products of loads; NaN for
        none."""
        found = (self._share_of_products(channel) for channel in channels)
        return p_of_products([share for share in found if share is not None])

    def _share_of_products(self, channel: ChannelView) -> ShareOfProducts | None:
        rows, fit, kept = channel.rows, channel.fit, channel.fit.kept
        load, time_s = self.steps.load[rows], self.steps.time_s[rows]
        groups = response_columns(load, channel.run, time_s, self._around()[rows])
        removed = fitted_columns(groups, channel.run, time_s)[kept] / fit.sigma[kept, None]
        standardized = fit.residual[kept] / fit.sigma[kept]
        return share_of_products(standardized, removed, load[kept], channel.run[kept], channel.place)

    def _around(self) -> Array:
        """Return the recorded temperatures (N, C)."""
        known = [name for name in TEMPERATURES if name in self.steps.covariates]
        return np.column_stack([self.steps.covariates[name] for name in known] or [np.zeros((len(self.steps.run), 0))])

    def _channel(self, k: int, is_observed: Mask, around: Array) -> ChannelView:
        steps = self.steps.subset(is_observed)
        runs, run = np.unique(steps.run, return_inverse=True)
        groups = response_columns(steps.load, run, steps.time_s, around[is_observed])
        reading, sigma = steps.reading[:, k], steps.sigma[:, k]
        fit = fit_channel(reading, sigma, groups, run, steps.time_s, steps.load, self.load_sigma)
        known = np.isfinite(sigma)
        declared = float(np.median(sigma[known])) if known.any() else float("nan")
        return ChannelView(k, np.flatnonzero(is_observed), runs, run, declared, fit)

    def run_name(self, run: int) -> str:
        """Return the name of a run in the campaign."""
        return f"run {self.steps.runs[run]}"

    def places(self, rows: Iterable[int]) -> list[str]:
        """Return run and step of rows (n,) in words."""
        return [f"{self.run_name(self.steps.run[row])} step {self.steps.step[row]}" for row in rows]

    @cached_property
    def is_counted(self) -> bool:
        """True if times merely count the steps of every run."""
        return merely_counts(self.steps.time_s, self.steps.step, self.steps.run)

    @cached_property
    def axis(self) -> Index:
        """Axis (R,) that each run loads most, relative to the campaign's largest loads; -1 where none is loaded."""
        share = np.abs(self.steps.load) / np.maximum(np.abs(self.steps.load).max(axis=0, initial=0.0), 1e-300)
        most = np.zeros((len(self.steps.runs), 6))
        np.maximum.at(most, self.steps.run, share)
        return np.where(most.any(axis=1), most.argmax(axis=1), -1)

    @cached_property
    def loaded_alone(self) -> Mask:
        """True for runs (R,) that load a single axis."""
        loaded = np.zeros((len(self.steps.runs), 6), dtype=bool)
        np.logical_or.at(loaded, self.steps.run, self.steps.load != 0.0)
        return loaded.sum(axis=1) == 1


@dataclass(frozen=True)
class Programme:
    """A load programme run more than once: its first run, chi-square and degrees of freedom over all runs."""

    run: str
    square: float
    freedom: float


def repeated_programmes(view: LoadingView, channel: ChannelView) -> Iterator[Programme]:
    """Return load programmes that a channel was read in more than once, and the scatter of its runs."""
    steps = view.steps
    alike: dict[bytes, list[Index]] = {}
    for places in channel.of_runs:
        alike.setdefault((steps.load[channel.rows[places]].round(9) + 0.0).tobytes(), []).append(places)
    for group in (np.array(rows) for rows in alike.values() if len(rows) > 1):
        used = channel.fit.kept[group].all(axis=0)
        if used.sum() < 2:
            continue
        values = steps.reading[channel.rows[group], channel.place][:, used]
        residual = values - values.mean(axis=1, keepdims=True)
        residual = residual - residual.mean(axis=0)
        square = float(np.sum((residual / channel.fit.sigma[group][:, used]) ** 2))
        first = int(steps.run[channel.rows[group[0][0]]])
        yield Programme(view.run_name(first), square, (len(group) - 1.0) * (float(used.sum()) - 1.0))


def scatter_of_signal(view: LoadingView, at: int, sigma: float) -> float:
    """Return the scatter of one signal over sigma, from at most 8,000 steps; NaN where too few determine it."""
    there = np.isfinite(view.steps.signal[:, at])
    if there.sum() < _FEWEST_STEPS:
        return float("nan")
    # Every n-th step scatters alike, and a robust fit to 100,000 samples would take minutes.
    steps = view.steps.subset(_thinned(there))
    run = np.unique(steps.run, return_inverse=True)[1]
    groups = response_columns(steps.load, run, steps.time_s, np.zeros((len(run), 0)))
    declared = np.full(len(run), sigma)
    fit = fit_channel(steps.signal[:, at], declared, groups, run, steps.time_s, steps.load, view.load_sigma)
    return float(np.sqrt(fit.chi_square / fit.dof)) if fit.dof >= _LEAST_FREEDOM else float("nan")


def _thinned(there: Mask) -> Mask:
    """Return a mask (N,) with every n-th of its rows, so that at most _MOST_STEPS are left."""
    rows = np.flatnonzero(there)
    left = np.zeros(len(there), bool)
    left[rows[:: max(-(-len(rows) // _MOST_STEPS), 1)]] = True
    return left


def predicted_by_loads(load: Array, value: Array) -> Array:
    """Return a signal (N,) fitted by its loads (N, 6) and a zero."""
    design = np.column_stack([load / np.maximum(np.abs(load).max(axis=0), 1e-300), np.ones(len(load))])
    return np.asarray(design @ np.linalg.lstsq(design, value, rcond=None)[0])


def steps_without(run: Index, values: Array) -> Index:
    """Return the few steps (N,) without values in a table (B, K), in runs (B,) that mostly have them."""
    there = np.isfinite(values).any(axis=1)
    lost = np.flatnonzero(~there & np.isin(run, np.unique(run[there])))
    return lost if len(lost) <= _FEW * there.sum() else lost[:0]


def first_steps(view: LoadingView) -> Index:
    """Return the number (R,) of the first step of each run; the lowest one where most runs begin with it."""
    steps = view.steps
    first = np.full(len(steps.runs), np.iinfo(np.int64).max)
    np.minimum.at(first, steps.run, steps.step)
    return np.full(len(first), first.min()) if np.mean(first == first.min()) > 0.5 else first
