"""Sentences on causes of an axis say from where a size counts."""

from __future__ import annotations

from tests.sentences import assert_says
from truing.report.wordings.catalogue import clause
from truing.report.wordings.claim import Claim, ParameterSize


def test_growth_names_the_temperature_at_which_it_is_zero() -> None:
    """A scale error next to it holds at this temperature, not at the reference temperature."""
    size = ParameterSize("growth", 1.15e-5, 4e-7, "1/K")
    grows = Claim(cause="axis-growth", subject="axis", sizes=(size,), settings={"reference_c": 21.318})
    assert_says(clause(grows), "grows with temperature", "ppm/K", "mean temperature of 21.3 °C")
    assert "°C" not in clause(Claim(cause="axis-growth", subject="axis", sizes=(size,)))
