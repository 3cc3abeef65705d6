"""Random courses of an effect over the epochs, as functions of a campaign's inputs."""

from __future__ import annotations

import numpy as np

from truing.inference.arrays import Array
from truing.inference.campaign_inputs import columns_of, in_time_of, is_copy, numbers
from truing.inference.fitted_model import FittedModel
from truing.inference.input_spectra import Spectra
from truing.inference.model import CauseT
from truing.inference.random_functions import (
    MOST_FUNCTIONS,
    SCALES,
    centred,
    level_functions,
    of_unit_variance,
    smooth_functions,
    standard,
)

_MOST_FREE = 400  # with more epochs, courses without any input are not tried


def random_courses(fitted: FittedModel[CauseT]) -> dict[tuple[str, ...], list[Array]]:
    """Return random courses over the epochs as functions (B, m), of unit variance on average, by the inputs followed.

    They are smooth in an input, with its history or without, or linear in all inputs. Courses that follow no input
    walk in the order of the epochs, or have no order.
    """
    groups = fitted.model.error_groups
    columns, whole = columns_of(fitted, groups), np.ones(len(fitted.measured.values), bool)
    spectra = Spectra(columns, in_time_of(fitted, whole))
    found: dict[tuple[str, ...], list[Array]] = {(name,): list(spectra.functions((name,))) for name in columns}
    asked = [own[:, None] for own in map(numbers, fitted.scene.inputs.values()) if own is not None]
    inputs = tuple(name for name, own in columns.items() if any(is_copy(own[:, None], one, None) for one in asked))
    if len(inputs) > 1:
        together = np.column_stack([columns[name] for name in inputs])
        found[inputs] = [standard(together), *([] if (levels := level_functions(together)) is None else [levels])]
    if len(whole) <= _MOST_FREE:
        order = spectra.in_time.order
        walk = [] if order is None else [np.tri(len(whole))[np.argsort(np.argsort(order))]]
        found[()] = [*walk, np.eye(len(whole))]
    return {name: [of_unit_variance(own) for own in several] for name, several in found.items()}


def random_factors(fitted: FittedModel[CauseT]) -> dict[tuple[str, ...], Array]:
    """Return gentle random functions (B, m) of each input, of unit variance on average, by the input."""
    columns = columns_of(fitted, fitted.model.error_groups)
    return {
        (name,): of_unit_variance(centred(next(smooth_functions(own[:, None], MOST_FUNCTIONS, SCALES[-1:]))))
        for name, own in columns.items()
    }
