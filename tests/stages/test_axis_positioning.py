"""Positioning by ISO 230-2 from rows of an axis agrees with a second computation; few repeats omit figures."""

from __future__ import annotations

import math
from statistics import mean, stdev

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from tests.sentences import assert_says
from tests.tolerance import assert_close
from truing.report.reasons import why_no_deformation
from truing.report.sensor.positioning import positioning
from truing.report.tables import WHY_NOT
from truing.schemas.campaign import read_campaign
from truing.schemas.settings_text import parsed_toml
from truing.stages.axis.positioning import positioning_rows, with_axis_positioning
from truing.stages.common.axis_columns import columns_of
from truing.stages.common.evaluable_axis_stages import IN_MOTION, prospects
from truing.stages.declaration import Outcome

TARGETS = (-40.0, 0.0, 40.0)
SIGMA = 0.003
SETTINGS = """
[campaign]
name = "axis"
kind = "photogrammetry"
[mechanism]
type = "axis"
kind = "{kind}"
command = "command_{unit}"
load = "load_{unit}"
[noise]
load_{unit} = 0.001
measured_{unit} = 0.001
"""


def _table(unit: str, cycles: int, lost: int = 0, wrap: bool = False) -> pa.Table:
    """A first movement of unknown side, then cycles up and down with overtravel; the last rows may be lost."""
    rng = np.random.default_rng(3)
    cycle = [*TARGETS, 50.0, *reversed(TARGETS), -50.0]
    command = np.array([-50.0, *cycle * cycles])[: 1 + 8 * cycles - lost]
    way = np.sign(np.diff(command, prepend=-60.0))
    measured = command - 0.01 * way + 1e-4 * command + rng.normal(0.0, SIGMA, len(command))
    if wrap:
        measured %= 360.0
    count = len(command)
    return pa.table(
        {
            "pose": np.arange(count),
            "role": ["calibration"] * count,
            "time_s": np.arange(float(count)),
            f"command_{unit}": command,
            f"load_{unit}": measured + 7.0,
            f"measured_{unit}": measured,
        }
    )


def _figures(table: pa.Table, kind: str, unit: str) -> pd.DataFrame:
    settings = read_campaign(parsed_toml(SETTINGS.format(kind=kind, unit=unit)))
    rows = positioning_rows(table, columns_of(settings, table), settings)
    return rows.table("string").to_pandas() if rows.count else pd.DataFrame()


def _by_hand(table: pa.Table, unit: str, factor: float) -> dict[str, float]:
    """The standard's equations, number by number: x_ij+ and x_ij- by lists."""
    command, measured = (table.column(f"{name}_{unit}").to_pylist() for name in ("command", "measured"))
    x: dict[tuple[float, str], list[float]] = {}
    for before, at, read in zip(command, command[1:], measured[1:], strict=False):
        if at in TARGETS:
            off = (read - at + 180.0) % 360.0 - 180.0
            x.setdefault((at, "+" if at > before else "-"), []).append(off * factor)
    m, s = {k: mean(v) for k, v in x.items()}, {k: stdev(v) for k, v in x.items()}
    b = {t: m[t, "+"] - m[t, "-"] for t in TARGETS}
    r = {t: max(2 * s[t, "+"] + 2 * s[t, "-"] + abs(b[t]), 4 * s[t, "+"], 4 * s[t, "-"]) for t in TARGETS}
    middle = [(m[t, "+"] + m[t, "-"]) / 2 for t in TARGETS]
    found = {
        "B": max(abs(v) for v in b.values()),
        "B_mean": mean(b.values()),
        "R": max(r.values()),
        "E": max(m.values()) - min(m.values()),
        "M": max(middle) - min(middle),
        "A": max(m[k] + 2 * s[k] for k in m) - min(m[k] - 2 * s[k] for k in m),
    }
    for side, name in (("+", "forward"), ("-", "backward")):
        own = [(t, side) for t in TARGETS]
        found[f"R_{name}"] = max(4 * s[k] for k in own)
        found[f"E_{name}"] = max(m[k] for k in own) - min(m[k] for k in own)
        found[f"A_{name}"] = max(m[k] + 2 * s[k] for k in own) - min(m[k] - 2 * s[k] for k in own)
    return found


@pytest.mark.parametrize(
    ("kind", "unit", "factor", "lost", "wrap"),
    [("linear", "mm", 1e3, 0, False), ("linear", "mm", 1e3, 3, False), ("rotary", "deg", 3600.0, 0, True)],
)
def test_quantities_are_those_of_the_standard(kind: str, unit: str, factor: float, lost: int, wrap: bool) -> None:
    table = _table(unit, 5, lost, wrap)
    found = _figures(table, kind, unit)
    axis = found[found["subject"].isna()]
    assert list(dict.fromkeys(axis["run"])) == ["measured", "load"]
    assert set(axis["unit"]) == {"um" if unit == "mm" else "arcsec"}
    own = axis[axis["run"] == "measured"].set_index("figure")["value"]
    expected = _by_hand(table, unit, factor)
    assert set(own.index) == set(expected)
    assert_close([own[name] for name in expected], list(expected.values()), atol=1e-6)
    # an encoder with another zero has the same quantities
    other = axis[axis["run"] == "load"].set_index("figure")["value"]
    assert_close([other[name] for name in expected], list(expected.values()), atol=1e-6)


