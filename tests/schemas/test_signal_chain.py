"""[signals.chain] gives the sensitivity of a sensor's channels as the paper's data sheet does."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from truing.schemas.sections import Signals

PAPER = {"rated_load_n": 19600.0, "output_mv_per_v": 2.0, "output_sigma_mv_per_v": 0.01, "supply_v": 10.0}


def test_the_papers_cells_change_by_1_mv_per_980_n():
    signals = Signals.model_validate({"chain": PAPER})
    assert signals.sensitivity_mv_per_n == pytest.approx(1 / 980)
    assert signals.sensitivity_tolerance == pytest.approx(0.005)


def test_amplification_multiplies_the_sensitivity_and_adds_its_uncertainty():
    signals = Signals.model_validate({"chain": PAPER | {"amplification": 50.0, "amplification_sigma": 0.012}})
    assert signals.sensitivity_mv_per_n == pytest.approx(50 / 980)
    assert signals.sensitivity_tolerance == pytest.approx(0.013)


@pytest.mark.parametrize("missing", ["rated_load_n", "output_mv_per_v", "supply_v"])
def test_a_part_of_the_chain_is_no_sensitivity(missing: str):
    with pytest.raises(ValidationError, match=missing):
        Signals.model_validate({"chain": {key: value for key, value in PAPER.items() if key != missing}})


def test_a_chain_and_another_sensitivity_contradict_each_other():
    with pytest.raises(ValidationError, match="leave sensitivity_mv_per_n out"):
        Signals.model_validate({"chain": PAPER, "sensitivity_mv_per_n": 0.5})
