"""Sentences on causes of a chain name the parameters that are fitted along with the cause."""

from __future__ import annotations

from tests.sentences import assert_says
from truing.report.wordings.chain_wordings import CHAIN
from truing.report.wordings.claim import Claim, ParameterSize


def test_a_compliance_names_links_whose_centres_of_mass_are_fitted_beside_it() -> None:
    parts = ["upper arm x", "upper arm z", "tip z"]
    clause = CHAIN["joint-compliance"].clause
    fitted = clause(Claim(cause="joint-compliance", subject="joint j2", settings={"parts": parts, "free": True}))
    assert_says(fitted, "centres of mass", "upper arm", "tip")
    assumed = clause(Claim(cause="joint-compliance", subject="joint j2", settings={"parts": parts, "free": False}))
    assert "centres" not in assumed


def test_a_negative_backlash_is_no_backlash_but_one_that_is_compensated_too_much() -> None:
    clause = CHAIN["joint-backlash"].clause
    leads, lags = (
        clause(
            Claim(
                cause="joint-backlash", subject="joint j2", sizes=(ParameterSize("backlash", way * 2e-4, 1e-5, "rad"),)
            )
        )
        for way in (-1.0, 1.0)
    )
    assert_says(leads, "leads its reading after each reversal", "compensated too much")
    assert "-" not in leads
    assert "has backlash" in lags
