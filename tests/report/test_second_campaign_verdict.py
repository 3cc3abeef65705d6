"""A model that predicts a second campaign worse than the nominal one fails, whatever its gain in the first."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from truing.belonging.relation import RelationState
from truing.report.transfer_section import verdict_elsewhere
from truing.schemas.verdict import ReasonCode
from truing.stages.second_campaign.compared import probability_worse


def _errors(*rows: tuple[str, str, float, float | None], noise: float = 10.0) -> pd.DataFrame:
    """Rows of second_campaign_errors: model, quantity, rms error, p_worse."""
    return pd.DataFrame(
        {
            "campaign": "other",
            "prediction_by": by,
            "model": by,
            "quantity": quantity,
            "rms_error": rms,
            "largest_error": 3.0 * rms,
            "noise_rms": noise,
            "count": 60,
            "unit": "um",
            "p_worse": p,
            "beyond_range": 40,
        }
        for by, quantity, rms, p in rows
    )


@pytest.mark.parametrize(
    ("position", "p", "state", "code"),
    [
        (12.0, 1.0, RelationState.OK, ReasonCode.PREDICTS_ELSEWHERE),
        (40.0, 1.0, RelationState.ATTENTION, ReasonCode.BEYOND_NOISE_ELSEWHERE),
        (200.0, 1e-9, RelationState.FAILS, ReasonCode.WORSE_ELSEWHERE),
        (200.0, 0.2, RelationState.ATTENTION, ReasonCode.BEYOND_NOISE_ELSEWHERE),  # chance explains the difference
        (102.0, 1e-9, RelationState.ATTENTION, ReasonCode.BEYOND_NOISE_ELSEWHERE),  # worse by 2 %
    ],
)
def test_the_state_follows_from_the_errors_elsewhere(
    position: float, p: float, state: RelationState, code: ReasonCode
) -> None:
    verdict = verdict_elsewhere(_errors(("nominal", "position", 100.0, None), ("extended", "position", position, p)))
    assert (verdict.state, verdict.reason_code) == (state, code)


def test_one_worse_quantity_fails_although_another_gains() -> None:
    rows = ("nominal", "position", 100.0, None), ("nominal", "orientation", 100.0, None)
    verdict = verdict_elsewhere(
        _errors(*rows, ("extended", "position", 12.0, 1.0), ("extended", "orientation", 250.0, 1e-8))
    )
    assert verdict.reason_code is ReasonCode.WORSE_ELSEWHERE
    assert verdict.value == pytest.approx(2.5)
    assert "40 of 60 values" in verdict.explanation


def test_equally_good_predictions_are_called_worse_at_the_stated_rate() -> None:
    rng = np.random.default_rng(5)
    p = np.array([probability_worse(*rng.normal(size=(2, 60))) for _ in range(2000)], float)
    assert 0.03 < np.mean(p < 0.05) < 0.07


def test_predictions_with_larger_errors_are_called_worse() -> None:
    rng = np.random.default_rng(6)
    common = rng.normal(size=60)
    probability = probability_worse(common + 2.0 * rng.normal(size=60), common)
    assert probability is not None
    assert probability < 1e-3
    assert probability_worse(common, common) == 0.5
    assert probability_worse(common[:4], common[:4]) is None
