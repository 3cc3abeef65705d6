"""Which loads to apply: load steps from which a sensor's calibration learns most, by the design code of the poses.

As `stages.design`, no stage of a run: a campaign.toml in, a table and words out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.design.pose_order import PoseOrder, order_poses
from truing.estimation.interferometry.recorded_steps import LOADS
from truing.estimation.sensor.load_cases import (
    LoadDesign,
    LoadLimits,
    bench_loads,
    choose_loads,
    corner_loads,
    judge_loads,
    load_rows,
    predicted_sigma,
)
from truing.report.numbers import count as counted
from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.common.reading_arrays import LOAD_COLUMNS, load_steps
from truing.stages.configurations.chosen import DesignWish

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

Array = NDArray[np.float64]

FILE = "campaign.toml"
_RUN = 10  # loads between two readings without load, so that zero and drift of every run are told
_FULL = np.array([1.0])


@dataclass(frozen=True)
class LoadPlan:
    """Chosen loads in the order in which to apply them, how good they are, and beside what.

    sigma (6,): of a signal at the full load of each axis, in sigmas of a signal, for every channel the same; existing:
    the campaign's own loads by the same measure, and one_of: what one chosen load is worth in them.
    """

    wish: DesignWish
    limits: LoadLimits
    chosen: LoadDesign
    candidates: int
    order: PoseOrder
    sigma: Array
    existing: LoadDesign | None
    signal_mv: float | None
    table: pa.Table


def plan_loads(settings: Campaign, wish: DesignWish, tables: Mapping[str, pa.Table]) -> LoadPlan:
    """Choose load steps within [loading], at most ``wish.at_once`` components at a time; raises CampaignFaults.

    tables: what the campaign holds already, to compare with.
    """
    limits = LoadLimits(_limits(settings))
    rng = np.random.default_rng(wish.seed)
    every = wish.at_once >= len(LOADS)
    candidates = corner_loads(limits) if every else bench_loads(limits, _FULL, wish.at_once)
    try:
        chosen = choose_loads(candidates, wish.poses, limits, rng=rng)
    except ValueError as error:
        raise CampaignFaults([Fault("--poses", str(error), value=str(wish.poses))]) from None
    shares = chosen.loads / limits.limits
    regressors = np.stack([load_rows(chosen.loads, limits, zero=False, powers="linear")[:, 0]])
    order = order_poses(shares, np.zeros(len(LOADS)), regressors, rng, wish.trade_off)
    check = _verification(limits, wish, rng)
    return LoadPlan(
        wish,
        limits,
        chosen,
        len(candidates),
        order,
        predicted_sigma(chosen.loads, np.ones(1), limits)[0] * limits.limits,
        _existing(tables, limits),
        settings.noise.signal_mv,
        _table(chosen.loads[order.order], check),
    )


def _limits(settings: Campaign) -> Array:
    missing = [name for name in LOAD_COLUMNS if getattr(settings.loading, name) is None]
    if missing:
        raise CampaignFaults(
            Fault(FILE, "the range of this load, within which to choose", column=f"loading.{name}") for name in missing
        )
    return np.array([getattr(settings.loading, name) for name in LOAD_COLUMNS])


def _verification(limits: LoadLimits, wish: DesignWish, rng: np.random.Generator) -> Array:
    """Loads (V, 6) anywhere within the range, as many components at once as may be."""
    shares = rng.uniform(-1.0, 1.0, (wish.verification, len(LOADS)))
    rank = rng.permuted(np.tile(np.arange(len(LOADS)), (wish.verification, 1)), axis=1)
    return np.where(rank < wish.at_once, shares, 0.0) * limits.limits


def _existing(tables: Mapping[str, pa.Table], limits: LoadLimits) -> LoadDesign | None:
    """The campaign's own calibration loads, all axes at once allowed to what they are held against."""
    held = {name: table for name, table in tables.items() if name in ("signals", "readings")}
    if not held:
        return None
    steps = load_steps({"signals": held["signals"]} if "signals" in held else held)
    loads = steps.load[~steps.held_out]
    return judge_loads(loads, corner_loads(limits), limits) if len(loads) else None


def _table(loads: Array, check: Array) -> pa.Table:
    """Runs of some loads each, without load before and after; times still empty."""
    import pyarrow as pa

    parts: list[Array] = []
    roles: list[str] = []
    runs: list[int] = []
    steps: list[int] = []
    for role, values in (("calibration", loads), ("verification", check)):
        for first in range(0, len(values), _RUN):
            part = np.concatenate([np.zeros((1, 6)), values[first : first + _RUN], np.zeros((1, 6))])
            runs += [len(parts) + 1] * len(part)
            roles += [role] * len(part)
            steps += list(range(len(part)))
            parts.append(part)
    columns: dict[str, object] = {
        "run": pa.array(runs, pa.int64()),
        "step": pa.array(steps, pa.int64()),
        "time_s": pa.nulls(len(runs), pa.float64()),
        "role": pa.array(roles, pa.string()),
    }
    whole = np.round(np.concatenate(parts), 6) + 0.0
    return pa.table(columns | dict(zip(LOAD_COLUMNS, whole.T, strict=True)))


def words_of_loads(plan: LoadPlan) -> list[str]:
    """Return the lines that a plan is told in."""
    wish = plan.wish
    held = f" and {wish.verification} for verification" if wish.verification else ""
    at_once = "all components at once" if wish.at_once >= len(LOADS) else f"at most {wish.at_once} at once"
    spread = [100.0 * one for one in plan.sigma]
    lines = [
        f"{counted(wish.poses, 'load')}{held} within [loading], {at_once}, in runs of {_RUN} that begin "
        "and end without load",
        f"log det of the information about a channel's six sensitivities and its zero: {plan.chosen.log_det:.3f}",
        f"D-efficiency {100.0 * plan.chosen.efficiency:.2f} % of the best possible (equivalence theorem over "
        f"{counted(plan.candidates, 'load')})",
        f"predicted sigma of a signal at full load, in hundredths of its noise{_microvolts(plan)}: "
        + ", ".join(f"{load} {one:.1f}" for load, one in zip(LOADS, spread, strict=True)),
        f"drift: of a line in time, loads can imitate {100.0 * plan.order.drift:.2f} % "
        f"({100.0 * plan.order.random_drift:.2f} % in a random order)",
    ]
    return lines + _words_of_existing(plan)


def _microvolts(plan: LoadPlan) -> str:
    return "" if plan.signal_mv is None else f" of {plan.signal_mv:g} mV"


def _words_of_existing(plan: LoadPlan) -> list[str]:
    own = plan.existing
    if own is None:
        return []
    if own.efficiency == 0.0:
        return [f"the campaign's own {len(own.loads)} loads do not determine a calibration"]
    size = len(LOADS) + 1
    worth = np.exp((plan.chosen.log_det - own.log_det) / size) * len(own.loads) / plan.wish.poses
    return [
        f"the campaign's own {counted(len(own.loads), 'load')}: {100.0 * own.efficiency:.2f} % of the "
        "best of as many, all "
        "components at once",
        f"one chosen load tells as much as {worth:.2f} of the campaign's own",
    ]
