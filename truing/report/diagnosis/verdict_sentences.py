"""Diagnosis at the head of the page: findings, rivals, and next step."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from truing.belonging.relation import RelationState
from truing.report.chain_corrections import clear_numbers, estimates_zeros
from truing.report.diagnosis.adequacy import noise_compared, shortcoming
from truing.report.diagnosis.assessed_causes import (
    CHANGES,
    HOLDS,
    NOT_TESTABLE,
    REJECTED,
    RIVAL,
    SUSPECTED,
    AssessedCause,
    accepted_of,
    assessed_causes,
    testable_of,
)
from truing.report.diagnosis.effect_units import plain_size
from truing.report.diagnosis.headline import clause, gain, noise_of_row
from truing.report.diagnosis.next_steps import next_steps
from truing.report.numbers import LEAST_PRINTED_P, capitalised, count_text, printed, rough
from truing.report.numbers import listed as listed_shortly
from truing.report.page import Verdict
from truing.report.parameter_names import UNBROKEN
from truing.report.reasons import recorded_readings, why_no_diagnosis
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import Tables, cell, is_bench, table_or_none
from truing.report.wordings.catalogue import cause_words
from truing.schemas.needs import Need
from truing.schemas.verdict import ReasonCode, Relation

# Number of findings, and of causes with their detectable size, in the first line.
_MOST_NAMED, _SIZES = 3, 3
_COUNTED = {2: "Two", 3: "Three"}
# Causes whose detectable size is given first.
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


def diagnosis_verdict(tables: Tables, before: Mapping[str, SectionVerdict]) -> SectionVerdict:
    """Return the verdict on the search for causes: found, suspected, nothing among the tested ones, or not tested."""
    rows = assessed_causes(tables)
    if not rows:
        is_contradictory = "belonging" in before and before["belonging"].state == RelationState.FAILS
        code = ReasonCode.WITHHELD if is_contradictory else ReasonCode.NOT_EVALUATED
        return _diagnosed(RelationState.NOT_TESTED, code, f"Diagnosis not evaluated: {lower(why_no_diagnosis(tables))}")
    accepted = accepted_of(rows)
    effects = [row for row in accepted if not row.is_noise]
    if effects:
        doubted = any(row.verdict == SUSPECTED for row in effects)
        code = ReasonCode.SUSPECTED if doubted else ReasonCode.FOUND
        return _diagnosed(RelationState.ATTENTION, code, _found_words(accepted, tables), len(_distinct(effects)))
    if accepted:
        text = f"{clause(accepted[0], tables)}; otherwise {_nothing_found(rows, tables)}."
        code = ReasonCode.NOTHING_FOUND if accepted[0].is_remainder else ReasonCode.NOISE
        return _diagnosed(RelationState.ATTENTION, code, text)
    if not testable_of(rows):
        text = f"{capitalised(tested_words(rows))}: not tested, because {_nothing_found(rows, tables)}."
        return _diagnosed(RelationState.NOT_TESTED, ReasonCode.NOT_TESTABLE, text)
    adequacy = before.get("adequacy")
    if adequacy is not None and adequacy.state in (RelationState.ATTENTION, RelationState.FAILS):
        text = f"{capitalised(_nothing_found(rows, tables))}, but the residuals are not {noise_compared(tables)}."
        return _diagnosed(RelationState.ATTENTION, ReasonCode.NOTHING_FOUND, text)
    return _diagnosed(RelationState.OK, ReasonCode.AGREES, _agreement(rows, tables))


def _diagnosed(state: RelationState, code: ReasonCode, text: str, causes: int | None = None) -> SectionVerdict:
    number = None if causes is None else float(causes)
    return SectionVerdict("diagnosis", state, code, text, number, None if causes is None else "1")


def simulation_verdict(tables: Tables, _: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict that no simulation was tested; None where one was, or this is unknown."""
    relations = {row.relation for row in assessed_causes(tables)} - {""}
    if not relations or any(Relation(name).is_simulated for name in relations):
        return None
    recorded = recorded_readings(tables)
    if not recorded:
        text = "No simulation was tested, because no readings were recorded to compare with the measured poses."
        return SectionVerdict("simulation", RelationState.NOT_TESTED, ReasonCode.NO_READINGS, text)
    names = listed_shortly(recorded)
    text = f"Not tested: whether the machine moves as its readings say. No [mechanism] relates {names} to the "
    text += f"measured poses. {_bodies_words(assessed_causes(tables), tables)}"
    return SectionVerdict("simulation", RelationState.NOT_TESTED, ReasonCode.NO_MECHANISM, text)


