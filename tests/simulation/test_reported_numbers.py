"""Parameters that changed between two campaigns, in the tables."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tolerance import assert_close
from truing.inference.changes import compare
from truing.simulation.prior_campaign import CampaignPrior
from truing.simulation.reported_numbers import Number, ReportedNumbers, figures


@pytest.mark.parametrize("follows", [2e-3, -2e-3])
def test_a_change_has_the_sign_of_now_less_before_whichever_way_the_tables_count(follows: float) -> None:
    """The components of an actuator's direction follow its tilts with either sign: one that points down, for one."""
    one, sure = np.eye(1), np.eye(1) * 1e-4
    earlier = CampaignPrior((), (), np.zeros(1), sure, 0 * one, one, np.linalg.inv(sure) - one, np.zeros(1))
    reported = ReportedNumbers((Number("u_y", 1, "1", 2e-3),), np.array([[follows]]), np.zeros(1))
    now = np.array([0.8])
    found = figures(earlier, reported, compare(np.zeros(1), sure, now, sure, one), now, sure)
    assert found["changed"] == [True]
    difference = found["now"][0] - found["before"][0]
    assert_close(found["change"][0], difference, atol=1e-3 * abs(difference))
    assert_close(found["sigma_change"][0], abs(follows) * np.sqrt(2e-4), atol=1e-7)
