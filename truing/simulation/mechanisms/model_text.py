"""The extended model of a mechanism as text, see `model_text`: its legs, what was known of them, and its survey.

Lengths are mm. Unknowns come in the order of their names: a, b, u, l leg by leg (u as two tilts across the nominal
direction), effects.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.simulation.catalogue import catalogue, of_photographed_points
from truing.simulation.cause import Cause
from truing.simulation.mechanisms.extended_model import ExtendedModel, bare_known
from truing.simulation.mechanisms.legs.closures import mechanism
from truing.simulation.mechanisms.legs.geometry import Legs
from truing.simulation.mechanisms.model import PointModel
from truing.simulation.mechanisms.unknowns import Conditions
from truing.simulation.model_text import (
    context_of,
    covariance_from,
    effects_of,
    model_text,
    read_document,
    toml_value,
)
from truing.simulation.targets import BASE, PLATFORM, Targets

_AXES = "xyz"
_BODIES = {"base": BASE, "platform": PLATFORM}
_OWN = ("mechanism", "reading_sigma_mm", "reference_temperature_c")


def write_model(extended_model: ExtendedModel) -> str:
    """Return the model as TOML text."""
    model, covariance = extended_model.model, extended_model.covariance
    identified, sigma = model.legs(extended_model.shared), np.sqrt(np.diag(covariance))
    numbers = {
        "mechanism": model.nominal.closure.name,
        "reading_sigma_mm": float(_mm(model.known.reading_sigma)),
        "reference_temperature_c": model.known.reference_temperature_c,
    }
    tables = ["", *_prior(model)]
    for leg in range(model.part_count):
        tables += ["", "[[legs]]", f"nominal = {_leg(model.nominal, leg)}", f"identified = {_leg(identified, leg)}"]
        tables += [f"sigma = {_leg_sigma(model, sigma, leg)}"]
    units, survey = "their prior standard deviations", _targets(extended_model)
    return model_text(extended_model, numbers, tables, survey, names=_names(model), units=units, legs=model.part_count)


def read_model(text: str) -> ExtendedModel:
    """Return the model that a text of `write_model` describes; raises ValueError where it does not describe one."""
    return read_document(text, _from_document)


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
    return names


def _mm(metres: Any) -> NDArray:
    """Return metres as millimetres; what is left out is a thousandth of an atom."""
    return np.round(np.asarray(metres, float) * 1e3, 12)


def _from_document(document: dict[str, Any]) -> ExtendedModel:
    nominal, identified = (
        _legs(document["model"]["mechanism"], [leg[kind] for leg in document["legs"]])
        for kind in ("nominal", "identified")
    )
    effects = effects_of(document, catalogue() | of_photographed_points())
    model = _model(document, nominal, tuple(effect.cause for effect in effects))
    shared = model.unknowns(identified, {effect.cause.key: effect.values for effect in effects})
    sigma = np.array([target["sigma_mm"] for target in document["survey"]["targets"]], float) * 1e-3
    covariance = covariance_from(document, model.shared_size)
    return ExtendedModel(model, shared, covariance, sigma, context_of(document, _OWN))


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
