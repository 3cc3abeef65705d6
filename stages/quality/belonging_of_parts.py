"""Parts of runs in another unit or with the opposite sign, as tests of the relations that they break."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.belonging.parts_of_runs import Part
from truing.belonging.plausible_slips import Column
from truing.belonging.relation import Slip, SlipKind, State, Tested
from truing.belonging.slip_search import merged

if TYPE_CHECKING:
    from truing.quality.loading import LoadingView


def rows_of_parts(found: Sequence[Part], run: NDArray[np.int64], columns: Container[int]) -> NDArray[np.bool_]:
    """Return the rows (N,) of runs (N,) of which a part of the loads, or of some of the columns, is wrong."""
    return np.isin(run, [one.run for one in found if _concerns(one, columns)])


def of_parts(
    found: Sequence[Part], view: LoadingView, columns: Sequence[Column], first: int, relation: str
) -> Iterator[Tested]:
    """Yield one failed test of a relation, where parts concern its columns (numbers from first) or their loads."""
    mine = [one for one in found if _concerns(one, range(first, first + len(columns)))]
    if mine:
        slips = merged([_slip(one, view, columns, first) for one in mine])
        before, after = (100.0 * max(getattr(one, name) for one in mine) for name in ("before", "after"))
        subject = ", ".join(dict.fromkeys(view.run_name(one.run) for one in mine)) if len(mine) <= 3 else ""
        sizes = (before, after, None, "% of the range")
        yield Tested(relation, State.FAILS, "slip", subject, *sizes, slips, tried=len(mine))


def _concerns(part: Part, columns: Container[int]) -> bool:
    return not part.columns or any(column in columns for column in part.columns)


def _slip(part: Part, view: LoadingView, columns: Sequence[Column], first: int) -> Slip:
    own = [columns[place - first] for place in part.columns]
    quantity = own[0].quantity if own else "load"
    every = len(own) == sum(column.quantity == quantity for column in columns)
    names = () if every and len(own) > 1 else tuple(column.name for column in own)
    kind = SlipKind.SIGN if part.factor == -1.0 else SlipKind.UNIT
    slip = Slip(kind, quantity, (*names, _where(part, view)))
    return slip if kind == SlipKind.SIGN else replace(slip, factor=part.factor)


def _where(part: Part, view: LoadingView) -> str:
    """The run and the part of it, in words."""
    run, step = view.run_name(part.run), view.steps.step[part.rows]
    if part.sign:
        return f"{run} at {'negative' if part.sign < 0 else 'positive'} loads"
    return f"{run} up to step {step[-1]}" if part.first else f"{run} from step {step[0]} on"
