"""The uncertainty section: its sentence, its three states, its budgets, and escaped names."""

from __future__ import annotations

import pandas as pd
import pytest

from tests.sentences import assert_says
from truing.report.uncertainty_section import freedom, group_of, statement, uncertainty


def _tables(dof: tuple[float | None, ...] = (None, None), hostile: str = "points") -> dict[str, pd.DataFrame]:
    factors = [1.96 if one is None else 2.2 for one in dof]
    names = {"result": "pose", "subject": ["platform, pose 1", "platform, pose 2"], "quantity": "px", "unit": "mm"}
    stated = pd.DataFrame({**names, "estimate": [1.23456, -2.0], "standard_uncertainty": [0.01, 0.02]})
    stated = stated.assign(
        degrees_of_freedom=[float("nan") if one is None else one for one in dof], coverage_factor=factors, stated=True
    )
    stated = stated.assign(expanded_uncertainty=stated["coverage_factor"] * stated["standard_uncertainty"], reason=None)
    parts = [
        pd.DataFrame({**names, "input_source": source, "evaluation": kind, "contribution": [a, b], "reason": None})
        for source, kind, a, b in ((hostile, "B", 0.006, 0.012), ("scatter", "A", 0.008, 0.016))
    ]
    budget = pd.concat(parts, ignore_index=True).assign(distribution="normal", degrees_of_freedom=float("nan"))
    budget["share_of_variance"] = [0.36, 0.36, 0.64, 0.64]
    left = {"result": "pose", "quantity": "all", "input_source": "scale", "evaluation": "not evaluated"}
    budget = pd.concat([budget, pd.DataFrame([{**left, "reason": "nobody declared it"}])], ignore_index=True)
    other = {"result": "cause", "subject": None, "quantity": "all", "stated": False, "reason": "no cause was found"}
    stated = pd.concat([stated, pd.DataFrame([other])], ignore_index=True).astype({"stated": bool})
    return {"uncertainty": stated, "uncertainty_budget": budget}


def test_the_sentence_is_that_of_the_guide() -> None:
    text = statement(_tables()["uncertainty"])
    assert_says(text, "expanded uncertainty", "coverage factor", "k = 1.96", "normal distribution", "95 %")
    few = statement(_tables((11.0, 11.0))["uncertainty"].iloc[:1])
    assert_says(few, "k = 2.20", "t-distribution", "ν_eff = 11")
    assert_says(statement(_tables((11.0, None))["uncertainty"]), "k next to it", "t-distribution")


def test_results_budgets_and_what_is_in_none_are_side_by_side() -> None:
    section = uncertainty(_tables())
    poses, cause = section.parts
    budget, results, omitted = poses.listings
    assert results.rows[0][2:] == ("1.235 ± 0.020 mm", "0.010 mm", "1.96", "∞")
    assert [(row[1], row[2], row[6]) for row in budget.rows] == [("scatter", "A", "64.0 %"), ("points", "B", "36.0 %")]
    assert omitted.rows == (("not evaluated", "scale", "nobody declared it"),)
    assert cause.state == "not evaluated"
    assert cause.listings[0].rows[0][-1] == "no cause was found"
    (figure, _), *_ = poses.figures
    assert [list(bar.x) for bar in figure.data] == [pytest.approx([64.0]), pytest.approx([36.0])]


def test_parameters_have_the_units_of_the_other_sections() -> None:
    tables = _tables()
    tables = {
        name: table.assign(result="calibration", quantity="K12 of leg 1", unit="1") for name, table in tables.items()
    }
    budget, results, *_ = uncertainty(tables).parts[0].listings
    assert results.rows[0][2:4] == ("1235 ± 20 µm/mm", "10 µm/mm")
    assert budget.rows[0][4].endswith(" µm/mm")


def test_a_run_without_it_says_so_and_names_inject_nothing() -> None:
    absent = uncertainty({})
    assert absent.state == "not evaluated"
    assert absent.lead
    (figure, _), *_ = uncertainty(_tables(hostile="<img src=x onerror=alert(1)>")).parts[0].figures
    assert not any("<img" in bar.name or "<img" in bar.hovertemplate for bar in figure.data)


@pytest.mark.parametrize(
    ("result", "quantity", "group"),
    [
        *[("calibration", "a_x of leg 3", "a_x"), ("calibration", "K12 of leg 1", "K"), ("cause", "gain_3", "gain")],
        *[("G_B", "fx per v2", "fx"), ("compliance", "dx per fx", "dx per fx"), ("cause", "offset_x", "offset_x")],
    ],
)
def test_numbers_of_all_legs_make_one_bar(result: str, quantity: str, group: str) -> None:
    assert group_of(result, quantity) == group


def test_degrees_of_freedom_are_cut_to_whole_ones() -> None:
    assert [freedom(value) for value in (5.99, 250.2, 1e7, float("nan"))] == ["5", "250", "∞", "∞"]
