"""Signals without declared noise: errors are not compared with a noise that the misfit itself was taken for."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.stages.line import run_line
from truing.report.diagnosis.adequacy import adequacy_verdict
from truing.schemas.verdict import ReasonCode

LOADS = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
TOML = """
[campaign]
name = "signals"
kind = "interferometer"
{noise}
[files.signals]
path = "signals.csv"
"""


def _campaign(folder: Path, noise_mv: float | None) -> Path:
    """40 loads of a sensor with two signals that bend by a tenth, noise 1 mV, and a running number of the rows."""
    rng = np.random.default_rng(8)
    loads = rng.uniform(-1.0, 1.0, (40, 6))
    signals = loads @ rng.normal(0.0, 100.0, (6, 2))
    signals += 0.1 * signals**2 / np.abs(signals).max() + rng.normal(0.0, 1.0, signals.shape)
    table = pd.DataFrame(loads, columns=LOADS).assign(run="1", step=range(1, 41), number=np.arange(101.0, 141.0))
    folder.mkdir()
    table.assign(v1_mv=signals[:, 0], v2_mv=signals[:, 1]).to_csv(folder / "signals.csv", index=False)
    noise = "" if noise_mv is None else f"[noise]\nsignal_mv = {noise_mv}"
    (folder / "campaign.toml").write_text(TOML.format(noise=noise))
    return folder


@pytest.fixture(scope="module", params=[None, 1.0])
def diagnosed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[bool, pd.DataFrame]:
    folder = _campaign(tmp_path_factory.mktemp("signals") / "campaign", request.param)
    tables, _ = run_line(folder, "ingest", "diagnose")
    return request.param is not None, tables["diagnosis"].to_pandas()


def test_noise_is_compared_with_errors_only_where_it_is_declared(diagnosed: tuple[bool, pd.DataFrame]) -> None:
    is_declared, rows = diagnosed
    assert rows["noise_floor"].notna().any() == is_declared
    assert rows["explanation"].str.contains("noise alone gives").any() == is_declared
    verdict = adequacy_verdict({"diagnosis": rows}, {})
    assert verdict is not None
    assert (verdict.reason_code is ReasonCode.NOT_EVALUATED) == (not is_declared)


def test_the_running_number_of_the_rows_is_no_input(diagnosed: tuple[bool, pd.DataFrame]) -> None:
    assert "number" not in " ".join(diagnosed[1]["follows"].fillna("")).split()


def test_undeclared_noise_is_estimated_next_to_the_causes_found(tmp_path: Path) -> None:
    """The scatter about the plain model holds the effect itself: by it, sigma would be 30 times larger."""
    rng = np.random.default_rng(5)
    loads = rng.uniform(-1.0, 1.0, (60, 6))
    signals = loads @ rng.normal(0.0, 100.0, (6, 6))
    signals[:, 1] += 1e-3 * signals[:, 1] ** 2
    signals += rng.normal(0.0, 0.1, signals.shape)
    table = pd.DataFrame(loads, columns=LOADS).assign(run="1", step=range(1, 61))
    table = table.assign(**{f"v{k + 1}_mv": signals[:, k] for k in range(6)})
    table.to_csv(tmp_path / "signals.csv", index=False)
    (tmp_path / "campaign.toml").write_text(TOML.format(noise=""))
    rows = run_line(tmp_path, "ingest", "diagnose")[0]["diagnosis"].to_pandas()
    (found,) = rows[rows["verdict"] == "found"].itertuples()
    assert (found.cause, found.subject) == ("signal-nonlinear", "signal v2")
    quadratic = json.loads(found.parameters)["quadratic"]
    assert quadratic["sigma"] < 3e-6
    assert abs(quadratic["value"] - 1e-3) < 4.0 * quadratic["sigma"]
