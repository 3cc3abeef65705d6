"""The verdict on a chain's geometry: within its tolerances, or which number the description has wrong."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from truing.belonging.relation import RelationState
from truing.report.chain_pulls import chain_pulls_verdict
from truing.report.section_verdict import SectionVerdict
from truing.report.verdict import section_verdicts
from truing.schemas.verdict import ReasonCode

_NUMBERS = ["joint", "parameter", "unit", "identified", "sigma", "tolerance", "pull", "identifiable"]


def _tables(far: float = 0.4, chi_square: float = 12.0, p_value: float = 0.3, freedom: int = 10) -> dict:
    rows = [
        ("elbow", "dz", "mm", 0.3 * far, 0.01, 0.3, far, True),
        ("wrist", "turn_x", "rad", 4e-4, 1e-5, 5e-4, 0.8, True),
        ("wrist", "dx", "mm", 9.0, 0.299, 0.3, 90.0, False),  # the data say next to nothing of it
        ("tool", "dy", "mm", 2.0, 0.1, np.nan, np.nan, True),  # no tolerance is declared
    ]
    sums = {"chi_square": chi_square, "freedom": freedom, "lower": 3.2, "upper": 20.5, "p_value": p_value}
    return {
        "chain_parameters": pd.DataFrame(rows, columns=_NUMBERS),
        "pull_sums": pd.DataFrame([{"model": model, **sums} for model in ("plain", "extended")]),
    }


def _verdict(tables: dict) -> SectionVerdict:
    verdict = chain_pulls_verdict(tables, {})
    assert verdict is not None
    assert section_verdicts(tables)["pulls"] == verdict
    return verdict


def test_a_chain_within_its_tolerances_agrees_with_its_description() -> None:
    verdict = _verdict(_tables())
    assert (verdict.state, verdict.reason_code) == (RelationState.OK, ReasonCode.WITHIN_TOLERANCE)
    assert verdict.value == pytest.approx(np.sqrt(1.2))


def test_one_length_far_from_its_tolerance_is_named_though_the_sum_of_all_is_good() -> None:
    verdict = _verdict(_tables(far=-5.5, chi_square=20.0))
    assert (verdict.state, verdict.reason_code) == (RelationState.FAILS, ReasonCode.BEYOND_TOLERANCE)
    assert "did you mean 1.65" in verdict.explanation
    assert "less for the shift along z of the frame of elbow" in verdict.explanation
    assert "wrist" not in verdict.explanation


def test_many_numbers_beyond_tolerances_fail_without_a_single_name() -> None:
    verdict = _verdict(_tables(far=2.5, chi_square=45.0, p_value=2e-6))
    assert verdict.state == RelationState.FAILS
    assert "did you mean" not in verdict.explanation
    assert _verdict(_tables(far=2.5, chi_square=22.0, p_value=0.015)).state == RelationState.ATTENTION


def test_without_tolerances_or_without_data_about_them_nothing_is_claimed() -> None:
    tables = _tables()
    assert chain_pulls_verdict({"chain_parameters": tables["chain_parameters"]}, {}) is None
    nothing = _verdict(_tables(chi_square=0.0, freedom=0, p_value=1.0))
    assert nothing.state == RelationState.NOT_TESTED
