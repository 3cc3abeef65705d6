"""Calibrate campaigns, and compare identified with true parameters."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tests.blind.at_once import AT_ONCE
from tests.blind.generator.folder import truth_path
from tests.blind.generator.quaternions import Array
from tests.blind.judging import UNLUCKY, fewest_of, most_of
from tests.stages.line import run_line

LINE = ("ingest", "pose", "deformation", "calibrate")
TABLES = ("configurations", "calibration", "correlations", "model_choice", "accuracy", "requirements")
DEFORMATION = {"platform-deformation-linear": "linear", "platform-deformation-matrix": "matrix"}
CASE = ["model", "deformation"]


@dataclass(frozen=True)
class Errors:
    """Numbers (n,) that should be unit normal, with their correlations (n, n)."""

    z: Array
    correlation: Array

    @property
    def spread(self) -> float:
        """Twice this is the variance of the sum of squares; n where nothing is correlated."""
        return float(np.sum(self.correlation**2))


@dataclass(frozen=True)
class Calibrated:
    """A campaign that was run: its tables, what the calibration said, and the truth."""

    name: str
    tables: dict[str, pd.DataFrame]
    said: str
    truth: dict[str, Any]

    @property
    def legs(self) -> int:
        return len(self.truth["geometry"]["a_mm"])

    @property
    def true_case(self) -> tuple[str, str]:
        model = "6-pus" if self.truth["geometry"]["u"] else "ups"
        deformations = [DEFORMATION[effect["cause"]] for effect in self.truth["effects"]]
        return model, next(iter(deformations), "none")

    @cached_property
    def figures(self) -> dict[tuple[str, str], pd.Series]:
        """Figures of every calibration by errors in variables, by model and deformation."""
        likely = self.tables["model_choice"].query("estimator == 'errors-in-variables'")
        return {case: rows.set_index("figure")["value"] for case, rows in likely.groupby(CASE)}

    @property
    def chosen(self) -> tuple[str, str]:
        return next(case for case, figure in self.figures.items() if figure["chosen"] == 1)

    @property
    def is_chosen_right(self) -> bool:
        """The true model is chosen, or reported as indistinguishable from the one that is."""
        own = self.figures.get(self.true_case, {})
        return self.chosen == self.true_case or own.get("indistinguishable") == 1

    @property
    def left_out(self) -> set[str]:
        """The poses that calibration names as mismeasured."""
        found = re.search(r"poses that disagree with all others: ([^;]*)", self.said)
        return set(found[1].split(", ")) if found else set()

    @property
    def parameters(self) -> pd.DataFrame:
        """Parameters identified by the chosen calibration, each with its true value."""
        rows = self._of_chosen("calibration")
        rows["true"] = [self._true(row.parameter, int(row.leg) - 1) for row in rows.itertuples()]
        return rows

    def _of_chosen(self, table: str) -> pd.DataFrame:
        rows = self.tables[table]
        return rows[(rows[CASE] == list(self.chosen)).all(axis=1)].reset_index(drop=True)

    def _true(self, parameter: str, leg: int) -> float:
        head, _, axis = parameter.partition("_")
        geometry = {"a": "a_mm", "b": "b_mm", "u": "u", "l": "length_mm"}
        if head in geometry:
            value = self.truth["geometry"][geometry[head]][leg]
            return float(value["xyz".index(axis)] if axis else value)
        return self._coefficient(leg, leg if head == "kappa" else int(parameter[-1]) - 1)

    def _coefficient(self, leg: int, column: int) -> float:
        names = (f"kappa_{leg + 1}",) if leg == column else ()
        reported = {
            name: entry["value"] for effect in self.truth["effects"] for name, entry in effect["parameters"].items()
        }
        return next((reported[name] for name in (*names, f"K{leg + 1}{column + 1}") if name in reported), 0.0)

    def errors(self, *, of_geometry: bool) -> Errors:
        """(identified - true) / sigma of the joints and legs, or of the deformation's coefficients."""
        rows = self.parameters
        rows = rows[_is_geometry(rows["parameter"]) == of_geometry]
        return Errors(((rows["identified"] - rows["true"]) / rows["sigma"]).to_numpy(), self._correlation(rows))

    @property
    def pulls(self) -> Errors:
        """The pulls of the geometry that data tell, whose shifts from nominal correlate as sigmas no more do.

        Prior variance is that of what was identified plus that of its error, entry by entry of the covariance.
        """
        rows = self.parameters
        rows = rows[_is_geometry(rows["parameter"]) & rows["pull"].notna()]
        shift = np.sqrt(rows["tolerance"] ** 2 - rows["sigma"] ** 2).to_numpy()
        covariance = self._correlation(rows) * np.outer(rows["sigma"], rows["sigma"])
        correlation = -covariance / np.outer(shift, shift)
        np.fill_diagonal(correlation, 1.0)
        return Errors(rows["pull"].to_numpy(), correlation)

    def _correlation(self, rows: pd.DataFrame) -> Array:
        place = {key: i for i, key in enumerate(zip(rows["leg"], rows["parameter"], strict=True))}
        found = np.eye(len(rows))
        for pair in self._of_chosen("correlations").itertuples():
            i, j = place.get((pair.leg, pair.parameter)), place.get((pair.other_leg, pair.other_parameter))
            if i is not None and j is not None:
                found[i, j] = found[j, i] = pair.correlation
        return found

    @property
    def held_out(self) -> tuple[float, float, float]:
        """Sum of squares of the chosen calibration at held-out poses, its expectation, and half its variance.

        Held-out closings share the errors of P parameters, P / N of their variance where N closings were fitted.
        """
        figure = self.figures[self.chosen]
        count = self.legs * float(np.sum(self.tables["configurations"]["role"] == "verification"))
        fitted = self.legs * figure["poses"]
        shared = figure["parameters"] * (count / fitted) ** 2
        return figure["heldout_ratio"] ** 2 * count, count, count + shared


