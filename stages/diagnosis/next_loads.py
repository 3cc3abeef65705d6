"""Candidates for the next measurement on a bench: runs of loads within its range, and their description."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from truing.arrays import TableRow
from truing.estimation.design.rival_design import Fitted, PoseCandidates, Readout, Runs, run_candidates
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS
from truing.estimation.sensor.load_cases import LoadLimits, bench_loads
from truing.report.numbers import duration
from truing.simulation.bench.known_readings import ChannelZeros, ReadingConditions
from truing.simulation.bench.model import BenchModel
from truing.stages.common.reading_arrays import LOAD_COLUMNS

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel
    from truing.schemas.campaign import Campaign

Array = NDArray[np.float64]

# Shares of the largest load, step by step: there and back, both ways, and held for what goes on under a load.
_THERE = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0])
_BOTH = np.array([0.0, 0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0])
_HELD = np.array([0.0, *[1.0] * 7, 0.0])
_STEPS = len(_THERE)
_LARGE, _SMALL = 1.0, 0.1  # of the range; the effect of a clearance is largest near zero
_AT_ONCE = 2
# A slow run takes this many times as long; a temperature that is let go changes by this many kelvin within a run.
_SLOWER = 8.0
_WARMER_K = 1.0
_TEMPERATURE = "_temperature_c"
# What moves no reading by this many sigma does not matter to a model.
_MATTERS = 0.1
_PAUSE_S = 3600.0
# Loads are asked for to this many digits, and are the same within this many sigmas, or within what rounding leaves.
_DIGITS, _SAME, _ROUNDED = 3, 3.0, 0.01
_TINY = 1e-9
_USUAL_S = 60.0  # between steps, where no run has two of them


@dataclass(frozen=True)
class _Run:
    """One run: loads (S, 6), duration of a step, a column with its even change, and words for both.

    ``repeats``: measured runs that hold all of these loads; empty where one of them is new.
    """

    load: Array
    loads_in_words: str
    step_s: float
    changing: str = ""
    words: str = ""
    repeats: str = ""


@dataclass(frozen=True)
class PossibleRuns:
    """Candidates: runs of ``_STEPS`` steps, their channels, and the noise of further readings."""

    runs: Runs
    made: tuple[_Run, ...]
    readout: Readout
    channels: tuple[str, ...]
    is_timed: bool = True  # False if the campaign's times only count its steps: then no duration is known

    what: ClassVar[tuple[str, str]] = ("load programme", "load programmes")
    unit: ClassVar[str] = "run"
    each: ClassVar[str] = "run"
    do: ClassVar[str] = "apply"
    pace: ClassVar[str] = "of loading"

    def linearised(self, fitted: Fitted) -> PoseCandidates:
        """Return the candidates linearised about a fitted model."""
        return run_candidates(fitted, self.runs, self.readout)

    def words_of(self, k: int) -> str:
        """Return a candidate in words: loads, procedure, and channels if not all are read."""
        run = self.made[self.runs.run[k]]
        channels = [name for name in self._read(k) if name in CHANNELS]
        reading = f"reading {' '.join(channels)}" if 0 < len(channels) < len(CHANNELS) else ""
        again = f"loads as in run{'s' * (', ' in run.repeats)} {run.repeats}" if run.repeats else ""
        return ", ".join(filter(None, (run.loads_in_words, run.words, reading, again)))

    def sets_conditions(self, k: int) -> bool:
        """True if a temperature must change within the run."""
        return bool(self.made[self.runs.run[k]].changing)

    def seconds(self, times: Mapping[int, int]) -> float | None:
        """Return the duration of runs, with repeats, at the pace of their steps and without pauses between them, s.

        None if no times were recorded.
        """
        if not self.is_timed:
            return None
        return sum(_STEPS * self.made[self.runs.run[k]].step_s * times_of_run for k, times_of_run in times.items())

    def rows(self, k: int) -> list[TableRow]:
        """Return the steps of a candidate as rows of next_loads.parquet."""
        run = self.made[self.runs.run[k]]
        return [
            {
                "step": step,
                "time_s": round(run.step_s * step, 3),
                **dict(zip(LOAD_COLUMNS, map(float, run.load[step] + 0.0), strict=True)),
                "branch": branch,
                "channels": " ".join(self._read(k)),
                "conditions": run.words or None,
                "repeat_of": run.repeats or None,
            }
            for step, branch in enumerate(_branches(run.load))
        ]

    def _read(self, k: int) -> list[str]:
        return [self.channels[channel] for channel in self.runs.reads[k]]


def _branches(load: Array) -> Iterator[str]:
    """Yield the branch of each step, up or back; a held load keeps its branch."""
    size, branch = np.abs(load).sum(1), "loading"
    for step, load_size in enumerate(size):
        if step and load_size != size[step - 1]:
            branch = "loading" if load_size > size[step - 1] else "unloading"
        yield branch if load_size else "unloaded"


def next_run(fitted: FittedModel) -> Fitted:
    """The fit of a bench for further runs, without the zeros of past runs."""
    model = fitted.model
    assert isinstance(model, BenchModel)
    none = ChannelZeros(np.array([], model.conditions.run.dtype), np.array([], int), np.zeros(0), np.zeros(0, bool))
    without_zeros = np.setdiff1d(np.arange(model.shared_size), np.arange(model.shared_size)[model.layout["zero"]])
    later = replace(model, known=replace(model.known, zeros=none))
    return Fitted(later, fitted.fit.shared[without_zeros], fitted.covariance()[np.ix_(without_zeros, without_zeros)])


def possible_runs(settings: Campaign, current: FittedModel, models: Sequence[Fitted]) -> PossibleRuns:
    """Return the possible next runs on the bench of a fit, to compare models."""
    model = current.model
    assert isinstance(model, BenchModel)
    readout, is_observed = _readout(current, model), current.measured.is_observed
    least = np.repeat([settings.noise.load_n, settings.noise.load_nm], 3)
    plain = [_as_measured(run, model, least) for run in _plain_runs(settings, model, least)]
    made = list(plain)
    for condition in _runs_under_other_conditions(model, plain):
        if any(_predicts_difference(fitted, plain, condition, readout.sigma) for fitted in models):
            made += condition
    reads = _reads(model, is_observed)
    run, read = (index.ravel() for index in np.indices((len(made), len(reads))))
    return PossibleRuns(
        Runs(_conditions(model, made), _STEPS, run, reads[read]),
        tuple(made),
        readout,
        model.known.channels,
        model.conditions.is_timed,
    )


def _readout(fitted: FittedModel, model: BenchModel) -> Readout:
    """Noise of readings in the fit, and prior of the zeros of runs."""
    known, is_observed = model.known, fitted.measured.is_observed
    variance = np.where(is_observed, fitted.measured.covariance[..., 0, 0], 0.0).sum(0) / np.maximum(
        is_observed.sum(0), 1
    )
    sigma = np.where(is_observed.any(0), np.sqrt(variance), known.sigma)
    zero = sigma.copy()
    zero[known.zeros.channel] = known.zeros.sigma
    return Readout(sigma, zero)


def _reads(model: BenchModel, is_observed: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Channels read in a run (N', N): all at once as in the campaign, or one of them with all signals."""
    ever = np.flatnonzero(is_observed.any(0))
    platform, signals = ever[ever < len(CHANNELS)], ever[ever >= len(CHANNELS)]
    in_run = np.zeros((int(model.steps.code.max()) + 1, len(platform)), bool)
    np.logical_or.at(in_run, model.steps.code, is_observed[:, platform])
    if len(platform) and in_run.sum(1).max() == 1:
        return np.array([[channel, *signals] for channel in platform])
    return ever[None]


