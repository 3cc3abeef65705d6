"""Sentences on causes of a chain: they name what is fitted beside the cause."""

from __future__ import annotations

from tests.sentences import assert_says
from truing.report.wordings.chain_wordings import CHAIN
from truing.report.wordings.claim import Claim


def test_a_compliance_names_links_whose_centres_of_mass_are_fitted_beside_it() -> None:
    parts = ["upper arm x", "upper arm z", "tip z"]
    clause = CHAIN["joint-compliance"].clause
    fitted = clause(Claim(cause="joint-compliance", subject="joint j2", settings={"parts": parts, "free": True}))
    assert_says(fitted, "centres of mass", "upper arm", "tip")
    assumed = clause(Claim(cause="joint-compliance", subject="joint j2", settings={"parts": parts, "free": False}))
    assert "centres" not in assumed
