"""Choice of loads that show given causes best.

Like `stages.load_design` no stage of a run: tables in, a table and sentences out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from truing.inference.fitter import Fitter
from truing.stages.diagnosis.next_loads import next_run, possible_runs
from truing.stages.diagnosis.next_measurement import plan_table, planned
from truing.stages.diagnosis.search import assembled_data, kinds_of
from truing.stages.power import reading_plan_of

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign
    from truing.simulation.cause import Cause


@dataclass(frozen=True)
class CauseLoads:
    """Runs of loads as rows of next_loads.parquet, and one sentence per cause and subject."""

    table: pa.Table
    sentences: tuple[str, ...]


def loads_for_causes(
    tables: Mapping[str, pa.Table], settings: Campaign, wanted: Sequence[str], *, measured: bool, seed: int
) -> CauseLoads:
    """Choose runs that halve the uncertainty of each wanted cause, in addition to the load steps of the tables.

    measured: whether these contain readings, or are a plan to be simulated first. Raises ValueError with the reason if
    the campaign cannot be simulated.
    """
    drawn = dict(tables) if measured else reading_plan_of(tables, settings).drawn((), np.random.default_rng(seed))
    data = assembled_data(drawn, settings)
    fitter = Fitter(data.model, data.calibration, data.held_out, settings.diagnosis.seed)
    plain = fitter.prepared(data.given)
    known = kinds_of(settings)
    causes = [member for name in wanted for member in _members(plain.scene.candidates(known[name]))]
    fits = [(cause, next_run(fitter.fitted((*data.given, cause), plain))) for cause in causes]
    plans, advice = planned(partial(possible_runs, settings, plain), fits, (), least_known=True)
    texts = [f"{cause.id} {cause.subject}".strip() + f": {advice[cause.key].words}" for cause in causes]
    return CauseLoads(plan_table("next_loads", plans), tuple(texts))


def _members(candidates: Iterable[Cause]) -> Iterator[Cause]:
    """Yield one cause per possible subject of a kind, with the middle one of its forms; none of a single run, because
    new runs cannot show it."""
    by_subject: dict[str, list[Cause]] = {}
    for cause in candidates:
        by_subject.setdefault(cause.subject, []).append(cause)
    for forms in by_subject.values():
        middle = forms[len(forms) // 2]
        if middle.settings().get("run", "") == "":
            yield middle
