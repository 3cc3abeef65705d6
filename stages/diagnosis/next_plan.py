"""A plan of what to measure next: candidates chosen for a purpose, in words and as rows of a table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from truing.estimation.design.rival_design import Candidates, Choice, Fitted
from truing.report.wordings.claim import Advice, AdviceKind
from truing.schemas.artifacts import ARTIFACTS

if TYPE_CHECKING:
    import pyarrow as pa

_TOLD = 4  # as many as a sentence holds


class Options(Protocol):
    """Candidates for what to measure next, and what each is called."""

    what: ClassVar[tuple[str, str]]  # what one is, and several
    unit: ClassVar[str]  # what they are counted in
    do: ClassVar[str]
    between: ClassVar[str]  # of several in a sentence

    def seen(self, fitted: Fitted) -> Candidates:
        """Return the candidates as a fitted model sees them."""

    def named(self, k: int) -> str:
        """Return a candidate in words."""

    def rows(self, k: int) -> list[dict[str, Any]]:
        """Return a candidate as rows of its table, which hold what is asked for."""


# What could be measured next to judge some fitted models by.
Reach = Callable[[Sequence[Fitted]], Options]


@dataclass(frozen=True)
class Plan:
    """Candidates chosen for a purpose, what each adds, and what all of them give, in words."""

    purpose: str
    options: Options
    choice: Choice
    expected: tuple[str, ...]
    given: str
    least: float = 0.0  # of the choice's value, to be worth measuring

    @property
    def leads(self) -> bool:
        """Return whether they lead to anything at all."""
        return self.choice.times is not None or self.choice.final >= self.least

    @property
    def effort(self) -> float:
        """Return the number of poses or runs to measure; infinite where no number gives what is wanted."""
        return np.inf if self.choice.times is None else float(self.choice.times * len(self.choice.chosen))

    def advice(self, kind: AdviceKind, aim: str) -> Advice:
        """Return what to measure for an aim ("To ..."), and what it gives; in short without the candidates' names."""
        count, places = len(self.choice.chosen), dict.fromkeys(self.choice.chosen)
        again = "" if self.choice.times in (1, None) else f", {self.choice.times} times each"
        named = self.options.between.join(self.options.named(k) for k in list(places)[:_TOLD])
        more = f"{self.options.between}.." if len(places) > _TOLD else ""
        one, several = self.options.what
        what = f"this {one}" if count == 1 else f"these {count} {several}"
        said = f"{aim}, {self.options.do} {what}{again}"
        return Advice(kind, f"{said} ({named}{more}): {self.given}.", f"{said}: {self.given}.")


def plan_table(artifact: str, plans: Sequence[Plan]) -> pa.Table:
    """Return the candidates of all plans that lead somewhere, in the order of a round."""
    import pyarrow as pa

    rows = [row for plan in plans if plan.leads for row in _rows(plan)]
    present = tuple(dict.fromkeys(name for row in rows for name in row))
    return pa.Table.from_pylist(rows, schema=ARTIFACTS[artifact].arrow_schema(present=present))


def _rows(plan: Plan) -> list[dict[str, Any]]:
    """Return the rows of a plan, each with the number of the pose or run that it belongs to."""
    return [
        {"purpose": plan.purpose, plan.options.unit: n, "times": plan.choice.times, **row, "expected": expected}
        for n, (k, expected) in enumerate(zip(plan.choice.chosen, plan.expected, strict=True), 1)
        for row in plan.options.rows(k)
    ]
