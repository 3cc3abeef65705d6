"""Findings in one clause each (subject, effect, size), and the gain by modelling them."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.report.diagnosis.assessed_causes import FOUND, RIVAL, AssessedCause, accepted_of, assessed_causes
from truing.report.diagnosis.findings import UNNAMED, expected_noise, subject_words
from truing.report.diagnosis.prediction_errors import AT_THE_FLOOR, Overall, overall, part_names
from truing.report.numbers import capitalised, count_text, printed, rough, rough_quantity, with_uncertainty
from truing.report.tables import Tables, table_or_none
from truing.report.wordings import catalogue
from truing.report.wordings.claim import Reach
from truing.report.wordings.nonparametric_wordings import columns_words, remainder_clause
from truing.schemas.verdict import Relation

if TYPE_CHECKING:
    from truing.report.tables import Tables


_MORE = {"kappa": 1, "quadratic": 2, "cubic": 3}


def clause(row: AssessedCause, tables: Tables) -> str:
    """Return a finding with its size in a clause, without a full stop."""
    if row.is_remainder:
        share, remains = row.share_predicted or 0.0, not row.is_conditional
        is_partial = row.is_partly_explained
        return printed(remainder_clause(row.follows, row.subject, share, remains=remains, is_partial=is_partial))
    if row.is_noise and row.cause == "unexplained":
        return printed(_noise(row))
    text = catalogue.clause(replace(row, reach=_largest_shift(row, tables)))
    is_unnamed = row.cause == "unexplained" and row.verdict == FOUND
    has_equal = is_unnamed and any(assessed_cause.verdict == RIVAL for assessed_cause in assessed_causes(tables))
    unnamed = UNNAMED if is_unnamed and not has_equal else ""
    return printed(f"{capitalised(text)}{unnamed}")


def gain(causes: list[AssessedCause], tables: Tables) -> str:
    """Return the gain by modelling all findings: ``lowers the rms error on held-out poses from 34 to 8 µm ...``."""
    rms_errors = overall(causes, tables, held_out=True) or overall(causes, tables, held_out=False)
    if rms_errors is None:
        return ""
    parts = part_names(tables)
    quantity = f"the rms error on {parts.held_out if rms_errors.held_out else parts.fitted}"
    return _change(quantity, rms_errors) + _against_noise(rms_errors, _whose_noise(tables))


def _change(quantity: str, errors: Overall) -> str:
    before, after = (rough_quantity(size, errors.unit) for size in (errors.before, errors.after))
    if before == after:
        return f"leaves {quantity} at {after}"
    return f"{'lowers' if errors.after < errors.before else 'raises'} {quantity} from {before} to {after}"


def _whose_noise(tables: Tables) -> str:
    """Return the content of the noise floor in words: noise alone, or also scatter estimated from the same
    residuals."""
    raised = any(row.raises_floor for row in accepted_of(assessed_causes(tables)))
    return "noise and the scatter found here" if raised else "the measurement noise"


def _against_noise(errors: Overall, noise_owner: str) -> str:
    """Return the rms error after all findings with the noise floor, if known; ``noise_owner``: whose noise."""
    if errors.floor is None:
        return ""
    floor = rough_quantity(errors.floor, errors.unit)
    if errors.is_below_noise:
        return f", significantly below {noise_owner} ({floor}): {errors.why_below}"
    near = 1.0 / AT_THE_FLOOR <= errors.after / errors.floor <= AT_THE_FLOOR
    return f", consistent with {noise_owner} ({floor})" if near else f"; {noise_owner} alone would give {floor}"


def _noise(row: AssessedCause) -> str:
    if (largest := row.size("largest_ratio")) is not None:
        poses, times = count_text(int(row.settings["large"]), "pose"), rough(largest.number or 0.0)
        return f"The errors of {subject_words(row.subject)} are large in {poses}, up to {times} times a typical one"
    size = row.size("noise_ratio")
    times = with_uncertainty(size.number or 0.0, size.sigma) if size is not None else "–"
    kind = row.settings.get("place")
    if row.follows or kind:
        input_text = str(kind) if kind else columns_words(row.follows)
        return (
            f"The noise depends on {input_text}: where it is largest, it is {times} times as large as where "
            "it is smallest"
        )
    subject_text = f" of {subject_words(row.subject)}" if row.subject else ""
    if row.settings.get("over") == "others":
        return f"The noise{subject_text} is {times} times that of the others"
    # Of residuals: an effect that is not known raises them as more noise does.
    return f"The residuals{subject_text} are {times} times {noise_of_row(row)}"


def noise_of_row(row: AssessedCause) -> str:
    """Return the noise that residuals exceed; that of signals was estimated if it gives no noise floor."""
    is_of_loads = row.relation in (Relation.LOADS_SIGNALS, Relation.LOADS_READINGS)
    return expected_noise(row.relation, is_declared=row.floor is not None or not is_of_loads)


def _largest_shift(row: AssessedCause, tables: Tables) -> Reach | None:
    """Return the largest shift of an attachment by a finding; for a full matrix, of two attachments relative to each
    other."""
    drives = _drives(tables)
    if drives is None:
        return None
    matrix = _matrix(row, drives.shape[1])
    if matrix is not None:
        return _largest_difference(drives, *matrix)
    shifts = _own_actuator_shifts(row, drives)
    if shifts is None or not np.any(shifts):
        return None
    leg = int(np.argmax(np.max(np.abs(shifts), axis=0)))
    pose = int(np.argmax(np.abs(shifts[:, leg])))
    sigma = _own_sigma(row, drives[pose, leg], leg, drives.shape[1])
    return Reach(1e3 * float(np.max(np.abs(shifts))), (leg + 1,), sigma)


def _own_sigma(row: AssessedCause, drive: float, leg: int, legs: int) -> float | None:
    """Return the uncertainty, um, of a leg's shift at a displacement of its actuator, from its parameters."""
    sigmas = [
        (s, p) for kind, p in _MORE.items() for s in row.sizes_of(kind) if leg in _legs_of(s.name, row.subject, legs)
    ]
    if any(size.sigma is None for size, _ in sigmas):
        return None
    return 1e3 * float(np.sqrt(sum((size.sigma or 0.0) ** 2 * drive ** (2 * power) for size, power in sigmas)))


