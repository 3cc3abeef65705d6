"""The page of positioning runs: accuracy and reversal on top, and deviations from both directions."""

from __future__ import annotations

import pandas as pd

from tests.sentences import assert_says
from tests.tolerance import assert_close
from truing.report.measured_loads import measured_loads
from truing.report.page_head import build_head
from truing.report.sensor.positioning import positioning
from truing.report.tables import WHY_NOT, untested_sections
from truing.report.verdict import section_verdicts


def test_accuracy_and_reversal_of_an_axis_are_at_the_top():
    rows = [("X", "B", "25 mm", 0.5), ("X", "A", None, 2.5197), ("X", "B", None, 0.59), ("X", "R", None, 0.8)]
    table = pd.DataFrame(rows, columns=["run", "figure", "subject", "value"]).assign(unit="um")
    alone = build_head("stage", {"positioning": table})
    assert not alone.tiles
    assert "A 2.52 µm" in alone.verdicts[0][1]
    failed = [("drift", "X", 2.0, 1.0, "1", "fail", "drifts.", None)]
    columns = ["check", "subject", "value", "limit", "unit", "verdict", "message", "accepted"]
    head = build_head("stage", {"positioning": table, "qa": pd.DataFrame(failed, columns=columns)})
    assert dict(head.tiles) == {"accuracy A, X": "2.52 µm", "reversal B, X": "0.590 µm"}
    head = build_head("stage", {"positioning": table.assign(run="1"), "qa": pd.DataFrame(failed, columns=columns)})
    assert set(dict(head.tiles)) == {"accuracy A, run 1", "reversal B, run 1"}


def test_every_run_is_drawn_with_its_means_and_twice_their_scatter():
    at = {"25 mm": (0.5, 0.1, 0.05, 0.02), "100 mm": (1.9, 1.4, 0.03, 0.04), "-5 mm": (0.0, -0.5, 0.01, 0.02)}
    names = ("mean_forward", "mean_backward", "s_forward", "s_backward")
    extra = ("B", "R")
    rows = [
        (run, name, t, value)
        for run in ("X", "<b>Y")
        for t, own in at.items()
        for name, value in zip(names, own, strict=True)
    ]
    rows += [(run, name, t, 1.0) for run in ("X", "<b>Y") for t in at for name in extra]
    table = pd.DataFrame(rows, columns=["run", "figure", "subject", "value"]).assign(
        unit="um", sigma=None, low=None, high=None
    )
    section = positioning({"positioning": table})
    assert section is not None
    first, second = (figure for figure, _ in section.figures)
    assert "&lt;b&gt;Y" in second.layout.title.text
    forward, backward = first.data
    assert list(forward.x) == [-5.0, 25.0, 100.0]
    assert_close(forward.y, [0.0, 0.5, 1.9], atol=0.0)
    assert_close(backward.error_y.array, [0.04, 0.04, 0.08], atol=1e-15)


def test_a_campaign_of_positioning_alone_begins_with_what_it_was_measured_for():
    axes = {"X": 22.0, "Y": 31.0}
    rows = [(run, figure, value) for run in axes for figure, value in (("A", axes[run]), ("R", 14.3), ("B", 4.5))]
    table = pd.DataFrame(rows, columns=["run", "figure", "value"]).assign(subject=None, unit="um", sigma=1.3)
    mark, text = build_head("stage", {"positioning": table}).verdicts[0]
    assert mark == "measured"
    assert_says(text, "ISO 230-2", "2 runs", "Y", "accuracy A 31.0 ± 1.3 µm", "R 14.3 ± 1.3 µm", "B 4.5 ± 1.3 µm")


def test_positions_alone_say_nothing_of_loads_or_machines_that_were_never_measured():
    axis = pd.DataFrame({"run": ["X"], "figure": ["A"], "value": [22.0], "subject": [None], "unit": ["um"]})
    positions = pd.DataFrame({"run": ["X"] * 2, "target_mm": [15.0, 25.0]})
    empty = {name: pd.DataFrame() for name in ("sensor_matrix", "displacement", "compliance", "diagnosis")}
    empty["diagnosis"].attrs[WHY_NOT] = "the noise is unknown: 2 targets in 3 cycles leave 4 degrees of freedom"
    tables = {"positioning": axis.assign(sigma=1.3), "positions": positions, **empty}
    assert set(section_verdicts(tables)) == {"positioning", "diagnosis"}
    assert_says(section_verdicts(tables)["diagnosis"].explanation, "not evaluated", "noise", "4 degrees of freedom")
    signals = pd.DataFrame({"run": ["1"], "v1": [0.1]})
    assert "calibration" in untested_sections(tables)
    assert not untested_sections({**tables, "signals": signals})


def test_approaches_of_an_axis_are_something_measured():
    table = pd.DataFrame({"run": ["X"] * 4, "target_mm": [15.0, 15.0, 25.0, 25.0]})
    section = measured_loads({"positions": table})
    assert section.state != "empty"
    assert_says(section.lead, "4 approaches", "2 targets", "1 run")


def test_a_run_that_failed_a_check_is_reported_with_the_reason_and_without_a_figure():
    measured = pd.DataFrame({"run": ["X"] * 4 + ["Y"] * 4, "target_mm": [15.0, 25.0] * 4})
    qa = pd.DataFrame(
        [("encoder-overflow", "run Y", "fail", "Run Y: positions jump by 65.5 mm.")],
        columns=["check", "subject", "verdict", "message"],
    )
    nothing = pd.DataFrame(columns=["run", "figure", "subject", "value"])
    section = positioning({"positions": measured[4:], "positioning": nothing, "qa": qa})
    assert section is not None
    assert section.state == "not evaluated"
    assert_says(section.lead, "Run Y", "not evaluated", "jump", "65.5 mm")
    rows = [("X", figure, 5.0) for figure in ("A", "R", "B")]
    table = pd.DataFrame(rows, columns=["run", "figure", "value"]).assign(subject=None, unit="um", sigma=1.3)
    reported = {"positions": measured, "positioning": table, "qa": qa.assign(value=None)}
    (failed, _), (mark, text), *_ = build_head("stage", reported).verdicts
    assert (failed, mark) == ("fail", "measured")
    assert_says(text, "Not evaluated", "1 further run", "Positioning")