def _as_measured(run: _Run, model: BenchModel, least: Array) -> _Run:
    """A run with the names of measured runs that contain all its loads, within the uncertainty of loads."""
    measured, runs = model.conditions.load, model.conditions.run
    difference = np.abs(run.load[:, None] - measured) <= np.maximum(_SAME * least, _ROUNDED * np.abs(run.load[:, None]))
    same = difference.all(-1)[run.load.any(1)]
    if not len(same) or not same.any(1).all():
        return run
    by_run = {name: same[:, runs == name].any(1) for name in dict.fromkeys(runs.tolist())}
    most = max(by_run, key=lambda name: by_run[name].sum())
    others = {runs[np.flatnonzero(is_same)[0]] for is_same in same[~by_run[most]]}
    return replace(run, repeats=", ".join(map(str, [most, *sorted(others)])))


def _plain_runs(settings: Campaign, model: BenchModel, least: Array) -> Iterator[_Run]:
    """Runs at the usual pace: of every axis that can be loaded there and back, both ways, near zero, and held.

    Loads are round numbers, and none is smaller than ``least`` (6,), what loads are known to.
    """
    steps = model.steps
    declared = np.array([getattr(settings.loading, name) is not None for name in LOAD_COLUMNS])
    usable = np.flatnonzero(declared | steps.loaded)
    at_once = min(int((steps.load != 0.0).sum(1).max()), _AT_ONCE)
    pace = float(np.median(steps.held_s[steps.rank > 0])) if (steps.rank > 0).any() else _USUAL_S
    yield _Run(np.zeros((_STEPS, len(LOADS))), "without load", pace)
    for peak in bench_loads(LoadLimits(steps.largest[usable]), np.array([_LARGE]), max(at_once, 1)):
        load = np.zeros(len(LOADS))
        load[usable] = _round(peak)
        yield _Run(_THERE[:, None] * load, _words(load, "{axis} 0 .. {peak:+g} .. 0 {unit}"), pace)
        if (load != 0.0).sum() > 1:
            continue
        yield _Run(_HELD[:, None] * load, _words(load, "{axis} held at {peak:+g} {unit}"), pace)
        if load.sum() > 0.0:
            for share in (_LARGE, _SMALL):
                if share * load.sum() <= _SAME * least[load > 0.0].sum():
                    continue
                description = _words(share * load, "{axis} 0 .. {peak:+g} .. {other:+g} .. 0 {unit}")
                yield _Run(_BOTH[:, None] * share * load, description, pace)


