"""Where to measure: configurations from which a calibration learns most, in the order in which to measure them.

Not a stage of a run, for it comes before there is anything to run: tables in, a table and words out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from truing.calibration.configuration_search import bounded, choose, verification
from truing.calibration.design_problem import DesignProblem
from truing.estimation.design.pose_order import PoseOrder, order_poses
from truing.estimation.design.pose_selection import information_of
from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.common.point_arrays import number_column
from truing.stages.configurations.chosen import Design, DesignWish, Judged
from truing.stages.configurations.problem import design_problem, limits_of

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign
    from truing.simulation.mechanisms.pose_regressors import Placed

_T = TypeVar("_T")


@dataclass(frozen=True)
class DesignTables:
    """What there is beside campaign.toml; each may be absent. ``extend``: poses to keep; ``existing``: to compare."""

    extend: pa.Table | None = None
    extend_file: str = "--extend"
    avoid: pa.Table | None = None
    avoid_file: str = "--avoid"
    existing: pa.Table | None = None
    survey: pa.Table | None = None


def design(settings: Campaign, wish: DesignWish, tables: DesignTables) -> Design:
    """Return configurations for a calibration and how far they are from the best; raises CampaignFaults."""
    limits = limits_of(settings, pose_too=wish.within == "workspace", avoid=tables.avoid, avoid_file=tables.avoid_file)
    kept_rho = None if tables.extend is None else readings_of(tables.extend, limits.readings.size, tables.extend_file)
    if kept_rho is not None and not len(kept_rho):
        raise CampaignFaults([Fault(tables.extend_file, "poses to keep, that are not for verification")])
    measured = wish.poses + (0 if kept_rho is None else len(kept_rho))
    problem = _with_room(tables.avoid_file, lambda: design_problem(settings, limits, wish.parameters, tables.survey))
    _check_wish(problem, measured)
    kept = None if kept_rho is None else _judged(problem, kept_rho, tables.extend_file)
    rng = np.random.default_rng(wish.seed)
    given = None if kept is None else kept.information
    candidates = _with_room(tables.avoid_file, lambda: bounded(problem, wish.poses, given, rng))
    x = choose(problem, candidates, wish.method, wish.poses, given, rng)
    whole = Judged(measured, information_of(problem.rows_at(x), given), 0 if kept is None else kept.outside)
    existing = _existing(problem, tables.existing)
    try:
        check = verification(problem, x, wish.verification, rng)
    except ValueError as error:
        raise CampaignFaults([Fault("--verification", str(error), value=str(wish.verification))]) from None
    placed = problem.regressors.at(np.concatenate([x, check]))
    order = _ordered(problem, placed, wish, kept_rho, rng)
    rest = problem.regressors.machine.legs.rho0 if _starts_at_rest(problem, tables.extend) else None
    table = _table(placed.rho, order, rest, wish, tables.extend)
    return Design(problem, wish, placed, whole, kept, existing, candidates, order, table)


def _with_room(avoid_file: str, make: Callable[[], _T]) -> _T:
    """Return what is made, the fault being the table of forbidden regions where they leave no room for it."""
    try:
        return make()
    except ValueError as error:
        raise CampaignFaults([Fault(avoid_file, str(error))]) from None


def _check_wish(problem: DesignProblem, measured: int) -> None:
    least = len(problem.names)
    if measured < least:
        expected = f"at least {least} configurations, one for each parameter of a leg"
        raise CampaignFaults([Fault("--poses", expected, value=str(measured))])


def readings_of(table: pa.Table, legs: int, file: str, role: str = "verification") -> NDArray:
    """Return the readings (N, L), m, of all poses but those of a role; raises CampaignFaults where they are none."""
    import pyarrow as pa
    import pyarrow.compute as pc

    names = [f"rho{leg + 1}_mm" for leg in range(legs)]
    missing = [name for name in names if name not in table.schema.names]
    if missing:
        raise CampaignFaults(Fault(file, "a column of that name", column=name) for name in missing)
    if "role" in table.schema.names:
        table = table.filter(pc.fill_null(pc.not_equal(table.column("role").cast(pa.string()), role), True))
    try:
        values = np.column_stack([number_column(table, name) for name in names]) * 1e-3
    except ValueError:
        raise CampaignFaults([Fault(file, "numbers", column="rho1_mm ..")]) from None
    if not np.isfinite(values).all():
        raise CampaignFaults([Fault(file, "a reading of every actuator in every pose")])
    return values


def _judged(problem: DesignProblem, rho: NDArray, file: str) -> Judged:
    try:
        placed = problem.placed_at(rho)
    except ValueError as error:
        raise CampaignFaults([Fault(file, str(error))]) from None
    # A hundredth beyond a limit is the actuator's noise, not another range.
    outside = problem.region.excess(problem.regressors.coordinates(placed)) > 1.01
    return Judged(len(rho), information_of(problem.rows(placed)), int(outside.sum()))


def _existing(problem: DesignProblem, table: pa.Table | None) -> Judged | None:
    """Return the campaign's own calibration poses as judged by the same measure; None where they cannot be."""
    if table is None:
        return None
    try:
        rho = readings_of(table, problem.legs, "configurations")
        return _judged(problem, rho, "configurations") if len(rho) >= len(problem.names) else None
    except CampaignFaults:
        return None


def _ordered(
    problem: DesignProblem, placed: Placed, wish: DesignWish, kept_rho: NDArray | None, rng: np.random.Generator
) -> PoseOrder:
    """Return the order, time being kept apart from every leg's regressors and from the drives."""
    rho0 = problem.regressors.machine.legs.rho0
    legs = np.moveaxis(problem.rows(placed), 1, 0)
    drives = placed.rho - rho0
    size = max(legs.shape[-1], problem.legs)
    groups = [*legs, drives]
    padded = np.stack([np.pad(group, ((0, 0), (0, size - group.shape[-1]))) for group in groups])
    start = rho0 if kept_rho is None else kept_rho[-1]
    return order_poses(placed.rho, start, padded, rng, wish.trade_off)


def _starts_at_rest(problem: DesignProblem, extend: pa.Table | None) -> bool:
    """Return whether the set begins at the reference: a new one does, unless that is forbidden."""
    return extend is None and bool(problem.region.allowed(np.zeros((1, 6)))[0])


def _table(rho: NDArray, order: PoseOrder, rest: NDArray | None, wish: DesignWish, extend: pa.Table | None) -> pa.Table:
    """Return the configurations in the order of measurement, times still empty, after ``rest`` (L,) where given."""
    import pyarrow as pa

    roles = np.repeat(["calibration", "verification"], [wish.poses, wish.verification])[order.order].tolist()
    values, first = rho[order.order], _first_number(extend)
    if rest is not None:
        roles, values, first = ["reference", *roles], np.concatenate([rest[None], values]), 0
    columns: dict[str, object] = {
        "pose": pa.array(np.arange(len(values)) + first),
        "role": pa.array(roles, pa.string()),
        "time_s": pa.nulls(len(values), pa.float64()),
    }
    return pa.table(columns | {f"rho{i + 1}_mm": np.round(column * 1e3, 6) for i, column in enumerate(values.T)})


def _first_number(extend: pa.Table | None) -> int:
    """Return the first free number of a pose."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if extend is None or "pose" not in extend.schema.names or not pa.types.is_integer(extend.schema.field("pose").type):
        return 1
    return int(pc.max(extend.column("pose")).as_py() or 0) + 1
