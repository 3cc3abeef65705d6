"""The catalogue of causes in tables: docs/causes.md.

    python -m docs.experiments.causes

asks every cause for its parameters, and puts their effects on sample_data/telescope side by side: how much of one is
left when another has imitated it as well as it can.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from docs.experiments.marked_tables import renew, table
from truing.inference.fit import Fit, fit_model
from truing.inference.observations import Observations, whitened_columns
from truing.simulation.bodies.causes.deformation import BodyDeformation
from truing.simulation.bodies.causes.drift import BodyDrift
from truing.simulation.bodies.causes.gravity import GravitySag
from truing.simulation.bodies.causes.jump import BodyJump
from truing.simulation.catalogue import OWN_CAUSES, catalogue
from truing.simulation.cause import Cause, Step
from truing.simulation.mechanisms.causes.leg_drift import LegDrift
from truing.simulation.mechanisms.causes.measurement_scale import PER_KELVIN, MeasurementScale
from truing.simulation.mechanisms.causes.per_leg import PerLeg
from truing.simulation.mechanisms.causes.warmth import APART

if TYPE_CHECKING:
    from truing.simulation.mechanisms.model import MechanismModel
    from truing.stages.diagnosis.diagnosis_data import DiagnosisData

DOCS = Path(__file__).resolve().parents[1]
CAMPAIGN = DOCS.parent / "sample_data" / "telescope"
LEGS = 6
WHERE = {Step.DRIVE: "drive", Step.STRUCTURE: "structure", Step.INSTRUMENT: "instrument"}
_CORNERS = (-0.1, -0.1, 0.0, 0.1, -0.1, 0.0, 0.1, 0.1, 0.0, -0.1, 0.1, 0.05)
# Causes that need a subject before they describe an effect.
_MARKS = ("T1", "T2", "T3", "T4")
EXAMPLES: dict[str, Cause] = {
    "body-deformation": BodyDeformation(
        "B", _MARKS, _CORNERS, terms=("temperature_c",), columns=("temperature_c",), zeros=(20.0,), ranges=(5.0,)
    ),
    "body-drift": BodyDrift("B", _MARKS, _CORNERS),
    "body-jump": BodyJump("B", _MARKS, _CORNERS),
    "gravity-sag": GravitySag("B", _MARKS, _CORNERS),
}
_FORMS = {"thermal-expansion": {"form": APART}, "measurement-scale": {"form": "both"}}
# What is compared: single targets and exchanged labels are like nothing else, bodies have no legs, a scatter has no
# mean, sudden shifts have any onset, and nothing tells what the sample campaign's legs carry, which stood still.
_ALONE = (
    "actuator-zero-shift",
    "body-jump",
    "leg-compliance",
    "reading-lag",
    "target-moved",
    "targets-swapped",
    "body-deformation",
    "body-drift",
    "gravity-sag",
    "approach-scatter",
    "noise-burst",
    "unexplained",
)
# A share of its signal that a rival leaves, below which a cause is taken for it.
ALIKE = 0.2


def example(name: str) -> Cause:
    """Return an instance of a cause of the catalogue that concerns something."""
    return EXAMPLES.get(name, catalogue()[name])


def parameters(cause: Cause) -> str:
    """Return names, units and plausible sizes of a cause's parameters, those of several legs or targets in one."""
    fullest = replace(cause, **_FORMS.get(cause.id, {}))
    sized: dict[str, str] = {}
    for entry in fullest.parameters(LEGS):
        unit = "" if entry.unit == "1" else f" {entry.unit}"
        sized.setdefault(_stem(entry.name), f"{float(f'{entry.scale / entry.si:.2g}'):g}{unit}")
    by_size: dict[str, list[str]] = {}
    for stem, size in sized.items():
        by_size.setdefault(size, []).append(f"`{stem}`")
    return "; ".join(f"{', '.join(stems)} {size}" for size, stems in by_size.items()) or "none"


def _stem(name: str) -> str:
    """Return a parameter's name without the leg or target that it is of."""
    name = re.sub(r"^K\d+$", "K11 .. K66", name)
    name = re.sub(r"^leg\d+_degree\d+$", "leg1_degree1 ..", name)
    return re.sub(r"_\d+$", "", re.sub(r"^T\d+_", "T1_", name))


def concerns(cause: Cause) -> str:
    """Return the possible subjects of a cause, in words."""
    names = {f.name for f in fields(cause)}
    if cause.id == "unexplained":
        return "legs, single targets, a body's targets, the scale"
    if {"body", "one"} <= names:
        return "a body, or a target"
    if {"body", "form"} <= names:
        return "the whole, or a body"
    if {"body", "legs"} <= names:
        return "all legs, or any of them, or a body"
    if "body" in names:
        return "two targets" if cause.id == "targets-swapped" else "a target" if "target" in names else "a body"
    return "all legs, or any of them" if isinstance(cause, PerLeg) else "the whole"


def catalogue_table() -> str:
    """Return one row per cause of the catalogue."""
    rows = []
    for own in OWN_CAUSES:
        cause = example(own.id)
        needs = ", ".join(f"`{name}`" for name in cause.needs(LEGS)) if cause.catalogued else "what it follows"
        rows.append([f"`{cause.id}`", WHERE[cause.step], concerns(cause), parameters(cause), needs])
    return table(
        ["id", "step", "may concern", "parameters as fitted, plausible size", "needs in addition to readings"], rows
    )


