"""Comparison of two runs of a chain: a slipped zero is named alone, chance is not, and other chains are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, chi2

from truing.runs.comparison.chain_step import chain_numbers, chain_step
from truing.runs.comparison.steps import LEVEL
from truing.simulation.cause import Effect
from truing.simulation.mechanisms.chains.causes import ChainCause, JointCompliance, JointOffset
from truing.simulation.mechanisms.chains.extended_model import ExtendedChain
from truing.simulation.mechanisms.chains.notations import DenavitHartenberg, tree_of_rows
from truing.simulation.mechanisms.chains.tree import geometry_modes
from truing.simulation.targets import FREE_ANGLE_RAD, FREE_LENGTH_M

JOINTS = ("a", "b", "c")
ROWS = ((0.0, np.pi / 2, 0.3), (0.4, 0.0, 0.0), (0.3, 0.0, 0.05))
TREE = tree_of_rows([DenavitHartenberg(a, alpha, d, 0.0) for a, alpha, d in ROWS], JOINTS)
SIGMAS = {"dx": 5e-4, "dy": 5e-4, "dz": 5e-4, "turn_x": 1e-3, "turn_y": 1e-3, "offset": 2e-3}  # m, rad
NUMBERS = [(joint, name) for joint in JOINTS for name in SIGMAS]
PRIOR = np.array([SIGMAS[name] for _, name in NUMBERS])
MEASURED = np.random.default_rng(1).normal(size=(12, len(NUMBERS))) / (0.01 * PRIOR)  # fewer readings than numbers
COVARIANCE = np.linalg.inv(MEASURED.T @ MEASURED + np.diag(PRIOR**-2))
SLIP = 4e-4  # rad
DRAWS = 150


def table(tolerance: float = 1.0) -> pd.DataFrame:
    units = ["mm" if name[0] == "d" else "rad" for _, name in NUMBERS]
    si = np.array([1e-3 if unit == "mm" else 1.0 for unit in units])
    columns = {"joint": [j for j, _ in NUMBERS], "parameter": [p for _, p in NUMBERS], "unit": units}
    return pd.DataFrame(columns).assign(identified=0.0, sigma=1.0, tolerance=tolerance * PRIOR / si)


def model_of(values: NDArray, *effects: Effect[ChainCause]) -> ExtendedChain:
    """A chain with these numbers (18,), whose zeros turn about z."""
    place = [6 * JOINTS.index(j) + ("dx", "dy", "dz", "turn_x", "turn_y", "offset").index(p) for j, p in NUMBERS]
    count = 18 + len(effects)
    twists, covariance = np.zeros(18), np.zeros((count, count))
    twists[place], covariance[np.ix_(place, place)] = values, COVARIANCE
    moved = np.array([TREE.node_of(k) for k in range(3)])
    every = np.zeros((TREE.size, 6))
    every[moved] = twists.reshape(3, 6)
    reach = np.array([[-np.inf] * 3, [np.inf] * 3])
    return ExtendedChain(
        TREE, every, moved, TREE.size - 1, None, np.zeros(3), 0.0, 20.0, reach,
        effects=effects, covariance=covariance, context={},
    )  # fmt: skip


def measured(rng: np.random.Generator, truth: NDArray) -> ExtendedChain:
    """Estimate of the true numbers (18,) by one campaign, from its readings and the tolerances."""
    readings = MEASURED @ truth + rng.normal(size=len(MEASURED))
    return model_of(COVARIANCE @ MEASURED.T @ readings)


@pytest.mark.slow
def test_numbers_that_did_not_change_are_named_no_oftener_than_the_level_says() -> None:
    rng = np.random.default_rng(2)
    steps = []
    for _ in range(DRAWS):
        truth = PRIOR * rng.normal(size=len(PRIOR))
        steps.append(chain_step(measured(rng, truth), measured(rng, truth), table(), table()).rows)
    assert sum(bool(rows["changed"].any()) for rows in steps) <= binom.ppf(0.999, DRAWS, LEVEL)
    z = np.array([rows["z"] for rows in steps], float)
    known = np.isfinite(z).all(0)
    assert known.any()
    # Never too small; larger where both campaigns leave a number to its tolerance.
    assert (np.sum(z[:, known] ** 2, 0) < chi2.ppf(1.0 - 1e-5, DRAWS)).all()


def test_a_zero_that_slipped_within_its_tolerance_is_named_alone_with_its_size() -> None:
    rng = np.random.default_rng(3)
    truth = PRIOR * rng.normal(size=len(PRIOR))
    slipped = truth + SLIP * np.array([number == ("b", "offset") for number in NUMBERS])
    rows = chain_step(measured(rng, truth), measured(rng, slipped), table(), table()).rows
    (changed,) = rows[rows["changed"]].itertuples()
    assert changed.parameter == "offset of joint b"
    assert abs(changed.change - SLIP) < 4 * changed.sigma_change
    assert changed.change > 5 * changed.sigma_change


def test_a_joint_offset_beyond_its_tolerance_counts_with_the_zero_of_the_joint() -> None:
    """If only one run finds a zero far off, the joint was taken apart in between."""
    truth = np.zeros(len(PRIOR))
    far = model_of(truth, Effect(JointOffset(joint="b"), np.array([0.02])))
    rows = chain_step(measured(np.random.default_rng(4), truth), far, table(), table()).rows
    largest = rows.loc[rows["change"].abs().astype(float).idxmax()]
    assert largest["parameter"] == "offset of joint b"
    assert abs(largest["change"] - 0.02) < 1e-3


def test_other_chains_and_other_numbers_are_not_compared() -> None:
    rng = np.random.default_rng(5)
    one = measured(rng, np.zeros(len(PRIOR)))
    longer = replace(one, tree=tree_of_rows([DenavitHartenberg(0.5, 0.0, 0.0, 0.0)] * 3, JOINTS))
    assert chain_step(one, longer, table(), table()).why
    assert chain_step(one, one, table(), table(2.0)).why
    assert chain_step(one, one, table(), table().iloc[1:]).why
    assert set(chain_numbers(one, table())["group"]) == {"geometry"}


# Without tolerances: the links have the fewest numbers that describe all their errors.
FREE = np.array([FREE_LENGTH_M] * 3 + [FREE_ANGLE_RAD] * 3)
MODES = geometry_modes(TREE, FREE, True)[[TREE.node_of(k) for k in range(3)]].reshape(18, -1)
SEEN = 1e3 * np.random.default_rng(11).normal(size=(40, MODES.shape[1]))  # whitened measurements per wide sigma
SPREAD = np.linalg.inv(SEEN.T @ SEEN + np.eye(MODES.shape[1]))
GAIN = 1e-5


def free_table() -> pd.DataFrame:
    """The components that any error of a link has, as a run lists them."""
    components = ("dx", "dy", "dz", "turn_x", "turn_y", "turn_z")
    found = [divmod(k, 6) for k in np.flatnonzero(np.abs(MODES).max(1) > 0.0)]
    units = ["mm" if c < 3 else "rad" for _, c in found]
    columns = {"joint": [JOINTS[j] for j, _ in found], "parameter": [components[c] for _, c in found], "unit": units}
    return pd.DataFrame(columns).assign(identified=0.0, sigma=1.0, tolerance=np.nan)


def free_measured(
    rng: np.random.Generator, errors: NDArray, gain: float | None = None, load: float = 1.0
) -> ExtendedChain:
    """Estimate of true errors (Q,) of the links and of a joint's gain by one campaign without tolerances."""
    away = SPREAD @ SEEN.T @ (SEEN @ errors + rng.normal(size=len(SEEN)))
    model = model_of(np.zeros(18))
    effects = []
    if gain is not None:
        compliant = JointCompliance(joint="b", load=load)
        effects = [Effect(compliant, np.array([gain + GAIN * rng.normal()]))]
    covariance = np.zeros((18 + len(effects),) * 2)
    covariance[:18, :18] = MODES @ SPREAD @ MODES.T
    covariance[18:, 18:] = GAIN**2
    twists = np.zeros((TREE.size, 6))
    twists[model.moved] = (MODES @ away).reshape(3, 6)
    return replace(model, twists=twists, covariance=covariance, effects=tuple(effects))


