"""What the head of the page says of the diagnosis: what is wrong, what it could be as well, what to do next."""

from __future__ import annotations

import pandas as pd

from truing.report.diagnosis.adequacy import shortcoming
from truing.report.diagnosis.effect_units import plain_size
from truing.report.diagnosis.headline import clause, gain
from truing.report.diagnosis.judged import REJECTED, RIVAL, SUSPECTED, Judged, accepted_of, judged
from truing.report.diagnosis.misses import AT_THE_FLOOR, Overall, as_it_is
from truing.report.diagnosis.unwritten_loads import load_warning
from truing.report.numbers import count, printed, rough, sign
from truing.report.page import Verdict
from truing.report.parameter_names import UNBROKEN
from truing.report.reasons import why_no_diagnosis
from truing.report.tables import Tables, cell, filled, is_bench
from truing.report.wordings.catalogue import cause_words
from truing.report.wordings.claim import AdviceKind

# Findings that the first line tells, and causes whose smallest detectable size it tells.
_TOLD, _SIZES = 3, 3
_INCOMPLETE = "The picture is incomplete"
_COUNTED = {2: "Two", 3: "Three"}
# What a reader asks for first, of causes that stayed hidden.
_ASKED = (
    "platform-deformation-linear",
    "actuator-backlash",
    "actuator-gain",
    "leg-drift",
    "thermal-expansion",
    "body-drift",
    "target-moved",
    "load-eccentricity",
    "stiffness-scale",
    "hysteresis",
)
# What tells rivals apart comes first, and what no number of poses brings comes last.
_USEFULNESS: dict[str, int] = {AdviceKind.SEPARATE: 0, AdviceKind.IN_VAIN: 2}


def diagnosis_verdicts(tables: Tables) -> list[Verdict]:
    """The lines of the head that tell the diagnosis, the one to act on first."""
    rows = judged(tables)
    if not rows:
        return [("none", f"Diagnosis not evaluated: {lower(why_no_diagnosis(tables))}")]
    found = accepted_of(rows)
    warning = ("warn", load_warning(rows, tables))
    told = [_first(found, rows, tables), *_rivals(found, rows, tables), warning, *_next(found, tables)]
    return [line for line in told if line[1]]


def _first(found: list[Judged], rows: list[Judged], tables: Tables) -> Verdict:
    """The line that a busy person acts on."""
    effects = [row for row in found if not row.is_noise]
    noise = [row for row in found if row.is_noise]
    short = shortcoming(tables)
    if not effects and short:
        beside = f"; {lower(clause(noise[0], tables))}" if noise else ""
        return ("warn", f"{_INCOMPLETE}: no cause of the catalogue was found, and yet {short}{beside}.")
    if not found:
        return _nothing(rows, tables)
    if not effects:
        left = "; beyond that the simulation agrees with the measurement: no cause moves it."
        return ("warn", clause(noise[0], tables) + left)
    brings = gain(found, tables)
    sure = [row for row in [*effects, *noise] if row.verdict != SUSPECTED]
    doubted = [row for row in effects if row.verdict == SUSPECTED]
    said = [f"{_INCOMPLETE}: {short}"] if short else []
    said += [_listed([clause(row, tables) for row in sure[:_TOLD]], len(sure)) + _further(sure)] if sure else []
    if doubted:
        names = "; ".join(lower(clause(row, tables)) for row in doubted[:_TOLD])
        said.append(f"Suspected, not found: {names}{_further(doubted)}")
    modelling = "modelling it" if len(effects) == 1 else f"modelling {'both' if len(effects) == 2 else 'all of it'}"
    told = ". ".join(said)
    return ("warn" if short or doubted else "found", f"{told}; {modelling} {brings}." if brings else f"{told}.")


def _further(rows: list[Judged]) -> str:
    more = len(rows) - _TOLD
    return f", and {count(more, 'further finding')} under Diagnosis" if more > 0 else ""


def _nothing(rows: list[Judged], tables: Tables) -> Verdict:
    """Agreement; and where predictions miss by more than noise all the same, that and no pass."""
    beyond = _beyond_noise(rows, tables)
    if not beyond and (below := [one for one in _missed(rows, tables) if one.is_below_noise]):
        one = below[0]
        said = f"None of {count(len(rows), 'candidate')} was found; yet predictions miss by only {rough(one.after)} "
        said += f"{sign(one.unit)} rms where noise alone would leave {rough(one.floor)}, less than chance explains: "
        return ("warn", f"{said}{one.why_below}. Causes that hide in such noise cannot show: correct [noise].")
    if not beyond:
        return ("pass", _agreement(rows, tables))
    said = f"None of {count(len(rows), 'candidate')} was found; yet predictions miss by {rough(beyond[0].after)} "
    said += (
        f"{sign(beyond[0].unit)} rms where noise alone would leave {rough(beyond[0].floor)}: look at how they miss, "
    )
    return ("warn", f"{said}pose by pose, under Diagnosis.")


def _beyond_noise(rows: list[Judged], tables: Tables) -> list[Overall]:
    """By how much predictions miss where nothing was found and that is more than noise leaves."""
    missed = _missed(rows, tables)
    return [one for one in missed if one.floor is not None and one.after > AT_THE_FLOOR * one.floor]


def _missed(rows: list[Judged], tables: Tables) -> list[Overall]:
    """How far predictions miss on what was held out, or else on the rest."""
    return as_it_is(rows, tables, held_out=True) or as_it_is(rows, tables, held_out=False)


