"""Errors of predictions before and after all findings: of points, readings or an axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from truing.report.diagnosis.assessed_causes import AssessedCause, modelled_of, total_gain
from truing.report.diagnosis.findings import IN_TURN
from truing.report.numbers import plain
from truing.report.tables import STEP_KEYS, Tables, in_channel_order, is_bench, load_steps, table_or_none
from truing.schemas.verdict import DECLARED_FREEDOM

# Standard deviation of a normal distribution over the median of its absolute values.
_MEDIAN_TO_SIGMA = 1.4826

# Number of resampled campaigns for an interval, and fewest poses or runs for one.
_DRAWS, _FEWEST = 2000, 3

_FEWEST_POSES = 8  # fewest poses for an estimate of the independent numbers per pose

# Errors within this factor of the noise floor, in both directions, are called consistent with it.
AT_THE_FLOOR = 1.1
# p-value below which errors are called smaller than noise allows.
_UNLIKELY = 1e-3
# The same for errors that are called larger than noise allows; and independent numbers where these are unknown.
_RARE, _MANY = 1e-2, 1e9


@dataclass(frozen=True)
class PartNames:
    """Names of the parts of a campaign: held-out units, fitted and held-out data.

    ``built``: the part with a tolerance, with the question whether it keeps that, and the positive answer.
    ``not_fitted``: how held-out data are predicted.
    """

    single: str
    fitted: str
    held_out: str
    fitted_or_not: str
    not_planned: str
    built: str
    built_question: str
    as_built: str
    not_fitted: str = "not used in any fit"

    @property
    def is_of_points(self) -> bool:
        """True for points of bodies in poses."""
        return self.single == POINTS.single

    @property
    def is_of_readings(self) -> bool:
        """True for readings and signals of a bench."""
        return self.single == READINGS.single


POINTS = PartNames(
    "pose",
    "calibration poses",
    "held-out poses",
    "Calibration poses were used in the fit; held-out poses were not.",
    "No configurations were computed: no finding or open question needs more poses.",
    "geometry",
    "does the geometry agree with nominal?",
    "The geometry agrees with its nominal values within tolerances.",
)
READINGS = PartNames(
    "run",
    "fitted runs",
    "held-out runs",
    "Held-out runs are predicted by a fit that did not use them.",
    "No loads were computed: no finding or open question needs more loads on this bench.",
    "lengths and stiffnesses",
    "does the sensor agree with nominal?",
    "Lengths and stiffnesses agree with their nominal values within tolerances.",
)
_AXIS = PartNames(
    "row",
    "fitted rows",
    "held-out rows",
    "Held-out rows are predicted by a fit that did not use them.",
    "No commands were computed: the list says what to measure for each finding.",
    "encoders",
    "do the encoders agree with nominal?",
    "The encoders agree with their nominal values within tolerances.",
)


_AXIS_IN_TURN = replace(  # no row has the role of verification
    _AXIS,
    held_out=IN_TURN,
    fitted_or_not="Rows left out in turn are predicted by fits that did not use them.",
    not_fitted="predicted by fits that did not use them",
)
_FITS_WITHOUT = "predicted by fits that did not use them"
_POINTS_IN_TURN = replace(
    POINTS,
    held_out="poses left out in turn",
    fitted_or_not="All poses were used in the fit.",
    not_fitted=_FITS_WITHOUT,
)
_READINGS_IN_TURN = replace(
    READINGS,
    held_out="runs left out in turn",
    fitted_or_not="Runs left out in turn are predicted by fits that did not use them.",
    not_fitted=_FITS_WITHOUT,
)


_STEPS_IN_TURN = replace(  # of a single run
    _READINGS_IN_TURN,
    held_out="load steps left out in turn",
    fitted_or_not="Load steps left out in turn are predicted by fits that did not use them.",
)


def part_names(tables: Tables) -> PartNames:
    """Return the names for a campaign's kind, and for whether it holds data out."""
    axis = table_or_none(tables, "axis_errors")
    if axis is not None:
        return _AXIS if axis["role"].eq("verification").any() else _AXIS_IN_TURN
    if is_bench(tables):
        errors = table_or_none(tables, "reading_errors")
        if errors is None or errors["role"].eq("verification").any():
            return READINGS
        return _READINGS_IN_TURN if errors["run"].nunique() > 1 else _STEPS_IN_TURN
    poses = table_or_none(tables, "prediction")
    return POINTS if poses is None or poses["role"].eq("verification").any() else _POINTS_IN_TURN


