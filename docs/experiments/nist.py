"""NIST's Statistical Reference Datasets for non-linear regression, solved from both starts by both methods.

    TRUING_REAL_DATA=FOLDER python -m docs.experiments.nist

reads FOLDER/nist-strd/*.dat (in the public domain, not ours to copy) and renews the table of docs/solver.md.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.experiments.marked_tables import renew
from docs.experiments.nist_models import MODELS, Evaluated
from truing.estimation.least_squares.solver import Method, Solution, least_squares

DOCS = Path(__file__).resolve().parents[1]
METHODS: tuple[Method, ...] = ("levenberg-marquardt", "trust-region")
CERTIFIED_DIGITS = 11.0
_FIRST_ROW = 60  # data start on line 61, as every head says


@dataclass(frozen=True)
class Problem:
    """One file: data, starts and certified answers."""

    name: str
    level: str  # of difficulty: lower, average, higher
    y: NDArray  # (N,)
    x: NDArray  # (N,) or, for two predictors, (N, 2)
    starts: NDArray  # (2, P)
    parameters: NDArray  # (P,)
    deviations: NDArray  # (P,)
    cost: float  # residual sum of squares

    def residuals(self, b: NDArray) -> Evaluated:
        """Return model minus response (B, N), and its derivatives (B, N, P)."""
        value, columns = MODELS[self.name](b, self.x)
        return value - self.y, columns

    @property
    def rounding(self) -> float:
        """Relative rounding error of the residuals at the certified answer."""
        return float(np.finfo(float).eps * np.linalg.norm(self.y) / np.sqrt(self.cost))


def read_problem(path: Path) -> Problem:
    """Read one file as it was published."""
    lines = path.read_text(encoding="ascii").splitlines()
    level = next(re.split("level", line, flags=re.I)[0].strip().lower() for line in lines if "Level of Diff" in line)
    found = re.findall(r"^\s*b\d+\s*=\s*(\S+)\s+(\S+)\s+(\S+)\s+(\S+)\s*$", "\n".join(lines), re.MULTILINE)
    answers = np.array(found, float)
    cost = next(float(line.split(":")[1]) for line in lines if line.startswith("Residual Sum of Squares"))
    rows = np.array([line.split() for line in lines[_FIRST_ROW:] if line.strip()], float)
    y, x = rows[:, 0], rows[:, 1:] if rows.shape[1] > 2 else rows[:, 1]
    y = np.log(y) if path.stem == "Nelson" else y
    return Problem(path.stem, level, y, x, answers[:, :2].T, answers[:, 2], answers[:, 3], cost)


def problems(folder: Path) -> list[Problem]:
    """Return all 27, in the order of their names."""
    return [read_problem(path) for path in sorted(folder.glob("*.dat"))]


def solve(problem: Problem, method: Method) -> Solution:
    """Return the minima reached from both starts, one batch of two."""
    return least_squares(problem.residuals, problem.starts, method=method)


def digits(found: NDArray, certified: NDArray) -> NDArray:
    """Return the fewest digits (B,) to which values (B, P) agree with certified ones: -log10 of the relative error."""
    error = np.max(np.abs(found - certified) / np.abs(certified), -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.isnan(error), -np.inf, np.clip(-np.log10(error), 0.0, CERTIFIED_DIGITS))


def agreement(problem: Problem, solution: Solution) -> tuple[NDArray, NDArray]:
    """Return the digits of the parameters and of their standard deviations, (2,) each, per start."""
    freedom = len(problem.y) - len(problem.parameters)
    variances = np.diagonal(solution.covariance, axis1=1, axis2=2) * (solution.cost / freedom)[:, None]
    return digits(solution.x, problem.parameters), digits(np.sqrt(variances), problem.deviations)


def table(folder: Path) -> str:
    """Return digits of the parameters / of their standard deviations, and iterations, as a table of the docs."""
    lines = [
        "| problem | difficulty | damping, start 1 | start 2 | trust region, start 1 | start 2 |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for problem in problems(folder):
        cells = [cell for method in METHODS for cell in _cells(problem, solve(problem, method))]
        lines.append(f"| {problem.name} | {problem.level} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cells(problem: Problem, solution: Solution) -> list[str]:
    rows = zip(*agreement(problem, solution), solution.iterations, solution.status, strict=True)
    return [f"{p:.1f} / {s:.1f}, {n}" + ("" if status == "converged" else f" ({status})") for p, s, n, status in rows]


def main() -> None:
    """Renew the table."""
    folder = Path(os.environ["TRUING_REAL_DATA"]) / "nist-strd"
    renew(DOCS / "solver.md", {"nist": lambda: table(folder)})


if __name__ == "__main__":
    main()
