"""Two campaigns of one machine: what was built is the same, what was measured is not; parts may change between."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from tests.blind.generator import campaign as generator
from tests.blind.generator.effects import Effect
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Geometry, Layout, Targets
from tests.blind.generator.schedule import at_rest, random_moves
from tests.stages.line import run_line
from truing.inference.fitted_model import FittedModel
from truing.inference.fitter import Fitter
from truing.schemas.campaign import read_campaign
from truing.simulation.cause import Cause
from truing.simulation.mechanisms.extended_model import extended, write_model
from truing.stages.diagnosis.diagnosis_data import DiagnosisData
from truing.stages.diagnosis.mechanism_points import assemble

LAYOUT = Layout(name="machine", targets=Targets(base=8, platform=8, per_leg=0))
POSES = 24
MACHINE = 11  # the seed of what was built, unless another is asked for


@dataclass(frozen=True)
class Machine:
    """Seeds of a campaign; the machine and its targets have a seed of their own."""

    seed: int
    same_survey: bool
    built: int

    def spawn(self, count: int) -> list[np.random.Generator]:
        own = {"build", "marks"} | ({"survey"} if self.same_survey else set())
        streams = zip(generator.STREAMS, range(count), strict=True)
        return [np.random.default_rng([self.built if name in own else self.seed, n]) for name, n in streams]


def measured(
    home: Path,
    seed: int,
    effects: Sequence[Effect] = (),
    change: Callable[[Geometry], Geometry] | None = None,
    *,
    same_survey: bool = False,
    machine: int = MACHINE,
) -> Path:
    """A campaign folder of the machine, as it is after ``change``."""
    moves = [at_rest(), *random_moves(POSES, 4, np.random.default_rng(seed))]
    with pytest.MonkeyPatch.context() as patch:
        if change is not None:
            build = generator.build
            patch.setattr(generator, "build", lambda *given: change(build(*given)))
        made = generator.draw_campaign(LAYOUT, moves, list(effects), Machine(seed, same_survey, machine))  # type: ignore[arg-type]
    return write_campaign(made, home / f"campaign-{machine}-{seed}", seed)


def gathered(folder: Path) -> DiagnosisData:
    """Data that the diagnosis compares, of a campaign folder."""
    import tomllib

    tables, _ = run_line(folder, "ingest", "pose")
    document = tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))
    return assemble(tables, read_campaign(document))


def fitted(diagnosis_data: DiagnosisData, *causes: Cause) -> FittedModel:
    """The model with some causes, fitted to a campaign."""
    return Fitter(diagnosis_data.model, diagnosis_data.calibration, diagnosis_data.held_out, 0).prepared(
        (*diagnosis_data.given, *causes)
    )


def model_text(stand: FittedModel, campaign: str) -> str:
    """The model.toml of a fit."""
    made = extended(stand.model, stand.fit.shared, stand.covariance(), {"campaign": campaign})
    return write_model(made)


def longer(leg: int, by_mm: float) -> Callable[[Geometry], Geometry]:
    """A leg was exchanged for another one."""
    return lambda built: replace(built, length=built.length + by_mm * (np.arange(len(built.length)) == leg - 1))


def rows_by_name(table: pa.Table) -> dict[str, dict[str, Any]]:
    """The rows of changes.parquet by what they are called."""
    return {f"{row['parameter']}{row['leg'] or ''}": row for row in table.to_pylist()}