def _listed(clauses: list[str], several: int) -> str:
    """One clause as it is; several numbered."""
    if len(clauses) == 1:
        return clauses[0]
    numbered = "; ".join(f"({k}) {lower(said)}" for k, said in enumerate(clauses, 1))
    return f"{_COUNTED.get(several, several)} things are wrong: {numbered}"


def _agreement(rows: list[Judged], tables: Tables) -> str:
    said = (
        f"The simulation agrees with the data to within its noise: none of {count(len(rows), 'candidate')} was found."
    )
    sizes = _hidden_sizes(filled(tables, "detectable"))
    if not sizes:
        return said
    return printed(f"{said} From these sizes on one would have been (80 %): {', '.join(sizes)}.")


def _hidden_sizes(table: pd.DataFrame | None) -> list[str]:
    """The smallest detectable size of the causes that are asked for first: ``actuator gain 0.021 %``.

    Where it differs from subject to subject, the largest, so that the sentence holds for each.
    """
    if table is None or not table["size"].notna().any():
        return []
    known = table.dropna(subset="size")
    order = [*(cause for cause in _ASKED if (known["cause"] == cause).any()), *known["cause"]]
    return [f"{cause_words(c)} {_worst(known[known['cause'] == c])}" for c in dict.fromkeys(order)][:_SIZES]


def _worst(own: pd.DataFrame) -> str:
    """The largest size of a cause's parameters, unit by unit: ``0.8 um/h or 0.3 arcsec/h``."""
    largest = own.loc[own.groupby("unit", sort=False, dropna=False)["size"].idxmax()]
    told = (plain_size(str(r.parameter), float(r.size), cell(r.unit)) for r in largest.itertuples())
    return " or ".join(dict.fromkeys(told))


def _rivals(found: list[Judged], rows: list[Judged], tables: Tables) -> list[Verdict]:
    """What the data cannot tell from what was found."""
    rivals = [row for row in rows if row.verdict == RIVAL]
    if not rivals or not found:
        return []
    said = [lower(clause(row, tables)) for row in rivals[:_TOLD]]
    more = f", or one of {len(rivals) - _TOLD} more" if len(rivals) > _TOLD else ""
    which = "It" if len(found) == 1 else "Part of it"
    words = f"{which} could as well be that {', or that '.join(said)}{more}: this campaign cannot tell."
    return [("warn", words)]


def lower(sentence: str) -> str:
    """A sentence as it goes on behind a colon."""
    return sentence[:1].lower() + sentence[1:]


def _next(found: list[Judged], tables: Tables) -> list[Verdict]:
    """What to do next, in the words of the first finding: to tell it from its rivals where it has any."""
    asked = sorted((row for row in found if row.then), key=lambda row: _USEFULNESS.get(row.advice_kind, 1))
    if not asked:
        return []
    computed = any(filled(tables, name) is not None for name in ("next_poses", "next_loads"))
    if not computed or not asked[0].in_short:
        return [("next", f"Next: {lower(printed(asked[0].then))}")]
    return [("next", f"Next: {lower(printed(asked[0].in_short))} They stand under What to measure next.")]


def certainty(row: Judged) -> str:
    """How sure a finding is: chance, signal over noise, probability among the candidates, and what it predicts."""
    told = []
    if row.p_value is not None:
        told.append(f"chance alone would show as much in {_share(row.p_value)} campaigns")
    if row.signal_to_noise is not None:
        told.append(f"signal-to-noise {rough(row.signal_to_noise)}")
    if row.probability is not None and not row.is_noise:
        told.append(f"probability among the candidates {_probability(row.probability)}")
    if row.holds:
        told.append(f"with plausible scales tripled the ranking {row.holds}")
    return "; ".join(told)


def _share(p: float) -> str:
    return f"at most {100.0 * p:.2g}{UNBROKEN}% of" if p >= 1e-5 else "less than one of 100,000"


def _probability(p: float) -> str:
    return (
        f"above 99.9{UNBROKEN}%"
        if p > 0.999
        else f"below 0.1{UNBROKEN}%"
        if p < 0.001
        else f"{100.0 * p:.3g}{UNBROKEN}%"
    )


def counted(rows: list[Judged], tables: Tables) -> str:
    """How many candidates were judged, and what became of them; bodies without legs leave no model."""
    rivals, out = (sum(row.verdict == verdict for row in rows) for verdict in (RIVAL, REJECTED))
    accepted = [row for row in accepted_of(rows) if not row.is_noise]
    found, suspected = len(accepted), sum(row.verdict == SUSPECTED for row in accepted)
    causes = [row for row in rows if not row.is_noise]
    judged_words = f"{count(len(causes), 'candidate cause')} judged"
    if not found:
        if short := shortcoming(tables):
            return f"{judged_words}, none found; yet the model does not hold as a whole: {short}."
        if len(causes) == len(rows) and _beyond_noise(rows, tables):
            return f"{judged_words}, none found; yet predictions miss by more than noise, and nothing judged tells why."
        noise = "" if len(causes) == len(rows) else ", which is not as declared"
        return f"{judged_words}, none found: the simulation agrees with the data to within its noise{noise}."
    other = f", {rivals} as good and not to be told from it" if rivals else ""
    into = "modelled in what follows"
    if is_bench(tables) or any(name in tables for name in ("pulls", "axis_errors")):
        into = "accepted into the extended model (model.toml)"
    return (
        f"{judged_words}: {_accepted_words(found - suspected, suspected)} and {into}{other}, {out} rejected. "
        f"Each is held against the others by all that was measured, with every other parameter left free."
    )


def _accepted_words(found: int, suspected: int) -> str:
    told = [f"{found} found"] if found or not suspected else []
    return ", ".join([*told, *([f"{suspected} suspected"] if suspected else [])])
