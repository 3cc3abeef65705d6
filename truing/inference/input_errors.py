"""Errors of inputs that follow their own input and its history, as friction with memory does.

Where the observations of an epoch determine the errors of all its inputs, each error is a course of its own: errors of
other inputs do not leak into it. So its pattern is known, and friction has to be told only from other courses of the
same input's error.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from truing.inference.arrays import Array
from truing.inference.fitted_model import FittedModel
from truing.inference.input_sets import INCLUDED, clipped, explained, log_evidence_of_spectrum, log_odds_of_sets
from truing.inference.input_spectra import Spectra
from truing.inference.model import CauseT
from truing.inference.random_functions import centred

_OWN_HISTORY = 0.5  # prior probability of friction among all that an input's error may follow
_DETERMINED = 1e-6  # least eigenvalue of an epoch's information on its inputs, over the largest


def input_errors(fitted: FittedModel[CauseT]) -> Array | None:
    """Return the errors (B, n) of the inputs that the observations of each epoch determine without any prior, in prior
    sigmas; None where they do not determine all of them."""
    problem, rows = fitted.fit.whitened.problem, fitted.input_rows
    if rows.stop - rows.start != len(fitted.scene.inputs) or not len(fitted.scene.inputs):
        return None
    own, others = problem.by_local[..., rows], np.delete(problem.by_local, np.arange(rows.start, rows.stop), axis=-1)
    if others.shape[-1]:
        basis, size, _ = np.linalg.svd(others, full_matrices=False)
        basis = basis * (size > _DETERMINED * size[:, :1])[:, None]
        own = own - basis @ (np.swapaxes(basis, 1, 2) @ own)
    information = np.swapaxes(own, 1, 2) @ own
    values = np.linalg.eigvalsh(information)
    if not np.all(values[:, 0] > _DETERMINED * values[:, -1]):
        return None
    moved = np.linalg.solve(information, np.swapaxes(own, 1, 2) @ problem.residual[..., None])[..., 0]
    return np.asarray(problem.local_value[:, rows] + moved)


def own_histories(
    errors: Array, names: tuple[str, ...], spectra: Spectra, level: float
) -> Iterator[tuple[str, float, float]]:
    """Yield the inputs whose errors (B, n) depend on their own input and its history. Also yield the share of squares
    predicted, and the p-value of any dependence."""
    for name, course in zip(names, errors.T, strict=True):
        rest, others = clipped(centred(course[:, None])), np.log1p(-_OWN_HISTORY)
        evidence = [float(log_evidence_of_spectrum(rest, one, spectra.freedom)[0]) for one in spectra.histories(name)]
        if not evidence:
            continue
        history = np.log(_OWN_HISTORY) + np.logaddexp.reduce(evidence) - np.log(len(evidence))
        own = np.logaddexp(history, others + log_odds_of_sets(rest, spectra, 1)[name,])
        if own < np.log(INCLUDED) - np.log(level):  # whatever else it may follow
            continue
        every = np.logaddexp.reduce([history, *(others + np.array(list(log_odds_of_sets(rest, spectra).values())))])
        _, squares = explained(rest, spectra, (name,))
        if every >= -np.log(level) and own - every >= np.log(INCLUDED) and squares > 0.0:
            yield name, min(1.0, squares / float(np.sum(rest**2))), float(np.exp(-every))
