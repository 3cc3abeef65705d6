"""Budget of the tip's predicted pose: its parts sum to the whole, and it holds for simulated arms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.pipeline.test_power_of_chains import TOML
from truing.estimation.rotation import log_so3
from truing.inference.fitter import Fitter
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.in_memory import chain_tables
from truing.simulation.cause import Effect
from truing.simulation.mechanisms.chains.causes import JointGain
from truing.simulation.mechanisms.chains.extended_model import extended_chain, predict_tip
from truing.stages.diagnosis.search import assembled_data
from truing.stages.diagnosis.tip_uncertainty import tip_contributions
from truing.stages.power import chain_plan_of

_CAMPAIGNS = 100
_SIGMA = np.radians([2e-3, 2e-3, 2e-3])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A planned arm with noisy readings."""
    found = tmp_path_factory.mktemp("tip") / "small"
    found.mkdir()
    (found / "campaign.toml").write_text(f"{TOML}joint_deg = 0.002\n")
    (found / "targets.csv").write_text("body,target,x_mm,y_mm,z_mm\ntip,A,0,0,0\ntip,B,0,50,0\ntip,C,0,0,50\n")
    rng, rows = np.random.default_rng(3), ["pose,role,first_deg,second_deg,third_deg"]
    for pose in range(30):
        a, b, c = rng.uniform((-120.0, -60.0, -90.0), (120.0, 60.0, 90.0))
        rows.append(f"{pose},calibration,{a:.3f},{b:.3f},{c:.3f}")
    (found / "configurations.csv").write_text("\n".join(rows) + "\n")
    return found


def test_the_budget_of_the_tip_holds_in_simulated_campaigns(folder: Path) -> None:
    """Squared errors over variances average to one: links, zeros, effect, points, and readings are drawn anew."""
    campaign = open_campaign(folder)
    settings = campaign.validated()
    plan = chain_plan_of(chain_tables(campaign, settings), settings)
    cause, ratios = JointGain("third"), []
    for seed in range(_CAMPAIGNS):
        rng = np.random.default_rng(seed)
        effect = Effect(cause, np.array([1e-3 * rng.standard_normal()]))
        data = assembled_data(plan.drawn((effect,), np.random.default_rng((seed, 1))), settings)
        fitter = Fitter(data.model, data.calibration, None, 0)
        fitted = fitter.prepared((cause,))
        conditions = data.model.conditions
        extended, parts = tip_contributions(fitted, conditions, _SIGMA)
        covariance = np.sum([part for _, part in parts], 0)
        # The truth: the same numbers as `drawn` takes from its generator first.
        plain = plan.model.with_causes(())
        count = len(plain.conditions.readings)
        known = plain.predict(np.zeros(plain.shared_size), np.zeros((count, plain.local_size))).shared_known
        hidden = plain.with_causes([cause])
        draw = np.random.default_rng((seed, 1)).standard_normal(plain.shared_size)
        shared = plain.embedded(np.where(known, draw, 0.0), hidden)
        hidden.set_effects(shared, [effect])
        true = extended_chain(hidden, shared, np.zeros((hidden.shared_size, hidden.shared_size)), extended.tip, {})
        moved = replace(
            conditions, readings=conditions.readings + _SIGMA * rng.standard_normal(conditions.readings.shape)
        )
        there, predicted = predict_tip(true, moved), predict_tip(extended, conditions)
        turned = log_so3(there.R @ np.swapaxes(predicted.R, -1, -2))
        error = np.concatenate([there.p - predicted.p, turned], -1)
        ratios.append(np.mean(error**2 / np.diagonal(covariance, axis1=1, axis2=2), 0))
    mean, spread = np.mean(ratios, 0), np.std(ratios, axis=0, ddof=1) / np.sqrt(_CAMPAIGNS)
    assert (spread < 0.25).all()
    assert (np.abs(mean - 1.0) < 3.0 * spread).all()
    for factor in (1.5**2, 1.5**-2):  # budgets that are half as large again, or as small, would be seen
        assert (np.abs(mean * factor - 1.0) > 3.0 * factor * spread).any()


def test_the_parts_of_the_fit_sum_to_its_covariance(folder: Path) -> None:
    campaign = open_campaign(folder)
    settings = campaign.validated()
    plan = chain_plan_of(chain_tables(campaign, settings), settings)
    data = assembled_data(plan.drawn((), np.random.default_rng(0)), settings)
    fitted = Fitter(data.model, data.calibration, None, 0).prepared()
    extended, parts = tip_contributions(fitted, data.model.conditions, 0.0 * _SIGMA)
    whole = predict_tip(extended, data.model.conditions).covariance
    together = np.sum([part for _, part in parts], 0)
    assert np.abs(together - whole).max() < 1e-9 * np.abs(whole).max()
    assert {source.source for source, _ in parts if source} >= {"observations", "inputs", "links", "zeros"}


def test_a_comparable_fit_keeps_the_noise_of_the_other_fit(folder: Path) -> None:
    """Noise learned from a later fit changes no comparison with an earlier one."""
    campaign = open_campaign(folder)
    settings = campaign.validated()
    plan = chain_plan_of(chain_tables(campaign, settings), settings)
    hidden = Effect(JointGain("third"), np.array([5e-3]))
    data = assembled_data(plan.drawn((hidden,), np.random.default_rng(0)), settings)
    fitter = Fitter(data.model, data.calibration, None, 0)
    plain, squares = fitter.fitted(()), {}
    for name in ("before", "after"):
        squares[name] = float(np.sum(fitter.comparable((hidden.cause,), plain).fit.whitened.rest ** 2))
        again = float(np.sum(fitter.fitted((hidden.cause,), plain).fit.whitened.rest ** 2))
        assert (abs(again / squares[name] - 1.0) < 1e-9) == (name == "before")
        fitter.converged((), plain)  # noise without the effect is larger
    assert abs(squares["after"] / squares["before"] - 1.0) < 1e-9
