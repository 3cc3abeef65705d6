"""The model of a search in some epochs of a long campaign, fitted to all of them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from truing.inference.fitter import Fitter

if TYPE_CHECKING:
    from truing.inference.selection import CauseDiagnosis
    from truing.stages.diagnosis.diagnosis_data import DiagnosisData


def fitted_to_all(
    diagnosis: CauseDiagnosis, data: DiagnosisData[Any], seed: int
) -> tuple[CauseDiagnosis, DiagnosisData[Any]]:
    """Diagnosis and data of all epochs: the same causes, with plain and final model fitted to all of them.

    Unchanged if all were searched, or if the search weighted its epochs by noise that depends on something or by inputs
    that scatter: these weights are known only for its own epochs.
    """
    every = data.every_epoch
    if every is None or diagnosis.noise_dependences or diagnosis.scatters:
        return diagnosis, data
    fitter = Fitter(every.model, every.calibration, every.held_out, seed)
    causes = diagnosis.final.causes
    final = fitter.fitted(causes, diagnosis.final)
    screened = fitter.screen(final)
    if fitter.learn_noise(final) or screened:
        final = fitter.fitted(causes, final)
    final = fitter.predicted(final)
    plain = fitter.comparable(diagnosis.plain.causes, final)
    whole = replace(diagnosis, plain=plain, final=final, held_out=fitter.held_out, screened=tuple(fitter.screened))
    return whole, every
