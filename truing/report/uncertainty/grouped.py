"""Budgets of results that are alike, put together: a component of all poses, a number of all legs."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

_OF_LEG, _NUMBERED = re.compile(r" of leg \d+$"), re.compile(r"_\d+$|(?<=^K)\d+(_\d+)?$")


@dataclass(frozen=True)
class Grouped:
    """Groups of results by name, sources in the order of their weight; by (group, source): rms contribution, share."""

    names: tuple[str, ...]
    sources: tuple[str, ...]
    typical: dict[tuple[str, str], float]
    share: dict[tuple[str, str], float]
    unit: dict[str, str]
    evaluation: dict[str, str]
    distribution: dict[str, str]
    dof: dict[str, float]
    several: bool


def group_of(result: str, quantity: str) -> str:
    """``a_x`` for ``a_x of leg 3``, ``K`` for ``K12``, ``fx`` of a matrix for ``fx per v2``."""
    if result in ("G_B", "compliance"):
        return quantity.partition(" per ")[0] if result == "G_B" else quantity
    return _NUMBERED.sub("", _OF_LEG.sub("", quantity))


def grouped(stated: pd.DataFrame, budget: pd.DataFrame) -> Grouped:
    """Budgets of one kind of result by group; a share is that of the group's summed variance."""
    result = str(stated["result"].iloc[0])
    rows = budget.assign(
        group=[group_of(result, quantity) for quantity in budget["quantity"]], squares=budget["contribution"] ** 2
    )
    names = tuple(dict.fromkeys(rows["group"]))
    size = Counter(group_of(result, quantity) for quantity in stated["quantity"])
    squares = rows.groupby(["group", "input_source"])["squares"].sum()
    total = rows.groupby("group")["squares"].sum()
    sources = _by_weight(rows)
    places = [(name, source) for name in names for source in sources]
    told = {place: float(squares.get(place, 0.0)) for place in places}
    first = rows.drop_duplicates("input_source").set_index("input_source")
    return Grouped(
        names,
        sources,
        {place: (told[place] / size[place[0]]) ** 0.5 for place in places},
        {place: told[place] / total[place[0]] if total[place[0]] > 0.0 else 0.0 for place in places},
        {name: str(rows.loc[rows["group"] == name, "unit"].iloc[0] or "") for name in names},
        {source: str(first.loc[source, "evaluation"]) for source in sources},
        {source: str(first.loc[source, "distribution"]) for source in sources},
        {source: float(first.loc[source, "degrees_of_freedom"]) for source in sources},
        max(size[name] for name in names) > 1,
    )


def _by_weight(rows: pd.DataFrame) -> tuple[str, ...]:
    """Sources by their mean share, the largest first."""
    shares = rows.groupby("input_source", sort=False)["share_of_variance"].sum()
    return tuple(shares.sort_values(ascending=False, kind="stable").index)
