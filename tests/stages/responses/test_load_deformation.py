"""The compliance of a loaded platform from readings, entry by entry against the simulated one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.blind.generator.sensor.effects import Hysteresis, LoadEccentricity
from tests.blind.generator.sensor.layout import Noise, Programme
from tests.stages.benches import Bench, bench, entry_errors, layout


def _figures(made: Bench, model: str) -> dict[tuple[str, str | None], float]:
    rows = made.frame("deformation_errors")
    rows = rows[rows["model"] == model]
    return {(r.figure, r.subject if r.subject == r.subject else None): r.value for r in rows.itertuples()}


@pytest.fixture(scope="module")
def eccentric(tmp_path_factory) -> Bench:
    """Each axis loaded three times, one of them held out, the z load off its line by 12 and -8 mm."""
    programme = Programme(channels="all", repeats=3, held_out=1)
    off = LoadEccentricity(2, (0.012, -0.008, 0.0))
    return bench(tmp_path_factory.mktemp("eccentric") / "c", replace(layout(), programme=programme), 7, [off])


def test_entries_are_the_true_ones_within_their_sigma(tmp_path):
    made = [bench(tmp_path / str(seed), layout("all"), seed) for seed in range(3)]
    errors = np.concatenate([entry_errors(one) for one in made])
    assert len(errors) == 3 * 36
    assert abs(np.mean(errors**2) - 1.0) < 4 * np.sqrt(2 / len(errors))
    for one in made:
        assert (one.frame("compliance").query("model == 'matrix'")["verdict"] == "agrees").all()
        assert _figures(one, "matrix")["agreement_p_value", None] > 1e-3


def test_an_eccentric_load_changes_only_responses_to_that_load(eccentric):
    rows = eccentric.frame("compliance").query("model == 'matrix'")
    differs = set(zip(*(rows.loc[rows["verdict"] == "differs", name] for name in ("response", "load")), strict=True))
    assert {("rx", "fz"), ("ry", "fz")} <= differs
    assert all(load == "fz" for _, load in differs)
    assert _figures(eccentric, "matrix")["symmetry_p_value", None] < 1e-6


def test_every_model_has_its_errors_of_what_was_held_out(eccentric):
    none, simulated, matrix = (_figures(eccentric, name) for name in ("none", "simulated", "matrix"))
    for prefix in ("", "cv_", "verification_"):
        assert matrix[f"{prefix}rms_error", "dx"] < 1.3 * 0.5
    assert simulated["verification_rms_error", "rx"] > 3.0 * matrix["verification_rms_error", "rx"]
    assert none["rms_error", "dx"] > 100.0
    assert abs(matrix["noise_ratio", None] - 1.0) < 0.1


def test_curves_have_the_simulation_next_to_the_measurement(eccentric):
    curves = eccentric.frame("axis_curves")
    own = curves[(curves["load"] == "fz") & (curves["channel"] == "dz")]
    assert set(own["branch"]) == {"unloaded", "loading", "unloading"}
    off = (own["measured"] - own["simulated"]) / np.hypot(own["sigma"], own["simulated_sigma"])
    assert off.abs().max() < 4.0
    turned = curves[(curves["load"] == "fz") & (curves["channel"] == "ry") & (curves["applied"].abs() > 8000.0)]
    off = (turned["measured"] - turned["simulated"]) / np.hypot(turned["sigma"], turned["simulated_sigma"])
    assert off.abs().min() > 4.0


def test_entries_that_were_never_measured_are_not_reported(tmp_path):
    made = bench(tmp_path / "c", layout("own"), 2)
    rows = made.frame("compliance")
    measured, simulated = (rows[rows["model"] == model] for model in ("matrix", "simulated"))
    assert [r[0][1] == r[1][1] for r in zip(measured["response"], measured["load"], strict=True)] == [True] * 6
    assert len(simulated) == 36
    assert "cv_rms_error" not in {figure for figure, _ in _figures(made, "matrix")}


def test_loads_that_are_uncertain_widen_the_entries(tmp_path):
    noise = Noise(force=20.0, torque=10.0)
    made = [bench(tmp_path / str(seed), layout("all", noise=noise), seed) for seed in range(2)]
    errors = np.concatenate([entry_errors(one) for one in made])
    # the error of a load moves all six channels at once: six entries of a column share it
    assert abs(np.mean(errors**2) - 1.0) < 4 * np.sqrt(2 / (len(errors) / 6))


def test_a_table_of_six_components_is_the_same_measurement(tmp_path):
    made = bench(tmp_path / "c", layout("all", written_as="displacement"), 3)
    again = bench(tmp_path / "d", layout("all"), 3)
    rows, others = (one.frame("compliance").query("model == 'matrix'") for one in (made, again))
    off = (rows["coefficient"].to_numpy() - others["coefficient"].to_numpy()) / rows["sigma"].to_numpy()
    assert np.abs(off).max() < 0.1  # files are rounded differently


def test_the_way_back_lies_apart_where_there_is_hysteresis_and_nowhere_else(tmp_path):
    made = bench(tmp_path / "c", layout("own"), 3, [Hysteresis(2, 0.03)])
    found = _figures(made, "measured")
    largest = made.compliance[2, 2] * made.frame("axis_curves").query("load == 'fz'")["applied"].max() * 1e6
    assert abs(found["branch_gap", "dz under fz"] / (0.03 * largest) - 1.0) < 0.2
    chance = {subject: value for (figure, subject), value in found.items() if figure == "branch_gap_p_value"}
    assert len(chance) == 6
    assert chance.pop("dz under fz") < 1e-9
    assert min(chance.values()) > 1e-3