def reading_misses(tables: Tables) -> pd.DataFrame | None:
    """Return one row per reading: run, step, channel, role, before, after, unit, time_s, loads by axis, sigma; None
    without any.

    Rows are in the order of measurement. ``sigma`` is the declared noise of the reading; ``noise_floor`` the error of a
    channel by declared noise alone, NaN where none is declared. ``noise`` is that, or else the median residual of the
    channel, scaled to a standard deviation.
    """
    errors = table_or_none(tables, "reading_errors")
    if errors is None:
        return None
    steps_with_errors = errors.rename(columns={"missed_before": "before", "missed_after": "after"})
    steps_with_errors = steps_with_errors.merge(_steps(tables), on=STEP_KEYS, how="left").merge(
        _sigma(tables), on=[*STEP_KEYS, "channel"], how="left"
    )
    steps_with_errors = steps_with_errors.sort_values(["start", "time_s", "step"], kind="stable").reset_index(drop=True)
    left = steps_with_errors["after"].abs().groupby(steps_with_errors["channel"]).transform("median") * _MEDIAN_TO_SIGMA
    if "noise_floor" not in steps_with_errors:
        steps_with_errors["noise_floor"] = np.nan
    return steps_with_errors.assign(noise=steps_with_errors["noise_floor"].fillna(left))


def channels_of(misses: pd.DataFrame) -> list[str]:
    """Return the channels that were read: displacements, rotations, then signals by number."""
    return in_channel_order(misses["channel"].unique())


def _steps(tables: Tables) -> pd.DataFrame:
    """Return the load steps with the time at which their run began."""
    steps = load_steps(tables).drop(columns="role")
    return steps.assign(start=steps.groupby("run")["time_s"].transform("min"))


def _sigma(tables: Tables) -> pd.DataFrame:
    readings = table_or_none(tables, "readings")
    if readings is None:
        return pd.DataFrame({"run": [], "step": [], "channel": [], "sigma": []}).astype({"channel": object})
    return readings[[*STEP_KEYS, "channel", "sigma"]]


def root_mean_square(values: pd.Series) -> float:
    """Return the rms of known values; NaN where there are none."""
    known = values.dropna().to_numpy(dtype=float)
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


def rms_with_interval(rms: ArrayLike, rng: np.random.Generator, counts: ArrayLike | None = None) -> str:
    """Return ``4.1 (3.2 to 5.0)`` over the rms of N poses or runs, each of a number of readings (one by default)."""
    sizes = np.asarray(rms, dtype=float)
    weights = np.ones(len(sizes)) if counts is None else np.asarray(counts, dtype=float)
    known = np.isfinite(sizes)
    squares, weights = weights[known] * sizes[known] ** 2, weights[known]
    if not len(squares):
        return "–"
    text = plain(float(np.sqrt(squares.sum() / weights.sum())))
    if len(squares) < _FEWEST:
        return text
    chosen = rng.integers(0, len(squares), (_DRAWS, len(squares)))
    drawn = np.sqrt(squares[chosen].sum(axis=1) / weights[chosen].sum(axis=1))
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{text} ({plain(float(low))} to {plain(float(high))})"


@dataclass(frozen=True)
class Overall:
    """Rms of measured minus predicted before and after; ``freedom``: its independent numbers, 0 where unknown.

    ``of_fit``: rms error of held-out data by the uncertainty of the fit alone; 0 where unknown.
    """

    before: float
    after: float
    floor: float | None
    unit: str
    held_out: bool
    freedom: float = 0.0
    of_fit: float = 0.0

    @property
    def times_noise(self) -> float:
        """The error over the noise floor."""
        return self.after / (self.floor or 1.0)

    @property
    def times_expected(self) -> float:
        """The error over that of noise and the uncertainty of the fit."""
        return self.after / (float(np.hypot(self.floor or 0.0, self.of_fit)) or 1.0)

    @property
    def is_beyond_noise(self) -> bool:
        """True if the error exceeds the noise floor by a clear factor, beyond chance and wrongly declared noise."""
        if not self.floor or self.after <= AT_THE_FLOOR * self.floor:
            return False
        from scipy.special import fdtrc

        freedom = self.freedom if self.freedom > 0.0 else _MANY
        return bool(fdtrc(freedom, DECLARED_FREEDOM, (self.after / self.floor) ** 2) < _RARE)

    @property
    def is_below_noise(self) -> bool:
        """True if noise as declared would hardly ever leave so small an error."""
        if self.floor is None or self.after * AT_THE_FLOOR >= self.floor or not self.freedom > 0.0:
            return False
        from scipy.special import chdtr

        return bool(chdtr(self.freedom, self.freedom * (self.after / self.floor) ** 2) < _UNLIKELY)

    @property
    def why_below(self) -> str:
        """Possible reason of errors smaller than the declared noise allows."""
        large = "the declared noise is too large"
        return large if self.held_out else f"{large}, or the model is over-fitted"


def overall(findings: list[AssessedCause], tables: Tables, *, held_out: bool) -> Overall | None:
    """Return the gain by all findings together; None where it was not evaluated.

    One finding on a bench is assessed over the channels that it moves. Several are assessed over all channels of the
    unit in which they gain most, with the noise floor of these. Findings on poses that gain in several units, position
    and orientation, are assessed by the errors of each pose.
    """
    effects = modelled_of(findings)
    if part_names(tables).is_of_readings and len(effects) > 1:
        units = dict.fromkeys(row.unit for row in effects)
        reported = [of_unit for unit in units if (of_unit := _of_readings(unit, tables, held_out)) is not None]
        return max(
            reported, key=lambda of_unit: of_unit.before / of_unit.after if of_unit.after > 0.0 else 1.0, default=None
        )
    pair = total_gain(findings, held_out)
    if pair is None:
        return _of_poses(effects, tables, held_out)
    unit = effects[-1].unit
    of_fit = _of_fit(tables, unit) if held_out else 0.0
    return Overall(*pair, effects[-1].floor, unit, held_out, _freedom(tables, unit, held_out), of_fit)


