"""Measurements that show why the final model does not hold as a whole: noise, drift or form."""

from __future__ import annotations

from collections.abc import Iterator

from truing.report.diagnosis.adequacy import CAUSES_LEFT, LOOKS_BACK, columns_along, noise_compared, shortcoming_words
from truing.report.diagnosis.assessed_causes import FOUND, SUSPECTED, AssessedCause
from truing.report.section_verdict import verdict_rows
from truing.report.tables import Row, Tables, cell, table_or_none
from truing.report.verdict import with_verdict
from truing.report.wordings.catalogue import WORDINGS, cause_words
from truing.report.wordings.nonparametric_wordings import OF_TIME, columns_words
from truing.schemas.verdict import ReasonCode, Relation

_MOST, _NOISE = 2, "observation-noise"
# Words for one epoch, several, a repeat without any change, and a repeat with its inputs set again.
_POSE = (
    "pose",
    "poses",
    "Measure one pose ten times without moving anything.",
    "Move ten times to one pose, each time from the same side.",
)
_LOAD = (
    "load",
    "loads",
    "Hold one load and read every channel ten times.",
    "Apply one load ten times, each time from zero.",
)
_COMMAND = (
    "command",
    "commands",
    "Read every encoder ten times at one command, without moving.",
    "Send the axis ten times to one command, from the same side.",
)
_APPROACH = (
    "target",
    "targets",
    "Read the instrument ten times at one target, without moving.",
    "Approach one target ten times from the same side.",
)
_EPOCHS = {
    Relation.LOADS_READINGS: _LOAD,
    Relation.LOADS_SIGNALS: _LOAD,
    Relation.COMMANDS_ENCODERS: _COMMAND,
    Relation.TARGETS_POSITIONS: _APPROACH,
}
_IF_NOISE = "If the scatter differs from [noise], correct [noise]. If it agrees, an effect is missing in the model."
_IF_SCATTER = "If the scatter is as small as before, an effect is missing in the model."
# Shortcoming and remedy by reason code, where no test of the model fails.
_OF_VERDICT = {
    ReasonCode.BEYOND_NOISE: ("the errors of predictions exceed the declared noise", _IF_NOISE),
    ReasonCode.UNDETERMINED_THERE: (
        "the fitted poses do not determine the model at the held-out ones",
        "Fit some poses of that region too: with other readings of every joint, above all of the last ones.",
    ),
    ReasonCode.BELOW_NOISE: (
        "the errors of predictions are smaller than the declared noise",
        "Declare the scatter as noise.",
    ),
}


def decisive_measurements(rows: list[AssessedCause], tables: Tables) -> Iterator[tuple[str, str]]:
    """Yield the shortcomings of the final model with a measurement that shows the reason, the worst first."""
    table, verdict = table_or_none(tables, "adequacy"), verdict_rows(with_verdict(tables)).get("adequacy")
    if table is None or verdict is None or not rows:
        return
    epochs = _EPOCHS.get(Relation(rows[0].relation), _POSE) if rows[0].relation else _POSE
    reported: dict[str, str] = {}
    failed = table[table["state"] == "fails"].sort_values("p_value", kind="stable")
    if any(row.is_noise and row.verdict in (FOUND, SUSPECTED) for row in rows):  # its own advice requests repeats
        failed = failed[failed["test"] != _NOISE]
    for row in failed.itertuples():
        reported.setdefault(_decisive_measurement(row, epochs), shortcoming_words(row, noise_compared(tables)))
    if epochs is not _APPROACH and not (table["state"] == "fails").any() and verdict.reason_code in _OF_VERDICT:
        why, then = _OF_VERDICT[verdict.reason_code]
        is_of_noise = verdict.reason_code in (ReasonCode.BEYOND_NOISE, ReasonCode.BELOW_NOISE)
        reported[f"{epochs[2]} {then}" if is_of_noise else then] = why
    for words, why in list(reported.items())[:_MOST]:
        yield why, words


def _decisive_measurement(row: Row, epochs: tuple[str, str, str, str]) -> str:
    """Return the measurement that shows why one test of the final model fails."""
    _, several, again, anew = epochs
    if row.test == CAUSES_LEFT:
        return _of_cause_left(cell(row.left_cause))
    if row.test == _NOISE:
        return f"{again} {_IF_SCATTER if epochs is _APPROACH else _IF_NOISE}"
    if row.test == "input-noise":
        return f"{anew} {_IF_NOISE}"
    if row.test == "pure-error":  # a mean of repeats depends on the command, whatever the noise
        return f"Measure more {several} near those that were repeated: common errors show the missing effect."
    return _revealing_measurement(columns_along(row), several)


def _of_cause_left(cause: str) -> str:
    """Return the measurement for the cause that a limited search would have accepted next, if it is equal for all
    subjects."""
    known = WORDINGS.get(cause)
    if known is not None and isinstance(known.advice, str):
        return f"To test {cause_words(cause)}: {known.advice}"
    return "Measure a small campaign in which one input changes at a time, so that each effect shows separately."


def _revealing_measurement(columns: tuple[str, ...], several: str) -> str:
    """Return the measurement that shows why residuals are correlated along columns."""
    quantities = columns_words(columns)
    if set(columns) <= OF_TIME:
        text = f"Repeat five of the first {several} at the end, and measure the others in random order."
        return f"{text} If the repeats differ, something drifts with time. If not, the errors depend on the {several}."
    if all(LOOKS_BACK.fullmatch(name) for name in columns):
        return (
            f"Measure five {several} twice from each side. Effects of the direction of approach then show separately."
        )
    if any("temperature" in name for name in columns):
        return f"Repeat five {several} at two stable temperatures, with everything else unchanged."
    if len(columns) > 1:
        text = f"Repeat the five {several} with the largest errors on another day."
        return f"{text} If the errors are the same, measure more {several} near them, to find the form of the error."
    return f"Measure at five values of {quantities}, increasing and decreasing, with everything else unchanged."