def _is_geometry(names: pd.Series) -> pd.Series:
    return ~names.str.match("kappa|K")


def run_all(folders: Sequence[Path]) -> list[Calibrated]:
    """Runs every campaign folder, as many at a time as leave the cores busy."""
    if AT_ONCE == 1:
        return [run(folder) for folder in folders]
    with ProcessPoolExecutor(AT_ONCE, get_context("spawn")) as pool:
        return list(pool.map(run, folders))


def run(folder: Path) -> Calibrated:
    """One folder, as far as the calibration, the diagnosis left out: what that adds is none of these models."""
    tables, said = run_line(folder, *LINE)
    truth = json.loads(truth_path(folder).read_text(encoding="utf-8"))
    reported = f"{said['calibrate'].left_out}; {said['calibrate'].figure}"
    return Calibrated(folder.name, {name: tables[name].to_pandas() for name in TABLES}, reported, truth)


def mean_square_band(errors: Iterable[Errors]) -> tuple[float, float, float]:
    """Mean square of all errors, and the band that it leaves once in a thousand (Satterthwaite's chi-square)."""
    every = list(errors)
    count, spread = sum(len(one.z) for one in every), sum(one.spread for one in every)
    return sum(float(np.sum(one.z**2)) for one in every) / count, *chi_square_band(count**2 / spread)


def chi_square_band(freedom: float) -> tuple[float, float]:
    """The band that a chi-square over its freedom leaves once in a thousand."""
    from scipy.stats import chi2

    low, high = chi2.ppf([UNLUCKY / 2, 1 - UNLUCKY / 2], freedom) / freedom
    return float(low), float(high)


def coverage_band(errors: Iterable[Errors], reach: float, probability: float) -> tuple[float, float, float]:
    """Share of errors within ``reach``, and its band.

    For two normal numbers of correlation r, the coverage of one depends on that of the other by less than r^2. The
    effective number is therefore that of independent squares.
    """
    every = list(errors)
    count, spread = sum(len(one.z) for one in every), sum(one.spread for one in every)
    trials = int(count**2 / spread)
    within = sum(int(np.sum(np.abs(one.z) < reach)) for one in every) / count
    return within, fewest_of(trials, probability) / trials, most_of(trials, probability) / trials
