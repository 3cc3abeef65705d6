"""A campaign handed over in another laboratory's formats is the same campaign after ingest."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from schemas.campaign import read_campaign
from stages import ingest
from tests.blind.generator import disguise
from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Layout, Surroundings
from tests.blind.generator.schedule import published_moves
from tests.tolerance import assert_close
from truing.formats.source import CampaignFiles

KEY = ("pose", "body", "target")
PLACE = ("x_mm", "y_mm", "z_mm")
LAYOUT = Layout(name="handed-over", surroundings=Surroundings(frame_shift_mm=2000.0))  # thousands, with their separator


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of eight poses in the contract's own files."""
    campaign = draw_campaign(LAYOUT, published_moves()[:8], [], np.random.default_rng(2))
    return write_campaign(campaign, tmp_path_factory.mktemp("plain") / "plain", 2)


def observed(folder: Path) -> dict[tuple[object, ...], np.ndarray]:
    """Coordinates (3,) in mm by pose, body and target, as ingest leaves them."""
    campaign = read_campaign(tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8")))
    outcome = ingest.run({}, campaign, lambda done, total, what: None, CampaignFiles(folder, campaign))
    found = outcome.artifacts["observations"]
    table = found.read_all() if isinstance(found, pa.RecordBatchReader) else found
    rows = table.to_pylist()
    return {tuple(row[name] for name in KEY): np.array([row[name] for name in PLACE]) for row in rows}


@pytest.mark.parametrize("name", disguise.DISGUISES)
def test_ingest_sees_through_the_disguise(plain: Path, tmp_path: Path, name: str) -> None:
    expected, found = observed(plain), observed(disguise.DISGUISES[name](plain, tmp_path / name))
    assert found.keys() == expected.keys()
    # The digits that were written: 1e-5 mm at best, 1e-6 mm in metres, 2.5e-7 mm in inches.
    assert_close([found[key] for key in expected], list(expected.values()), atol=1.01e-6, what="coordinates, mm")
