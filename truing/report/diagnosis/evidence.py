"""Evidence of the diagnosis: odds of each candidate cause and of its rivals."""

from __future__ import annotations

import math

import numpy as np
import plotly.graph_objects as go

from truing.report.column_heads import CAUSE, UNIT, Head
from truing.report.diagnosis.assessed_causes import (
    EQUAL_ODDS,
    FOUND,
    HOLDS,
    NOT_TESTABLE,
    REJECTED,
    RIVAL,
    SUSPECTED,
    AssessedCause,
    accepted_of,
)
from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, label, style
from truing.report.numbers import count_text, p_equals, p_value, plain, rough, sign
from truing.report.page import Listing, ReportSection
from truing.report.parameter_names import UNBROKEN
from truing.report.wordings.catalogue import cause_words

_PALE = "#C8C8C8"
_VERDICTS = {
    FOUND: ("found", BLUE),
    SUSPECTED: ("suspected", GREEN),
    RIVAL: ("not distinguishable", ORANGE),
    REJECTED: ("rejected", GREY),
    NOT_TESTABLE: ("not testable", _PALE),
}
_MARKS = {FOUND: "found", SUSPECTED: "warn", RIVAL: "warn", REJECTED: "none", NOT_TESTABLE: "none"}
_CHANCE = "chance"  # reason of a rejection: next to all findings, chance does as much
_CLEAR = 0.95
# Most candidates of a figure; the table has them all.
_SHOWN = 16
_RAISED = "⁰¹²³⁴⁵⁶⁷⁸⁹"
_ROW, _AROUND = 30, 190
# Shares of the axis: least distance of two ticks, and space next to the longest bar for its words.
_APART, _ROOM = 0.09, 0.32
# Decades of odds that may have a tick.
_DECADES = (1, 3, 10, 30, 100, 300, 1000, 3000, 10000, 100000)


def evidence(rows: list[AssessedCause]) -> ReportSection:
    """Return the evidence for each candidate, with rivals of findings marked."""
    causes = [row for row in rows if not row.is_noise]
    title = "Evidence against every alternative" if accepted_of(causes) else "Evidence for each cause"
    return ReportSection("evidence", title, _opening_sentences(causes), tuple(_figures(causes)), (_candidates(rows),))


def _figures(causes: list[AssessedCause]) -> list[tuple[object, str]]:
    known = [row for row in causes if row.evidence is not None]
    if known:
        return [
            (
                _odds_figure(known),
                f"Right of the line: evidence for the cause; left: against it. {_shown_causes(causes)}",
            )
        ]
    known = [row for row in causes if row.probability is not None]
    return [(_probability_figure(known), _shown_causes(causes))] if known else []


def _opening_sentences(rows: list[AssessedCause]) -> str:
    """Return in words the lead of the findings over the next candidates, and its robustness against plausible sizes."""
    rivals = [row for row in rows if row.verdict == RIVAL]
    accepted = accepted_of(rows)
    if not accepted:
        return "No candidate is significant at the chosen rate of false alarms."
    nearest = _next_best(rows, accepted)
    if rivals:
        are = "it is" if len(rivals) == 1 else "they are"
        count = count_text(len(rivals), "alternative")
        text = f"{count} cannot be ruled out: {are} within a factor of {EQUAL_ODDS:g} of the best probability."
    elif weak := [row for row in accepted if row.evidence is not None and row.evidence < math.log(EQUAL_ODDS)]:
        text = " ".join(_weakly_favoured(row.in_sentence, row.evidence or 0.0) for row in weak)
    else:
        alternative_text = (
            "alternative" if nearest and len(accepted) == 1 else "alternative that passes the other tests"
        )
        text = f"Every {alternative_text} is at least {EQUAL_ODDS:g} times less probable."
    text += nearest
    assessed = [row for row in accepted if row.holds]
    changed = list(dict.fromkeys(row.name for row in assessed if row.holds != HOLDS))
    if changed:
        return f"{text} If assumed effect sizes are tripled, the ranking changes for {'; '.join(changed)}."
    return f"{text} The ranking is unchanged if assumed effect sizes are tripled." if assessed else text


def _weakly_favoured(name: str, evidence: float) -> str:
    """Return in words the odds, as their logarithm, of a cause over no effect, where they decide little or against
    it."""
    if evidence < 0.0:
        return f"No effect is {plain(math.exp(-evidence))} times as probable as {name}."
    return f"The data favour {name} over no effect by only {plain(math.exp(evidence))} to 1."


def _next_best(rows: list[AssessedCause], findings: list[AssessedCause]) -> str:
    """Return in words the lead over the best rejected candidate, in the first round, where both competed."""
    first = findings[0].evidence
    behind = [row for row in rows if row.verdict == REJECTED and row.evidence is not None]
    if first is None or not behind:
        return ""
    best = max(behind, key=lambda row: row.evidence or 0.0)
    gap, winner = first - (best.evidence or 0.0), findings[0].in_sentence
    if gap < math.log(EQUAL_ODDS):
        return _alone(best, findings)
    return f" The best rejected cause ({_kind(best)}) is {_times(gap)} times less probable than {winner}."


