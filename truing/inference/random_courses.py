"""Random courses of an effect over the epochs, as functions of a campaign's inputs."""

from __future__ import annotations

import numpy as np

from truing.inference.arrays import Array, Integers
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

_MOST_FREE = 1000  # with more epochs, courses without any input are not tried


def random_courses(fitted: FittedModel[CauseT]) -> dict[tuple[str, ...], list[Array]]:
    """Return random courses over the epochs as functions (B, m), of unit variance on average, by the inputs followed.

    They are smooth in an input, with its history or without, or linear in all inputs. Courses that follow no input
    walk in the order of the epochs, or have no order.
    """
    groups = fitted.model.error_groups
    columns, whole = columns_of(fitted, groups), np.ones(len(fitted.measured.values), bool)
    spectra = Spectra(columns, in_time_of(fitted, whole))
    by_inputs: dict[tuple[str, ...], list[Array]] = {(name,): list(spectra.functions((name,))) for name in columns}
    asked = [column[:, None] for column in map(numbers, fitted.scene.inputs.values()) if column is not None]
    inputs = tuple(
        name for name, column in columns.items() if any(is_copy(column[:, None], varied, None) for varied in asked)
    )
    if len(inputs) > 1:
        together = np.column_stack([columns[name] for name in inputs])
        by_inputs[inputs] = [standard(together), *([] if (levels := level_functions(together)) is None else [levels])]
    if len(whole) <= _MOST_FREE:
        order = spectra.in_time.order
        walk = [] if order is None else [_walk(np.argsort(np.argsort(order)), groups)]
        by_inputs[()] = [*walk, np.eye(len(whole))]
    return {name: [of_unit_variance(shapes) for shapes in several] for name, several in by_inputs.items()}


def _walk(rank: Integers, groups: Integers | None) -> Array:
    """Return functions (B, B) whose random sums are walks by the rank (B,) in time, anew in each of the ``groups``."""
    walk = (rank[:, None] >= rank).astype(float)
    return walk if groups is None else walk * (groups[:, None] == groups)


def random_factors(fitted: FittedModel[CauseT]) -> dict[tuple[str, ...], Array]:
    """Return gentle random functions (B, m) of each input, of unit variance on average, by the input."""
    columns = columns_of(fitted, fitted.model.error_groups)
    return {
        (name,): of_unit_variance(centred(next(smooth_functions(column[:, None], MOST_FUNCTIONS, SCALES[-1:]))))
        for name, column in columns.items()
    }
