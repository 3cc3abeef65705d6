"""What a model brings to be fitted, and to take up causes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, Self

from numpy.typing import NDArray

# The pathway on which a cause acts on the observations themselves, whose motions are the identity.
OBSERVED = "observed"


class Parameter(Protocol):
    """A parameter of a cause: its name and unit as in the tables, and one sigma of a plausible size, SI."""

    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def scale(self) -> float: ...


class Cause(Protocol):
    """What a search asks of a cause; scenes, what a campaign offers to causes, are passed on unread."""

    @property
    def id(self) -> str:
        """Name of its kind."""

    @property
    def key(self) -> str:
        """Name that tells it from all other candidates."""

    @property
    def share(self) -> float:
        """Weight of its kind in the budget of false alarms and among the probabilities beforehand."""

    @property
    def catalogued(self) -> bool:
        """Whether its form was declared; else it is a dependence on inputs in a form that nobody declared."""

    @property
    def subject(self) -> str:
        """What it concerns, as tables name it; empty for the whole."""

    @property
    def concerns_several(self) -> bool:
        """Whether it concerns several things, named one by one."""

    @property
    def is_higher_order(self) -> bool:
        """Whether this adds higher-order terms to a cause that must be accepted first."""

    def excludes(self, other: Any, /) -> bool:
        """Whether a model that holds this cause has no place for another."""

    def parameters(self, parts: int, /) -> Sequence[Parameter]:
        """Return the parameters for so many like parts."""

    def alike(self, parts: int, /) -> Sequence[int]:
        """Return the positions of parameters that are of like size."""

    def one_sided(self, parts: int, /) -> Sequence[int]:
        """Return the positions of parameters that nature makes no less than zero."""

    def prior(self, scene: Any, /) -> float:
        """Return its share of its kind's probability beforehand."""

    def candidates(self, scene: Any, /) -> Sequence[Cause]:
        """Return the candidates of its kind worth testing in a campaign."""

    def channel_candidates(self, scene: Any, /) -> Sequence[ChannelCandidates]:
        """Return candidates over single channels, too many to be told one by one."""

    def higher_order_terms(self, scene: Any, /) -> Sequence[Cause]:
        """Return the forms that go on where this one ends."""

    def refined(self) -> Cause:
        """Return the form that is fitted once it is chosen, with its shape among the parameters."""

    def with_fixed_shape(self, shape: NDArray, /) -> Cause | None:
        """Return the form with its shape held; None where that need not be asked."""

    def narrowed(self, values: NDArray, covariance: NDArray, parts: int, /) -> Cause:
        """Return the cause without the parts that clearly do nothing once it is fitted."""

    def covers(self, covariates: Mapping[str, NDArray], epochs: int, /) -> NDArray:
        """Return at which epochs (B,) it claims to hold."""


class ChannelCandidates(Protocol):
    """Candidates that each shift one channel, or n that hold together, by one of S shapes over the epochs."""

    @property
    def values(self) -> NDArray:
        """Shapes (S, B, m), without dimension."""

    @property
    def channels(self) -> NDArray:
        """Places (T,) of the channels, or (T, n) with patterns."""

    @property
    def usable(self) -> NDArray:
        """Whether (S, T) a channel was seen often enough for a shape."""

    @property
    def scale(self) -> float:
        """One sigma of a plausible shift, SI."""

    @property
    def member(self) -> Callable[[int, int], Cause]:
        """The cause for a channel and a shape."""

    @property
    def patterns(self) -> NDArray | None:
        """Shifts (T, n, d, q) over a plausible one; None for single channels."""


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


class Split(Protocol):
    """Shared unknowns that split into what is common to all like parts and each part's own."""

    @property
    def places(self) -> NDArray:
        """Their places among the shared unknowns."""

    @property
    def common(self) -> NDArray:
        """Which of these are common to all."""

    @property
    def share(self) -> float:
        """Share of their variance that is common."""


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
    def channel_groups(self) -> NDArray:
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
    def split(self) -> Split | None:
        """Return which shared unknowns split into what is common to all parts and each part's own; None where none
        do."""

    @property
    def blocks(self) -> NDArray | None:
        """Return which epochs (B,) can be left out of a fit together, by number in time; None where none can be, since
        they would have to be predicted from others before and after."""

    @property
    def scene(self) -> Any:
        """Return what the campaign offers to causes."""

    def with_causes(self, causes: Sequence[Any]) -> Self:
        """Return the model with these causes among its unknowns."""

    def at(self, conditions: Any) -> Self:
        """Return the model at other epochs."""

    def rescaled(self, inputs: float, survey: float) -> Self:
        """Return the model with the noise of inputs and survey so many times as large."""

    def with_share(self, share: float) -> Self:
        """Return the model with another share of what splits in common."""

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Predicted:
        """Return observations and derivatives, as `Model` does."""

    def embedded(self, shared: NDArray, model: Self) -> NDArray:
        """Return shared unknowns of this model as those of another."""

    def pathways(self, shared: NDArray, local: NDArray) -> Mapping[str, NDArray]:
        """Return how the observations (B, K, d, C) follow each pathway."""

    def design_matrix(self, shared: NDArray, local: NDArray) -> Callable[[Cause], Mapping[str, NDArray]]:
        """Return what tells a cause's change (B or 1, C, P) of each pathway that it acts on, per plausible scale."""

    def rotations(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the rotations (B, K, d, d) from the axes of the channels' groups to those of the observations."""

    def effect_sigma(self, cause: Cause) -> NDArray:
        """Return the prior sigma (P,), SI, that a cause's parameters are fitted with."""