def _alone(best: AssessedCause, findings: list[AssessedCause]) -> str:
    """Return in words why a rejected cause can have like odds alone as the first finding, which the figure shows."""
    first = findings[0]
    if len(findings) < 2 or best.reason_code != _CHANCE or best.p_value is None or (first.probability or 0.0) < _CLEAR:
        return ""
    rejected = _kind(best)
    return (
        f" Taken alone, the rejected cause {rejected} explains the data about as well as {first.in_sentence}. With "
        f"the other findings in the model, {first.in_sentence} is more probable, and {rejected} explains no more than "
        f"chance (p {p_equals(best.p_value)})."
    )


def _times(gap: float) -> str:
    """Return the factor of a natural logarithm: ``350``, or ``10^75``."""
    decades = gap / math.log(10.0)
    return rough(10.0**decades) if decades < 4.0 else f"10{''.join(_RAISED[int(d)] for d in f'{decades:.0f}')}"


def _shown_causes(rows: list[AssessedCause]) -> str:
    if len(rows) > _SHOWN:
        return f"The {_SHOWN} candidates with most evidence; the table has all {len(rows)}."
    return "Each cause is shown for the leg, target or axis that it fits best."


def _position(evidence: float) -> float:
    """Return the place of odds on the axis: even odds at 0, then the logarithm of their decades."""
    decades = evidence / math.log(10.0)
    return math.copysign(math.log10(1.0 + abs(decades)), decades)


def _best(rows: list[AssessedCause]) -> list[AssessedCause]:
    """Return the candidates of the figure by evidence; found ones in any case."""
    order = sorted(rows, key=lambda row: (row.verdict not in (FOUND, SUSPECTED), -(row.evidence or 0.0)))
    return sorted(order[:_SHOWN], key=lambda row: -(row.evidence or 0.0))


def _odds_figure(rows: list[AssessedCause]) -> go.Figure:
    """Return the odds of the model with each candidate over the model without it."""
    shown = _best(rows)
    figure = _bars(shown, [_position(row.evidence or 0.0) for row in shown], [_odds(row) for row in shown])
    positions = np.array([_position(row.evidence or 0.0) for row in shown])
    subtitle = (
        "A found cause is added to those found before it, any other to the plain model. "
        "Hatched: depends on the assumed effect size"
    )
    _finish(figure, "Odds of the model with each cause over the model without it", subtitle, len(shown))
    figure.update_xaxes(title_text="odds (powers of ten, compressed scale)", **_axis(positions))
    figure.add_vline(x=0.0, line={"color": GREY, "width": 1})
    return figure


def _axis(positions: np.ndarray) -> dict[str, object]:
    """Return ticks at round odds that fit on a phone, and space at the right end for the words of the longest bar."""
    low, high = min(0.0, float(positions.min())), max(0.3, float(positions.max()))
    reach = high - low
    shown_decades: list[int] = [0]
    for decades in (*_DECADES, *(-d for d in _DECADES)):
        position = _position(decades * math.log(10.0))
        distance = min(abs(position - _position(d * math.log(10.0))) for d in shown_decades)
        if low - 0.05 <= position <= high + 0.05 and distance > _APART * reach:
            shown_decades.append(decades)
    return {
        "tickvals": [_position(d * math.log(10.0)) for d in sorted(shown_decades)],
        "ticktext": [_power(d) for d in sorted(shown_decades)],
        "tickangle": 0,
        "range": [low - 0.02 * reach, high + _ROOM * reach],
        "zeroline": False,
    }


def _power(decades: int) -> str:
    return "even" if not decades else f"10<sup>{decades}</sup>"


def _odds(row: AssessedCause) -> str:
    """Return odds in words: ``10^12 to 1``, or against it."""
    decades = (row.evidence or 0.0) / math.log(10.0)
    size = abs(decades)
    if size < 0.02:
        return "even odds"
    if size < 3.0:
        text = rough(10.0**size)
        return f"{text} to 1" if decades >= 0.0 else f"{text} to 1 against"
    power = f"10<sup>{size:,.0f}</sup>"
    return f"{power} to 1" if decades > 0.0 else f"{power} to 1 against"


def _probability_figure(rows: list[AssessedCause]) -> go.Figure:
    """Return the probability of each candidate, where its evidence was not recorded."""
    shown = sorted(rows, key=lambda row: -(row.probability or 0.0))[:_SHOWN]
    figure = _bars(shown, [row.probability or 0.0 for row in shown], [plain(row.probability) for row in shown])
    subtitle = "Among the candidates of its step, given the data"
    _finish(figure, "Probability of each candidate cause", subtitle, len(shown))
    figure.update_xaxes(title_text="probability", range=[0.0, 1.12])
    return figure


