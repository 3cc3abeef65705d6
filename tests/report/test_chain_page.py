"""The section of a chain: determined parameters, deviations from nominal, and the drawing of the arm."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tests.sentences import assert_says
from tests.tolerance import assert_close
from truing.belonging.relation import RelationState
from truing.report.chain_corrections import corrections, estimates_zeros
from truing.report.chain_page import chain
from truing.report.section_verdict import SectionVerdict
from truing.runs.chain_positions import chain_positions
from truing.schemas.verdict import ReasonCode

_NOT_TURNED = {"rx_rad": 0.0, "ry_rad": 0.0, "rz_rad": 0.0}


def _joints() -> pd.DataFrame:
    """Two joints about z, 300 mm apart, a flange 200 mm farther along x."""

    def row(joint: str, link: str, below: int, kind: str, x: float, number: int) -> dict[str, object]:
        place = {"x_mm": x, "y_mm": 0.0, "z_mm": 0.0, **_NOT_TURNED, "axis_x": 0.0, "axis_y": 0.0, "axis_z": 1.0}
        own = {
            "joint": joint,
            "link": link,
            "below": below,
            "joint_kind": kind,
            "follows_joint": joint,
            "input": number,
        }
        weight = {"mass_kg": 0.0, "com_x_mm": 0.0, "com_y_mm": 0.0, "com_z_mm": 0.0}
        return {**own, **place, **weight, "factor": 1.0, "zero_si": 0.0}

    rows = [
        row("", "floor", -1, "fixed", 0.0, -1),
        row("<b>", "upper", 0, "revolute", 0.0, 0),
        row("elbow", "lower", 1, "revolute", 300.0, 1),
        row("", "flange", 2, "fixed", 200.0, -1),
    ]
    return pd.DataFrame(rows)


def _tables() -> dict[str, pd.DataFrame]:
    configurations = pd.DataFrame({"pose": ["a", "b"], "<b>_deg": [90.0, 0.0], "elbow_rad": [-np.pi / 2, 0.0]})
    observations = pd.DataFrame({"pose": ["a"], "body": ["flange"], "target": ["T1"]})
    survey = pd.DataFrame({"body": ["flange"], "target": ["T1"], "x_mm": [10.0], "y_mm": [0.0], "z_mm": [5.0]})
    rows = [
        ("elbow", "dx", "mm", 0.02, 0.01, 0.3, 0.1, True),
        ("elbow", "offset", "rad", 0.004, 0.0001, 0.001, 4.0, True),
        ("elbow", "turn_x", "rad", 0.0, 0.001, 0.001, np.nan, False),
    ]
    names = ["joint", "parameter", "unit", "identified", "sigma", "tolerance", "pull", "identifiable"]
    errors = {"rms_nominal": [40.0, 30.0], "rms_before": [9.0, 8.0], "rms_after": [2.0, 3.0], "unit": ["um", "um"]}
    prediction = pd.DataFrame({"pose": ["a", "b"], "role": ["calibration", "verification"], **errors})
    tables = {"joints": _joints(), "configurations": configurations, "observations": observations, "survey": survey}
    tables |= {"chain_parameters": pd.DataFrame(rows, columns=names), "prediction": prediction}
    return tables | chain_positions(tables)


def test_the_arm_is_where_its_joints_are_read() -> None:
    tables = _tables()
    nodes = tables["chain_nodes"].set_index("link")
    assert_close(nodes.loc["lower", ["x_mm", "y_mm", "z_mm"]].to_numpy(float), np.array([0.0, 300.0, 0.0]), atol=1e-9)
    assert_close(
        nodes.loc["flange", ["x_mm", "y_mm", "z_mm"]].to_numpy(float), np.array([200.0, 300.0, 0.0]), atol=1e-9
    )
    places = tables["chain_tip"].set_index("pose")
    assert_close(places.loc["b", ["x_mm", "y_mm", "z_mm"]].to_numpy(float), np.array([500.0, 0.0, 0.0]), atol=1e-9)
    section = chain(tables)
    assert section is not None
    (arm, _), (errors, _) = section.figures
    (targets,) = (trace for trace in arm.data if trace.name == "targets")
    assert_close(np.array([targets.x[0], targets.y[0], targets.z[0]]), np.array([210.0, 300.0, 5.0]), atol=1e-9)
    (joints,) = (trace for trace in arm.data if trace.name == "joints that turn")
    assert list(joints.text) == ["&lt;b&gt;", "elbow"]  # no markup out of a name
    assert list(errors.data[0].marker.color) == [2.0, 3.0]


def test_numbers_come_by_significance_and_far_ones_are_marked() -> None:
    section = chain(_tables())
    assert section is not None
    (numbers,) = section.listings
    assert [row[1] for row in numbers.rows] == ["offset", "dx", "turn_x"]
    assert numbers.marks == ("warn", "none", "none")
    assert numbers.rows[0][2:] == ("0.2292 ± 0.0057 deg", "0.0573 deg", "4.0", "yes")
    assert numbers.rows[2][4:] == ("–", "no")
    assert "2 of 3 numbers" in section.lead
    assert "Not determined: turn_x of elbow." in section.lead
    assert "offset of elbow" in section.lead


def test_a_chain_that_was_not_diagnosed_is_drawn_and_other_machines_have_no_section() -> None:
    tables = _tables()
    del tables["chain_parameters"], tables["prediction"]
    section = chain(tables)
    assert section is not None
    assert len(section.figures) == 1
    assert not section.listings
    assert "not identified" in section.lead
    assert chain({}) is None
    assert chain_positions({"configurations": tables["configurations"]}) == {}
    unread = {**tables, "configurations": tables["configurations"].drop(columns="elbow_rad")}
    assert chain_positions(unread) == {}


@pytest.mark.parametrize(
    ("state", "reason", "said"),
    [
        ("ok", ReasonCode.WITHIN_NOISE, True),
        ("attention", ReasonCode.BELOW_NOISE, True),
        ("attention", ReasonCode.LACK_OF_FIT, False),
        ("fails", ReasonCode.BEYOND_NOISE, False),
    ],
)
def test_clear_corrections_of_a_model_that_fits_are_on_the_first_screen(
    state: str, reason: ReasonCode, said: bool
) -> None:
    tables = _tables()
    adequacy = SectionVerdict("adequacy", RelationState(state), reason, "")
    lines = corrections(tables, adequacy)
    assert bool(lines) == said
    if said:
        assert_says(lines[0][1], "held-out", "30 µm", "3 µm")
    if said:  # 0.02 mm are two standard deviations, and no correction
        assert "zero of elbow" in lines[0][1]
        assert "0.2292 ± 0.0057 deg" in lines[0][1]
        assert "dx" not in lines[0][1]
    assert estimates_zeros(tables)
    tables["chain_parameters"]["identified"] = tables["chain_parameters"]["sigma"]
    assert corrections(tables, adequacy) == []
    del tables["chain_parameters"]
    assert corrections(tables, adequacy) == []
    assert not estimates_zeros(tables)


def test_a_rotation_on_the_first_screen_has_the_words_of_the_field() -> None:
    tables = _tables()
    numbers = tables["chain_parameters"]
    turned = numbers["parameter"] == "turn_x"
    numbers.loc[turned, ["identifiable", "identified", "sigma"]] = [True, 1e-3, 1e-5]
    (line,) = corrections(tables, SectionVerdict("adequacy", RelationState.OK, ReasonCode.WITHIN_NOISE, ""))
    assert "rotation about x of the frame of elbow" in line[1]
    assert "turn_x" not in line[1]