@cache
def _gathered() -> DiagnosisData:
    """Return the assembled data of the sample campaign, as the diagnosis reads them."""
    from tests.stages.line import run_line
    from truing.schemas.campaign import read_campaign
    from truing.stages.diagnosis.mechanism_points import assemble

    settings = read_campaign(tomllib.loads((CAMPAIGN / "campaign.toml").read_text(encoding="utf-8")))
    return assemble(run_line(CAMPAIGN, "ingest", "pose")[0], settings)


@dataclass(frozen=True)
class Seen:
    """The plain model of the sample campaign fitted to the points that are looked at."""

    model: MechanismModel
    measured: Observations
    fit: Fit

    def effect(self, cause: Cause) -> NDArray:
        """Return the effect (N, P) of plausible parameters on what was measured, nuisances refitted, in sigmas."""
        wider = self.model.with_causes((cause,))
        found = wider.predict(self.model.embedded(self.fit.shared, wider), self.fit.local)
        slopes = found.by_shared if found.zero_columns is None else found.zero_columns.before(found.by_shared)
        scale = np.array([parameter.scale for parameter in cause.parameters(LEGS)]) / wider.effect_sigma(cause)
        own = slopes[..., wider.layout[cause.key]] * scale
        return self._without_nuisances(whitened_columns(self.measured, self.fit.frames, own))

    def _without_nuisances(self, columns: NDArray) -> NDArray:
        """Return columns (B, M, P) of the points as rows (N, P) of all that is fitted, less what nuisances explain."""
        whitened = self.fit.whitened
        priors = np.zeros((len(columns), whitened.problem.local_value.shape[1], columns.shape[-1]))
        of_poses = whitened.without_local(np.concatenate([columns, priors], 1)).reshape(-1, columns.shape[-1])
        rows = np.zeros((len(whitened.residual), columns.shape[-1]))
        rows[: len(of_poses)] = of_poses
        return rows - whitened.basis @ (whitened.basis.T @ rows)


def seen(bare: bool) -> Seen:
    """Return the campaign as measured, or ``bare``: without the targets on attachments and legs."""
    gathered = _gathered()
    model, poses = gathered.model, gathered.calibration
    own = (model.targets.leg < 0) | (not bare)
    measured = replace(poses.measured, is_observed=poses.measured.is_observed & own)
    start = np.zeros(model.shared_size), np.zeros((len(poses.frames.t), model.local_size))
    return Seen(model, measured, fit_model(model.predict, measured, poses.frames, *start))


def compared() -> tuple[Cause, ...]:
    """Return the causes to compare, each for all legs; the measurement scale also per kelvin."""
    start, end = _gathered().model.conditions.span_s
    evenly = {"leg-drift": LegDrift((), start, end - start)}
    known = [evenly.get(cause.id, cause) for cause in OWN_CAUSES if cause.id not in _ALONE]
    return (*known, MeasurementScale(PER_KELVIN))


def left(of: NDArray, rival: NDArray) -> float:
    """Return the share of an effect's size that is left once a rival has imitated it as well as it can."""
    basis, strengths, _ = np.linalg.svd(rival, full_matrices=False)
    basis = basis[:, strengths > 1e-6 * strengths[0]]
    return float(np.linalg.norm(of - basis @ (basis.T @ of)) / np.linalg.norm(of))


@dataclass(frozen=True)
class Likeness:
    """Signals (C,), in sigmas, of causes of plausible size.

    left (C, C): share of each signal (row) that remains after the fit of a rival (column).
    """

    signal: NDArray
    left: NDArray


@cache
def likeness(bare: bool) -> Likeness:
    """Return the signal of each cause in a campaign, and the share of it that remains after each rival's fit."""
    campaign = seen(bare)
    effects = [campaign.effect(cause) for cause in compared()]
    shares = np.array([[left(of, rival) for rival in effects] for of in effects])
    return Likeness(np.array([np.linalg.norm(of) for of in effects]), shares)


def likeness_table(bare: bool) -> str:
    """Return the signals, and the shares in per cent, small ones in bold."""
    per_kelvin = MeasurementScale(PER_KELVIN)
    names = [f"`{cause.id}`{' per K' if cause == per_kelvin else ''}" for cause in compared()]
    return shares_table(names, likeness(bare), lambda signal: f"{signal:.0f}" if signal >= 10.0 else f"{signal:.2g}")


def shares_table(names: Sequence[str], found: Likeness, sigmas: Callable[[float], str]) -> str:
    """Return the table of signals, and of the share of each cause (row) that remains after a rival's fit, per cent."""
    numbers, rows = range(1, len(names) + 1), []
    for n, name in zip(numbers, names, strict=True):
        shares = ["" if k == n else _cell(found.left[n - 1, k - 1]) for k in numbers]
        rows.append([f"{n} {name}", sigmas(found.signal[n - 1]), *shares])
    return table(["hidden, and in its place", "sigma", *map(str, numbers)], rows)


def _cell(share: float) -> str:
    if np.isnan(share):
        return "–"
    reported = f"{100 * share:.0f}"
    return f"**{reported}**" if share < ALIKE else reported


TABLES = {
    "catalogue": catalogue_table,
    "likeness": lambda: likeness_table(bare=False),
    "likeness-bare": lambda: likeness_table(bare=True),
}

if __name__ == "__main__":
    renew(DOCS / "causes.md", TABLES)
