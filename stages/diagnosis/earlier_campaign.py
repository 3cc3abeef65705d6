"""Starting from an earlier campaign of the same machine: what it knew enters, and what has changed since is told."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.faults import CampaignFaults, Fault
from stages.responses.tables import Rows
from truing.estimation.diagnosis.changes import Comparison, compare
from truing.estimation.diagnosis.fitted_model import Fitter, Stand
from truing.estimation.diagnosis.point_fit import fit_points
from truing.simulation.bench.earlier_sensor import earlier_sensor
from truing.simulation.bench.sensor_text import is_sensor, read_sensor
from truing.simulation.cause import Cause
from truing.simulation.earlier import Earlier, Part, earlier_knowledge
from truing.simulation.effects_model import EffectsModel
from truing.simulation.identified import identified_geometry, name_and_leg
from truing.simulation.model_text import read_model
from truing.simulation.unknowns import Unknowns

if TYPE_CHECKING:
    import pyarrow as pa

    from stages.diagnosis.mechanism_points import Gathered
    from truing.simulation.six_upur.uncertain_sensor import UncertainSensor

# A number of which the data take away less than this share of what was not known has not been measured anew.
_TOLD = 0.05
_OF_SENSOR = ("geometry", "stiffness")
_UNNAMED = "the earlier campaign"
_AXES = {"a": "xyz", "b": "xyz", "u": "12", "l": ("",)}


def started(gathered: Gathered, text: str, seed: int) -> Gathered:
    """What is compared, with the effects and the knowledge of an earlier model.

    Numbers that have changed since are let free, and all of them where the machine is another one. Raises
    CampaignFaults where the text is no model.
    """
    try:
        campaign, causes, earlier = _known(text, gathered.model)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise CampaignFaults([Fault("start.toml", f"a model.toml that a run has written ({error})")]) from None
    alone = with_earlier(gathered.model, earlier.nothing)
    try:
        stand = Fitter(alone, gathered.calibration, gathered.held_out, seed).prepared(gathered.given)
        compared = _compared(earlier, stand.model, stand.fit.shared, stand.covariance())
    except np.linalg.LinAlgError:
        raise ValueError("with the effects of the earlier model the fit left what the legs can reach") from None
    changed = compared.changed()
    kept = earlier.nothing
    if changed is not None:
        kept = earlier.without(sorted({*changed, *chain.from_iterable(compared.instead(changed))}))
    said = _words(campaign, earlier, stand.model, compared)
    lost = {cause.id for cause in causes if cause.lasts} - {cause.id for cause in earlier.causes}
    missing = f"{', '.join(sorted(lost))} of {campaign}, whose columns are missing here" if lost else ""
    words = "; ".join(part for part in (gathered.left_out, missing, said) if part)
    return replace(gathered, model=with_earlier(gathered.model, kept), left_out=words)


def _known(text: str, model: Any) -> tuple[str, tuple[Cause, ...], Earlier]:
    """The earlier campaign's name, its effects, and what it tells of a model of points or of readings."""
    if is_sensor(tomllib.loads(text)):
        sensor = read_sensor(text)
        return sensor.context.get("campaign", _UNNAMED), sensor.causes, earlier_sensor(sensor, model)
    found = read_model(text)
    return found.context.get("campaign", _UNNAMED), found.model.causes, earlier_knowledge(found, model)


def with_earlier(model: Any, earlier: Earlier) -> Any:
    """The model, of points or of readings, that starts from what an earlier campaign found."""
    return replace(model, known=replace(model.known, earlier=earlier)).with_causes(())


def _compared(earlier: Earlier, model: EffectsModel, shared: NDArray, covariance: NDArray) -> Comparison:
    """The earlier numbers against those of a model that was fitted without the earlier campaign's knowledge."""
    now = _now(earlier, model, shared, covariance)
    return compare(earlier.mean, earlier.covariance, *now, earlier.shared, earlier.frames)


