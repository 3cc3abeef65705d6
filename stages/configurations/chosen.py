"""Chosen configurations, the options, and the quality for a calibration."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.calibration.configuration_search import AssessedConfigurations, Bounded, DesignProblem
from truing.calibration.needed_configurations import NeededConfigurations
from truing.estimation.design.pose_order import TRADE_OFF, PoseOrder
from truing.estimation.design.pose_selection import efficiency
from truing.estimation.interferometry.recorded_steps import LOADS
from truing.estimation.sensor.load_cases import LoadDesign, LoadLimits

if TYPE_CHECKING:
    from truing.simulation.mechanisms.pose_regressors import Placed


@dataclass(frozen=True)
class DesignOptions:
    """Options. method: exchange, direct, ioops or random; within: ``workspace`` (limits of pose and readings) or
    ``actuators`` (of readings alone); parameters: names for each leg, all separable ones if empty; trade_off: see
    `order_poses`; at_once: number of load components that act together; causes: causes to show with loads instead of
    a calibration; cycles: visits of every target of an axis from both sides."""

    poses: int
    verification: int = 0
    method: str = "exchange"
    within: str = "workspace"
    parameters: tuple[str, ...] = ()
    trade_off: float = TRADE_OFF
    seed: int = 0
    at_once: int = 6
    causes: tuple[str, ...] = ()
    cycles: int | None = None

    @property
    def may_all_act(self) -> bool:
        """True if all components of a load may act together."""
        return self.at_once >= len(LOADS)


@dataclass(frozen=True)
class DesignTables:
    """Optional tables. ``extend``: poses to keep; ``existing``: poses to compare with."""

    extend: pa.Table | None = None
    extend_file: str = "--extend"
    avoid: pa.Table | None = None
    avoid_file: str = "--avoid"
    existing: pa.Table | None = None
    survey: pa.Table | None = None


@dataclass(frozen=True)
class Design:
    """Chosen configurations and their quality. placed: calibration poses, then verification poses; whole: chosen and
    kept poses; existing: the campaign's own; candidates: candidates and the bound on them; needed: least number of
    configurations of each model that the machine has."""

    problem: DesignProblem
    options: DesignOptions
    placed: Placed
    all_configurations: AssessedConfigurations
    kept: AssessedConfigurations | None
    existing: AssessedConfigurations | None
    candidates: Bounded
    order: PoseOrder
    needed: tuple[NeededConfigurations, ...]
    table: pa.Table = field(repr=False)

    @property
    def efficiency(self) -> float:
        """Return the D-efficiency."""
        return efficiency(self.all_configurations.log_det, self.candidates.upper, self.problem.size)

    @property
    def existing_efficiency(self) -> float | None:
        """Return the efficiency of the campaign's own poses, relative to the best of equal number; None without any."""
        if self.existing is None or self.kept is not None:
            return None
        best = self.candidates.upper + self.problem.size * float(np.log(self.existing.count / self.options.poses))
        return efficiency(self.existing.log_det, best, self.problem.size)


@dataclass(frozen=True)
class LoadPlan:
    """Chosen loads in the order of application, and their quality. sigma (6,): of a signal at the full load of each
    axis, in sigmas of a signal, equal for all channels; existing: the campaign's own loads by the same measure, and
    one_of: information of one chosen load relative to one of them."""

    options: DesignOptions
    limits: LoadLimits
    chosen: LoadDesign
    candidates: int
    order: PoseOrder
    sigma: NDArray
    existing: LoadDesign | None
    signal_mv: float | None
    table: pa.Table
