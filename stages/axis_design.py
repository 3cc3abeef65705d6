"""Choice of targets for an axis, with the detectable sizes of the plan and of the campaign's own rows.

Like `stages.design` no stage of a run: tables in, tables and numbers out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array
from truing.calibration.axis_design import (
    candidate_targets,
    choose_targets,
    lattice_step,
    row_information,
    target_rows,
    targets_within,
    visited,
    with_periods,
)
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.axis.causes import AxisCause
from truing.simulation.axis.model import AxisModel
from truing.simulation.axis.rows import AxisRows
from truing.simulation.detection_trials import curve, questions
from truing.stages.common.axis_columns import (
    SI,
    AxisColumns,
    columns_of,
    command_sigma,
    encoder_sigma,
    planned_readings,
)
from truing.stages.common.evaluable_axis_stages import is_held_out
from truing.stages.common.missing_data import HELD_OUT
from truing.stages.configurations.axis_targets import AxisDesign, AxisDesignTables
from truing.stages.configurations.tables import first_number
from truing.stages.simulated_campaigns.tables import sizes_table

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import AxisMechanism
    from truing.stages.configurations.chosen import DesignOptions

FILE = "campaign.toml"
# Causes that targets can show; the others depend on time, temperature or motion.
OF_TARGETS = ("scale-error", "lost-motion", "periodic-error")
# Cycles and targets that ISO 230-2 asks for, as far as the readings allow.
_CYCLES, _TARGETS = 5, 5


def design_axis(settings: Campaign, options: DesignOptions, tables: AxisDesignTables) -> AxisDesign:
    """Choose targets of an axis, visited in cycles from both sides; raises CampaignFaults."""
    _check(options)
    rng = np.random.default_rng(options.seed)
    section = cast("AxisMechanism", settings.mechanism)
    columns = AxisColumns.of(section, [])
    own_rows = None if tables.own is None else planned_readings(tables.own, settings)
    commands = np.zeros(0) if own_rows is None else columns_of(settings, own_rows).commands(own_rows)
    low, high = _travel(section, commands)
    cycles = options.cycles or max((c for c in range(1, _CYCLES + 1) if _fits(options.poses, c)), default=1)
    count = targets_within(options.poses, cycles)
    if count < _TARGETS:
        least = len(visited(np.zeros(_TARGETS), cycles, low, high))
        expected = f"at least {least} readings: {_TARGETS} targets from both sides in {cycles} cycles, with turns"
        raise CampaignFaults([Fault("--poses", expected, value=str(options.poses))])
    positions = candidate_targets(low, high, count, rng)
    model, sigma = _model(settings, columns, visited(positions, 1, low, high))
    effects = with_periods(_causes(model, options.causes), high - low, count)
    even = np.linspace(positions[0], positions[-1], count)
    kept_information = (
        None if tables.extend is None else _information(tables, columns, settings, (model, sigma), effects)
    )
    chosen = choose_targets(
        target_rows(model, sigma, positions, effects),
        target_rows(model, sigma, even, effects),
        kept_information,
        rng,
        is_random=options.method == "random",
    )
    targets = positions[chosen.chosen]
    held_out = _held_out(positions, targets, (options.verification + 1) // 2)
    command, roles = _in_cycles(targets, held_out, cycles, (low, high))
    table = _plan_table(command, roles, columns, first_number(tables.extend))
    unit = SI[section.unit]
    step, own_step = lattice_step(targets), lattice_step(commands)
    return AxisDesign(
        options=options,
        unit=section.unit,
        table=table.drop_columns(["time_s"]),
        cycles=cycles,
        travel=(low / unit, high / unit),
        targets=targets / unit,
        even_step=float(np.ptp(targets)) / (count - 1) / unit,
        chosen=chosen,
        kept=0 if tables.extend is None else len(tables.extend),
        step=None if step is None else step / unit,
        sizes=sizes_of(settings, planned_readings(table, settings), options),
        own_rows=len(commands),
        own_step=None if own_step is None else own_step / unit,
        own_sizes=None if own_rows is None else sizes_of(settings, own_rows, options),
    )


def sizes_of(settings: Campaign, table: pa.Table, options: DesignOptions) -> pa.Table | None:
    """Return the size of every effect that theory expects these rows to show, as in `truing power`; None if they allow
    no diagnosis."""
    from truing.stages.diagnosis.search import assembled_data
    from truing.stages.power import axis_plan_of, expected_sights, searched_causes

    try:
        plan = axis_plan_of({"configurations": table}, settings)
        data = assembled_data(plan.drawn((), np.random.default_rng(options.seed)), settings)
    except ValueError:
        return None
    asked = questions(plan, expected_sights(plan, data, settings), (), searched_causes(plan, settings)[0].values())
    return sizes_table([curve(question, index, []) for index, question in enumerate(asked)])


def _check(options: DesignOptions) -> None:
    """Raise CampaignFaults for options that axes do not have."""
    faults = []
    if options.method not in ("exchange", "random"):
        faults.append(Fault("--method", "exchange or random: targets are chosen from candidates", value=options.method))
    if options.parameters:
        faults.append(Fault("--parameters", "no parameters of legs", value=" ".join(options.parameters)))
    expected = f"causes that targets of an axis can show: {', '.join(OF_TARGETS)}"
    faults += [Fault("--causes", expected, value=name) for name in options.causes if name not in OF_TARGETS]
    if faults:
        raise CampaignFaults(faults)


def _fits(readings: int, cycles: int) -> bool:
    return targets_within(readings, cycles) >= _TARGETS


def _travel(section: AxisMechanism, commands: Array) -> tuple[float, float]:
    """Return the lowest and highest command, rad or m; raises CampaignFaults if nothing says them."""
    if section.travel is not None:
        low, high = (value * SI[section.unit] for value in section.travel)
        return low, high
    known = commands[np.isfinite(commands)]
    if not len(known) or not np.ptp(known) > 0.0:
        expected = "the lowest and the highest command, [low, high], or commands in configurations.csv"
        raise CampaignFaults([Fault(FILE, expected, column=f"mechanism.travel_{section.unit}")])
    return float(known.min()), float(known.max())


def _model(settings: Campaign, columns: AxisColumns, command: Array) -> tuple[AxisModel, NDArray]:
    """Return the plain model at commands (N,), and the noise (K,) of its encoders; raises CampaignFaults without it."""
    from truing.stages.diagnosis.search import assembled_data

    table = planned_readings(_plan_table(command, ["calibration"] * len(command), columns, 1), settings)
    names = list(columns_of(settings, table).encoders)
    sigma = [encoder_sigma(settings, name) for name in names]
    missing = [
        f"noise.{name}_{columns.unit}"
        for name, sigma_of_encoder in zip(names, sigma, strict=True)
        if sigma_of_encoder is None
    ]
    if missing or not names:
        expected = "one standard deviation of the instrument"
        raise CampaignFaults(
            Fault(FILE, expected, column=name) for name in missing or [f"noise.measured_{columns.unit}"]
        )
    try:
        data = assembled_data({"configurations": table}, settings)
    except ValueError as why:
        raise CampaignFaults([Fault(FILE, f"rows of an axis that can be evaluated: {why}")]) from None
    return data.model, np.array(sigma, float)


def _causes(model: AxisModel, names: Sequence[str]) -> list[AxisCause]:
    """Return the causes that targets shall show, at the first element to which the encoders respond; raises
    CampaignFaults without any."""
    from truing.simulation.catalogue import OF_TYPES

    kinds = OF_TYPES["axis"]()
    axis_causes = list[AxisCause]()
    for name in names or OF_TARGETS:
        kind = kinds[name]
        assert isinstance(kind, AxisCause)
        candidates = list(model.scene.candidates(kind))
        axis_causes += [cause for cause in candidates if cause.subject == candidates[0].subject]
    if not axis_causes:
        expected = "an encoder outside the loop, or an outside instrument: the encoder in the loop follows the command"
        raise CampaignFaults([Fault(FILE, expected, column="mechanism.loop")])
    return axis_causes


def _information(
    tables: AxisDesignTables,
    columns: AxisColumns,
    settings: Campaign,
    known: tuple[AxisModel, NDArray],
    effects: Sequence[Sequence[AxisCause]],
) -> NDArray:
    """Return the information (L, q, q) of the rows that are kept; raises CampaignFaults for faulty ones."""
    table = tables.extend
    assert table is not None
    if columns.command not in table.column_names:
        raise CampaignFaults([Fault(tables.extend_file, "a column of that name", column=columns.command)])
    command = columns.si(table, columns.command)
    if not len(command) or not np.isfinite(command).all():
        raise CampaignFaults([Fault(tables.extend_file, "a command in every row", column=columns.command)])
    least = columns.axis(command_sigma(settings)).least_move
    rows = AxisRows.of(range(len(command)), np.arange(float(len(command))), command, least)
    if "role" in table.column_names:
        rows = rows.subset(~is_held_out(table))
    return row_information(*known, rows, effects)


def _held_out(positions: Array, targets: Array, count: int) -> Array:
    """Return candidates far from the targets and from each other."""
    distance, held_out = np.abs(positions[:, None] - targets).min(1), list[float]()
    for _ in range(min(count, len(positions) - len(targets))):
        held_out.append(float(positions[np.argmax(distance)]))
        distance = np.minimum(distance, np.abs(positions - held_out[-1]))
    return np.sort(np.array(held_out))


def _in_cycles(targets: Array, held_out: Array, cycles: int, ends: tuple[float, float]) -> tuple[Array, list[str]]:
    """Return commands and roles: cycles through the targets, then one through those for verification."""
    command = visited(targets, cycles, *ends)
    roles = ["calibration"] * len(command)
    if len(held_out):
        check = visited(held_out, 1, *ends)
        command, roles = np.concatenate([command, check]), roles + [HELD_OUT] * len(check)
    return command, roles


def _plan_table(command: Array, roles: list[str], columns: AxisColumns, first: int) -> pa.Table:
    """Return rows at commands (N,), rad or m, numbered from ``first``, with their order as times."""
    pose_columns = {
        "pose": np.arange(len(command)) + first,
        "role": pa.array(roles),
        "time_s": np.arange(float(len(command))),
    }
    return pa.table(pose_columns | {columns.command: np.round(columns.recorded(columns.command, command), 9)})
