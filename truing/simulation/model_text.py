"""Writing and reading of model.toml: an identified model as TOML, with all numbers in full precision.

All models share the head, the effects and the covariance of all unknowns. An effect has its settings and SI values for
the program, and its parameters in the units of the tables for people. A mechanism or sensor adds tables of its own.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from truing.schemas.settings_text import Document, parsed_toml
from truing.simulation.cause import CauseT, Effect
from truing.simulation.effects_model import consecutive_slices

FORMAT = 2
Read = TypeVar("Read")


class IdentifiedModel(Protocol[CauseT]):
    """An identified model that can be written: its effects, and the covariance of all unknowns."""

    @property
    def context(self) -> dict[str, str]:
        """Origin of the model, in words for people."""

    @property
    def covariance(self) -> NDArray:
        """Covariance (G, G) of all unknowns; effects come last."""

    @property
    def effects(self) -> tuple[Effect[CauseT], ...]:
        """Effects that were found."""

    def covariance_of(self, cause: CauseT) -> NDArray:
        """Return the covariance (P, P) of an effect's parameters, SI."""


@dataclass(frozen=True, kw_only=True)
class IdentifiedInSI(Generic[CauseT]):
    """Identified numbers and effects with their joint covariance (G, G) in this order, SI, at the estimated noise.

    ``context``: origin of the model, in words.
    """

    effects: tuple[Effect[CauseT], ...]
    covariance: NDArray
    context: dict[str, str]

    @property
    def causes(self) -> tuple[CauseT, ...]:
        """Causes of the effects."""
        return tuple(effect.cause for effect in self.effects)

    @cached_property
    def layout(self) -> dict[str, slice]:
        """Slices of the covariance: ``own`` for the identified numbers, then one per effect by its key."""
        sizes = {effect.cause.key: len(effect.values) for effect in self.effects}
        return consecutive_slices({"own": len(self.covariance) - sum(sizes.values()), **sizes})

    def places(self, causes: Sequence[CauseT]) -> NDArray:
        """Return the indices of the identified numbers and of the parameters of some effects in the covariance."""
        return np.concatenate([np.r_[self.layout[name]] for name in ("own", *(cause.key for cause in causes))])

    def covariance_of(self, cause: CauseT) -> NDArray:
        """Return the covariance (P, P) of an effect's parameters, SI."""
        part = self.layout[cause.key]
        return self.covariance[part, part]


def model_text(
    model: IdentifiedModel[CauseT],
    numbers: Mapping[str, object],
    tables: Sequence[str],
    after: Sequence[str],
    *,
    names: Sequence[str],
    units: str,
    legs: int,
) -> str:
    """Return a model as TOML; ``tables`` and ``after`` are lines before and after the effects.

    ``names`` are the unknowns before those of the effects; ``units`` is the unit of all unknowns.
    """
    about = [f"{toml_key(key)} = {toml_value(value)}" for key, value in {**model.context, **numbers}.items()]
    lines = [f"format = {FORMAT}", "", "[model]", *about, *tables]
    for effect in model.effects:
        lines += _effect_lines(effect, model.covariance_of(effect.cause), legs)
    every = [*names, *(p.name for effect in model.effects for p in effect.cause.parameters(legs))]
    return "\n".join([*lines, *after, *_covariance_lines(every, model.covariance, units)]) + "\n"


def read_document(text: str, made: Callable[[dict[str, object]], Read]) -> Read:
    """Parse the text of a model and return ``made(document)``; raises ValueError if the text is no model."""
    try:
        document = parsed_toml(text)
        if document["format"] != FORMAT:
            raise ValueError(f"model: found format {document['format']!r}, expected {FORMAT}")
        return made(document)
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"model: found no usable {error}, expected what `truing run` writes as model.toml") from error


def describes(document: dict[str, object], mechanism: str) -> bool:
    """True if a parsed model.toml describes this kind of mechanism."""
    about = document.get("model", {})
    return isinstance(about, dict) and about.get("mechanism") == mechanism


def effects_of(document: Document, known: Mapping[str, CauseT]) -> tuple[Effect[CauseT], ...]:
    """Return the effects of a parsed model; raises ValueError if no installed package defines a cause."""
    reported = document.get("effects", [])
    return tuple(Effect(_cause_of(effect, known), np.array(effect["values"], float)) for effect in reported)


def context_of(document: Document, numbers: Collection[str]) -> dict[str, str]:
    """Return the origin of a model: its head without ``numbers``."""
    return {key: str(value) for key, value in document["model"].items() if key not in numbers}


def _effect_lines(effect: Effect[CauseT], covariance: NDArray, legs: int) -> list[str]:
    """Return the TOML lines of an effect: settings and SI values for the program, parameters for people."""
    cause = effect.cause
    settings = {name: value for name, value in cause.settings().items() if value is not None}
    lines = ["", "[[effects]]", f"cause = {toml_value(cause.id)}", f"subject = {toml_value(cause.subject)}"]
    lines += [
        f"settings = {toml_value(settings)}",
        f"values = {toml_value(exact(effect.values))}",
        "[effects.parameters]",
    ]
    for reported in cause.reported(effect.values, covariance, legs):
        value = float(f"{reported.value:.10g}") if isinstance(reported.value, float) else reported.value
        sigma = {} if reported.sigma is None else {"sigma": float(f"{reported.sigma:.4g}")}
        lines.append(f"{toml_key(reported.name)} = {toml_value({'value': value, **sigma, 'unit': reported.unit})}")
    return lines


def _cause_of(effect: Document, known: Mapping[str, CauseT]) -> CauseT:
    """Return the cause with its settings; raises ValueError if no installed package defines it."""
    if effect["cause"] not in known:
        raise ValueError(f"model: found cause {effect['cause']!r}, expected one of {', '.join(known)}")
    return known[effect["cause"]].with_settings(**{name: _frozen(v) for name, v in effect["settings"].items()})


def _covariance_lines(names: Sequence[str], covariance: NDArray, units: str) -> list[str]:
    """Return the covariance of the unknowns, in the given units, as lines of a TOML table."""
    head = f"[covariance]  # of the unknowns in {units}, lower triangle"
    rows = [f"  {toml_value(row[: i + 1])}," for i, row in enumerate(covariance)]
    return ["", head, f"names = {toml_value(list(names))}", "rows = [", *rows, "]"]


def covariance_from(document: Document, size: int) -> NDArray:
    """Return the covariance (size, size) of a parsed model; raises ValueError if it has another size."""
    table = document["covariance"]
    lower = np.zeros((size, size))
    if len(table["rows"]) != size:
        raise ValueError(f"model: found {len(table['rows'])} rows of covariance, expected {size}")
    for i, row in enumerate(table["rows"]):
        lower[i, : i + 1] = row
    return lower + np.tril(lower, -1).T


def exact(values: NDArray) -> list[float]:
    """Round numbers to 15 digits, which survive scaling to other units and back."""
    return [float(f"{value:.15g}") for value in values]


def toml_key(name: str) -> str:
    """Name as a TOML key, quoted where it has to be."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def toml_value(value: Any) -> str:
    """Return a value as TOML text."""
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if isinstance(value, str):
        return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{toml_key(key)} = {toml_value(item)}' for key, item in value.items())} }}"
    if isinstance(value, list | tuple) or np.ndim(value):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    return repr(int(value)) if isinstance(value, int | np.integer) else repr(float(value))


def _frozen(value: object) -> object:
    return tuple(_frozen(item) for item in value) if isinstance(value, list) else value
