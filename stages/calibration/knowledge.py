"""What the campaign's data can know of the parameters, and what swallows an effect that a model leaves out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truing.calibration.fits import Calibration
from truing.calibration.knowledge import absorbed, observe_legs, observe_model
from truing.calibration.measured import Gathered, Measured
from truing.estimation.design.combinations import Inseparable, inseparable
from truing.estimation.design.identifiable_set import choose_identifiable
from truing.estimation.design.observability import Observability, indices
from truing.stages.common.rows import Rows


def observability_rows(gathered: Gathered, fitted: Measured, chosen: Calibration) -> Rows:
    """Return what the data can know: leg by leg of the rigid legs with all their numbers, and of the chosen model."""
    rows = Rows("observability")
    for leg, found in enumerate(observe_legs(gathered, fitted)):
        _add(rows, gathered.machine.legs.closure.name, "linear", leg + 1, found, len(fitted.poses))
    whole = observe_model(gathered, fitted, chosen)
    _add(rows, chosen.case.structure.name, chosen.case.deformation, None, whole, len(fitted.poses))
    return rows


def _add(rows: Rows, model: str, deformation: str, leg: int | None, found: Observability, poses: int) -> None:
    best = choose_identifiable(found.triangle / found.scales, found.scales, found.labels).observability
    figures = {
        "parameters": float(len(found.labels)),
        "rank": float(found.rank),
        "threshold": found.least,
        "condition": best.condition,
        **{name.upper(): value for name, value in vars(indices(best.singular_values, poses)).items() if name[0] == "o"},
    }
    common = {"model": model, "deformation": deformation, "leg": leg, "unit": "1"}
    for name, value in figures.items():
        rows.add(**common, figure=name, value=value if np.isfinite(value) else None)
    rows.add(**common, figure="identifiable_set", value=float(len(best.labels)), combination=" ".join(best.labels))
    for label, sigma in zip(found.labels, found.sigma / found.scales, strict=True):
        rows.add(**common, figure="sigma", value=float(sigma) if np.isfinite(sigma) else None, combination=label)
    for value in found.singular_values:
        rows.add(**common, figure="singular_value", value=float(value))
    for group in inseparable(found):
        for text, sigma in zip(_words(group), group.sigma, strict=False):
            value = float(sigma) if np.isfinite(sigma) else None
            rows.add(**common, figure="unidentifiable", value=value, combination=text)


def _words(group: Inseparable) -> tuple[str, ...]:
    """Return a sentence for the group where one says it all, else one for each change that goes unseen."""
    return group.texts if len(group.seen) > 1 else (group.text,)


def absorption_rows(gathered: Gathered, fitted: Measured, calibrations: Sequence[Calibration]) -> Rows:
    """Return what the parameters of models with less deformation take over of K, predicted and as the fits did it."""
    rows = Rows("absorption")
    known = gathered.deformations.get("matrix")
    if known is None or not np.isfinite(known.K).all():
        return rows
    full = {(c.case.structure.name, c.estimator): c for c in calibrations if c.case.deformation == "matrix"}
    for calibration in calibrations:
        whole = full.get((calibration.case.structure.name, calibration.estimator))
        if calibration.case.deformation != "matrix" and whole is not None:
            _absorbed(rows, gathered, fitted.chosen(calibration.kept & whole.kept), calibration, whole)
    return rows


def _absorbed(rows: Rows, gathered: Gathered, fitted: Measured, calibration: Calibration, whole: Calibration) -> None:
    entries, units = calibration.parameters.entries, calibration.parameters.units
    found = absorbed(gathered, fitted, calibration, whole)
    rows.add(
        effect="platform-deformation-matrix",
        model=calibration.case.structure.name,
        deformation=calibration.case.deformation,
        estimator=calibration.estimator,
        leg=[entry.leg + 1 for entry in entries],
        parameter=[entry.name for entry in entries],
        unit=[entry.unit for entry in entries],
        predicted=found.predicted / units,
        observed=found.observed / units,
        sigma=found.sigma / units,
    )
