"""The terms of a calibration: which functions of the inputs a response is a weighted sum of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Powers = Literal["linear", "squares", "products"]


@dataclass(frozen=True)
class Terms:
    """Terms in C inputs x and K covariates z: x always; z itself (``drift``), z x (``gain``), and powers of x.

    ``squares`` adds every x_c^2, ``products`` every x_c x_d as well. The zero is no term: see `CalibrationModel`.
    """

    inputs: tuple[str, ...]
    covariates: tuple[str, ...] = ()
    drift: bool = False
    gain: bool = False
    powers: Powers = "linear"

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the name of each term (P,)."""
        names = list(self.inputs)
        names += list(self.covariates) if self.drift else []
        names += [f"{z} {x}" for z in self.covariates for x in self.inputs] if self.gain else []
        first, second = self._pairs
        return (*names, *(_power(self.inputs[i], self.inputs[j]) for i, j in zip(first, second, strict=True)))

    @property
    def _pairs(self) -> tuple[NDArray, NDArray]:
        count = len(self.inputs)
        if self.powers == "products":
            return np.triu_indices(count)
        every = np.arange(count if self.powers == "squares" else 0)
        return every, every

    def at(self, x: NDArray, z: NDArray) -> NDArray:
        """Return the terms (N, P) at inputs (N, C) and covariates (N, K)."""
        first, second = self._pairs
        parts = [x]
        parts += [z] if self.drift else []
        parts += [(z[:, :, None] * x[:, None]).reshape(len(x), -1)] if self.gain else []
        return np.concatenate([*parts, x[:, first] * x[:, second]], axis=1)

    def by_inputs(self, x: NDArray, z: NDArray) -> NDArray:
        """Return their derivatives (N, P, C) by the inputs."""
        count = len(self.inputs)
        eye, (first, second) = np.eye(count), self._pairs
        parts = [np.broadcast_to(eye, (len(x), count, count))]
        parts += [np.zeros((len(x), z.shape[1], count))] if self.drift else []
        parts += [(z[:, :, None, None] * eye).reshape(len(x), -1, count)] if self.gain else []
        powers = x[:, first, None] * eye[second] + x[:, second, None] * eye[first]
        return np.concatenate([*parts, powers], axis=1)


def _power(first: str, second: str) -> str:
    return f"{first}^2" if first == second else f"{first} {second}"
