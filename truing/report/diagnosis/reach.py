"""How far an effect of the platform's deformation moves its attachments over a campaign, and where most."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from truing.report.diagnosis.judged import Judged
from truing.report.tables import Tables, filled
from truing.report.wordings.claim import Reach

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MORE = {"kappa": 1, "quadratic": 2, "cubic": 3}


def reach(row: Judged, tables: Tables) -> Reach | None:
    """The largest shift of an attachment by what was found; by a full matrix, of two attachments against each other."""
    drives = _drives(tables)
    if drives is None:
        return None
    matrix = _matrix(row, drives.shape[1])
    if matrix is not None:
        return _between(drives, *matrix)
    shifts = _own(row, drives)
    if shifts is None or not np.any(shifts):
        return None
    leg = int(np.argmax(np.max(np.abs(shifts), axis=0)))
    pose = int(np.argmax(np.abs(shifts[:, leg])))
    sigma = _own_sigma(row, drives[pose, leg], leg, drives.shape[1])
    return Reach(1e3 * float(np.max(np.abs(shifts))), (leg + 1,), sigma)


def _own_sigma(row: Judged, drive: float, leg: int, legs: int) -> float | None:
    """What the parameters of a leg leave open of its shift at a displacement of its actuator, um."""
    own = [
        (s, p) for kind, p in _MORE.items() for s in row.sizes_of(kind) if leg in _legs_of(s.name, row.subject, legs)
    ]
    if any(size.sigma is None for size, _ in own):
        return None
    return 1e3 * float(np.sqrt(sum((size.sigma or 0.0) ** 2 * drive ** (2 * power) for size, power in own)))


def _between(drives: NDArray, matrix: NDArray, sigma: NDArray) -> Reach | None:
    """The largest difference of two attachments' shifts by K and its sigma (L, L), with drives (B, L) in mm."""
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
    """Displacements of the actuators (B, L) in mm; from the middle of their range where the reference is not known."""
    shifts = filled(tables, "deformation")
    if shifts is not None:
        return shifts.pivot(index="pose", columns="leg", values="delta_rho_mm").dropna().to_numpy(dtype=float)
    readings = filled(tables, "configurations")
    columns = _reading_columns(list(map(str, readings.columns))) if readings is not None else []
    if readings is None or not columns:
        return None
    rho = readings[columns].dropna().to_numpy(dtype=float)
    home = readings.loc[readings["role"] == "reference", columns].dropna().to_numpy(dtype=float)
    return rho - (home[0] if len(home) else (rho.max(axis=0) + rho.min(axis=0)) / 2) if len(rho) else None


def _reading_columns(columns: list[str]) -> list[str]:
    return [column for column in columns if re.fullmatch(r"rho\d+_mm", column)]


def _matrix(row: Judged, legs: int) -> tuple[NDArray, NDArray] | None:
    """K and its sigma (L, L), row by row, where the cause has one."""
    entries = [(size.number, np.nan if size.sigma is None else size.sigma) for size in row.sizes_of("K")]
    if len(entries) != legs**2:
        return None
    values, sigma = np.array(entries, dtype=float).T.reshape(2, legs, legs)
    return values, sigma


def _own(row: Judged, drives: NDArray) -> NDArray | None:
    """Shifts (B, L) in mm where each attachment follows its own actuator."""
    if not row.cause.startswith("platform-deformation"):
        return None
    shifts = np.zeros_like(drives)
    for kind, power in _MORE.items():
        for size in row.sizes_of(kind):
            for leg in _legs_of(size.name, row.subject, drives.shape[1]):
                shifts[:, leg] += (size.number or 0.0) * drives[:, leg] ** power
    return shifts


def _legs_of(parameter: str, subject: str, legs: int) -> list[int]:
    """Legs (from 0) that a parameter belongs to: by its suffix, else those of the subject, else all."""
    numbered = re.search(r"_(\d+)$", parameter)
    named = [int(numbered[1])] if numbered else [int(n) for n in re.findall(r"\bleg(\d+)\b", subject)]
    chosen = [leg - 1 for leg in named] or list(range(legs))
    return [leg for leg in chosen if 0 <= leg < legs]
