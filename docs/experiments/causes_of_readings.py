"""The causes of a sensor on its bench in tables: the second part of docs/causes.md.

    python -m docs.experiments.causes_of_readings

asks every cause for its parameters, and puts their effects on sample_data/force-sensor side by side.
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from docs.experiments.causes import DOCS, LEGS, WHERE, Likeness, Seen, left, parameters, shares_table
from docs.experiments.marked_tables import renew, table
from truing.inference.fit import fit_model
from truing.inference.observations import Frames
from truing.simulation.bench.causes.beams import AbbeOffset, CosineError
from truing.simulation.bench.causes.channels import DeadPath, ThermalDrift, ZeroDrift
from truing.simulation.bench.causes.counts import Crosstalk, FringeSlip
from truing.simulation.bench.causes.load_history import Creep
from truing.simulation.bench.causes.load_path import ASYMMETRY, LoadEccentricity, LoadImbalance
from truing.simulation.bench.causes.signal_nonlinear import CUBIC, QUADRATIC
from truing.simulation.bench.causes.stiffness import (
    Hysteresis,
    JointClearance,
    StiffnessAsymmetry,
    StiffnessNonlinear,
    StiffnessScale,
)
from truing.simulation.bench.load_steps import AIR, CHANNELS, MATERIAL
from truing.simulation.catalogue import OWN_CAUSES_OF_READINGS
from truing.simulation.cause import Cause

CAMPAIGN = DOCS.parent / "sample_data" / "force-sensor"
_CONCERNS = {
    "load-eccentricity": "a load axis, or all forces",
    "load-imbalance": "a load axis",
    "joint-clearance": "a load axis",
    "leg-stiffness": "a leg, or one part of it",
    "zero-drift": "a channel or signal, in all runs or one",
    "thermal-drift": "a channel or signal, or all linear channels",
    "cosine-error": "a channel",
    "abbe-offset": "a linear channel, or all of them",
    "dead-path": "a linear channel, or all of them",
    "fringe-slip": "a linear channel in a run",
    "zero-step": "a rotation, a signal, all displacements or all signals, in a run",
    "crosstalk": "a signal",
    "noise-burst": "all displacements of a run, all signals, or one of them",
    "signal-nonlinear": "a signal, or all",
    "signal-hysteresis": "a load axis, or all",
    "rows-exchanged": "a run, or two",
    "unexplained": "a channel or signal",
}
_FORMS = {
    "play-hysteresis": {"free": True},
    "thermal-drift": {"columns": (MATERIAL, AIR)},
    "signal-nonlinear": {"powers": (QUADRATIC, CUBIC), "loads": ("fx-fy",), "full_scale": (0.01,)},
}
# What is compared, under the load fz and in the channel dz: all that a run up and down may be taken for.
COMPARED: tuple[Cause, ...] = (
    LoadEccentricity("fz"),
    LoadImbalance("fz", ("x",), (ASYMMETRY,)),
    StiffnessScale("fz"),
    StiffnessAsymmetry("fz"),
    StiffnessNonlinear("fz"),
    Hysteresis("fz"),
    JointClearance("fz"),
    Creep("fz", 60.0),
    ZeroDrift("dz"),
    ThermalDrift("dz", (AIR,)),
    CosineError("dz"),
    AbbeOffset("dz"),
    DeadPath("dz"),
    FringeSlip("dz", 15, 10, 10, True),
    Crosstalk("v1", "v2"),
)


def catalogue_table() -> str:
    """Return one row per cause of a bench."""
    rows = []
    for cause in OWN_CAUSES_OF_READINGS:
        fullest = replace(cause, **_FORMS.get(cause.id, {}))
        reported, needs = parameters(fullest), ", ".join(f"`{name}`" for name in fullest.needs(LEGS))
        if not cause.catalogued:
            reported, needs = "`degree1` .. four sigmas of the channel", "what it follows"
        rows.append(
            [f"`{cause.id}`", WHERE[cause.step], _CONCERNS.get(cause.id, "a load axis, or all"), reported, needs]
        )
    return table(
        ["id", "step", "may concern", "parameters as fitted, plausible size", "needs in addition to loads"], rows
    )


@cache
def _campaign() -> Seen:
    """Return the sample campaign's plain model, fitted to what was read."""
    from tests.stages.line import run_line
    from truing.schemas.campaign import read_campaign
    from truing.stages.diagnosis.reading_points import assemble_readings

    settings = read_campaign(tomllib.loads((CAMPAIGN / "campaign.toml").read_text(encoding="utf-8")))
    gathered = assemble_readings(run_line(CAMPAIGN, "ingest")[0], settings)
    return _fitted(gathered.model, gathered.calibration.measured)


def _fitted(model: object, measured: object) -> Seen:
    steps = len(measured.is_observed)  # type: ignore[attr-defined]
    start = np.zeros(model.shared_size), np.zeros((steps, model.local_size))  # type: ignore[attr-defined]
    frames = Frames.of_numbers(steps)
    return Seen(model, measured, fit_model(model.predict, measured, frames, *start))


@cache
def likeness(*, own: bool) -> Likeness:
    """Return the signal of each cause in the campaign, and the share of it that remains after each rival's fit.

    ``own``: each load is observed by its own channel alone.
    """
    campaign = _campaign()
    if own:
        alone = campaign.measured.is_observed.copy()
        load = campaign.model.conditions.readings
        alone[:, : len(CHANNELS)] &= load != 0.0
        alone[:, len(CHANNELS) :] = False
        campaign = _fitted(campaign.model, replace(campaign.measured, is_observed=alone))
    effects = [campaign.effect(cause) for cause in COMPARED]
    signal = np.array([np.linalg.norm(of) for of in effects])
    shares = np.array([[left(of, rival) if _shows(of) else np.nan for rival in effects] for of in effects])
    return Likeness(signal, shares)


def _shows(effect: NDArray) -> bool:
    return bool(np.linalg.norm(effect) > 1e-3)


def likeness_table(*, own: bool) -> str:
    """Return the signals, and the shares in per cent, small ones in bold."""
    return shares_table([f"`{cause.id}`" for cause in COMPARED], likeness(own=own), _sigmas)


def _sigmas(signal: float) -> str:
    return f"{signal:.0f}" if signal >= 9.5 else f"{signal:.1g}" if signal > 1e-3 else "0"


TABLES = {
    "catalogue-of-readings": catalogue_table,
    "likeness-of-readings": lambda: likeness_table(own=False),
    "likeness-of-own-channels": lambda: likeness_table(own=True),
}

if __name__ == "__main__":
    renew(DOCS / "causes.md", TABLES)
