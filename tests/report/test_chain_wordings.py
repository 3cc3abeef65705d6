"""Sentences on causes of a chain name the parameters that are fitted along with the cause."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.sentences import assert_says
from truing.report.wordings.catalogue import clause, confirming
from truing.report.wordings.chain_wordings import CHAIN
from truing.report.wordings.claim import Claim, ParameterSize


def test_a_compliance_names_links_whose_centres_of_mass_are_fitted_next_to_it() -> None:
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
    sizeless = clause(Claim(cause="joint-backlash", subject="joint j2", is_negative=True))
    assert_says(sizeless, "leads its reading", "compensated too much")


def test_a_deflection_against_the_declared_gravity_is_gravity_or_the_controller() -> None:
    """A controller that corrects too much sag, and gravity from the other side, move a joint alike."""
    gravity = CHAIN["gravity-direction"]
    opposite, other = (
        Claim(cause="gravity-direction", settings={"direction": way, "joints": ["j2"], "is_opposite": is_opposite})
        for way, is_opposite in (("+z", True), ("-x", False))
    )
    assert_says(gravity.clause(opposite), "gravity along +z", "or the controller")
    assert "controller" not in gravity.clause(other)
    assert callable(gravity.advice)
    assert "the controller" in gravity.advice(opposite)
    assert "controller" not in gravity.advice(other)


@pytest.mark.parametrize(("cause", "subject"), [("base-drift", ""), ("base-jump", ""), ("tool-jump", "link tool0")])
def test_a_displacement_has_the_length_of_its_shift(cause: str, subject: str) -> None:
    """Measured values change by less than the shift, because the place of the base is free."""
    shift = (("dx", 0.06, 0.003, "mm"), ("dy", 0.08, 0.003, "mm"), ("dz", 0.0, 0.003, "mm"))
    still = tuple((f"turn_{axis}", 1e-6, 4e-6, "rad") for axis in "xyz")
    turned = (*still[:2], ("turn_z", 1e-4, 4e-6, "rad"))
    words = [
        CHAIN[cause].clause(
            Claim(
                cause=cause,
                subject=subject,
                sizes=tuple(ParameterSize(*size) for size in (*shift, *turns)),
                largest_motion=62.0,
                unit="um",
            )
        )
        for turns in (still, turned)
    ]
    assert all("100.0 ± 3.0 um" in clause and "62" not in clause for clause in words)
    assert "arcsec" not in words[0]
    assert "20.6" in words[1]  # 1e-4 rad in arc seconds


@pytest.mark.parametrize("cause", ["joint-gain", "joint-error-curve", "joint-offset"])
def test_no_advice_turns_a_slide(cause: str) -> None:
    turns, slides = (
        CHAIN[cause].advice(Claim(cause=cause, subject="joint rail", settings={"is_angle": is_angle}))
        for is_angle in (True, False)
    )
    assert turns != slides
    assert not any(word in slides.lower() for word in ("turn", "angle", "degree", "level"))


def test_loads_of_weight_and_directions_of_approach_are_inputs_in_words() -> None:
    claim = Claim(
        cause="unexplained",
        subject="joint j2",
        follows=("torque_j2_nm",),
        settings={"joint": "j2", "columns": ["torque_j2_nm"], "half_ranges": [30.0], "form": "polynomial"},
    )
    assert_says(clause(claim), "the torque of weight on j2")
    assert_says(confirming(claim).words, "another payload")
    late = replace(
        claim, settings={**claim.settings, "columns": ["speed_pct", "approach_j2"], "half_ranges": [40.0, 1.0]}
    )
    assert_says(clause(late), "speed_pct", "the direction of approach of j2")
    assert_says(confirming(late).words, "from both sides", "speed_pct")
