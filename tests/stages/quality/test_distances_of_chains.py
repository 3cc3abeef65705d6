"""Distances that contradict the joint readings of a chain are named by the check of its joints."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.blind.generator.arms import draw, write
from truing.belonging.relation import RelationState, RelationTest, SlipKind
from truing.pipeline.command_line import app
from truing.schemas.campaign import Campaign, read_campaign
from truing.stages.quality.chain_checks import checks, joints_against_distances

LATE = 30  # poses from which a slip acts

Changed = Callable[[pd.DataFrame, pd.DataFrame], None]


@pytest.fixture(scope="module")
def distances(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, pa.Table], Campaign]:
    """Tables and settings of an arm of four joints, with the distances of three targets to three stations."""
    home = tmp_path_factory.mktemp("distances")
    folder = write(draw(4, instrument="distances", causes=(), poses=50), home / "arm")
    words = ["run", str(folder), "--out", str(home / "run"), "--only", "ingest", "--quiet"]
    assert CliRunner().invoke(app, words).exit_code == 0
    tables = {file.stem: pq.read_table(file) for file in (home / "run").glob("*.parquet")}
    document = tomllib.loads(Path(folder / "campaign.toml").read_text(encoding="utf-8"))
    return tables, read_campaign(document)


def checked(distances: tuple[dict[str, pa.Table], Campaign], change: Changed) -> RelationTest:
    tables, settings = distances
    configurations, lengths = (tables[name].to_pandas() for name in ("configurations", "distances"))
    change(configurations, lengths)
    changed = {
        name: pa.Table.from_pandas(frame, schema=tables[name].schema, preserve_index=False)
        for name, frame in (("configurations", configurations), ("distances", lengths))
    }
    return joints_against_distances({**tables, **changed}, settings)


def joints(table: pd.DataFrame) -> list[str]:
    return [name for name in table if name.endswith("_rad")]


def nothing(table: pd.DataFrame, lengths: pd.DataFrame) -> None:
    pass


def a_zero_off_by_half_a_degree(table: pd.DataFrame, lengths: pd.DataFrame) -> None:
    table["j2_rad"] += np.radians(0.5)


def a_zero_off_by_ten_degrees(table: pd.DataFrame, lengths: pd.DataFrame) -> None:
    table["j2_rad"] += np.radians(10.0)


def with_a_zero(offset: float, of_station: bool = False) -> Changed:
    """Distances that are too long by an offset, mm: all of them, or those to one station."""

    def change(table: pd.DataFrame, lengths: pd.DataFrame) -> None:
        stations = sorted({end for end in (*lengths["from_end"], *lengths["to_end"]) if end.startswith("station:")})
        is_of_station = (lengths[["from_end", "to_end"]] == stations[0]).any(axis=1)
        lengths["reading_mm"] += offset * (is_of_station if of_station else 1.0)

    return change


def late_inches(table: pd.DataFrame, lengths: pd.DataFrame) -> None:
    lengths.loc[lengths["pose"] > LATE, "reading_mm"] /= 25.4


def exchanged_rows(table: pd.DataFrame, lengths: pd.DataFrame) -> None:
    table.loc[[8, 17], joints(table)] = table.loc[[17, 8], joints(table)].to_numpy()


def late_sign(table: pd.DataFrame, lengths: pd.DataFrame) -> None:
    table.loc[LATE:, "j2_rad"] *= -1.0


def frozen(table: pd.DataFrame, lengths: pd.DataFrame) -> None:
    table.loc[10:19, "j2_rad"] = table.loc[10, "j2_rad"]


def copied(table: pd.DataFrame, lengths: pd.DataFrame) -> None:
    known = {(row.pose, row.from_end, row.to_end): row.reading_mm for row in lengths.itertuples()}
    for row in lengths.itertuples():
        if 21 <= row.pose <= 24:
            lengths.loc[row.Index, "reading_mm"] = known[row.pose - 10, row.from_end, row.to_end]


def test_distances_as_they_are_belong_to_the_readings(distances: tuple[dict[str, pa.Table], Campaign]) -> None:
    found = checked(distances, nothing)
    assert found.state is RelationState.OK
    assert found.misfit is not None
    assert found.limit is not None
    assert found.misfit < 0.5 * found.limit


def test_a_wrong_zero_is_left_to_the_calibration(distances: tuple[dict[str, pa.Table], Campaign]) -> None:
    found = checked(distances, a_zero_off_by_half_a_degree)
    assert found.state is RelationState.OK
    assert not found.slips


def test_a_zero_far_off_is_no_slip_of_the_records_and_is_reported_with_its_size(
    distances: tuple[dict[str, pa.Table], Campaign],
) -> None:
    found = checked(distances, a_zero_off_by_ten_degrees)
    assert found.state is RelationState.ATTENTION
    (slip,) = found.slips
    assert (slip.kind, slip.subjects) == (SlipKind.ZERO, ("j2_rad",))
    assert slip.offset == pytest.approx(np.radians(-10.0), abs=0.01)


@pytest.mark.parametrize(
    ("change", "kind", "subjects"),
    [
        (late_inches, SlipKind.UNIT, ("from pose 31 on",)),
        (exchanged_rows, SlipKind.ROWS_EXCHANGED, ("pose 9", "pose 18")),
        (late_sign, SlipKind.SIGN, ("j2_rad", "from pose 31 on")),
        (frozen, SlipKind.FROZEN, ("j2_rad", "from pose 11 to pose 20")),
        (copied, SlipKind.COPIED, ("pose 21", "pose 22", "pose 23", "pose 24")),
    ],
)
def test_a_slip_of_distances_or_of_their_readings_is_named(
    distances: tuple[dict[str, pa.Table], Campaign], change: Changed, kind: SlipKind, subjects: tuple[str, ...]
) -> None:
    found = checked(distances, change)
    assert found.state is RelationState.FAILS
    (slip,) = found.slips
    assert (slip.kind, slip.subjects) == (kind, subjects)


@pytest.mark.parametrize("offset", [-19.05, 12.7, 100.0])
@pytest.mark.parametrize("of_station", [False, True])
def test_a_wrong_zero_of_distances_is_named_with_its_size(
    distances: tuple[dict[str, pa.Table], Campaign], offset: float, of_station: bool
) -> None:
    found = checked(distances, with_a_zero(offset, of_station))
    assert found.state is RelationState.FAILS
    (slip,) = found.slips
    assert (slip.kind, slip.quantity, bool(slip.subjects)) == (SlipKind.ZERO, "distances (mm)", of_station)
    assert slip.offset == pytest.approx(-offset, abs=0.15 * abs(offset))
    assert found.misfit_explained is not None
    assert found.misfit is not None
    assert found.misfit_explained < 0.4 * found.misfit


def test_a_small_zero_of_distances_is_left_to_the_diagnosis(
    distances: tuple[dict[str, pa.Table], Campaign],
) -> None:
    assert checked(distances, with_a_zero(0.3)).state is RelationState.OK


@pytest.mark.parametrize(("away", "verdict"), [(0.0, "pass"), (273.15, "fail")])
def test_temperatures_of_a_campaign_without_points_are_checked(
    distances: tuple[dict[str, pa.Table], Campaign], away: float, verdict: str
) -> None:
    tables, settings = distances
    configurations = tables["configurations"]
    names = [name for name in configurations.column_names if name != "temperature_c"]
    warmth = settings.mechanism.reference_temperature_c + away + np.linspace(0.0, 0.5, len(configurations))
    warm = configurations.select(names).append_column("temperature_c", pa.array(warmth))
    found = {row.check: row.verdict for row in checks({**tables, "configurations": warm}, settings).checks}
    assert found["temperature-unit"] == verdict
    assert {"time-unit", "time-gaps", "temperature-span"} <= set(found)
