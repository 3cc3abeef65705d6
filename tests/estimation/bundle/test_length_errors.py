"""Length measuring errors against calibrated lengths agree with a calculation by hand."""

import numpy as np
import pytest

from truing.estimation.bundle.length_errors import (
    CONFORMS,
    FAILS,
    UNDECIDED,
    CalibratedLengths,
    PermissibleError,
    length_errors,
)

CALIBRATED = np.array([0.2, 0.5, 1.0, 1.5])
EXACT = CalibratedLengths(CALIBRATED, np.zeros(4))


def test_errors_are_measured_less_calibrated_at_the_reference_temperature():
    warm = CALIBRATED * (1 + 11.5e-6 * 5) + [1e-5, -2e-5, 0, 3e-5]
    lengths = CalibratedLengths(CALIBRATED, np.full(4, 1e-6), expansion_per_k=11.5e-6, temperature_c=25.0)
    found = length_errors(warm, np.eye(4) * 1e-12, lengths)
    assert found.error_m == pytest.approx([1e-5, -2e-5, 0, 3e-5], abs=2e-9)
    assert found.sigma_m == pytest.approx([np.sqrt(2) * 1e-6] * 4)
    assert found.verdict == ("",) * 4
    assert found.p_value < 1e-6


def test_the_verdict_keeps_clear_of_the_uncertainty():
    permitted = PermissibleError(10e-6, 20e-6, 30e-6)  # 14, 20, 30, 30 um
    error = np.array([5e-6, 19e-6, -29e-6, 45e-6])
    found = length_errors(CALIBRATED + error, np.eye(4) * 1e-12, EXACT, permissible=permitted)
    assert found.permitted_m == pytest.approx([14e-6, 20e-6, 30e-6, 30e-6])
    assert found.verdict == (CONFORMS, UNDECIDED, UNDECIDED, FAILS)


def test_an_error_of_scale_is_reported_with_its_correlation():
    rng = np.random.default_rng(0)
    common = np.outer(CALIBRATED, CALIBRATED) * 1e-10  # all lengths share an error of scale of 1e-5
    cov = common + np.eye(4) * 1e-14
    error = rng.multivariate_normal(np.zeros(4), cov)
    found = length_errors(CALIBRATED + error, cov, EXACT)
    assert found.sigma_scale == pytest.approx(1e-5, rel=1e-2)
    assert abs(found.scale) < 4 * found.sigma_scale
    assert found.p_value > 1e-3


def test_items_required_by_the_guideline_and_missing_are_reported():
    line = np.array([0, 0, 0, 1])
    lines_of_two = CalibratedLengths(CALIBRATED, np.zeros(4), line=line)
    found = length_errors(CALIBRATED, np.eye(4) * 1e-12, lines_of_two, volume_m=np.array([2.0, 2.0, 1.5]))
    assert found.lacks == (
        "2 measuring lines of 7",
        "2 measuring lines with fewer than 5 lengths",
        "the longest is 1.5 m, two thirds of the diagonal 2.13 m",
    )
    lines = np.repeat(np.arange(7), 5)
    lengths = np.tile(np.linspace(0.4, 2.2, 5), 7)
    full = length_errors(
        lengths, np.eye(35), CalibratedLengths(lengths, np.zeros(35), line=lines), volume_m=np.array([2.0, 2.0, 1.5])
    )
    assert full.lacks == ()