def _of_poses(effects: list[AssessedCause], tables: Tables, held_out: bool) -> Overall | None:
    poses = table_or_none(tables, "prediction")
    if poses is None:
        return None
    known = poses[poses["role"].eq("verification") == held_out].dropna(subset=["rms_before", "rms_after"])
    if not len(known):
        return None
    unit = str(known["unit"].iloc[0])
    before, after = (float(np.sqrt(np.mean(known[f"rms_{when}"] ** 2))) for when in ("before", "after"))
    floor = next((row.floor for row in reversed(effects) if row.unit == unit), None)
    of_fit = _of_fit(tables, unit) if held_out else 0.0
    return Overall(before, after, floor, unit, held_out, _freedom(tables, unit, held_out), of_fit)


def plain_errors(rows: list[AssessedCause], tables: Tables, *, held_out: bool) -> list[Overall]:
    """Return the errors of the plain simulation where nothing was found; on a bench by unit."""
    if part_names(tables).is_of_readings:
        misses = reading_misses(tables)
        units = [] if misses is None else list(dict.fromkeys(misses["unit"]))
        return [of_unit for unit in units if (of_unit := _of_readings(unit, tables, held_out)) is not None]
    reported = next((row for row in rows if row.rms[0] is not None), None)
    size = None if reported is None else (reported.held_out if held_out else reported.rms)[0]
    if reported is None or size is None:
        return []
    of_fit = _of_fit(tables, reported.unit) if held_out else 0.0
    freedom = _freedom(tables, reported.unit, held_out)
    return [Overall(size, size, reported.floor, reported.unit, held_out, freedom, of_fit)]


def errors_of_models(rows: list[AssessedCause], findings: list[AssessedCause], tables: Tables) -> list[Overall]:
    """Return the errors at held-out data, then the rest; ``findings``: the modelled ones of all candidates."""
    missed: list[Overall] = []
    for is_held_out in (True, False):
        overall_errors = overall(findings, tables, held_out=is_held_out) if findings else None
        missed += (
            [overall_errors]
            if overall_errors is not None
            else []
            if findings
            else plain_errors(rows, tables, held_out=is_held_out)
        )
    return missed


def _of_fit(tables: Tables, unit: str) -> float:
    """Return the rms error at held-out poses by the uncertainty of the fit alone; 0 where it was not computed."""
    poses = table_or_none(tables, "prediction")
    if poses is None or "sigma_of_fit" not in poses or not poses["unit"].eq(unit).all():
        return 0.0
    rms = root_mean_square(poses["sigma_of_fit"])
    return rms if np.isfinite(rms) else 0.0


def _freedom(tables: Tables, unit: str, held_out: bool) -> float:
    """Return the least number of independent values in an rms: readings of a channel less one zero per run; for points,
    poses. Values of one pose have errors in common. The number per pose follows from the scatter of the poses' mean
    squares."""
    if part_names(tables).is_of_readings:
        own_readings = _own_readings(unit, tables, held_out)
        if own_readings is None:
            return 0.0
        zeros = own_readings.groupby(["run", "channel"]).ngroups
        return max(len(own_readings) - zeros, 0) / own_readings["channel"].nunique()
    if (
        rows := table_or_none(tables, "axis_errors")
    ) is not None:  # encoders share how far the axis stands from its command
        own_readings = rows[rows["role"].eq("verification") == held_out]
        return float(max(own_readings["pose"].nunique() - 1, 0))
    poses = table_or_none(tables, "prediction")
    if poses is None:
        return 0.0
    squares = poses["rms_after"].dropna().to_numpy(dtype=float) ** 2
    worth = 1.0
    if len(squares) >= _FEWEST_POSES and squares.std(ddof=1) > 0.0:
        worth = max(1.0, 2.0 * float(squares.mean() / squares.std(ddof=1)) ** 2)
    return worth * int((poses["role"].eq("verification") == held_out).sum())


def _own_readings(unit: str, tables: Tables, held_out: bool) -> pd.DataFrame | None:
    misses = reading_misses(tables)
    if misses is None:
        return None
    rows = misses[(misses["unit"] == unit) & ((misses["role"] == "verification") == held_out)]
    return rows if len(rows) else None


def _of_readings(unit: str, tables: Tables, held_out: bool) -> Overall | None:
    own_readings = _own_readings(unit, tables, held_out)
    if own_readings is None:
        return None
    floor = root_mean_square(own_readings["noise_floor"]) if own_readings["noise_floor"].notna().all() else None
    before, after = root_mean_square(own_readings["before"]), root_mean_square(own_readings["after"])
    return Overall(before, after, floor, unit, held_out, _freedom(tables, unit, held_out))
