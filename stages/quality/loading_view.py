"""A loading campaign as its quality checks see it: load steps, what each channel leaves over, what was simulated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.quality.loading import ExpectedReadings, LoadingView
from truing.stages.common.declared_optics import channel_rows
from truing.stages.common.reading_arrays import load_steps

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

Array = NDArray[np.float64]


def loading_view(tables: Mapping[str, pa.Table], settings: Campaign) -> LoadingView:
    """The tables ``readings`` and ``signals`` with what [mechanism] simulates of the readings."""
    steps = load_steps(tables)
    noise = settings.noise
    compliance = simulated_compliance(tables, settings)
    load_sigma = np.array([noise.load_n] * 3 + [noise.load_nm] * 3)
    if compliance is None:
        return LoadingView(steps, None, load_sigma)
    gives = np.maximum(np.diag(compliance), 0.0)
    at_most = np.sqrt((steps.load**2 @ gives)[:, None] * gives)
    seen = channel_rows(settings.interferometer.beams) @ compliance
    return LoadingView(steps, ExpectedReadings(steps.load @ seen.T, at_most), load_sigma)


def simulated_compliance(tables: Mapping[str, pa.Table], settings: Campaign) -> Array | None:
    """The simulated compliance (6, 6), SI; None where campaign.toml tells of none."""
    from truing.stages.common.nominal_sensor import elastic_parts, given_matrix

    if settings.mechanism.type != "6-upur":
        return None
    if "given_compliance" in tables:
        return given_matrix(tables["given_compliance"])
    elastic = elastic_parts(settings.mechanism)  # type: ignore[arg-type]
    return None if elastic is None else elastic.compliance
