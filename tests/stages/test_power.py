"""A campaign as a plan for simulated campaigns, and detection rates from their diagnoses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Layout, Noise, Targets
from tests.blind.generator.schedule import at_rest, random_moves
from tests.stages.line import run_line, settings_of
from truing.inference.detectable import AcceptanceRule, EffectSensitivity
from truing.pipeline.campaign_folder import SettingsView
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import Campaign
from truing.simulation.detection_trials import (
    FACTORS,
    Answer,
    DetectionQuestion,
    EffectKind,
    EffectSize,
    Trial,
    curve,
    false_alarms,
    trial_answer,
    trials,
)
from truing.simulation.mechanisms.causes.drive import ActuatorGain
from truing.stages import pose
from truing.stages.diagnosis.mechanism_points import assemble
from truing.stages.power import complete_plan
from truing.stages.simulated_campaigns.plan import CampaignPlan, bare_plan
from truing.stages.simulated_campaigns.tables import rates_table, sizes_table

POSES, HELD = 14, 3
LAYOUT = Layout(
    "small", targets=Targets(base=5, platform=4, per_leg=3), noise=Noise(axis_ratio=(1.0, 1.0, 3.0), write_sigmas=True)
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(5)
    campaign = draw_campaign(LAYOUT, [at_rest(), *random_moves(POSES, HELD, rng)], [], rng)
    return write_campaign(campaign, tmp_path_factory.mktemp("power") / "campaign", 1)


@pytest.fixture(scope="module")
def settings(folder: Path) -> Campaign:
    return settings_of(folder)


@pytest.fixture(scope="module")
def tables(folder: Path) -> dict[str, pa.Table]:
    return run_line(folder, "ingest", "pose")[0]


def _posed(tables: dict[str, pa.Table], settings: Campaign) -> dict[str, pa.Table]:
    view = SettingsView(settings, pose.DECLARATION.settings)
    return {**tables, **pose.run(tables, view, lambda *_: None).artifacts}


@pytest.fixture(scope="module")
def plan(tables: dict[str, pa.Table], settings: Campaign) -> CampaignPlan:
    return complete_plan(bare_plan(tables, settings), assemble(tables, settings), tables["poses"])


@pytest.fixture(scope="module")
def drawn(plan: CampaignPlan) -> dict[str, pa.Table]:
    return plan.drawn((), np.random.default_rng(7))


def _keys(table: pa.Table) -> list[tuple[Any, ...]]:
    return list(zip(*(table.column(name).to_pylist() for name in ("pose", "body", "target")), strict=True))


def test_a_redrawn_campaign_has_the_same_sightings_and_the_declared_noise(
    tables: dict[str, pa.Table], drawn: dict[str, pa.Table]
) -> None:
    before, after = tables["observations"], drawn["observations"]
    assert _keys(after) == _keys(before)
    assert after.column("sigma_z_mm").equals(before.column("sigma_z_mm"))
    assert not np.allclose(after.column("x_mm").to_numpy(), before.column("x_mm").to_numpy())
    assert drawn["configurations"].equals(tables["configurations"])


@pytest.mark.parametrize("name", ["observations", "survey"])
def test_drawn_tables_are_what_the_stages_take(name: str, drawn: dict[str, pa.Table]) -> None:
    assert ARTIFACTS[name].faults(drawn[name]) == []


def test_bodies_that_are_drawn_lie_where_they_were_measured(
    tables: dict[str, pa.Table], drawn: dict[str, pa.Table], settings: Campaign
) -> None:
    """The mechanism is another one within its tolerances, at the same readings."""
    own = (pc.field("body") == "platform") & pc.field("default")
    was, now = (_posed(t, settings)["poses"].filter(own).column("pz_mm").to_numpy() for t in (tables, drawn))
    assert np.abs(now - was).max() < 10 * LAYOUT.tolerance.length_mm
    assert np.ptp(now - was) < 0.1


def test_a_campaign_without_points_is_planned_with_all_targets_seen(
    tables: dict[str, pa.Table], settings: Campaign
) -> None:
    bare = bare_plan({name: tables[name] for name in ("survey", "configurations")}, settings)
    assert not bare.was_measured
    assert bare.layout.is_observed.all()
    first = _posed(bare.drawn((), np.random.default_rng(1)), settings)
    found = complete_plan(bare, assemble(first, settings), first["poses"])
    assert found.layout.model.known.geometry["a"] == pytest.approx(5e-4)
    assert found.drawn((), np.random.default_rng(2))["observations"].num_rows == bare.layout.is_observed.size


def test_poses_without_readings_are_not_drawn(tables: dict[str, pa.Table], settings: Campaign) -> None:
    table = tables["configurations"]
    place = table.schema.get_field_index("rho2_mm")
    values = table.column("rho2_mm").to_pylist()
    unread = table.set_column(place, table.schema.field(place), pa.array([None, *values[1:]], table.column(place).type))
    found = bare_plan({**tables, "configurations": unread}, settings)
    first = table.column("pose").to_pylist()[0]
    assert first not in found.drawn((), np.random.default_rng(1))["observations"].column("pose").to_pylist()


def test_a_campaign_without_a_platform_is_refused(tables: dict[str, pa.Table], settings: Campaign) -> None:
    survey = tables["survey"].filter(pc.equal(pc.field("body"), "base"))
    with pytest.raises(ValueError, match="targets on base and platform"):
        bare_plan({**tables, "survey": survey}, settings)


GAIN = ActuatorGain((3,))


def _question(per_scale: float) -> DetectionQuestion:
    seen = EffectSensitivity(GAIN, GAIN.id, AcceptanceRule(1, 500.0, 1e-5), np.array([per_scale]))
    sort = EffectKind(GAIN.id, "one leg", tuple(ActuatorGain((leg,)) for leg in range(1, 7)), np.full(6, 1 / 6))
    return DetectionQuestion(sort, (seen,), EffectSize("gain_3", 0.01, "1"))


def test_campaigns_are_drawn_about_the_size_that_theory_expects_and_with_seeds_of_their_own(plan: CampaignPlan) -> None:
    seen, blind = _question(50.0), _question(1e-9)
    assert blind.expected is None
    listed = trials([seen, blind], plan, 2, 6, seed=1)
    assert len(listed) == 6 + 2 * len(FACTORS)
    first = listed[: len(listed) // 2]
    assert sorted(trial.factor for trial in first) == [0.0, 0.0, 0.0, *FACTORS]  # one of each before the second of any
    assert len({trial.seed for trial in listed}) == len(listed)
    for trial in (t for t in listed if t.effects):
        assert abs(trial.effects[0].values[0]) == pytest.approx(trial.factor * seen.expected * 0.01)


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([], (False, False, False)),
        ([("actuator-gain", "found", "leg3")], (True, True, True)),
        ([("actuator-gain", "found", "leg4")], (True, True, False)),
        ([("leg-drift", "found", "leg3"), ("actuator-gain", "indistinguishable", "leg3")], (True, True, True)),
        ([("leg-drift", "found", "leg3"), ("actuator-gain", "rejected", "leg3")], (True, False, False)),
    ],
)
def test_a_diagnosis_counts_as_found_named_and_placed(
    rows: list[tuple[str, str, str]], expected: tuple[bool, ...]
) -> None:
    hidden = Trial(0, 1.0, (replace(_question(50.0).kind, causes=(GAIN,), weights=np.ones(1)).draw(1.0, 6, RNG),), (1,))
    reported = trial_answer(hidden, [dict(zip(("cause", "verdict", "subject"), row, strict=True)) for row in rows])
    assert (reported.found, reported.named, reported.subject_right) == expected


RNG = np.random.default_rng(0)


def _answers(found: list[int], of: int = 8) -> list[Answer]:
    nothing = [Answer(-1, 0.0, k == 0, False, False, ()) for k in range(20)]
    return nothing + [
        Answer(0, factor, k < count, k < count - 1, k < count - 2, ("leg-drift leg1",) if k == count - 1 else ())
        for factor, count in zip(FACTORS, found, strict=True)
        for k in range(of)
    ]


def test_tables_report_sizes_with_bounds_and_rates_with_theirs() -> None:
    question, answers = _question(50.0), _answers([0, 2, 6, 8, 8])
    found = curve(question, 0, answers)
    sizes = sizes_table([found]).to_pylist()[0]
    assert sizes["expected_80"] == pytest.approx(question.expected * 0.01)
    assert sizes["lower_80"] < sizes["found_80"] < sizes["upper_80"]
    assert sizes["found_80"] < sizes["found_95"]
    assert sizes["expected_80"] * 0.8 < sizes["found_80"] < sizes["expected_80"] * 1.4
    assert sizes["instead"] == "leg-drift leg1 (4)"
    nothing, *rates = rates_table([found], false_alarms(answers)).to_pylist()
    assert (nothing["cause"], nothing["found"], nothing["campaigns"]) == ("nothing", 1 / 20, 20)
    assert [row["found"] for row in rates] == [0.0, 0.25, 0.75, 1.0, 1.0]
    assert [row["named"] for row in rates] == [0.0, 0.125, 0.625, 0.875, 0.875]
    assert all(row["found_lower"] <= row["found"] <= row["found_upper"] for row in rates)
    assert rates[2]["expected"] == pytest.approx(0.8, abs=0.01)


def test_without_draws_the_table_has_theory_alone() -> None:
    row = sizes_table([curve(_question(50.0), 0, [])]).to_pylist()[0]
    assert row["expected_80"] is not None
    assert row["found_80"] is None
    blind = sizes_table([curve(_question(1e-9), 0, [])]).to_pylist()[0]
    assert blind["expected_80"] is None
