"""The page of detectable effects: sizes in suitable units, rates with intervals, and undetectable effects."""

from __future__ import annotations

import math

import pandas as pd
import pytest

from tests.sentences import assert_says
from truing.report.page import all_of
from truing.report.power_page import alarm_words, power_head, power_sections, size_rows
from truing.report.rendering.render import render_page

_LEVELS = {"expected_80": 9e-4, "found_80": 8e-4, "lower_80": 7e-4, "upper_80": 1.1e-3}
GAIN = {"cause": "actuator-gain", "concerns": "the whole", "parameter": "gain", "unit": "1", "beside": ""}
SCALE = {"cause": "measurement-scale", "concerns": "the whole", "parameter": "scale_per_k", "unit": "1/K", "beside": ""}
BLIND = {**GAIN, "cause": "flexure-shift", "parameter": "flexure_length", "unit": "mm", "instead": ""}


def _sizes() -> pd.DataFrame:
    nearly = {name.replace("80", "95"): 1.5 * value for name, value in _LEVELS.items()}
    never = dict.fromkeys([*_LEVELS, *nearly], math.nan)
    return pd.DataFrame([{**GAIN, **_LEVELS, **nearly, "instead": "leg-drift (2)"}, {**BLIND, **never}])


def _rates(drawn: bool = True) -> pd.DataFrame:
    columns = [*GAIN, "size", "campaigns", "expected"]
    columns += [f"{what}{bound}" for what in ("found", "named") for bound in ("", "_lower", "_upper")]
    nothing = ["nothing", "", "", "", "", 0.0, 40, math.nan, 0.025, 0.001, 0.13, math.nan, math.nan, math.nan]
    steps = [_step(GAIN, k) for k in (1, 2, 3)]
    return pd.DataFrame([nothing, *steps] if drawn else [], columns=columns)


def _step(sort: dict[str, str], k: int) -> list[object]:
    return [*sort.values(), 1e-3 * k, 8, k / 3, k / 3, 0.1, 1.0, k / 4, 0.0, 0.9]


def test_a_size_is_reported_with_its_bounds_in_the_unit_of_a_laboratory() -> None:
    gain, blind = size_rows(_sizes())
    assert gain[2:] == ["gain 0.090 %", "0.080 (0.070 to 0.11) %", "0.12 (0.10 to 0.17) %", "leg-drift (2)"]
    assert blind[2:] == ["not at any plausible size", "–", "–", ""]


def test_the_head_reports_false_alarms_and_what_the_campaign_is_blind_to() -> None:
    head = power_head("bench", _sizes(), _rates())
    assert alarm_words(_rates()) in [text for _, text in head.verdicts]
    assert_says(alarm_words(_rates()), "1 of 40", "without any effect", "0.1 to 13.0 %")
    assert_says([text for mark, text in head.verdicts if mark == "warn"], "not", "flexure shift")


def test_every_cause_that_was_drawn_has_a_figure_with_bars() -> None:
    sections = power_sections(_sizes(), _rates())
    (figure, caption), *others = [drawn for section in all_of(sections) for drawn in section.figures]
    assert not others
    assert caption.startswith("8 campaigns per size")
    theory, found, _ = figure.data
    assert theory.name == "theory"
    assert list(found.error_y.array) == pytest.approx([100 * (1.0 - k / 3) for k in (1, 2, 3)])


def test_names_of_cases_distinguish_what_grows_together() -> None:
    both = {**SCALE, "beside": "scale"}
    sizes = pd.DataFrame([{**sort, **_sizes().iloc[0][list(_LEVELS)], "instead": ""} for sort in (SCALE, both)])
    sizes = sizes.assign(**{name.replace("80", "95"): math.nan for name in _LEVELS})
    assert [row[2] for row in size_rows(sizes)] == ["scale_per_k 900 ppm/K", "scale_per_k 900 ppm/K (with scale)"]
    drawn = pd.DataFrame([_step(sort, k) for sort in (SCALE, both) for k in (1, 2)], columns=_rates().columns)
    figures = [figure for section in power_sections(sizes, drawn) for figure, _ in section.figures]
    assert [len(figure.data[0].x) for figure in figures] == [2, 2]
    assert "with scale" in figures[1].layout.title.text


def test_theory_alone_makes_a_page_without_a_figure_or_a_rate() -> None:
    sizes, rates = _sizes(), _rates(drawn=False)
    page = render_page(power_head("bench <1>", sizes, rates), power_sections(sizes, rates))
    assert_says(page, "theory only", "no campaign", "simulated")
    assert "False alarms" not in page
    assert "bench &lt;1&gt;: what it would show" in page
