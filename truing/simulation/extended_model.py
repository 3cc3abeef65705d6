"""The extended model as text: nominal geometry, what was identified, accepted effects; and its prediction of poses.

The text is TOML for people and for `read_model`. Unknowns keep the order and the names of its ``[covariance]``
table: a, b, u, l leg by leg (u as two tilts across the nominal direction, see `PointModel`), then the effects.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.simulation.causes import catalogue
from truing.simulation.causes.unexplained import Unexplained
from truing.simulation.chain import Cause, Effect
from truing.simulation.legs import Legs
from truing.simulation.mechanisms import mechanism
from truing.simulation.point_model import Conditions, Known, PointModel
from truing.simulation.survey import ShapeUnknowns
from truing.simulation.targets import Targets

FORMAT = 1
_AXES = "xyz"
_NO_SURVEY = ShapeUnknowns(np.zeros((0, 3, 0)), np.zeros((0, 0)))


@dataclass(frozen=True)
class ExtendedModel:
    """A mechanism as identified: unknowns (G,) of a model without targets, with covariance (G, G), in prior sigmas."""

    model: PointModel
    shared: NDArray
    covariance: NDArray
    context: dict[str, str]  # what the model was made from, for people


@dataclass(frozen=True)
class PredictedPoses:
    """Poses of the platform seen from the base, m and rad; whether the legs closed."""

    p: NDArray  # (B, 3)
    R: NDArray  # (B, 3, 3)
    covariance: NDArray  # (B, 6, 6) of (p, theta), R <- exp(theta) R
    converged: NDArray  # (B,)


def bare(model: PointModel) -> PointModel:
    """Return a model without targets: what is left of the unknowns are geometry and effects."""
    none = np.zeros((0, 3))
    known = Known(
        model.known.geometry,
        none,
        _NO_SURVEY,
        model.known.reading_sigma,
        np.arange(0),
        model.known.seat_rotation,
        model.known.seat,
    )
    return PointModel(model.nominal, Targets(np.zeros(0, int), np.zeros(0, int)), known, model.conditions, model.causes)


def extended(model: PointModel, shared: NDArray, covariance: NDArray, context: dict[str, str]) -> ExtendedModel:
    """Return the extended model of a fit over targets: its geometry and effects with their joint covariance."""
    smaller = bare(model)
    kept = np.concatenate(
        [np.arange(part.start, part.stop) for name, part in model.layout.items() if name not in ("shape", "seat")]
    ).astype(int)
    return ExtendedModel(smaller, shared[kept], covariance[np.ix_(kept, kept)], context)


def predict_poses(extended_model: ExtendedModel, conditions: Conditions) -> PredictedPoses:
    """Return the platform's poses at the given conditions, with the uncertainty of unknowns and readings propagated."""
    model = extended_model.model.at(conditions)
    local = np.zeros((len(conditions.readings), model.local_size))
    state = model.state(extended_model.shared, local)
    by_shared, by_local = model.pose_derivatives(extended_model.shared, local)
    covariance = by_shared @ extended_model.covariance @ np.swapaxes(by_shared, 1, 2) + by_local @ np.swapaxes(
        by_local, 1, 2
    )
    return PredictedPoses(state.p, state.R, covariance, state.converged)


def write_model(extended_model: ExtendedModel) -> str:
    """Return the model as TOML text, every number to full precision."""
    model = extended_model.model
    identified, sigma = model.legs(extended_model.shared), np.sqrt(np.diag(extended_model.covariance))
    lines = [
        f"format = {FORMAT}",
        "",
        "[model]",
        *(f"{key} = {_text(value)}" for key, value in extended_model.context.items()),
        f"mechanism = {_text(model.nominal.closure.name)}",
        f"reading_sigma_mm = {_mm(model.known.reading_sigma)}",
        "",
        "[prior]  # one standard deviation of the nominal geometry; 0: taken as exact",
        *(f"{name} = {model.known.geometry.get(name, 0.0)!r}  # {'rad' if name == 'u' else 'm'}" for name in "abul"),
    ]
    for leg in range(model.nominal.count):
        lines += [
            "",
            "[[legs]]",
            f"nominal = {_leg(model.nominal, leg)}",
            f"identified = {_leg(identified, leg)}",
            f"sigma = {_leg_sigma(model, sigma, leg)}",
        ]
    for effect in model.effects(extended_model.shared):
        lines += _effect_lines(model, effect, sigma)
    return "\n".join([*lines, *_covariance_lines(model, extended_model.covariance)]) + "\n"


def read_model(text: str) -> ExtendedModel:
    """Return the model that a text of `write_model` describes; raises ValueError where it does not describe one."""
    try:
        return _from_document(tomllib.loads(text))
    except (KeyError, TypeError, IndexError) as error:
        raise ValueError(f"model: found no usable {error}, expected what `truing run` writes as model.toml") from error


