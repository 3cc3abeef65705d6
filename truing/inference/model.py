"""What a model brings to be fitted, and to take up causes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from numpy.typing import NDArray

# The pathway on which a cause acts on the observations themselves, whose motions are the identity.
OBSERVED = "observed"


class Predicted(Protocol):
    """What a model returns: observations (B, K, d), SI, in its own frame, derivatives, whitened rows that concern no
    epoch."""

    values: NDArray
    by_shared: NDArray  # (B, K, d, G)
    by_local: NDArray  # (B, K, d, H)
    known_residual: NDArray  # (E,)
    known_by_shared: NDArray  # (E, G)
    shared_known: NDArray  # (G,) whose prior is knowledge
    local_known: NDArray  # (H,)


class Model(Protocol):
    """A model of observations; unknowns are counted in standard deviations of their priors."""

    @property
    def zero_groups(self) -> NDArray | None:
        """Return which inputs (B, K) share a zero, by number, -1 for none; None where observations have frames."""

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Predicted:
        """Return observations and derivatives at shared (G,) and local (B, H) unknowns; by the shared ones if asked
        for."""


class CausalModel(Protocol):
    """A model of observations that can take up causes; each brings parameters and a design per pathway."""

    @property
    def layout(self) -> dict[str, slice]:
        """Return where each kind of shared unknown stands; effects by their key, the survey as ``shape``."""

    @property
    def local_size(self) -> int:
        """Return the number of local unknowns H."""

    @property
    def unpredicted(self) -> NDArray:
        """Return which local unknowns (H,) the model does not claim to predict."""

    @property
    def groups(self) -> NDArray:
        """Return the number of each channel's group (K,)."""

    @property
    def part_count(self) -> int:
        """Return the number of like parts L, each of which has parameters of its own in some causes."""

    @property
    def zero_groups(self) -> NDArray | None:
        """Return which inputs (B, K) share a zero, by number, -1 for none; None where observations have frames."""

    @property
    def error_groups(self) -> NDArray | None:
        """Return which epochs (B,) err together, by number: those of a run; None where each stands for itself."""

    @property
    def split(self) -> Any:
        """Return which shared unknowns split into what is common to all parts and each part's own; None where none
        do."""

    @property
    def blocks(self) -> NDArray | None:
        """Return which epochs (B,) can be left out of a fit together, by number in time; None where none can be, since
        they would have to be predicted from others before and after."""

    @property
    def scene(self) -> Any:
        """Return what the campaign offers to causes."""

    def with_causes(self, causes: Sequence[Any]) -> Any:
        """Return the model with these causes among its unknowns."""

    def at(self, conditions: Any) -> Any:
        """Return the model at other epochs."""

    def rescaled(self, inputs: float, survey: float) -> Any:
        """Return the model with the noise of inputs and survey so many times as large."""

    def with_share(self, share: float) -> Any:
        """Return the model with another share of what splits in common."""

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Any:
        """Return observations and derivatives, as `Model` does."""

    def embedded(self, shared: NDArray, model: Any) -> NDArray:
        """Return shared unknowns of this model as those of another."""

    def pathways(self, shared: NDArray, local: NDArray) -> Mapping[str, NDArray]:
        """Return how the observations (B, K, d, C) follow each pathway."""

    def design_matrix(self, shared: NDArray, local: NDArray) -> Callable[[Any], Mapping[str, NDArray]]:
        """Return what tells a cause's change (B or 1, C, P) of each pathway that it acts on, per plausible scale."""

    def rotations(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the rotations (B, K, d, d) from the axes of the channels' groups to those of the observations."""

    def effect_sigma(self, cause: Any) -> NDArray:
        """Return the prior sigma (P,), SI, that a cause's parameters are fitted with."""