def _round(load: Array) -> Array:
    """Loads towards zero to a few digits."""
    size = np.where(load, np.abs(load), 1.0)
    last = 10.0 ** (np.floor(np.log10(size)) - _DIGITS + 1)
    return np.asarray(np.trunc(load / last * (1.0 + _TINY)) * last)


def _words(load: Array, form: str) -> str:
    applied = [(axis, float(value)) for axis, value in zip(LOADS, load, strict=True) if value]
    texts = [form.format(axis=a, peak=v, other=-v, unit="N" if a.startswith("f") else "N m") for a, v in applied]
    return " with ".join(texts)


def _runs_under_other_conditions(model: BenchModel, plain: Sequence[_Run]) -> Iterator[list[_Run]]:
    """The same runs at a slower pace, if the usual one is known, and with a changing temperature."""
    slow = f"a step every {duration(_SLOWER * plain[0].step_s)}"
    if model.conditions.is_timed:
        yield [replace(run, step_s=_SLOWER * run.step_s, words=slow) for run in plain]
    for name in model.conditions.covariates:
        if name.endswith(_TEMPERATURE):
            words = f"while {name} changes by {_WARMER_K:g} K"
            yield [replace(run, changing=name, words=words) for run in plain]


def _predicts_difference(fitted: Fitted, plain: Sequence[_Run], other: Sequence[_Run], sigma: Array) -> bool:
    """True if a model predicts other readings for runs under other conditions."""
    model: BenchModel = fitted.model
    local = np.zeros((len(plain) * _STEPS, model.local_size))
    usual, then = (model.at(_conditions(model, runs)).points(fitted.shared, local)[..., 0] for runs in (plain, other))
    return bool(np.max(np.abs(then - usual) / sigma) > _MATTERS)


def _conditions(model: BenchModel, made: Sequence[_Run]) -> ReadingConditions:
    """The steps of runs that each begin after all that was measured; columns stay as they mostly were."""
    conditions, count = model.conditions, len(made)
    start = float(np.max(conditions.time_s)) + _PAUSE_S
    share = np.arange(_STEPS) / (_STEPS - 1)
    covariates = {
        name: np.concatenate([_middle(values) + (run.changing == name) * _WARMER_K * share for run in made])
        for name, values in conditions.covariates.items()
    }
    return ReadingConditions(
        np.repeat(_labels(conditions.run, count), _STEPS),
        np.tile(np.arange(_STEPS), count),
        np.concatenate([start + run.step_s * np.arange(_STEPS) for run in made]),
        np.concatenate([run.load for run in made]),
        covariates,
        conditions.span_s,
    )


def _labels(run: NDArray, count: int) -> NDArray:
    """Unused names for runs (count,), in the style of the measured ones."""
    if np.issubdtype(run.dtype, np.integer):
        return np.asarray(run.max() + 1 + np.arange(count))
    return np.array([f"{max(run)} then {number}" for number in range(count)])


def _middle(values: Array) -> float:
    return float(np.median(values))
