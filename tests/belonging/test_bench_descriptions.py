"""Slips in the description of a force sensor's legs are named; other stiffnesses are none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.sensor_campaign import LOWER_MM, UPPER_MM, campaign_toml, measured, write_campaign
from truing.belonging import bench_descriptions
from truing.belonging.load_tests import KnownBench
from truing.belonging.relation import RecordSlip, SlipKind
from truing.pipeline.in_memory import stage_line

TURN, MIRROR = np.array([-1.0, -1.0, 1.0]), np.array([1.0, -1.0, 1.0])
QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def declared(lower: np.ndarray, upper: np.ndarray, height: float = 60.0) -> str:
    """campaign.toml with other joint centres."""
    legs = "".join(
        f"  {{ B_mm = {B.round(6).tolist()}, b_mm = {b.round(6).tolist()} }},\n"
        for B, b in zip(lower, upper, strict=True)
    )
    before, rest = campaign_toml().split("legs = [\n")
    text = f"{before}legs = [\n{legs}]{rest.split(chr(10) + ']', 1)[1]}"
    return text.replace("height_mm = 60.0", f"height_mm = {height}")


def slips(folder: Path, toml: str, seed: int = 3, *, with_readings: bool = True, **how: float) -> list[tuple[str, str]]:
    """Kind and quantity of the slips of signals, the first ones and then the equally likely."""
    readings, signals = measured(np.random.default_rng(seed), **how)  # type: ignore[arg-type]
    write_campaign(folder / "c", readings if with_readings else None, signals, toml)
    table = stage_line(str(folder / "c")).call("ingest", "qa").tables["belonging"].to_pylist()
    (row,) = (row for row in table if row["relation"] == "signals-against-loads")
    assert (row["state"] == "fails") == bool(json.loads(row["slips"]))
    return [(slip["kind"], slip["quantity"]) for slip in (*json.loads(row["slips"]), *json.loads(row["rivals"]))]


@pytest.mark.parametrize(
    ("lower", "upper", "kind", "quantity"),
    [
        (UPPER_MM, LOWER_MM, "parts-exchanged", "joints of [mechanism]"),
        (LOWER_MM * MIRROR, UPPER_MM * MIRROR, "mirrored", "B_mm and b_mm of [mechanism]"),
        (LOWER_MM * TURN, UPPER_MM * TURN, "sign", "x and y of B_mm and b_mm of [mechanism]"),
        (LOWER_MM @ QUARTER, UPPER_MM @ QUARTER, "columns-exchanged", "x and y of B_mm and b_mm of [mechanism]"),
        (np.roll(LOWER_MM, 1, 0), np.roll(UPPER_MM, 1, 0), "columns-exchanged", "signals against legs of [mechanism]"),
        (2.0 * LOWER_MM, UPPER_MM, "unit", "B_mm of [mechanism]"),
    ],
)
def test_a_slip_in_the_joint_centres_is_named(
    tmp_path: Path, lower: np.ndarray, upper: np.ndarray, kind: str, quantity: str
) -> None:
    assert slips(tmp_path, declared(lower, upper))[0] == (kind, quantity)


def test_without_readings_a_slip_of_loads_is_as_likely(tmp_path: Path) -> None:
    found = slips(tmp_path, declared(UPPER_MM, LOWER_MM), with_readings=False)
    assert found[0] == ("parts-exchanged", "joints of [mechanism]")
    assert ("sign", "load") in found


@pytest.mark.parametrize("stiffness", [0.8, 1.0, 1.25])
@pytest.mark.parametrize("seed", [3, 4])
def test_other_stiffnesses_are_no_other_description(tmp_path: Path, stiffness: float, seed: int) -> None:
    assert not slips(tmp_path, campaign_toml(), seed, stiffness=stiffness)


def test_legs_that_do_not_carry_every_load_explain_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Legs with singular geometry predict no signals, so they cannot explain the data."""
    known = KnownBench((), None, np.eye(6), None, np.ones(6), 1.0, tared=False)
    slip = RecordSlip(SlipKind.PARTS_EXCHANGED, "b_mm", ("legs moved on by 1",))

    def missed(_: object, bench: KnownBench) -> bench_descriptions._Misfit:
        return bench_descriptions._Misfit(0.0, 0.0 if bench.leg_forces is None else 0.9)

    monkeypatch.setattr(bench_descriptions, "_misfit", missed)
    singular = bench_descriptions.DescribedBench(slip, None, None, None)
    assert bench_descriptions.with_described((), None, known, [singular]) == ()  # type: ignore[arg-type]
