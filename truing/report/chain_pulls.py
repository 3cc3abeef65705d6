"""Verdict on the identified numbers of a chain against their tolerances, all together and each by itself."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pandas as pd

from truing.belonging.relation import RelationState
from truing.report.chain_corrections import DEGREES, NAMES
from truing.report.far_numbers import UNLIKELY, FarNumber, far_number
from truing.report.numbers import listed, p_equals, rough, with_uncertainty
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import Row, Tables, table_or_none
from truing.schemas.verdict import ReasonCode

_INFORMED = 0.95  # standard deviation in tolerances below which the data say something about a number


def chain_pulls_verdict(tables: Tables, _: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict on the geometry of a chain against its tolerances; None without tolerances."""
    numbers, sums = table_or_none(tables, "chain_parameters"), table_or_none(tables, "pull_sums")
    if numbers is None or sums is None or not len(sums):
        return None
    last = next(row for row in sums.itertuples() if row.model == "extended")
    if not last.freedom:
        text = "Pulls not tested: the data determine no number of the chain better than its tolerance."
        return SectionVerdict("pulls", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, text)
    size, limit = (math.sqrt(squares / last.freedom) for squares in (last.chi_square, last.upper))
    pulls = f"Pulls of the chain's numbers: rms {rough(size)}; upper limit (95 %) if tolerances are realistic: "
    pulls += f"{rough(limit)} (p {p_equals(last.p_value)})."
    far = far_number(_informed(numbers), "squares")
    is_beyond = last.chi_square > last.upper
    if far is None and not is_beyond:
        text = f"The chain agrees with its description within the tolerances. {pulls}"
        return SectionVerdict("pulls", RelationState.OK, ReasonCode.WITHIN_TOLERANCE, text, size, "1", limit)
    if far is not None:
        text = f"The description does not fit the machine: {_meant(far)} {pulls}"
    else:
        text = "Numbers of the chain are farther from nominal than tolerances allow: tolerances are too small, or a "
        text += f"cause is missing. {pulls}"
    least = min(last.p_value if is_beyond else 1.0, 1.0 if far is None else far.p_value)
    state = RelationState.FAILS if least < UNLIKELY else RelationState.ATTENTION
    return SectionVerdict("pulls", state, ReasonCode.BEYOND_TOLERANCE, text, size, "1", limit)


def _informed(numbers: pd.DataFrame) -> pd.DataFrame:
    """Return the numbers that the data know better than their tolerances, with squared pulls."""
    known = numbers[numbers["pull"].notna() & (numbers["sigma"] < _INFORMED * numbers["tolerance"])]
    return known.assign(squares=known["pull"] ** 2)


def _meant(far: FarNumber) -> str:
    first, *others = map(_other, far.rows)
    text = f"did you mean {first}?"
    return f"{text} Equally likely: {listed(others)}." if others else text


def _other(row: Row) -> str:
    """Return a difference from nominal: ``5.157 ± 0.008 mm more for the shift along z of the frame of elbow``."""
    factor, unit = DEGREES.get(row.unit, (1.0, row.unit))
    size = with_uncertainty(factor * abs(row.identified), factor * row.sigma, unit)
    name = NAMES.get(row.parameter, row.parameter)
    return f"{size} {'more' if row.identified > 0.0 else 'less'} for the {name} of {row.joint}"