def _from_document(document: dict[str, Any]) -> ExtendedModel:
    if document["format"] != FORMAT:
        raise ValueError(f"model: found format {document['format']!r}, expected {FORMAT}")
    about = document["model"]
    nominal, identified = (
        _legs(about["mechanism"], [leg[kind] for leg in document["legs"]]) for kind in ("nominal", "identified")
    )
    causes = tuple(_cause(effect) for effect in document.get("effects", []))
    geometry = {name: sigma for name, sigma in document["prior"].items() if sigma > 0}
    count = nominal.count
    known = Known(
        geometry,
        np.zeros((0, 3)),
        _NO_SURVEY,
        about["reading_sigma_mm"] * 1e-3,
        np.arange(0),
        np.tile(np.eye(3), (count, 1, 1)),
        np.zeros((count, 3)),
    )
    model = PointModel(
        nominal, Targets(np.zeros(0, int), np.zeros(0, int)), known, Conditions(nominal.rho0[None]), causes
    )
    tables = [effect["parameters"] for effect in document.get("effects", [])]
    values = {
        cause.key: np.array([table[p.name]["value"] * p.si for p in cause.parameters(count)])
        for cause, table in zip(causes, tables, strict=True)
    }
    shared = model.unknowns(identified, values)
    context = {key: str(value) for key, value in about.items() if key not in ("mechanism", "reading_sigma_mm")}
    return ExtendedModel(model, shared, _covariance(document["covariance"], model.shared_size), context)


def _cause(effect: dict[str, Any]) -> Cause:
    return Unexplained(**effect["settings"]) if effect["cause"] == Unexplained.id else catalogue()[effect["cause"]]


def _legs(kind: str, legs: list[dict[str, Any]]) -> Legs:
    def lengths(name: str) -> NDArray:
        return np.array([leg[name] for leg in legs]) * 1e-3

    return mechanism(
        kind, lengths("a_mm"), lengths("b_mm"), [leg["u"] for leg in legs], lengths("length_mm"), lengths("rho0_mm")
    )


def _leg(legs: Legs, leg: int) -> str:
    directions = ", ".join(repr(round(float(value), 13)) for value in legs.u[leg])
    joints = ", ".join(f"{name}_mm = [{_mm(*joint[leg])}]" for name, joint in (("a", legs.a), ("b", legs.b)))
    lengths = f"length_mm = {_mm(legs.l[leg])}, rho0_mm = {_mm(legs.rho0[leg])}"
    return f"{{ {joints}, u = [{directions}], {lengths} }}"


def _leg_sigma(model: PointModel, sigma: NDArray, leg: int) -> str:
    parts = []
    for name, size, key in (("a", 3, "a_mm"), ("b", 3, "b_mm"), ("u", 2, "tilt_rad"), ("l", 1, "length_mm")):
        if name in model.layout:
            own = sigma[model.layout[name]].reshape(-1, size)[leg] * model.known.geometry[name]
            own = own * (1.0 if name == "u" else 1e3)
            numbers = ", ".join(f"{value:.4g}" for value in own)
            parts.append(f"{key} = {numbers}" if size == 1 else f"{key} = [{numbers}]")
    return "{ " + ", ".join(parts) + " }"


def _mm(*values: float) -> str:
    """Return metres as millimetres; what is left out is a thousandth of an atom."""
    return ", ".join(repr(round(float(value) * 1e3, 12)) for value in values)


def _effect_lines(model: PointModel, effect: Effect, sigma: NDArray) -> list[str]:
    own = sigma[model.layout[effect.cause.key]] * model.effect_sigma(effect.cause)
    lines = ["", "[[effects]]", f"cause = {_text(effect.cause.id)}"]
    settings = effect.cause.settings()
    if settings:
        parts = (
            f"{key} = {_text(value) if isinstance(value, str) else repr(value)}" for key, value in settings.items()
        )
        lines.append(f"settings = {{ {', '.join(parts)} }}")
    lines.append("[effects.parameters]")
    for p, value, s in zip(effect.cause.parameters(model.nominal.count), effect.values, own, strict=True):
        lines.append(
            f"{p.name} = {{ value = {float(value / p.si)!r}, sigma = {s / p.si:.4g}, unit = {_text(p.unit)} }}"
        )
    return lines


def _names(model: PointModel) -> list[str]:
    legs = range(1, model.nominal.count + 1)
    names: list[str] = []
    for name, parts in (("a", _AXES), ("b", _AXES), ("u", "12"), ("l", " ")):
        if name in model.layout:
            names += [f"{name}{leg}{f'_{part}' if part != ' ' else ''}" for leg in legs for part in parts]
    return names + [p.name for cause in model.causes for p in cause.parameters(model.nominal.count)]


def _covariance_lines(model: PointModel, covariance: NDArray) -> list[str]:
    rows = [", ".join(f"{value:.9g}" for value in row[: i + 1]) for i, row in enumerate(covariance)]
    return [
        "",
        "[covariance]  # of the unknowns in their prior standard deviations, lower triangle",
        f"names = [{', '.join(_text(name) for name in _names(model))}]",
        "rows = [",
        *(f"  [{row}]," for row in rows),
        "]",
    ]


def _covariance(table: dict[str, Any], size: int) -> NDArray:
    lower = np.zeros((size, size))
    if len(table["rows"]) != size:
        raise ValueError(f"model: found {len(table['rows'])} rows of covariance, expected {size}")
    for i, row in enumerate(table["rows"]):
        lower[i, : i + 1] = row
    return lower + np.tril(lower, -1).T


def _text(value: str) -> str:
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