def _largest_difference(drives: NDArray, matrix: NDArray, sigma: NDArray) -> Reach | None:
    """Return the largest difference of two attachments' shifts by K and its sigma (L, L), with drives (B, L) in mm."""
    shifts = drives @ matrix.T
    if shifts.shape[1] < 2:
        return None
    spread = np.ptp(shifts, axis=1)
    pose = int(np.argmax(spread))
    legs = sorted((int(np.argmin(shifts[pose])) + 1, int(np.argmax(shifts[pose])) + 1))
    noise = 1e3 * float(np.sqrt(np.sum((sigma[[leg - 1 for leg in legs]] * drives[pose]) ** 2)))
    known = noise if np.isfinite(noise) else None
    return Reach(1e3 * float(spread[pose]), tuple(legs), known) if spread[pose] > 0.0 else None


def _drives(tables: Tables) -> NDArray | None:
    """Return displacements of the actuators (B, L) in mm; from the middle of their range where the reference is
    unknown."""
    shifts = table_or_none(tables, "deformation")
    if shifts is not None:
        return shifts.pivot(index="pose", columns="leg", values="delta_rho_mm").dropna().to_numpy(dtype=float)
    readings = table_or_none(tables, "configurations")
    columns = _reading_columns(list(map(str, readings.columns))) if readings is not None else []
    if readings is None or not columns:
        return None
    rho = readings[columns].dropna().to_numpy(dtype=float)
    reference = readings.loc[readings["role"] == "reference", columns].dropna().to_numpy(dtype=float)
    return rho - (reference[0] if len(reference) else (rho.max(axis=0) + rho.min(axis=0)) / 2) if len(rho) else None


def _reading_columns(columns: list[str]) -> list[str]:
    return [column for column in columns if re.fullmatch(r"rho\d+_mm", column)]


def _matrix(row: AssessedCause, legs: int) -> tuple[NDArray, NDArray] | None:
    """Return K and its sigma (L, L), row by row, if the cause has one."""
    entries = [(size.number, np.nan if size.sigma is None else size.sigma) for size in row.sizes_of("K")]
    if len(entries) != legs**2:
        return None
    values, sigma = np.array(entries, dtype=float).T.reshape(2, legs, legs)
    return values, sigma


def _own_actuator_shifts(row: AssessedCause, drives: NDArray) -> NDArray | None:
    """Return shifts (B, L) in mm where each attachment follows its own actuator."""
    if not row.cause.startswith("platform-deformation"):
        return None
    shifts = np.zeros_like(drives)
    for kind, power in _MORE.items():
        for size in row.sizes_of(kind):
            for leg in _legs_of(size.name, row.subject, drives.shape[1]):
                shifts[:, leg] += (size.number or 0.0) * drives[:, leg] ** power
    return shifts


def _legs_of(parameter: str, subject: str, legs: int) -> list[int]:
    """Return the legs (from 0) of a parameter: by its suffix, otherwise those of the subject, otherwise all."""
    numbered = re.search(r"_(\d+)$", parameter)
    named = [int(numbered[1])] if numbered else [int(n) for n in re.findall(r"\bleg(\d+)\b", subject)]
    chosen = [leg - 1 for leg in named] or list(range(legs))
    return [leg for leg in chosen if 0 <= leg < legs]
