"""Configurations that were chosen, what was asked for, and how well a calibration sees them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.calibration.configuration_search import AssessedConfigurations, Bounded, DesignProblem
from truing.estimation.design.pose_order import TRADE_OFF, PoseOrder
from truing.estimation.design.pose_selection import efficiency
from truing.estimation.interferometry.recorded_steps import LOADS
from truing.estimation.sensor.load_cases import LoadDesign, LoadLimits

if TYPE_CHECKING:
    from truing.simulation.mechanisms.pose_regressors import Placed


@dataclass(frozen=True)
class DesignOptions:
    """What is asked for.

    method: exchange, direct, ioops or random; within: ``workspace`` (limits of pose and readings) or ``actuators`` (of
    readings alone); parameters: names of a leg's, all that can be told apart where empty; trade_off: see `order_poses`;
    at_once: components of a load that may act together; causes: what loads are to show, not a calibration.
    """

    poses: int
    verification: int = 0
    method: str = "exchange"
    within: str = "workspace"
    parameters: tuple[str, ...] = ()
    trade_off: float = TRADE_OFF
    seed: int = 0
    at_once: int = 6
    causes: tuple[str, ...] = ()

    @property
    def may_all_act(self) -> bool:
        """Whether all components of a load may act together."""
        return self.at_once >= len(LOADS)


@dataclass(frozen=True)
class DesignTables:
    """What there is beside campaign.toml; each may be absent. ``extend``: poses to keep; ``existing``: to compare."""

    extend: pa.Table | None = None
    extend_file: str = "--extend"
    avoid: pa.Table | None = None
    avoid_file: str = "--avoid"
    existing: pa.Table | None = None
    survey: pa.Table | None = None


@dataclass(frozen=True)
class Design:
    """Chosen configurations and what can be said of them.

    placed: calibration poses, then verification poses; whole: the chosen with those kept; existing: the campaign's own;
    candidates: what the bound is about, and the bound.
    """

    problem: DesignProblem
    options: DesignOptions
    placed: Placed
    all_configurations: AssessedConfigurations
    kept: AssessedConfigurations | None
    existing: AssessedConfigurations | None
    candidates: Bounded
    order: PoseOrder
    table: pa.Table = field(repr=False)

    @property
    def efficiency(self) -> float:
        """Return the share of the best possible."""
        return efficiency(self.all_configurations.log_det, self.candidates.upper, self.problem.size)

    @property
    def existing_efficiency(self) -> float | None:
        """Return what share of the best of as many poses the campaign's own are; None where there are none to judge."""
        if self.existing is None or self.kept is not None:
            return None
        best = self.candidates.upper + self.problem.size * float(np.log(self.existing.count / self.options.poses))
        return efficiency(self.existing.log_det, best, self.problem.size)


@dataclass(frozen=True)
class LoadPlan:
    """Chosen loads in the order in which to apply them, how good they are, and beside what.

    sigma (6,): of a signal at the full load of each axis, in sigmas of a signal, for every channel the same; existing:
    the campaign's own loads by the same measure, and one_of: what one chosen load is worth in them.
    """

    options: DesignOptions
    limits: LoadLimits
    chosen: LoadDesign
    candidates: int
    order: PoseOrder
    sigma: NDArray
    existing: LoadDesign | None
    signal_mv: float | None
    table: pa.Table
