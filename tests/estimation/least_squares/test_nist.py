"""All 27 certified problems of non-linear regression (NIST), from both of their start values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from docs.experiments.nist import Problem, agreement, problems, solve
from docs.experiments.nist_models import MODELS
from tests.tolerance import assert_close
from truing.estimation.least_squares.solver import SolverStatus

# Certified values are printed with eleven digits: half of the last one is up to so much of them.
PRINTED = 5e-11
# From these starts damping runs into a region where the model has gone flat, or is still in a valley at the limit.
TRAPS = {("BoxBOD", 0): SolverStatus.STALLED, ("MGH10", 0): SolverStatus.ITERATION_LIMIT}


@pytest.fixture(scope="module")
def published(real_data: Path) -> list[Problem]:
    folder = real_data / "nist-strd"
    if not folder.is_dir():
        pytest.skip(f"no reference datasets in {folder}")
    return problems(folder)


def _allowed(problem: Problem) -> tuple[float, float]:
    """Digits that printing and rounding leave to parameters and to standard deviations."""
    freedom = len(problem.y) - len(problem.parameters)
    spread = np.max(problem.deviations / np.abs(problem.parameters))
    parameters = PRINTED + spread * np.sqrt(freedom) * problem.rounding
    return -np.log10(parameters), -np.log10(PRINTED + problem.rounding)


def test_all_nist_problems_are_present(published: list[Problem]) -> None:
    assert [problem.name for problem in published] == sorted(MODELS)
    assert {problem.level for problem in published} == {"lower", "average", "higher"}


def test_the_trust_region_reaches_the_certified_digits_from_both_starts(published: list[Problem]) -> None:
    for problem in published:
        solution = solve(problem, "trust-region")
        assert solution.ok.all(), f"{problem.name}: {solution.status}"
        for found, allowed in zip(agreement(problem, solution), _allowed(problem), strict=True):
            assert np.all(found >= allowed), f"{problem.name}: {found} digits, expected {allowed:.1f}"


@pytest.mark.slow
def test_damping_reaches_the_certified_digits_or_reports_no_convergence(published: list[Problem]) -> None:
    ends = {}
    for problem in published:
        solution = solve(problem, "levenberg-marquardt")
        ends |= {(problem.name, start): status for start, status in enumerate(solution.status)}
        for found, allowed in zip(agreement(problem, solution), _allowed(problem), strict=True):
            assert np.all((found >= allowed) | ~solution.ok), f"{problem.name}: {found} digits, {solution.status}"
    assert {start: status for start, status in ends.items() if status != SolverStatus.CONVERGED} == TRAPS


@pytest.mark.parametrize("name", MODELS)
def test_derivatives_are_exact(name: str) -> None:
    rng = np.random.default_rng(len(name))
    x = np.linspace(1.0, 2.0, 7) if name != "Nelson" else rng.uniform(1.0, 2.0, (7, 2))
    b = rng.uniform(0.5, 1.5, (1, SIZES[name]))
    step = 1e-30
    value, columns = MODELS[name](b, x)
    shifted = MODELS[name](b + 1j * step * np.eye(SIZES[name]), x)[0]
    assert_close(shifted.imag.T / step, columns[0], atol=1e-13 * np.abs(columns).max())
    assert value.shape == (1, 7)


SIZES = dict.fromkeys(MODELS, 3)
SIZES |= dict.fromkeys(("BoxBOD", "DanWood", "Misra1a", "Misra1b", "Misra1c", "Misra1d"), 2)
SIZES |= dict.fromkeys(("MGH09", "Rat43", "Roszman1"), 4) | dict.fromkeys(("Kirby2", "MGH17"), 5)
SIZES |= dict.fromkeys(("Lanczos1", "Lanczos2", "Lanczos3"), 6) | dict.fromkeys(("Hahn1", "Thurber"), 7)
SIZES |= dict.fromkeys(("Gauss1", "Gauss2", "Gauss3"), 8) | {"ENSO": 9}
