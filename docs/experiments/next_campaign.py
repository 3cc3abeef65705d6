"""Tables of docs/next-campaign.md: two campaigns of one machine, the second started from the first.

    python -m docs.experiments.next_campaign

draws machines, measures each twice with the generator of the blind tests, changes parts of some in between, and renews
the tables of the page.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docs.experiments.marked_tables import renew, table
from tests.blind.generator.effects import ActuatorGain, Effect
from tests.blind.generator.layout import Geometry
from tests.stages.two_campaigns import fitted, gathered, longer, measured, model_text
from truing.simulation.mechanisms.causes.drive import ActuatorGain as Gain
from truing.simulation.mechanisms.extended_model import identified_geometry
from truing.stages.diagnosis.prior_campaign import changes_table, started

PAGE = Path(__file__).resolve().parents[1] / "next-campaign.md"
MACHINES = 8
LEG, GAIN = 3, 0.02


@dataclass(frozen=True)
class Case:
    """Change of the machine between its campaigns, and the numbers of which one has to be named."""

    name: str
    expected: frozenset[str]
    change: Callable[[Geometry], Geometry] | None = None
    mended: bool = False


CASES = (
    Case("nothing", frozenset()),
    Case("leg 5 longer by 20 µm", frozenset({"l5", "a_z5"}), longer(5, 0.02)),
    Case("leg 5 longer by 150 µm", frozenset({"l5", "a_z5"}), longer(5, 0.15)),
    Case(f"actuator {LEG}, {100 * GAIN:g} % too far, mended", frozenset({f"gain{LEG}"}), mended=True),
)


@dataclass(frozen=True)
class Pair:
    """Results of a pair of campaigns: the rows of changes.parquet, and the sigmas of the geometry alone and of both."""

    rows: list[dict[str, Any]]
    alone: NDArray
    both: NDArray

    @property
    def named(self) -> list[set[str]]:
        """Reported changes: each number with those that would explain as much in its place."""
        changed = [row for row in self.rows if row["changed"]]
        return [{f"{row['parameter']}{row['leg'] or ''}", *(row["instead"] or "").split()} for row in changed]

    def names(self, case: Case) -> bool:
        """True if the true change of the machine is reported."""
        return any(one & case.expected for one in self.named) if case.expected else not self.named

    def errs(self, case: Case) -> bool:
        """True if a false change is reported."""
        return any(not one & case.expected for one in self.named)


def _effects(wrong: bool) -> list[Effect]:
    return [ActuatorGain(GAIN * (np.arange(6) == LEG - 1))] if wrong else []


def _sigma(stand: Any) -> NDArray:
    return identified_geometry(stand.model, stand.fit.shared, stand.covariance()).sigma


@cache
def pairs(case: Case) -> tuple[Pair, ...]:
    """All machines of a case, each measured twice."""
    return tuple(measured_twice(case, machine) for machine in range(1, MACHINES + 1))


def measured_twice(case: Case, machine: int) -> Pair:
    """One machine of a case."""
    with tempfile.TemporaryDirectory() as home:
        return _pair(case, machine, Path(home))


def _pair(case: Case, machine: int, home: Path) -> Pair:
    own = Gain((LEG,))
    first = fitted(gathered(measured(home, 1, _effects(True), machine=machine)), own)
    second = gathered(measured(home, 2, _effects(not case.mended), case.change, machine=machine))
    stand = fitted(started(second, model_text(first, "first"), 0))
    return Pair(changes_table(stand).to_pylist(), _sigma(fitted(second, own)), _sigma(stand))


def changes() -> str:
    """The table of what was named."""
    rows = []
    for case in CASES:
        found = pairs(case)
        right, wrong = sum(pair.names(case) for pair in found), sum(pair.errs(case) for pair in found)
        others = [len(one) - 1 for pair in found for one in pair.named if one & case.expected]
        rows.append([case.name, str(len(found)), str(right), str(wrong), f"{np.median(others):g}" if others else ""])
    heads = ["between the campaigns", "machines", "named", "something else named", "others that explain as much"]
    return table(heads, rows)


def gain() -> str:
    """The table of what both campaigns know together."""
    found = pairs(CASES[0])
    ratio = np.stack([pair.both / pair.alone for pair in found])
    z = np.array([row["z"] for pair in found for row in pair.rows if row["z"] is not None])
    rows = [
        [
            "sigma with both campaigns over sigma with the second alone, median of the geometry",
            f"{np.median(ratio):.2f}",
        ],
        ["the same, smallest", f"{ratio.min():.2f}"],
        ["rms of z where nothing has changed (1 where sigmas are honest)", f"{np.sqrt(np.mean(z**2)):.2f}"],
    ]
    return table(["", ""], rows)


if __name__ == "__main__":
    renew(PAGE, {"gain": gain, "changes": changes})