def _bodies_words(rows: list[AssessedCause], tables: Tables) -> str:
    accepted = accepted_of(rows)
    return f"Tested: {tested_words(rows)}; {'see Diagnosis' if accepted else _nothing_found(rows, tables)}."


def diagnosis_details(tables: Tables) -> list[Verdict]:
    """Return the next step behind the diagnosis at the head of the page."""
    rows = assessed_causes(tables)
    return [line for line in _most_urgent_step(rows, tables) if line[1]] if rows else []


def _found_words(causes: list[AssessedCause], tables: Tables) -> str:
    """Return the findings, and the gain by modelling them."""
    effects, noise = [row for row in causes if not row.is_noise], [row for row in causes if row.is_noise]
    brings = gain(causes, tables)
    sure = [row for row in effects if row.verdict != SUSPECTED]
    doubted = [row for row in effects if row.verdict == SUSPECTED]
    several = len(_distinct(sure))
    texts = [_listed(_clauses(sure, tables), several) + _more_findings(sure)] if sure else []
    if doubted:
        names = "; ".join(map(lower, _clauses(doubted, tables)))
        texts.append(f"Suspected, not confirmed: {names}{_more_findings(doubted)}")
    # Larger noise, and inputs that predict residuals, are no further effects.
    other_noise = [row for row in noise if row.verdict != SUSPECTED and not row.is_conditional]
    in_place = [row for row in noise if row.is_conditional]
    if other_noise:
        names = "; ".join(lower(clause(row, tables)) for row in _named(other_noise))
        texts.append(f"{'Also, ' if texts else ''}{names}{_more_findings(other_noise)}")
    texts += [clause(row, tables) for row in in_place[:1]]
    texts += _rivals(causes, assessed_causes(tables), tables)
    modelling = f"Modelling {_modelled_words(_distinct(effects))}"
    return ". ".join([*texts, f"{modelling} {brings}"] if brings else texts) + "."


def _modelled_words(effects: list[AssessedCause]) -> str:
    """Return the effects that the extended model holds, as the object of a sentence after their list."""
    modelled = [row for row in effects if row.in_model]
    if len(modelled) == len(effects):
        return {1: "it", 2: "both"}.get(len(effects), "all of them")
    if all(row.verdict != SUSPECTED for row in modelled):
        return "what was found" if len(modelled) < 2 else f"the {count_text(len(modelled), 'finding')}"
    return "those of them that the extended model holds"


def _distinct(rows: list[AssessedCause]) -> list[AssessedCause]:
    """Return the findings without terms of higher order of another one: one slow drift is one effect."""
    return [row for row in rows if not any(other.has_terms(row) for other in rows)]


def _clauses(rows: list[AssessedCause], tables: Tables) -> list[str]:
    """Return the findings that are written out, each with its terms of higher order."""
    texts = []
    for row in _named(rows):
        sizes = [
            f"{rough(term.largest_motion)} {term.unit}" for term in rows if row.has_terms(term) and term.largest_motion
        ]
        more = f"; its terms of higher order reach {' and '.join(sizes)}" if sizes else ""
        texts.append(printed(f"{clause(row, tables)}{more}"))
    return texts


def _named(rows: list[AssessedCause]) -> list[AssessedCause]:
    """Return the findings that are written out: all, if no more than one would be left."""
    rows = _distinct(rows)
    return rows if len(rows) <= _MOST_NAMED + 1 else rows[:_MOST_NAMED]


def _more_findings(rows: list[AssessedCause]) -> str:
    more = len(_distinct(rows)) - len(_named(rows))
    return f", and {count_text(more, 'further finding')} (see Diagnosis)" if more > 0 else ""


def _nothing_found(rows: list[AssessedCause], tables: Tables) -> str:
    """Return ``none of 9 candidates was found; not testable with these data: measurement scale, sag under gravity``."""
    tested, idle = len(testable_of(rows)), [row for row in rows if row.verdict == NOT_TESTABLE]
    if not tested:
        return f"none of {count_text(len(idle), 'candidate')} is testable with these data"
    estimated = {"joint-offset"} if estimates_zeros(tables) else set()
    names = list(dict.fromkeys(cause_words(row.cause) for row in idle if row.cause not in estimated))
    more = f"; not testable with these data: {listed_shortly(names)}" if names else ""
    return f"none of {count_text(tested, 'candidate')} was found{more}"


