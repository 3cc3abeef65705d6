"""A campaign in the file formats of another laboratory is the same campaign after ingest."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from tests.blind.generator import disguise
from tests.blind.generator.campaign import Campaign, draw_campaign
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import DataFaults, Layout, Surroundings
from tests.blind.generator.schedule import published_moves
from tests.tolerance import assert_close
from truing.formats.source import CampaignFiles
from truing.schemas.campaign import read_campaign
from truing.stages import ingest

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
def test_disguised_files_give_the_same_coordinates(plain: Path, tmp_path: Path, name: str) -> None:
    expected, found = observed(plain), observed(disguise.DISGUISES[name](plain, tmp_path / name))
    assert found.keys() == expected.keys()
    # The digits that were written: 1e-5 mm at best, 1e-6 mm in metres, 2.5e-7 mm in inches.
    assert_close([found[key] for key in expected], list(expected.values()), atol=1.01e-6, what="coordinates, mm")


@pytest.mark.parametrize("bodies_known", [True, False])
def test_points_without_names_get_their_own_back(tmp_path: Path, bodies_known: bool) -> None:
    """No name is wrong; without one stay gross errors, and bodies of which fewer than four good points were seen."""
    layout = replace(LAYOUT, faults=DataFaults(missing_share=0.05, gross_share=0.01, gross_mm=(5.0, 20.0)))
    campaign = draw_campaign(layout, published_moves()[:8], [], np.random.default_rng(3))
    named = write_campaign(campaign, tmp_path / "named", 3)
    expected = observed(named)
    rng = np.random.default_rng(4)
    found = observed(disguise.unlabelled(named, tmp_path / "unnamed", rng, bodies_known=bodies_known))
    assert found.keys() <= expected.keys()
    assert_close(list(found.values()), [expected[key] for key in found], atol=1e-9, what="coordinates, mm")
    assert expected.keys() - found.keys() <= _excused(campaign)


def _excused(campaign: Campaign) -> set[tuple[object, ...]]:
    marks, record = campaign.marks, campaign.record
    good, bodies = record.is_observed & ~record.gross, np.array(marks.body)
    few = np.stack([good[:, bodies == body].sum(axis=1) < 4 for body in marks.body], axis=1)
    poses, columns = np.nonzero(record.gross | few)
    return {(campaign.schedule.pose[n], marks.body[k], marks.name[k]) for n, k in zip(poses, columns, strict=True)}
