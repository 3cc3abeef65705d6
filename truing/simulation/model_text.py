"""The extended model as text: TOML for people and for `read_model`, every number to full precision.

Lengths are mm and parameters of effects in the tables' units. What people have no use for stands beside it in SI:
``values`` of an effect (where the tables tell amplitude and phase, these are sine and cosine), and the covariance of
all unknowns, in the order of its names: a, b, u, l leg by leg (u as two tilts across the nominal direction), effects.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.settings_text import parsed_toml
from truing.simulation.cause import Cause
from truing.simulation.causes import catalogue, of_photographed_points
from truing.simulation.effect_text import (
    cause_of,
    covariance_lines,
    covariance_of,
    effect_lines,
    toml_key,
    toml_value,
)
from truing.simulation.extended_model import ExtendedModel, bare_known
from truing.simulation.legs import Legs
from truing.simulation.mechanisms import mechanism
from truing.simulation.point_model import PointModel
from truing.simulation.targets import BASE, PLATFORM, Targets
from truing.simulation.unknowns import Conditions

FORMAT = 2
_AXES = "xyz"
_BODIES = {"base": BASE, "platform": PLATFORM}
_OWN = ("mechanism", "reading_sigma_mm", "reference_temperature_c")


def write_model(extended_model: ExtendedModel) -> str:
    """Return the model as TOML text."""
    model, covariance = extended_model.model, extended_model.covariance
    identified, sigma = model.legs(extended_model.shared), np.sqrt(np.diag(covariance))
    lines = [f"format = {FORMAT}", "", "[model]", *_about(extended_model), "", *_prior(model)]
    for leg in range(model.nominal.count):
        lines += ["", "[[legs]]", f"nominal = {_leg(model.nominal, leg)}", f"identified = {_leg(identified, leg)}"]
        lines += [f"sigma = {_leg_sigma(model, sigma, leg)}"]
    for effect in model.effects(extended_model.shared):
        part = model.layout[effect.cause.key]
        scale = model.effect_sigma(effect.cause)
        lines += effect_lines(effect, covariance[part, part] * np.outer(scale, scale), model.nominal.count)
    lines += _targets(extended_model)
    return "\n".join([*lines, *covariance_lines(_names(model), covariance, "their prior standard deviations")]) + "\n"


def read_model(text: str) -> ExtendedModel:
    """Return the model that a text of `write_model` describes; raises ValueError where it does not describe one."""
    try:
        return _from_document(parsed_toml(text))
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"model: found no usable {error}, expected what `truing run` writes as model.toml") from error


def _about(extended_model: ExtendedModel) -> list[str]:
    known = extended_model.model.known
    told = {**extended_model.context, "mechanism": extended_model.model.nominal.closure.name}
    numbers = {
        "reading_sigma_mm": float(_mm(known.reading_sigma)),
        "reference_temperature_c": known.reference_temperature_c,
    }
    return [f"{toml_key(key)} = {toml_value(value)}" for key, value in {**told, **numbers}.items()]


def _prior(model: PointModel) -> list[str]:
    """Return what was known of the geometry: lines of a table."""
    known = model.known
    sigmas = [f"{n} = {toml_value(known.geometry.get(n, 0.0))}  # {'rad' if n == 'u' else 'm'}" for n in "abul"]
    said = "[prior]  # one standard deviation of the nominal geometry; 0: taken as exact; open: only a start"
    return [said, *sigmas, f"open = {toml_value(known.open_geometry)}"]


def _leg(legs: Legs, leg: int) -> str:
    joints = {f"{name}_mm": _mm(joint[leg]) for name, joint in (("a", legs.a), ("b", legs.b))}
    lengths = {"length_mm": _mm(legs.l[leg]), "rho0_mm": _mm(legs.rho0[leg])}
    return toml_value({**joints, "u": np.round(legs.u[leg], 13), **lengths})


def _leg_sigma(model: PointModel, sigma: NDArray, leg: int) -> str:
    parts: dict[str, Any] = {}
    for name, size, key in (("a", 3, "a_mm"), ("b", 3, "b_mm"), ("u", 2, "tilt_rad"), ("l", 1, "length_mm")):
        if name in model.layout:
            own = sigma[model.layout[name]].reshape(-1, size)[leg] * model.known.geometry[name]
            own = [float(f"{value:.4g}") for value in own * (1.0 if name == "u" else 1e3)]
            parts[key] = own if size > 1 else own[0]
    return toml_value(parts)


def _targets(extended_model: ExtendedModel) -> list[str]:
    """Return the survey of the targets of base and platform, whose frames are those of the poses."""
    model, bodies = extended_model.model, {kind: body for body, kind in _BODIES.items()}
    found, lines = model.targets, []
    for k, place in enumerate(model.known.shape):
        told: dict[str, Any] = {"body": bodies[int(found.body[k])], "target": found.names[k] if found.names else str(k)}
        told |= {"leg": int(found.leg[k]) + 1} if found.leg[k] >= 0 else {}
        told |= {"place_mm": _mm(place), "sigma_mm": _mm(extended_model.survey_sigma[k])}
        lines.append(f"  {toml_value(told)},")
    return ["", "[survey]", "targets = [", *lines, "]"]


def _names(model: PointModel) -> list[str]:
    legs = range(1, model.nominal.count + 1)
    names: list[str] = []
    for name, parts in (("a", _AXES), ("b", _AXES), ("u", "12"), ("l", " ")):
        if name in model.layout:
            names += [f"{name}{leg}{f'_{part}' if part != ' ' else ''}" for leg in legs for part in parts]
    return names + [p.name for cause in model.causes for p in cause.parameters(model.nominal.count)]


def _mm(metres: Any) -> NDArray:
    """Return metres as millimetres; what is left out is a thousandth of an atom."""
    return np.round(np.asarray(metres, float) * 1e3, 12)


def _from_document(document: dict[str, Any]) -> ExtendedModel:
    if document["format"] != FORMAT:
        raise ValueError(f"model: found format {document['format']!r}, expected {FORMAT}")
    about, effects = document["model"], document.get("effects", [])
    nominal, identified = (
        _legs(about["mechanism"], [leg[kind] for leg in document["legs"]]) for kind in ("nominal", "identified")
    )
    causes = tuple(cause_of(effect, catalogue() | of_photographed_points()) for effect in effects)
    model = _model(document, nominal, causes)
    values = {cause.key: np.array(effect["values"], float) for cause, effect in zip(causes, effects, strict=True)}
    shared = model.unknowns(identified, values)
    context = {key: str(value) for key, value in about.items() if key not in _OWN}
    sigma = np.array([target["sigma_mm"] for target in document["survey"]["targets"]], float) * 1e-3
    covariance = covariance_of(document["covariance"], model.shared_size)
    return ExtendedModel(model, shared, covariance, sigma, context)


def _model(document: dict[str, Any], nominal: Legs, causes: tuple[Cause, ...]) -> PointModel:
    about, listed = document["model"], document["survey"]["targets"]
    targets = Targets(
        np.array([_BODIES[one["body"]] for one in listed], int),
        np.array([one.get("leg", 0) - 1 for one in listed], int),
        tuple(str(one["target"]) for one in listed),
        tuple(str(one["body"]) for one in listed),
    )
    places = np.array([one["place_mm"] for one in listed], float).reshape(-1, 3) * 1e-3
    prior = dict(document["prior"])
    opened = tuple(prior.pop("open"))
    geometry = {name: float(sigma) for name, sigma in prior.items() if sigma > 0}
    known = bare_known(geometry, places, targets, nominal.count, about["reading_sigma_mm"] * 1e-3)
    known = replace(known, open_geometry=opened, reference_temperature_c=about["reference_temperature_c"])
    return PointModel(nominal, targets, known, Conditions(nominal.rho0[None]), causes=causes)


def _legs(kind: str, legs: list[dict[str, Any]]) -> Legs:
    def lengths(name: str) -> NDArray:
        return np.array([leg[name] for leg in legs]) * 1e-3

    found = mechanism(
        kind, lengths("a_mm"), lengths("b_mm"), [leg["u"] for leg in legs], lengths("length_mm"), lengths("rho0_mm")
    )
    return found.replace(u=np.array([leg["u"] for leg in legs], float))