def test_true_values_lie_within_bounds_that_follow_from_the_noise() -> None:
    found = _figures(_table("mm", 12), "linear", "mm")
    own = found[found["subject"].isna() & (found["run"] == "measured")].set_index("figure")
    mean_sigma = SIGMA * 1e3 * math.sqrt(2.0 / (12 * len(TARGETS)))
    assert abs(own.loc["B_mean", "value"] + 20.0) < 3.3 * mean_sigma
    assert own.loc["M", "low"] <= 8.0 <= own.loc["M", "high"]
    assert own.loc["R", "low"] <= 20.0 + 4e3 * SIGMA <= own.loc["R", "high"]


def test_too_few_repeats_leave_out_what_needs_a_scatter_and_the_page_says_so() -> None:
    found = _figures(_table("mm", 1), "linear", "mm")
    axis = found[found["subject"].isna()]
    assert set(axis["figure"]) == {"B", "B_mean", "E", "M", "E_forward", "E_backward"}
    section = positioning({"positioning": found, "configurations": pd.DataFrame()})
    assert section is not None
    assert_says(section.statements[0][1], "R and A are not computed", "1 reading")
    few = positioning({"positioning": _figures(_table("mm", 3), "linear", "mm"), "configurations": pd.DataFrame()})
    assert few is not None
    assert_says(few.statements[0][1], "3 readings", "asks for 5")
    symbols = {row[1] for row in few.listings[0].rows}
    assert {"A", "E", "M", "R", "B", "R↑", "R↓"} <= symbols


def test_means_at_the_targets_are_reported_without_a_large_deviation_that_all_share() -> None:
    """A zero of the instrument far from the axis' would leave no digit of the differences between targets."""
    table = _table("mm", 5)
    far = table.set_column(
        table.schema.get_field_index("measured_mm"), "measured_mm", pc.add(table.column("measured_mm"), 3.0)
    )
    reported = []
    for one in (table, far):
        section = positioning({"positioning": _figures(one, "linear", "mm"), "configurations": pd.DataFrame()})
        assert section is not None
        targets = section.listings[1]
        rows = [row for row in targets.rows if row[0] == targets.rows[0][0]]
        reported.append(np.array([[float(row[2]), float(row[3])] for row in rows]))
    assert np.abs(reported[1]).max() < 50.0
    assert_close(reported[1] - reported[1].mean(), reported[0] - reported[0].mean(), atol=0.15)
    assert_says(section.listings[1].caption, "outside instrument", "all targets share")


def _at(table: pa.Table, period_s: float) -> pa.Table:
    """The same rows, each that long after the one before."""
    time = pa.array(period_s * np.arange(table.num_rows))
    return table.set_column(table.schema.names.index("time_s"), "time_s", time)


@pytest.mark.parametrize(("period_s", "why"), [(3.0, ""), (0.2, IN_MOTION)])
def test_an_axis_recorded_in_motion_is_no_test_by_the_standard(period_s: float, why: str) -> None:
    settings = read_campaign(parsed_toml(SETTINGS.format(kind="linear", unit="mm")))
    tables = {"configurations": _at(_table("mm", 5), period_s)}
    without = Outcome.not_evaluated({}, "no bodies")
    outcome = with_axis_positioning(without, tables, settings, "")
    assert outcome.why_not == why
    assert bool(outcome.artifacts["positioning"].num_rows) is not bool(why)
    stated = {name: reported for name, reported, _ in prospects(settings, tables)}
    assert stated["deformation"] == why


def test_the_page_says_that_an_axis_was_recorded_in_motion() -> None:
    empty = pd.DataFrame()
    empty.attrs[WHY_NOT] = IN_MOTION
    section = positioning({"positioning": empty, "configurations": pd.DataFrame()})
    assert section is not None
    assert_says(section.lead, "not tested", "recorded in motion", "rest at each")
    assert "both sides" not in section.lead.split(".")[0]
    other = why_no_deformation({"deformation": empty, "positioning": empty, "configurations": pd.DataFrame()})
    assert_says(other, "no bodies with targets")


def test_readings_that_follow_each_other_at_a_target_are_one_approach() -> None:
    """Their scatter is noise, and no repeatability."""
    once = _table("mm", 5)
    rows = np.repeat(np.arange(once.num_rows), 4)
    noise = np.tile([1e-3, -1e-3, 2e-3, -2e-3], once.num_rows)
    often = once.take(rows).set_column(0, "pose", pa.array(np.arange(len(rows))))
    often = often.set_column(often.schema.names.index("time_s"), "time_s", pa.array(1.0 * np.arange(len(rows))))
    measured = often.column("measured_mm").to_numpy() + noise
    often = often.set_column(often.schema.names.index("measured_mm"), "measured_mm", pa.array(measured))
    figures = [_figures(table, "linear", "mm")[["run", "figure", "subject", "value"]] for table in (once, often)]
    pd.testing.assert_frame_equal(*figures, check_exact=False, atol=1e-6)


def test_without_repeats_from_both_sides_nothing_is_stated() -> None:
    up = _table("mm", 1).slice(0, 5)
    assert _figures(up, "linear", "mm").empty
    section = positioning({"positioning": pd.DataFrame(), "configurations": pd.DataFrame()})
    assert section is not None
    assert section.state == "not evaluated"
    assert_says(section.lead, "not tested", "both sides")
    assert_says(section.lead, "five targets", "five times from each side")
