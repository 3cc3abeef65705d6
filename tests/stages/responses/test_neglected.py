"""Neglected effects of a sensor: platform, base and own weight, in the simulation or against its uncertainty."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.blind.generator.sensor.campaign import draw_campaign
from tests.blind.generator.sensor.folder import write_campaign
from tests.faults import faults_of
from tests.sentences import assert_says
from tests.stages.benches import DEFORMATION, layout
from tests.stages.line import run_line
from tests.tolerance import assert_close
from truing.report.sensor.neglected import neglected
from truing.schemas.campaign import read_campaign
from truing.schemas.mechanism import SensorPlate
from truing.stages.common.sensor_elements import leg_mass_kg, plate_mass_kg

STIFF = {"thickness_mm": 300.0, "rigid_radius_mm": 400.0, "youngs_gpa": 210.0, "poisson": 0.25}
SOFT = {"thickness_mm": 40.0, "rigid_radius_mm": 100.0, "youngs_gpa": 70.0, "poisson": 0.3, "density_kg_m3": 2700.0}


def made(folder: Path, seed: int, **plates: dict[str, Any]) -> dict[str, Any]:
    """Tables of a good bench whose campaign.toml declares plates; its true sensor has none."""
    write_campaign(draw_campaign(layout(channels="all"), [], np.random.default_rng(seed)), folder, seed)
    sections = [f"\n[mechanism.{name}]\n" + "".join(f"{key} = {str(value).lower()}\n" for key, value in plate.items())
                for name, plate in plates.items()]  # fmt: skip
    with (folder / "campaign.toml").open("a") as file:
        file.write("".join(sections))
    tables, _ = run_line(folder, *DEFORMATION)
    return {name: table.to_pandas() for name, table in tables.items() if not isinstance(table, str)}


def test_a_soft_platform_is_no_neglect_and_a_stiff_base_is_one(tmp_path):
    tables = made(tmp_path / "c", 3, platform=SOFT, base=STIFF)
    effects = tables["neglected"].set_index("effect")
    assert set(effects.index) == {"elastic platform", "elastic base", "own weight"}
    worst = effects.groupby("effect")["effect_over_sigma"].max()
    assert worst["elastic platform"] > 10.0
    assert worst["elastic base"] < 1.0 / 3.0
    assert (effects.loc["elastic base", "verdict"] == "negligible").all()
    assert (effects.loc["elastic platform", "verdict"] == "not negligible").sum() > 10
    weight = tables["own_weight"].set_index(["figure", "subject"])["value"]
    mass = np.pi * 0.55**2 * 0.04 * 2700.0
    assert_close(weight["mass", "platform"], mass, atol=1e-2)
    assert_close(weight["weight", "platform and half of the legs"], 9.80665 * mass, atol=0.1)
    section = neglected(tables)
    assert section.state == "warn"
    assert_says(section.lead, "Elastic platform: not negligible", "standard deviations")
    assert_says(section.lead, "Elastic base: negligible", "standard deviations")
    assert_says(section.lead, "counted from", "own weight")


def test_an_elastic_platform_in_the_simulation_is_missed_by_a_sensor_without_one(tmp_path):
    """Both ways: the plain simulation reproduces the plain sensor, the softened one does not."""
    plain = made(tmp_path / "a", 5)
    assert "neglected" not in plain
    softened = made(tmp_path / "b", 5, platform={**SOFT, "elastic": True})
    missed = [
        (each["compliance"].query("model == 'matrix'")["verdict"] == "differs").sum() for each in (plain, softened)
    ]
    assert missed[0] == 0
    assert missed[1] > 10
    assert set(softened["neglected"]["effect"]) == {"own weight"}  # what the simulation contains is not neglected
    diagonal = [
        each["compliance"].query("model == 'simulated' and response == 'dz' and load == 'fz'")["coefficient"].item()
        for each in (plain, softened)
    ]
    assert diagonal[1] > 1.1 * diagonal[0]


def section(**keys: Any) -> Any:
    legs = [{"B_mm": [0.5e3, k * 1e2, 0.0], "b_mm": [0.4e3, k * 1e2, 0.0]} for k in range(6)]
    mechanism = {"type": "6-upur", "legs": legs, "height_mm": 300.0, "elements": [{"kind": "rigid"}], **keys}
    return read_campaign({"campaign": {"name": "c", "kind": "interferometer"}, "mechanism": mechanism}).mechanism


def test_masses_follow_from_density_or_are_as_declared():
    steel = {"youngs_gpa": 206.0, "poisson": 0.3, "density_kg_m3": 7830.0}
    parts = [
        {"kind": "cylinder", "length_mm": 20.0, "diameter_mm": 24.0, **steel},
        {"kind": "leaf", "length_mm": 20.0, "width_mm": 30.0, "thickness_mm": 6.0, "soft": "s1", **steel},
        {"kind": "notch", "width_mm": 20.0, "web_mm": 1.0, "radius_mm": 3.0, "soft": "s2", **steel},
        {"kind": "spring", "axial_n_per_m": 1e7, "mass_kg": 4.0},
        {"kind": "rigid"},
    ]
    volume = np.pi * 144.0 * 20.0 + 3600.0 + 20.0 * (6.0 * 7.0 - np.pi * 9.0)
    assert_close(leg_mass_kg(section(elements=parts)), 4.0 + 7830.0e-9 * volume, atol=1e-9)
    plate = SensorPlate(**{**SOFT, "outer_radius_mm": 600.0})
    assert_close(plate_mass_kg(plate, 550.0), np.pi * 0.36 * 0.04 * 2700.0, atol=1e-9)
    assert plate_mass_kg(SensorPlate(**{**STIFF, "mass_kg": 7.0}), 550.0) == 7.0
    assert plate_mass_kg(SensorPlate(**STIFF), 550.0) == 0.0


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"platform": {**SOFT, "rigid_radius_mm": 500.0}}, ("platform.rigid_radius_mm below 400 mm", "not 500")),
        ({"platform": {**SOFT, "density_kg_m3": 2.7}}, ("from 30 to 30000 kg/m3", "did you mean 2700")),
        ({"platform": {**SOFT, "mass_kg": 4.0}}, ("density_kg_m3 or mass_kg", "not both")),
        ({"base": {**STIFF, "elastic": True}, "elements": []}, ("elements", "base.elastic")),
        (
            {"elements": [{"kind": "rigid", "density_kg_m3": 7830.0}]},
            ("length_mm for kind rigid", "density_kg_m3"),
        ),
    ],
)
def test_bad_plates_and_masses_are_refused(keys, expected):
    (fault,) = faults_of(lambda: section(**keys))
    assert fault.file == "campaign.toml"
    assert fault.column.startswith("mechanism")
    assert_says(fault.expected, *expected)