def _now(earlier: Earlier, model: EffectsModel, shared: NDArray, covariance: NDArray) -> tuple[NDArray, NDArray]:
    """The earlier numbers (n,) as a model has them, and their covariance (n, n)."""
    own, slopes = earlier.places(model), earlier.slopes(model, shared)
    return earlier.values(model, shared), slopes @ covariance[np.ix_(own, own)] @ slopes.T


def _words(campaign: str, earlier: Earlier, model: EffectsModel, compared: Comparison) -> str:
    changed = compared.changed()
    if changed is None:
        return (
            f"all that {campaign} knew of the machine and its effects: it was of another machine, or much was rebuilt"
        )
    if not changed:
        return ""
    names = [number.label for number in _numbers(earlier, model)]
    said = [" or ".join(names[i] for i in (one, *others)) for one, others in _alternatives(compared, changed)]
    return f"what {campaign} knew of {', '.join(said)}, changed since"


def _alternatives(compared: Comparison, changed: tuple[int, ...]) -> list[tuple[int, tuple[int, ...]]]:
    """Each changed number with those that may have changed in its place."""
    return list(zip(changed, compared.instead(changed), strict=True))


@dataclass(frozen=True)
class _Number:
    """One number that both campaigns have: what the tables call it, what it belongs to, and its scale in their unit."""

    name: str
    leg: int | None
    unit: str
    scale: float
    effect_of: str | None = None

    @property
    def label(self) -> str:
        return self.name if self.leg is None else f"{self.name}{self.leg}"


def _numbers(earlier: Earlier, model: Any) -> list[_Number]:
    """Return the numbers (n,) in their order; directions of actuators as tilts."""
    causes, found = {cause.key: cause for cause in earlier.causes}, []
    for part in earlier.parts:
        if part.name in _AXES:
            found += _of_geometry(part, model.leg_count)
        elif part.name in _OF_SENSOR:
            found += _of_sensor(part, model.known.sensor)
        else:
            cause = causes[part.name]
            for p, scale in zip(cause.parameters(model.leg_count), part.scale, strict=True):
                owner = f"{cause.id} {cause.subject}".strip()
                found.append(_Number(*name_and_leg(p.name), p.unit, float(scale) / p.si, owner))
    return found


def _of_geometry(part: Part, legs: int) -> list[_Number]:
    unit, si = ("1", 1.0) if part.name == "u" else ("mm", 1e-3)
    names = [(f"{part.name}_{axis}".removesuffix("_"), leg + 1) for leg in range(legs) for axis in _AXES[part.name]]
    return [_Number(*named, unit, float(scale) / si) for named, scale in zip(names, part.scale, strict=True)]


def _of_sensor(part: Part, sensor: UncertainSensor) -> list[_Number]:
    lengths = part.name == "geometry"
    named = sensor.unknowns[: sensor.geometry_size] if lengths else sensor.unknowns[sensor.geometry_size :]
    unit, si = ("mm", 1e-3) if lengths else ("1", 1.0)
    return [_Number(name, leg, unit, float(size) / si) for (leg, name), size in zip(named, part.scale, strict=True)]


def changes_table(final: Stand) -> pa.Table | None:
    """The rows of changes.parquet: what the final model says without the earlier knowledge, against that knowledge.

    None where the campaign starts from nothing.
    """
    earlier: Earlier | None = final.model.known.earlier
    if earlier is None:
        return None
    model: Any = with_earlier(final.model, earlier.nothing).with_causes(final.causes)
    fit = fit_points(model, final.measured, final.fit.frames, final.fit.shared, final.fit.local)
    covariance = fit.whitened.covariance() * final.noise_ratio**2
    found = _compared(earlier, model, fit.shared, covariance)
    told = _told(earlier, model, fit.shared, covariance)
    rows = Rows("changes")
    rows.add(**told.columns, **_figures(earlier, told, found, *_now(earlier, model, fit.shared, covariance)))
    return rows.table()


