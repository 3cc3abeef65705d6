"""The measured deformation of a platform against the simulated one: sentence, test, map and entries."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from truing.report.column_heads import Head
from truing.report.comparison_map import ComparedEntries, comparison_map
from truing.report.model_tests import CONTRADICTED, ModelTest, by_p
from truing.report.numbers import p_equals, with_uncertainty
from truing.report.page import Drawn, Listing
from truing.report.tables import Tables, table_or_none

UNLIKELY = 0.01  # p-value below which the matrices differ
_WITHIN = 2.0
_NAMED = 4
_UNIT = "µm/mm"
_PER_MM = 1e3

Facts = Mapping[tuple[str, str], float]


def simulated_sentence(tables: Tables, facts: Facts) -> list[str]:
    """Return the number of entries that agree with simulated ones, those that differ, and a common factor."""
    entries = table_or_none(tables, "simulated_deformation")
    p = facts.get(("matrix", "agreement_p_value"))
    if entries is None or p is None:
        why = "The simulated K is not compared, because the data do not determine the measured K in a frame of its own."
        return [why] if "simulated_deformation" in tables else []
    within = int((entries["pull"].abs() < _WITHIN).sum())
    texts = [
        f"Of {len(entries)} entries of K, {within} agree with the simulated ones within two standard deviations "
        f"(all together: p {p_equals(p)})."
    ]
    differing = entries[entries["verdict"] == "differs"]
    worst = differing.reindex(differing["pull"].abs().sort_values(ascending=False).index)
    named = [
        f"K{r.leg}{r.column} by {with_uncertainty(_PER_MM * r.difference, abs(_PER_MM * r.difference / r.pull), _UNIT)}"
        for r in worst.head(_NAMED).itertuples()
    ]
    if named:
        more = f" and {len(worst) - _NAMED} more" if len(worst) > _NAMED else ""
        texts.append(f"Measured minus simulated: {', '.join(named)}{more}.")
    return [*texts, *(_explained(facts) if p < UNLIKELY else ())]


def _explained(facts: Facts) -> list[str]:
    """Return sentences on a common factor, or a motion of the whole platform, that may explain the differences."""
    factor, sigma = (facts.get(("matrix", f"measured_over_simulated{part}")) for part in ("", "_sigma"))
    texts = []
    if factor is not None and sigma is not None:
        scaled = facts.get(("matrix", "scaled_p_value"), 0.0)
        verb = "explains" if scaled >= UNLIKELY else "does not explain"
        texts.append(
            f"Measured over simulated: {with_uncertainty(factor, sigma)} for all entries alike; this factor {verb} the "
            f"differences (p {p_equals(scaled)})."
        )
    if facts.get(("matrix", "agreement_without_plane_p_value"), 0.0) >= UNLIKELY:
        texts.append(
            "Lift and tilt of all attachments together explain the differences: the simulated K may refer to another "
            "frame of the platform."
        )
    return texts


def simulated_test(facts: Facts) -> list[ModelTest]:
    """Return the test of the measured K against the simulated one, where both are known."""
    p = facts.get(("matrix", "agreement_p_value"))
    meanings = ("Noise explains the differences.", "The simulation predicts another deformation than the measured one.")
    asked = "the platform deforms as simulated (all entries of K together)"
    return [] if p is None else [by_p(asked, p, UNLIKELY, meanings, "", CONTRADICTED)]


def simulated_map(tables: Tables) -> Drawn:
    """Return the map of measured and simulated entries with its words."""
    entries = table_or_none(tables, "simulated_deformation")
    if entries is None:
        return []
    words = "Upper number: measured; lower: simulated. Colour: difference over its standard deviation."
    return [(_map(entries), words)]


def _map(entries: pd.DataFrame) -> go.Figure:
    wide = {c: entries.pivot(index="leg", columns="column", values=c) for c in ("measured", "simulated", "pull")}
    shown = wide["pull"]
    pairs = zip(_PER_MM * wide["measured"].to_numpy(), _PER_MM * wide["simulated"].to_numpy(), strict=True)
    text = [[_both(m, s) for m, s in zip(*row, strict=True)] for row in pairs]
    hover = [[f"{pull:+.1f} sigma" for pull in row] for row in shown.to_numpy()]
    rows, columns = [f"attachment {r}" for r in shown.index], [f"actuator {c}" for c in shown.columns]
    title, subtitle = "K, measured (above) and simulated (below)", "µm per mm of each actuator"
    return comparison_map(ComparedEntries(shown, text, hover), rows, columns, title, subtitle)


def _both(measured: float, simulated: float) -> str:
    return "" if np.isnan(measured) else f"{measured:.1f}<br>{simulated:.1f}"


def simulated_entries(tables: Tables) -> tuple[Listing, ...]:
    """Return the listing of all entries, measured and simulated."""
    entries = table_or_none(tables, "simulated_deformation")
    if entries is None:
        return ()
    rows = tuple(
        (
            f"K{r.leg}{r.column}",
            with_uncertainty(_PER_MM * r.measured, _PER_MM * r.sigma),
            with_uncertainty(_PER_MM * r.simulated, _PER_MM * r.simulated_sigma),
            with_uncertainty(_PER_MM * r.difference, abs(_PER_MM * r.difference / r.pull) if r.pull else None),
            f"{r.pull:+.1f}",
            r.verdict,
        )
        for r in entries.itertuples()
    )
    marks = tuple({"differs": "warn", "agrees": "pass"}[str(verdict)] for verdict in entries["verdict"])
    heads = (
        Head("entry", "Entry of K: attachment that shifts, then actuator that moves it."),
        Head("measured, µm/mm", "Entry as measured, with one standard deviation."),
        Head("simulated, µm/mm", "Entry as simulated."),
        Head("difference, µm/mm", "Measured minus simulated entry."),
        Head("sigmas apart", "Difference divided by its standard deviation."),
        Head("verdict", "Whether both agree, at 5 % false alarms over all entries together."),
    )
    caption = "K, entry by entry. Differs: at 5 % false alarms over all entries together"
    return (Listing(heads, rows, marks, caption, True, "simulated_deformation.parquet"),)
