"""Numbers of docs/force-sensor-campaign.md on plates and weight, by the block of the page and the sample."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pyarrow as pa

from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import read_campaign
from truing.stages.common.nominal_sensor import simulated_compliance
from truing.stages.responses.neglected import neglected_effects

PROJECT = Path(__file__).resolve().parents[2]


def test_the_numbers_of_the_page_follow_from_its_block():
    page = (PROJECT / "docs" / "force-sensor-campaign.md").read_text(encoding="utf-8")
    block = next(found for found in re.findall(r"```toml\n(.*?)```", page, re.S) if "[mechanism.platform]" in found)
    document = tomllib.loads((PROJECT / "sample_data" / "force-sensor" / "campaign.toml").read_text(encoding="utf-8"))
    document["mechanism"] |= tomllib.loads(block)["mechanism"]
    settings = read_campaign(document)
    nothing = pa.table({name: [] for name in ARTIFACTS["compliance"].columns})
    tables = neglected_effects(settings, simulated_compliance(settings, None), nothing)
    effects = tables["neglected"].to_pandas()
    own = {"dx": "fx", "dy": "fy", "dz": "fz", "rx": "mx", "ry": "my", "rz": "mz"}
    diagonal = effects[effects["response"].map(own) == effects["load"]].set_index("effect")
    share = (diagonal["effect_change"] / diagonal["coefficient"]).groupby("effect").agg(["min", "max"])
    ratio = effects.groupby("effect")["effect_over_sigma"].max()
    platform = 100.0 * share.loc["elastic platform"].to_numpy()
    assert f"the diagonal of this sample's compliance by {platform[0]:.0f} to {platform[1]:.0f} %" in page
    sigmas = diagonal.loc["elastic platform", "effect_over_sigma"]
    assert f"{sigmas.min():.0f} to {sigmas.max():.0f} standard deviations" in page
    assert np.round(100.0 * share.loc["elastic base"].max(), 1) == 0.5
    assert f"at most {ratio['elastic base']:.2f} standard deviations" in page
    weight = tables["own_weight"].to_pandas().set_index("figure").loc["weight", "value"]
    assert f"own weight ({weight / 1e3:.1f} kN) by {ratio['own weight']:.2f} at most" in page