@dataclass(frozen=True)
class _Told:
    """The rows of the table: what each is called, how it follows the numbers (R, n) in its unit, nominal (R,)."""

    rows: tuple[_Number, ...]
    by_numbers: NDArray
    nominal: NDArray

    @property
    def columns(self) -> dict[str, list[Any]]:
        """What the rows are called, column by column."""
        return {name: [getattr(row, name) for row in self.rows] for name in ("leg", "unit", "effect_of")} | {
            "parameter": [row.name for row in self.rows]
        }


def _told(earlier: Earlier, model: EffectsModel, shared: NDArray, covariance: NDArray) -> _Told:
    """The geometry as the tables tell it, or a sensor's lengths and stiffnesses, then the effects."""
    if not isinstance(model, Unknowns):
        rows = _numbers(earlier, model)
        return _Told(tuple(rows), np.diag([row.scale for row in rows]), np.zeros(len(rows)))
    geometry, own = identified_geometry(model, shared, covariance), earlier.places(model)
    parts = {part.name for part in earlier.parts}
    kept = np.array([entry.name.partition("_")[0] in parts for entry in geometry.parameters], bool)
    entries = [entry for entry, told in zip(geometry.parameters, kept, strict=True) if told]
    si = np.array([entry.si for entry in entries])
    effects = [number for number in _numbers(earlier, model) if number.effect_of is not None]
    lower = np.zeros((len(effects), len(own)))
    lower[:, len(own) - len(effects) :] = np.diag([number.scale for number in effects])
    rows = [_Number(entry.name, entry.leg + 1, entry.unit, entry.si) for entry in entries]
    by = np.concatenate([(geometry.by_shared[kept][:, own].T / si).T, lower])
    return _Told((*rows, *effects), by, np.concatenate([geometry.nominal[kept] / si, np.zeros(len(effects))]))


def _figures(earlier: Earlier, told: _Told, found: Comparison, now: NDArray, covariance: NDArray) -> dict[str, NDArray]:
    by = told.by_numbers
    spread = np.sqrt(np.maximum(np.diag(by @ found.covariance @ by.T), 0.0))
    prior = np.diag(by @ np.linalg.inv(earlier.shared) @ by.T)
    measured = np.diag(by @ covariance @ by.T) < (1.0 - _TOLD) * prior
    return {
        "before": told.nominal + by @ earlier.mean,
        "sigma_before": np.sqrt(np.diag(by @ (earlier.covariance + earlier.frames) @ by.T)),
        "now": told.nominal + by @ now,
        "sigma_now": np.sqrt(np.diag(by @ covariance @ by.T)),
        "sigma_difference": spread,
        "z": np.where(measured & (spread > 0), by @ found.difference / np.where(spread > 0, spread, 1.0), np.nan),
        **_changed(told, found),
    }


def _changed(told: _Told, found: Comparison) -> dict[str, list[Any]]:
    """Which rows are those that changed, by how much, and which others may have done so in their place."""
    # A direction is told by components, each of which follows one of its two tilts most.
    row_of = {int(np.abs(told.by_numbers[row]).argmax()): row for row in range(len(told.rows))}
    changed, count = found.changed(), len(told.rows)
    if changed is None:
        return {"changed": [True] * count}
    columns: dict[str, list[Any]] = {"changed": [False] * count}
    columns |= {name: [None] * count for name in ("change", "sigma_change", "instead")}
    sizes, sigmas = found.sizes(changed)
    for (place, rivals), size, sigma in zip(_alternatives(found, changed), sizes, sigmas, strict=True):
        row, one = row_of[place], np.abs(told.by_numbers[row_of[place], place])
        others = " ".join(told.rows[row_of[rival]].label for rival in rivals) or None
        values = {"changed": True, "change": size * one, "sigma_change": sigma * one, "instead": others}
        for name, value in values.items():
            columns[name][row] = value
    return columns
