"""Sets of identifiable parameters: the report's set for the telescope, and maximality for all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.estimation.telescope_rows import COLUMNS, LEGS, REFERENCE, rows
from truing.estimation.design.observability import choose_identifiable, observe

SEEDS = st.integers(0, 2**32 - 1)
NOISE_MM = 0.005
GEOMETRY = list(COLUMNS[:9])
# How far the report lets parameters go: its tables 5 to 7 have millimetres and tenths of a radian.
SCALES = {**dict.fromkeys(COLUMNS, 4.0), "ux": 0.1, "uy": 0.1, "l": 5.0, "kappa": 0.05}


def choose(names, leg, **options):
    found = choose_identifiable(rows(names, leg) / NOISE_MM, [SCALES[name] for name in names], names, **options)
    return set(found.observability.labels), found


@pytest.mark.parametrize("leg", LEGS)
def test_the_reports_set_or_the_one_with_the_other_component_of_u(leg):
    chosen, found = choose(GEOMETRY, leg)
    assert chosen in ({"ax", "ay", "bx", "by", u, "l"} for u in ("ux", "uy"))
    leaning_along_y = leg in (2, 5)
    assert ("uy" in chosen) == leaning_along_y
    key = "ax ay bx by ux l" if "ux" in chosen else "ax ay bx by uy l"
    expected = REFERENCE["sets"][key]["legs"][leg]["singular_values"]
    unscaled = observe(rows(key.split(), leg), np.ones(6), key.split(), unidentifiable=1e12)
    assert unscaled.singular_values == pytest.approx(expected, rel=5e-6)
    assert found.observability.rank == 6


def test_every_leg_with_the_same_set_and_the_report_s_component_preferred():
    whole, labels, groups = np.zeros((240, 54)), [], []
    for leg in LEGS:
        whole[40 * leg : 40 * leg + 40, 9 * leg : 9 * leg + 9] = rows(GEOMETRY, leg) / NOISE_MM
        labels += [f"{name}{leg + 1}" for name in GEOMETRY]
        groups += GEOMETRY
    scales = [SCALES[name] for name in groups]
    preferred = choose_identifiable(whole, scales, labels, groups=groups, preference=[n != "ux" for n in groups])
    assert {g for g, used in zip(groups, preferred.chosen, strict=True) if used} == {"ax", "ay", "bx", "by", "ux", "l"}
    free = choose_identifiable(whole, scales, labels, groups=groups)
    assert {g for g, used in zip(groups, free.chosen, strict=True) if used} in (
        {"ax", "ay", "bx", "by", u, "l"} for u in ("ux", "uy")
    )
    assert free.observability.singular_values[-1] > 1.0


@pytest.mark.parametrize("leg", LEGS)
def test_kappa_or_u_but_not_both(leg):
    chosen, _ = choose([*GEOMETRY, "kappa"], leg)
    assert len(chosen & {"ux", "uy", "kappa"}) == 1
    without, _ = choose([*GEOMETRY, "kappa"], leg, preference=[0] * 9 + [1])
    assert without & {"ux", "uy"}
    assert "kappa" not in without


@pytest.mark.parametrize("favoured", ["az", "bz", "l"])
def test_of_indistinguishable_parameters_the_one_with_the_largest_tolerance_is_chosen(favoured):
    names = ["az", "bz", "l"]
    scales = [10.0 if name == favoured else 0.1 for name in names]
    assert choose_identifiable(rows(names, 0) / NOISE_MM, scales, names).observability.labels == (favoured,)


@given(SEEDS)
def test_the_set_is_identifiable_and_maximal(seed):
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(15, 8)) @ (rng.normal(size=(8, 8)) * 10.0 ** rng.uniform(-3, 2, 8))
    scales, labels = 10.0 ** rng.uniform(-1, 1, 8), [f"x{j}" for j in range(8)]
    found = choose_identifiable(J, scales, labels)
    assert found.observability.rank == len(found.order) == found.chosen.sum()
    for j in np.flatnonzero(~found.chosen):
        more = found.chosen | (np.arange(8) == j)
        bigger = observe(J[:, more], scales[more], [labels[k] for k in np.flatnonzero(more)])
        assert bigger.rank < more.sum()


@given(SEEDS)
def test_the_choice_does_not_depend_on_units_or_on_rotations_of_the_rows(seed):
    rng = np.random.default_rng(seed)
    J, scales = 3.0 * rng.normal(size=(12, 3)) @ rng.normal(size=(3, 6)), rng.uniform(0.5, 2.0, 6)
    unit, turn = 10.0 ** rng.integers(-3, 4, 6), np.linalg.qr(rng.normal(size=(12, 12)))[0]
    labels = list("abcdef")
    first = choose_identifiable(J, scales, labels)
    second = choose_identifiable(turn @ J / unit, scales * unit, labels)
    assert first.order == second.order


def test_preference_comes_before_size():
    J = np.array([[10.0, 1.0, 0.0], [0.0, 0.0, 5.0], [0.0, 0.1, 0.0]])
    assert choose_identifiable(J, np.ones(3), list("xyz")).order == (0, 2)
    assert choose_identifiable(J, 2 * np.ones(3), list("xyz"), preference=[1, 0, 2]).order == (1, 2)


def test_wrong_numbers_are_refused():
    with pytest.raises(ValueError, match="groups"):
        choose_identifiable(np.eye(3), np.ones(3), list("xyz"), groups=["a"])
    with pytest.raises(ValueError, match="preferences"):
        choose_identifiable(np.eye(3), np.ones(3), list("xyz"), preference=[1, 2])
