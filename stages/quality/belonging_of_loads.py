"""Do the loads, readings and signals of a loading campaign belong together?"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.belonging import loads_of_readings, signals_of_loads
from truing.belonging.copied_rows import Values, copied_runs, equal_columns
from truing.belonging.frozen_values import Frozen, frozen, stood_still
from truing.belonging.parts_of_runs import Part, parts
from truing.belonging.plausible_slips import Column
from truing.belonging.relation import (
    DISPLACEMENT_UNITS,
    FRINGE_SHARES,
    ROTATION_UNITS,
    SIGNAL_FACTORS,
    Slip,
    SlipKind,
    State,
    Tested,
)
from truing.belonging.row_order import can_reverse, row_slips
from truing.belonging.signals_of_loads import Recorded
from truing.estimation.interferometry.recorded_steps import CHANNELS, READING_SI
from truing.schemas.interferometer import LINEAR
from truing.stages.common.declared_optics import channel_rows
from truing.stages.common.reading_arrays import LOAD_COLUMNS
from truing.stages.quality.belonging_of_parts import of_parts, rows_of_parts
from truing.stages.quality.loading_checks import simulated_compliance

if TYPE_CHECKING:
    from truing.quality.loading import LoadingView
    from truing.schemas.campaign import Campaign
    from truing.schemas.sensor_mechanism import SensorMechanism

Array = NDArray[np.float64]

_MILLIVOLT = 1e-3
_SAME_SIZE = 1e-9  # of the logarithm of a factor


def relations_of_loads(view: LoadingView, tables: Mapping[str, pa.Table], settings: Campaign) -> tuple[Tested, ...]:
    """Return the tested relations of a loading campaign."""
    steps = view.steps
    names = [view.run_name(run) for run in range(len(steps.runs))]
    copies = copied_runs(steps.run, names, steps.load, _values(view, settings))
    alone = ~np.isin(steps.run, [names.index(name) for one in copies for slip in one.slips for name in slip.subjects])
    channels, signals = _channels(settings), _signal_columns(steps.signals)
    seen = _seen(tables, settings)
    wrong = _parts(view, [*channels, *signals], seen)
    found: list[Tested] = []
    if np.isfinite(steps.reading).any():
        apart = rows_of_parts(wrong, steps.run, range(len(channels)))
        reading, still = _moving(steps.load, steps.run, np.where((alone & ~apart)[:, None], steps.reading, np.nan))
        loaded = Recorded(steps.load, steps.run, reading, names)
        response = _of_readings(loaded, channels, seen, settings)
        answers = seen if seen is not None else signals_of_loads.responses_of(loaded, len(channels))
        rows = _of_rows(view, loaded, channels, answers, _typical(steps.sigma), still, loads_of_readings.RELATION)
        equal = equal_columns(steps.reading, channels, loads_of_readings.RELATION, "readings")
        own = of_parts(wrong, view, channels, 0, loads_of_readings.RELATION)
        found += _with_rows(_also_reversed(response, loaded), [*own, *equal, *rows])
    else:
        found.append(_in_range(steps.load, settings) or loads_of_readings.untested("no-displacements"))
    if steps.signals:
        apart = rows_of_parts(wrong, steps.run, range(len(channels), len(channels) + len(signals)))
        signal, still = _moving(steps.load, steps.run, np.where((alone & ~apart)[:, None], steps.signal, np.nan))
        recorded = Recorded(steps.load, steps.run, signal, names, settings.signals.zero_mv is not None)
        response = _of_signals(recorded, signals, settings)
        found[0], response = _reconciled(found[0], response)
        response = _by_the_same_slip(found[0], response, recorded, signals, settings)
        answers = signals_of_loads.responses_of(recorded, len(signals))
        hiss = np.full(len(signals), (settings.noise.signal_mv or np.nan) * _MILLIVOLT)
        rows = _of_rows(view, recorded, signals, answers, hiss, still, signals_of_loads.RELATION)
        equal = equal_columns(steps.signal, signals, signals_of_loads.RELATION, "signals")
        own = of_parts(wrong, view, signals, len(channels), signals_of_loads.RELATION)
        found += _with_rows(_also_reversed(response, recorded), [*own, *equal, *rows])
    return (*found, *copies)


def _reconciled(readings: Tested, signals: Tested) -> tuple[Tested, Tested]:
    """Both tests with the slip first that both know; where readings follow the loads as predicted, loads are right."""
    known = (*signals.slips, *signals.rivals)
    common = [slip for slip in (*readings.slips, *readings.rivals) if slip in known]
    if len(readings.slips) == len(signals.slips) == 1 and common:
        return _put_first(readings, common[0]), _put_first(signals, common[0])
    runs = readings.slips[0].subjects if len(readings.slips) == 1 and readings.slips[0].quantity == "load" else ()
    if runs and signals.state == State.OK and not any(set(slip.subjects) & set(runs) for slip in signals.hidden):
        moved = [slip for slip in readings.rivals if slip.quantity in ("displacement", "rotation")]
        return (_put_first(readings, moved[0]) if moved else readings), signals
    own = [slip for slip in signals.rivals if slip.quantity == "signal"]
    right = readings.state == State.OK and all(slip.quantity != "load" for slip in readings.hidden)
    if right and own and len(signals.slips) == 1 and signals.slips[0].quantity == "load":
        return readings, _put_first(signals, own[0])
    return readings, signals


def _by_the_same_slip(
    readings: Tested, signals: Tested, recorded: Recorded, columns: Sequence[Column], settings: Campaign
) -> Tested:
    """The test of signals with the slip of loads that readings tell, where it leaves nothing else to explain."""
    if readings.state != State.FAILS or not signals.slips or len(readings.slips) != 1:
        return signals
    slip = readings.slips[0]
    if slip == signals.slips[0] or slip.subjects or slip.kind not in (SlipKind.UNIT, SlipKind.SIGN):
        return signals
    axes = {"load": slice(0, 6), "force": slice(0, 3), "torque": slice(3, 6)}.get(slip.quantity)
    if axes is None:
        return signals
    load = recorded.load.copy()
    load[:, axes] *= -1.0 if slip.kind == SlipKind.SIGN else slip.factor
    right = _of_signals(replace(recorded, load=load), columns, settings)
    if right.slips or right.misfit is None or right.misfit > (signals.misfit_explained or np.inf):
        return signals
    return replace(signals, slips=(slip,), rivals=(), misfit_explained=right.misfit)


def _put_first(tested: Tested, slip: Slip) -> Tested:
    """A test with one of the slips that it has found as likely before the others."""
    if slip in tested.slips or abs(abs(np.log(slip.factor)) - abs(np.log(tested.slips[0].factor))) > _SAME_SIZE:
        return tested
    others = tuple(one for one in (*tested.slips, *tested.rivals) if one != slip)
    return replace(tested, slips=(slip,), rivals=others)


def _parts(view: LoadingView, columns: Sequence[Column], seen: Array | None) -> list[Part]:
    """Parts of runs that are in another unit or have the opposite sign, told by channels and signals together."""
    steps = view.steps
    value = np.column_stack([steps.reading, steps.signal])
    answers = signals_of_loads.responses_of(Recorded(steps.load, steps.run, value, ()), len(columns))
    if seen is not None:
        answers[: len(seen)] = seen
    return parts(steps.load, steps.run, value, columns, answers)


def _moving(load: Array, run: NDArray[np.int64], value: Array) -> tuple[Array, list[Frozen]]:
    """Values (N, K) without the runs in which their columns stood still, and these."""
    still, moving = list(stood_still(load, run, value)), value.copy()
    for one in still:
        moving[run == one.run, one.column] = np.nan
    return moving, still


def _also_reversed(tested: Tested, steps: Recorded) -> Tested:
    """Runs with the opposite sign whose loads go the same way backwards: their rows may be reversed as well; loads that
    are the same backwards never show it."""
    turned = [slip for slip in tested.slips if slip.kind == SlipKind.SIGN]
    number = {name: run for run, name in enumerate(steps.runs)}
    rivals = list(tested.rivals)
    for slip in turned:
        named = [number[name] for name in slip.subjects if name in number]
        rows = np.isin(steps.run, named)
        if named and can_reverse(steps.load[rows], steps.run[rows])[1]:
            what = "signals" if tested.relation == signals_of_loads.RELATION else "readings"
            rivals.append(Slip(SlipKind.REVERSED, what, tuple(steps.runs[run] for run in named)))
    if not tested.slips and can_reverse(steps.load, steps.run)[0]:
        return replace(tested, hidden=(*tested.hidden, Slip(SlipKind.REVERSED, "rows")))
    return replace(tested, rivals=tuple(rivals))


def _of_readings(loaded: Recorded, channels: Sequence[Column], seen: Array | None, settings: Campaign) -> Tested:
    alike = signals_of_loads.against_each_other(loaded, channels, loads_of_readings.RELATION)
    if seen is None:
        return alike if alike.slips else _in_range(loaded.load, settings) or alike
    return _either(loads_of_readings.against_simulation(loaded, channels, seen), alike, loaded.runs)


def _of_signals(recorded: Recorded, columns: Sequence[Column], settings: Campaign) -> Tested:
    declared = settings.signals.sensitivity_mv_per_n
    gain = None
    if declared is not None and np.size(declared) in (1, len(columns)):
        gain = np.broadcast_to(np.asarray(declared, float), len(columns)) * _MILLIVOLT
    alike = signals_of_loads.against_each_other(recorded, columns, signals_of_loads.RELATION)
    if settings.mechanism.type == "6-upur" and len(columns) == 6:
        legs = _leg_forces(settings.mechanism)  # type: ignore[arg-type]
        told = None if legs is None else signals_of_loads.against_geometry(recorded, columns, legs, gain)
        if told is not None:
            tested = _either(told, alike, recorded.runs)
            return tested if gain is None else _or_sensitivity(tested)
    return alike


def _either(predicted: Tested, alike: Tested, runs: Sequence[str]) -> Tested:
    """What a prediction tells; where it tells no slip, or one of single runs, what runs tell of each other."""
    of_runs = all(set(slip.subjects).intersection(runs) for slip in predicted.slips)
    if alike.slips and of_runs:
        return replace(alike, tried=predicted.tried + alike.tried)
    single = [slip for slip in alike.hidden if set(slip.subjects).intersection(runs) and slip.kind != SlipKind.SIGN]
    doubled = tuple(replace(slip, factor=0.5) if slip.kind == SlipKind.UNIT else slip for slip in single)
    return replace(predicted, tried=predicted.tried + alike.tried, hidden=(*predicted.hidden, *doubled))


def _or_sensitivity(tested: Tested) -> Tested:
    """All loads or all signals in another unit: the declared sensitivity may be, as well."""
    slip = tested.slips[0] if len(tested.slips) == 1 else None
    if slip is None or slip.subjects or slip.kind != SlipKind.UNIT or slip.quantity not in ("load", "signal"):
        return tested
    factor = slip.factor if slip.quantity == "load" else 1.0 / slip.factor
    return replace(tested, rivals=(*tested.rivals, Slip(SlipKind.UNIT, "sensitivity_mv_per_n", (), factor)))


def _in_range(load: Array, settings: Campaign) -> Tested | None:
    declared = np.array([getattr(settings.loading, name) or np.nan for name in LOAD_COLUMNS], float)
    return loads_of_readings.against_range(load, declared)


def _seen(tables: Mapping[str, pa.Table], settings: Campaign) -> Array | None:
    """The rows (6, 6) of the simulated compliance that channels see; None where nothing is simulated."""
    compliance = simulated_compliance(tables, settings)
    return None if compliance is None else np.asarray(channel_rows(settings.interferometer.beams) @ compliance)


def _leg_forces(section: SensorMechanism) -> Array | None:
    """The forces (6, 6) along the legs by the loads; None where the legs do not carry every load."""
    from truing.simulation.bench.six_upur.influence import influence_matrix
    from truing.stages.common.nominal_sensor import elastic_parts, sensor_joints

    elastic = elastic_parts(section)
    if elastic is not None:
        return np.asarray(elastic.axial_forces)
    G = influence_matrix(sensor_joints(section))
    return np.asarray(np.linalg.inv(G)) if np.linalg.cond(G) < 1e12 else None


def _of_rows(
    view: LoadingView,
    steps: Recorded,
    columns: Sequence[Column],
    answers: Array,
    noise: Array,
    still: Sequence[Frozen],
    relation: str,
) -> Iterator[Tested]:
    """Columns that stand still, and runs whose rows stand in another order than their loads."""
    still = [*still, *frozen(steps.load, steps.run, steps.value, answers, noise)]
    share = 100.0 * max((one.share for one in still), default=0.0)
    for slip in _frozen_slips(still, columns, steps.runs):
        yield Tested(relation, State.FAILS, "frozen", _subject(slip), share, None, None, "%", (slip,), tried=len(still))
    if not still:
        what = "signals" if relation == signals_of_loads.RELATION else "readings"
        found, tried = row_slips(steps.load, steps.run, view.steps.time_s, steps.value, steps.runs, what)
        for row in found:
            sizes, unit = (row.before, row.after, None), "% of the range"
            yield Tested(relation, State.FAILS, "rows", _subject(row.slip), *sizes, unit, (row.slip,), tried=tried)


def _frozen_slips(still: Sequence[Frozen], columns: Sequence[Column], runs: Sequence[str]) -> Iterator[Slip]:
    """One slip for runs in which the same columns of a quantity stand still."""
    by_run: dict[tuple[int, str], list[int]] = {}
    for one in still:
        by_run.setdefault((one.run, columns[one.column].quantity), []).append(one.column)
    alike: dict[tuple[str, tuple[int, ...]], list[str]] = {}
    for (run, quantity), places in by_run.items():
        alike.setdefault((quantity, tuple(places)), []).append(runs[run])
    for (quantity, same), names in alike.items():
        every = len(same) == sum(column.quantity == quantity for column in columns)
        own = () if every and len(same) > 1 else tuple(columns[place].name for place in same)
        yield Slip(SlipKind.FROZEN, quantity, (*own, *names))


def _subject(slip: Slip) -> str:
    return ", ".join(slip.subjects) if len(slip.subjects) <= 3 else ""


def _with_rows(response: Tested, rows: Iterable[Tested]) -> list[Tested]:
    """The test of responses and of rows: where rows are wrong, responses that follow from them are left out."""
    found = list(rows)
    return [*([] if found and not response.slips else [response]), *found]


def _values(view: LoadingView, settings: Campaign) -> list[Values]:
    """Tables whose runs are held against each other, in the units of their files."""
    steps, tables = view.steps, list[Values]()
    seen = np.isfinite(steps.reading)
    if seen.any():
        reading, sigma = steps.reading / READING_SI, steps.sigma / READING_SI
        if seen.sum(axis=1).max() == 1:  # one channel at a time: a copy may stand under the name of another
            reading = np.where(seen, reading, 0.0).sum(axis=1, keepdims=True)
            reading[~seen.any(axis=1)] = np.nan
            sigma = np.where(seen, sigma, np.inf).min(axis=1, keepdims=True)
        tables.append(Values("readings", reading, _typical(sigma)))
    if steps.signals:
        hiss = np.full(len(steps.signals), settings.noise.signal_mv or np.nan)
        tables.append(Values("signals", steps.signal / _MILLIVOLT, hiss))
    return tables


def _typical(sigma: Array) -> Array:
    """The typical noise (K,) of columns (N, K); NaN where none is declared."""
    known = np.isfinite(sigma)
    return np.array(
        [np.median(own[there]) if there.any() else np.nan for own, there in zip(sigma.T, known.T, strict=True)]
    )


def _channels(settings: Campaign) -> list[Column]:
    """The channels with their quantities, and what makes other units of them right."""
    wave_um = settings.interferometer.wavelength_nm * 1e-3
    fringes = tuple(share * wave_um for share in FRINGE_SHARES)
    return [
        Column(name, "displacement", DISPLACEMENT_UNITS, fringes, float(READING_SI[k]))
        if name in LINEAR
        else Column(name, "rotation", ROTATION_UNITS, (), float(READING_SI[k]))
        for k, name in enumerate(CHANNELS)
    ]


def _signal_columns(names: Sequence[str]) -> list[Column]:
    return [Column(name, "signal", SIGNAL_FACTORS) for name in names]
