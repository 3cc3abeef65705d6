"""Figures of docs/solver.md on many starts are computed from the sample."""

from __future__ import annotations

import re

import numpy as np
import pytest

from docs.experiments import many_starts
from tests.tolerance import assert_close
from truing.simulation.mechanisms.recalibration import recalibrate

PAGE = (many_starts.PROJECT / "docs" / "solver.md").read_text(encoding="utf-8")


def test_the_samples_poses_close_with_its_own_deformation() -> None:
    campaign = many_starts.sample_campaign()
    machine, parameters = many_starts.cases(campaign)["κ, the rest of K known"]
    fit = recalibrate(machine, parameters, campaign.p[None], campaign.R[None], campaign.rho[None])
    assert fit.ok.all()
    lever = 0.135 * many_starts.ORIENTATION_RAD  # the platform's joints
    noise = np.hypot(many_starts.POSITION_M, lever)
    rms = np.sqrt(fit.cost[0].sum() / (fit.cost[0].size * (len(campaign.p) - len(fit.names[0]))))
    assert 0.8 * many_starts.POSITION_M < rms < 1.2 * noise
    kappa = fit.values[0, :, fit.names[0].index("kappa")]
    assert_close(kappa, np.diag(campaign.K), atol=2e-3)


def test_shares_of_a_few_starts_are_complete(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many_starts, "STARTS", 3)
    campaign = many_starts.sample_campaign()
    case = {"κ": many_starts.cases(campaign)["κ, the rest of K ignored"]}
    monkeypatch.setattr(many_starts, "cases", lambda _: case)
    rows = many_starts.table(campaign).splitlines()[2:]
    assert len(rows) == 3
    assert all(row.count("100.0 % / 0.0 % / 0.0 %") == 2 for row in rows)
    assert all(row.endswith("| 1, 1, 1, 1, 1, 1 |") for row in rows)


def test_shares_on_the_page_add_up() -> None:
    rows = [line for line in PAGE.partition("<!-- table starts -->")[2].splitlines() if " % / " in line]
    assert len(rows) == 12
    for row in rows:
        for cell in row.split("|")[3:5]:
            assert_close(sum(float(share) for share in re.findall(r"([\d.]+) %", cell)), 100.0, atol=0.15)