def _bars(rows: list[AssessedCause], values: list[float], words: list[str]) -> go.Figure:
    figure = go.Figure()
    for verdict, (name, colour) in _VERDICTS.items():
        of_verdict = [k for k, row in enumerate(rows) if row.verdict == verdict]
        if not of_verdict:
            continue
        figure.add_trace(
            go.Bar(
                y=[_axis_label(rows, k) for k in of_verdict],
                x=[values[k] for k in of_verdict],
                name=name,
                orientation="h",
                customdata=[words[k] for k in of_verdict],
                marker={
                    "color": colour,
                    "pattern": {"shape": ["/" if rows[k].holds == "changes" else "" for k in of_verdict]},
                },
                hovertemplate="%{y}: %{customdata}<extra></extra>",
            )
        )
    order = [_axis_label(rows, k) for k in range(len(rows))]
    figure.add_trace(
        go.Scatter(
            y=order,
            x=[max(0.0, value) for value in values],
            text=[f" {text}" for text in words],
            mode="text",
            textposition="middle right",
            cliponaxis=False,
            hoverinfo="skip",
            showlegend=False,
        )
    )
    figure.update_yaxes(categoryorder="array", categoryarray=order)
    return figure


def _axis_label(rows: list[AssessedCause], k: int) -> str:
    """Return the candidate's name on the axis; equal names are separated by their rank."""
    names = [_kind(row) for row in rows]
    name = label(_short(names[k]))
    return f"{name} " if names.count(names[k]) == 1 else f"{name} (rank {rows[k].rank}) "


def _kind(row: AssessedCause) -> str:
    """Return a candidate by name; the evidence of a rejected cause is that of its best subject in the first round."""
    return cause_words(row.cause) if row.verdict == REJECTED else row.name


# Reasons to reject a candidate other than chance, by reason code.
_WHY_REJECTED = {
    "contained": "part of a found cause",
    "dropped": "not needed next to others",
    "held-out": "predicts held-out data worse",
}


def _short(name: str) -> str:
    return name if len(name) <= 46 else f"{name[:28]}…{name[-17:]}"


def _finish(figure: go.Figure, title: str, subtitle: str, count_of_rows: int) -> None:
    style(figure, title, subtitle, _AROUND + _ROW * count_of_rows)
    figure.update_yaxes(autorange="reversed", automargin=True, type="category")
    figure.update_layout(
        barmode="overlay",
        margin={"t": 100},
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0, "itemclick": False},
    )


_HEADS = (
    Head("rank", "Place among the candidates; 1 is the most probable."),
    CAUSE,
    Head("verdict", "Decision on the candidate: found, suspected, indistinguishable, rejected or not testable."),
    Head("p", "Probability of so clear an effect by chance, corrected for the number of candidates."),
    Head("signal / noise", "Size of the effect over its noise, after other free parameters have absorbed their part."),
    Head(
        "log10 odds",
        "Decimal logarithm of the odds with this cause over those without it, next to the causes found before it.",
    ),
    Head("probability", "Probability among the candidates and no effect, in the round that decided on it."),
    Head("ranking, sizes × 3", "Whether the rank holds if the assumed sizes of all effects are tripled."),
    Head("rms", "Rms of measured minus predicted on fitted data, before → after the cause is accepted."),
    Head(
        "rms, not fitted",
        "Rms of measured minus predicted on data that the fit did not use, before → after the cause is accepted.",
    ),
    UNIT,
)


def _change_words(pair: tuple[float | None, float | None]) -> str:
    return "" if pair == (None, None) else f"{plain(pair[0])} → {plain(pair[1])}".replace(" ", UNBROKEN)


def _decision(row: AssessedCause) -> str:
    """Return the verdict on a candidate; where it was rejected in spite of a clear effect, with the reason."""
    reason = _WHY_REJECTED.get(row.reason_code) if row.verdict == REJECTED else None
    return f"{row.verdict}: {reason}" if reason else row.verdict


def _candidates(rows: list[AssessedCause]) -> Listing:
    cells = tuple(
        (
            str(row.rank),
            row.name,
            _decision(row),
            p_value(row.p_value).replace(" ", UNBROKEN),
            plain(row.signal_to_noise),
            "–" if row.evidence is None else f"{row.evidence / math.log(10.0):+.1f}",
            plain(row.probability),
            row.holds or "–",
            _change_words(row.rms),
            _change_words(row.held_out),
            sign(row.unit),
        )
        for row in rows
    )
    marks = tuple(_MARKS[row.verdict] for row in rows)
    title = f"All {len(rows)} candidates; rms before and after each is accepted"
    return Listing(_HEADS, cells, marks, title, len(cells) > 12, "diagnosis.parquet")
