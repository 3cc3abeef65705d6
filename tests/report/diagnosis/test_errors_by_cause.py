"""The figure of errors before and after each cause: one figure for causes that follow each other, bars that differ."""

from __future__ import annotations

from dataclasses import replace

from tests.report.diagnosis_tables import diagnosis_tables
from truing.report.diagnosis.assessed_causes import assessed_causes
from truing.report.diagnosis.gain import _chained, misfit_figure

CAUSE = replace(assessed_causes(diagnosis_tables())[0], rms=(5.0, 2.0), held_out=(5.1, 2.1), floor=0.4, unit="um")
NEXT = replace(CAUSE, rms=(2.0, 0.5), held_out=(2.1, 0.6))


def test_causes_that_follow_each_other_share_a_figure() -> None:
    assert _chained([CAUSE, NEXT]) == [[CAUSE, NEXT]]


def test_causes_of_other_readings_or_noise_have_figures_of_their_own() -> None:
    for other in (replace(NEXT, rms=(1.9, 0.5)), replace(NEXT, floor=0.3), replace(NEXT, unit="mm")):
        assert _chained([CAUSE, other]) == [[CAUSE], [other]]


def test_causes_of_one_name_have_bars_of_their_own() -> None:
    for trace in misfit_figure([CAUSE, NEXT]).data:
        assert len(set(trace.y)) == len(trace.y) == 3


def test_long_names_go_on_in_further_lines() -> None:
    name = "effect of the direction of approach & the command, and of the travel of the axis since it reversed"
    figure = misfit_figure([replace(CAUSE, subject=name), NEXT])
    lines = [line for text in figure.layout.yaxis.ticktext for line in text.split("<br>")]
    assert max(map(len, lines)) <= 32 + len("&amp;") - len("&")
    assert " &amp; " in " ".join(lines)
    assert list(figure.layout.yaxis.tickvals) == list(figure.data[0].y)