# Relations of a search, as the subject of a sentence.
_RELATED = {
    Relation.READINGS_POSES: "actuator readings and measured poses (through the mechanism)",
    Relation.LOADS_READINGS: "loads and readings (through the simulated compliance)",
    Relation.LOADS_SIGNALS: "loads and signals (through the equations of the sensor)",
    Relation.JOINTS_LINKS: "joint readings and measured links (through the kinematics)",
    Relation.COMMANDS_ENCODERS: "commands and encoders of the axis",
    Relation.TARGETS_POSITIONS: "targets and positions of the axis",
    Relation.BODIES_SURVEY: "the shapes of bodies as measured in all poses",
    Relation.RAYS_POINTS: "rays of photographs and the points where they meet",
}


def tested_words(rows: list[AssessedCause]) -> str:
    """Return the tested relations by their two sides; empty where the rows do not name any."""
    return "; ".join(_RELATED[Relation(name)] for name in dict.fromkeys(row.relation for row in rows) if name)


def _listed(clauses: list[str], several: int) -> str:
    """Return one clause as it is, several numbered."""
    if len(clauses) == 1:
        return clauses[0]
    numbered = "; ".join(f"({k}) {lower(text)}" for k, text in enumerate(clauses, 1))
    return f"{_COUNTED.get(several, several)} effects found: {numbered}"


def _agreement(rows: list[AssessedCause], tables: Tables) -> str:
    tested_text = tested_words(rows)
    text = f"{tested_text} agree to within the noise" if tested_text else "the residuals are noise"
    corrected = len(clear_numbers(tables))
    text = (
        f"With {count_text(corrected, 'correction')} to the nominal geometry, {text}"
        if corrected
        else capitalised(text)
    )
    text = f"{text}: {_nothing_found(rows, tables)}."
    sizes = _hidden_sizes(table_or_none(tables, "detectable"))
    if not sizes:
        return text
    return printed(f"{text} Smallest sizes that would have been found (probability 80 %): {', '.join(sizes)}.")


def _hidden_sizes(table: pd.DataFrame | None) -> list[str]:
    """Return the detectable sizes of the most important causes: ``actuator gain 0.021 %``. Where sizes differ between
    subjects, the largest one, so that the sentence holds for each."""
    if table is None or not table["size"].notna().any():
        return []
    known = table.dropna(subset="size")
    order = [*(cause for cause in _ASKED if (known["cause"] == cause).any()), *known["cause"]]
    return [f"{cause_words(c)} {_worst(known[known['cause'] == c])}" for c in dict.fromkeys(order)][:_SIZES]


def _worst(table: pd.DataFrame) -> str:
    """Return the largest size of a cause's parameters, unit by unit: ``0.8 um/h or 0.3 arcsec/h``."""
    largest = table.loc[table.groupby("unit", sort=False, dropna=False)["size"].idxmax()]
    reported = (plain_size(str(r.parameter), float(r.size), cell(r.unit)) for r in largest.itertuples())
    return " or ".join(dict.fromkeys(reported))


def _rivals(causes: list[AssessedCause], rows: list[AssessedCause], tables: Tables) -> list[str]:
    """Return a sentence on the causes that the data cannot distinguish from the findings, without a full stop."""
    rivals = [row for row in rows if row.verdict == RIVAL]
    if not rivals:
        return []
    texts = [lower(clause(row, tables)) for row in rivals[:_MOST_NAMED]]
    more = f", or one of {len(rivals) - _MOST_NAMED} more" if len(rivals) > _MOST_NAMED else ""
    of_which = "" if len(causes) == 1 else " of one of these"
    named = f"{', or '.join(texts)}{more}"
    return [f"Another explanation{of_which}, which this campaign cannot rule out: {named}"]


def lower(sentence: str) -> str:
    """Return a sentence with a lower-case start, to follow a colon."""
    return sentence[:1].lower() + sentence[1:]


def _most_urgent_step(rows: list[AssessedCause], tables: Tables) -> list[Verdict]:
    """Return the aim of the most urgent next step; the section of next measurements has the rest."""
    steps = [step for step in next_steps(rows, tables) if step.need != Need.TESTABLE]
    if not steps:
        return []
    # A known size is no open question: a reader is not sent to the bench for another digit of it.
    aim_text = steps[0].aim_text
    return [("next", f"Optional: {lower(aim_text)}" if steps[0].need == Need.PRECISION else capitalised(aim_text))]


