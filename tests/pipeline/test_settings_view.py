"""A stage sees the sections that it declares, and nothing else."""

from __future__ import annotations

from operator import attrgetter

import pytest

from truing.pipeline.campaign_folder import SettingsView, UndeclaredSetting
from truing.schemas.campaign import Campaign

CAMPAIGN = Campaign.model_validate(
    {
        "campaign": {"name": "bench", "kind": "photogrammetry"},
        "mechanism": {
            "type": "ups",
            "legs": [{"a_mm": (0, 0, k), "b_mm": (0, 0, 1), "length_mm": 1} for k in range(3)],
        },
        "noise": {"point_mm": 0.005},
    }
)


def test_declared_sections_read_as_the_campaign_does_and_are_noted() -> None:
    view = SettingsView(CAMPAIGN, ("noise", "mechanism.legs", "workspace.x_mm"))
    assert view.noise.point_mm == 0.005
    assert view.mechanism.legs[2].a_mm == (0.0, 0.0, 2.0)
    assert view.sections_read == {"noise", "mechanism.legs"}


@pytest.mark.parametrize(
    "path", ["campaign", "mechanism.type", "mechanism.tolerance", "noise.actuator_mm", "model_dump"]
)
def test_an_undeclared_setting_cannot_be_read(path: str) -> None:
    view = SettingsView(CAMPAIGN, ("noise.point_mm", "mechanism.legs"))
    with pytest.raises(UndeclaredSetting, match=f"{path} is read but not declared"):
        attrgetter(path)(view)


def test_a_derived_setting_requires_its_sources() -> None:
    view = SettingsView(CAMPAIGN, ("bodies.reference", "mechanism.type"))
    assert view.reference_body == "base"
    assert view.sections_read == {"bodies.reference", "mechanism.type"}
    with pytest.raises(UndeclaredSetting):
        _ = SettingsView(CAMPAIGN, ("bodies.reference",)).reference_body
