"""Gaussian processes of sets of inputs, by the eigenvectors of their covariances at the epochs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from truing.inference.arrays import Array, Integers
from truing.inference.campaign_inputs import InTime, time_columns
from truing.inference.evidence import SizedEffect, sized_effect
from truing.inference.random_functions import (
    MOST_FUNCTIONS,
    SCALES,
    centred,
    level_functions,
    orthonormal,
    rough_functions,
    smooth_functions,
    standard,
)

EFFECT_SIZES = (10.0, 10 / 3, 10 / 9, 1 / 3, 1 / 9)  # plausible sizes of an effect, in units of the noise
_SCALES_OF_TIME = 0.1, 0.25, 0.5, 0.9, 1.6  # time has finer length scales, for drifts and walks
_LOOK_BACK = 0.5  # plausible effect of an input's history, relative to that of the input
_LEAST_VARIANCE = 1e-6  # variances along eigenvectors below this share of the largest are dropped


@dataclass(frozen=True)
class Spectrum:
    """Eigenvectors of the covariance of a random function at the epochs, and the roots (r,) of its eigenvalues.

    The function has unit variance on average. The eigenvectors are ``functions`` (n, m), free of what is held, times
    ``weights`` (m, r).
    """

    functions: Array
    weights: Array
    strengths: Array

    @cached_property
    def of_sizes(self) -> SizedEffect:
        """The evidence for functions of plausible sizes, as far as it does not depend on residuals."""
        return sized_effect(self.strengths, EFFECT_SIZES)

    def along(self, rest: Array) -> Array:
        """Return the parts (r, q) of residuals (n, q) along the eigenvectors; the residuals are free of what is held,
        so the functions need not be."""
        return np.asarray(self.weights.T @ (self.functions.T @ rest))


@dataclass(frozen=True)
class Spectra:
    """Spectra of functions of sets of inputs; ``held`` (n, h) are orthonormal functions from which they are free."""

    columns: Mapping[str, Array]
    in_time: InTime
    held: Array | None = None
    # Functions of each set of inputs, which do not depend on what is held: made once for all spectra.
    made: dict[tuple[str, ...], list[Array]] = field(default_factory=dict, repr=False)
    products: dict[tuple[str, ...], list[Array]] = field(default_factory=dict, repr=False)  # (m, m), of the same

    def of(self, inputs: tuple[str, ...]) -> list[Spectrum]:
        """Return the spectra of a set of inputs, one for each length scale, and for the history of a single input."""
        if inputs not in self._known:
            functions_and_products = zip(self.functions_of(inputs), self._products_of(inputs), strict=True)
            possible_spectra = (self._spectrum(*each) for each in functions_and_products)
            self._known[inputs] = [spectrum for spectrum in possible_spectra if spectrum is not None]
        return self._known[inputs]

    def functions_of(self, inputs: tuple[str, ...]) -> list[Array]:
        """Return the functions (n, m) of a set of inputs, as `functions` yields them; made once."""
        if inputs not in self.made:
            self.made[inputs] = list(self.functions(inputs))
        return self.made[inputs]

    def _products_of(self, inputs: tuple[str, ...]) -> list[Array]:
        """Return the products (m, m) of each of the functions of a set of inputs, centred; made once."""
        if inputs not in self.products:
            centred_functions = map(centred, self.functions_of(inputs))
            self.products[inputs] = [columns.T @ columns for columns in centred_functions]
        return self.products[inputs]

    def beyond(self, functions: Array) -> Spectra:
        """Return the spectra free of further functions (n, m)."""
        columns = functions if self.held is None else np.column_stack([self.held, functions])
        return Spectra(self.columns, self.in_time, orthonormal(columns), self.made, self.products)

    def free(self, rows: Array) -> Array:
        """Return rows (n, m), centred, without the functions that are held fixed."""
        centred_rows = centred(rows)
        return centred_rows if self.held is None else centred(centred_rows - self.held @ (self.held.T @ centred_rows))

    @property
    def freedom(self) -> int:
        """Degrees of freedom of residuals."""
        return len(next(iter(self.columns.values()))) - 1 - (0 if self.held is None else self.held.shape[1])

    def functions(self, inputs: tuple[str, ...]) -> Iterator[Array]:
        """Yield functions (n, m) whose products are the covariances of a set of inputs."""
        input_columns = np.column_stack([self.columns[name] for name in inputs])
        is_time = len(inputs) == 1 and inputs[0] in self._timed
        smooth = list(smooth_functions(input_columns, MOST_FUNCTIONS, _SCALES_OF_TIME if is_time else SCALES))
        yield from smooth
        if is_time and self.in_time.order is not None:
            yield from rough_functions(self.in_time.order, MOST_FUNCTIONS)
        if not is_time and (levels := level_functions(input_columns)) is not None:
            yield levels
        if len(inputs) == 1 and not is_time and (history := self.in_time.history(input_columns[:, 0])) is not None:
            past = _LOOK_BACK * standard(history)
            yield past
            yield np.column_stack([smooth[1], past])

    def _spectrum(self, functions: Array, products: Array) -> Spectrum | None:
        """Return the spectrum of functions (n, m) with products (m, m), None if the held functions explain them.

        The held functions are orthonormal and centred, so products with them take their part out of the others."""
        along_held = None if self.held is None else self.held.T @ functions
        values, vectors = np.linalg.eigh(products if along_held is None else products - along_held.T @ along_held)
        # What the held functions explain is no new function.
        is_large = values > _LEAST_VARIANCE * max(values[-1], float(np.trace(products)))
        if not is_large.any():
            return None
        unit = values[is_large] / values[is_large].sum() * len(functions)
        return Spectrum(functions, vectors[:, is_large] / np.sqrt(values[is_large]), np.sqrt(unit))

    def vectors(self, spectrum: Spectrum, chosen: Integers) -> Array:
        """Return some eigenvectors (n, k) of a spectrum."""
        return self.free(spectrum.functions) @ spectrum.weights[:, chosen]

    @cached_property
    def _timed(self) -> frozenset[str]:
        return time_columns(self.columns, self.in_time)

    @cached_property
    def _known(self) -> dict[tuple[str, ...], list[Spectrum]]:
        return {}
