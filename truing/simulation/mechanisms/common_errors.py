"""What the same error does to everything that was measured, in all poses alike: of a camera, of a scale bar."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import NDArray

from truing.simulation.mechanisms.parameters import SHARED, Parameter


@dataclass(frozen=True)
class CommonErrors:
    """K errors common to all poses, independent and of one standard deviation each: effects (B, N, K), m and rad, on
    what was measured in each pose."""

    effects: NDArray

    @property
    def entries(self) -> tuple[Parameter, ...]:
        """Return the errors as numbers to identify."""
        return tuple(Parameter(f"common{k + 1}", SHARED, "1", 1.0) for k in range(self.effects.shape[-1]))

    def corrected(self, deviation: NDArray, errors: NDArray) -> NDArray:
        """Return deviations (..., B, N) of the truth from the measurement, less what errors (..., K) did to it."""
        return deviation - (self.effects @ errors[..., None, :, None])[..., 0]

    def slopes(self, by_deviation: NDArray) -> NDArray:
        """Return how equations follow the errors, (..., B, M, K), from how they follow deviations (..., B, M, N)."""
        return -by_deviation @ self.effects