@pytest.mark.slow
def test_without_tolerances_numbers_that_did_not_change_are_named_no_oftener_than_the_level_says() -> None:
    rng, rows = np.random.default_rng(12), free_table()
    steps = []
    for _ in range(DRAWS):
        errors = 0.05 * rng.normal(size=MODES.shape[1])
        steps.append(chain_step(free_measured(rng, errors), free_measured(rng, errors), rows, rows).rows)
    assert sum(bool(step["changed"].any()) for step in steps) <= binom.ppf(0.999, DRAWS, LEVEL)
    z = np.array([step["z"] for step in steps], float)
    tested = np.isfinite(z).all(0)
    assert tested.sum() == MODES.shape[1]  # as many as the errors have dimensions; the others follow from them
    squares = np.sum(z[:, tested] ** 2, 0)
    assert (squares < chi2.ppf(1.0 - 1e-5, DRAWS)).all()
    assert (squares > chi2.ppf(1e-5, DRAWS)).all()
    assert (steps[0]["reason"].notna() == ~tested).all()


def test_without_tolerances_a_link_that_bent_is_named_alone_with_its_size() -> None:
    rng, rows = np.random.default_rng(13), free_table()
    errors = 0.05 * rng.normal(size=MODES.shape[1])
    names = [f"{r.parameter} of joint {r.joint}" for r in rows.itertuples()]
    tested = chain_step(*(free_measured(rng, errors) for _ in range(2)), rows, rows).rows
    tested = tested[tested["z"].notna()]
    components = np.flatnonzero(np.abs(MODES).max(1) > 0.0)
    of_tested = MODES[components[[names.index(name) for name in tested["parameter"]]]]
    for k in range(len(tested)):
        bent = np.linalg.solve(of_tested, 30.0 * np.eye(len(tested))[k] * np.sqrt(of_tested[k] @ SPREAD @ of_tested[k]))
        step = chain_step(free_measured(rng, errors), free_measured(rng, errors + bent), rows, rows).rows
        (changed,) = step[step["changed"]].itertuples()
        assert changed.parameter == tested["parameter"].iloc[k]
        si = 1e-3 if rows["unit"][names.index(changed.parameter)] == "mm" else 1.0
        assert abs(si * changed.change - of_tested[k] @ bent) < 4.5 * si * changed.sigma_change


def test_an_effect_that_both_runs_found_is_tested_whatever_its_load_was() -> None:
    rng, rows = np.random.default_rng(14), free_table()
    none = np.zeros(MODES.shape[1])
    same = chain_step(free_measured(rng, none, 1e-4), free_measured(rng, none, 1e-4, load=1.1), rows, rows).rows
    assert not same["changed"].any()
    assert same.loc[same["group"] == "effect", "z"].notna().all()
    softer = chain_step(free_measured(rng, none, 1e-4), free_measured(rng, none, 3e-4, load=1.1), rows, rows).rows
    (changed,) = softer[softer["changed"]].itertuples()
    assert (changed.effect_of, changed.parameter) == ("joint-compliance joint b", "compliance")
    assert abs(changed.change - 2e-4) < 4 * changed.sigma_change < 1e-4