def certainty(row: AssessedCause) -> str:
    """Return the certainty of a finding: p-value, signal-to-noise, probability among the candidates, prediction."""
    reported = []
    if row.p_value is not None:
        reported.append(f"noise alone would show an effect as clear as this in {_share(row.p_value)} campaigns")
    if row.signal_to_noise is not None:
        reported.append(f"signal-to-noise ratio {rough(row.signal_to_noise)}")
    # Odds against its rival say how probable a rival is; its probability is from an earlier round of the search.
    if row.probability is not None and not row.is_noise and row.verdict != RIVAL:
        reported.append(f"probability among the candidates {_probability(row.probability)}")
    ranking = {HOLDS: "is unchanged", CHANGES: "changes"}.get(row.holds)
    unsure = [f"The ranking {ranking} if assumed effect sizes are tripled"] if ranking else []
    return ". ".join([capitalised("; ".join(reported)), *unsure] if reported else unsure)


def _share(p: float) -> str:
    return (
        f"at most {100.0 * p:.2g}{UNBROKEN}% of"
        if p >= LEAST_PRINTED_P
        else f"fewer than 1 of {1.0 / LEAST_PRINTED_P:,.0f}"
    )


def _probability(p: float) -> str:
    return (
        f"above 99.9{UNBROKEN}%"
        if p > 0.999
        else f"below 0.1{UNBROKEN}%"
        if p < 0.001
        else f"{100.0 * p:.3g}{UNBROKEN}%"
    )


def counted(rows: list[AssessedCause], tables: Tables) -> str:
    """Return the number of assessed candidates and their results; bodies without legs have no model."""
    rivals, rejected = (sum(row.verdict == verdict for row in rows) for verdict in (RIVAL, REJECTED))
    untestable, tested_text = (
        sum(row.verdict == NOT_TESTABLE for row in rows),
        tested_words(rows) or "what was measured",
    )
    accepted = [row for row in accepted_of(rows) if not row.is_noise]
    left_out = [row for row in accepted if not row.in_model]
    refuted = len(left_out)
    found_count, suspected = len(accepted) - refuted, sum(row.verdict == SUSPECTED and row.in_model for row in accepted)
    causes = [row for row in rows if not row.is_noise]
    assessed = f"{count_text(len(causes), 'candidate cause')} assessed"
    if not accepted:
        if short := shortcoming(tables):
            idle = f", {untestable} not testable with these data" if untestable else ""
            return f"{assessed}: none found{idle}, but the model does not fit as a whole: {short}."
        noisy = next((row for row in rows if row.is_noise and not row.is_remainder), None)
        noise = f"; the residuals exceed {noise_of_row(noisy)}" if noisy else ""
        return f"{assessed} by comparing {tested_text}: {_nothing_found(rows, tables)}{noise}."
    indistinguishable = f", {rivals} not distinguishable from one of them" if rivals else ""
    unseen = f", {untestable} not testable with these data" if untestable else ""
    into = "included in the results below"
    if is_bench(tables) or any(name in tables for name in ("pulls", "axis_errors")):
        into = "added to the extended model (model.toml)"
    worse = f", {refuted} suspected but not {into} because {_why_left_out(left_out)}" if refuted else ""
    text = f"{_accepted_words(found_count - suspected, suspected)} and {into}" if found_count else "none found"
    return (
        f"{assessed}: {text}{worse}{indistinguishable}, {rejected} rejected{unseen}. "
        f"All causes were compared on the same data, re-estimating every other parameter."
    )


def _why_left_out(rows: list[AssessedCause]) -> str:
    weak = sum(row.reason_code == "weak" for row in rows)
    it = "it" if len(rows) == 1 else "them"
    if not weak:
        return f"predictions are not better with {it}"
    hardly = f"{'it is' if len(rows) == 1 else 'they are'} hardly more probable than no effect"
    return hardly if weak == len(rows) else f"{hardly}, or predictions are not better with {it}"


def _accepted_words(found_count: int, suspected: int) -> str:
    texts = [f"{found_count} found"] if found_count or not suspected else []
    return ", ".join([*texts, *([f"{suspected} suspected"] if suspected else [])])
