"""Starting from an earlier campaign of the same machine: what it knew enters, and what has changed since is told."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from truing.inference.changes import NumberComparison, compare
from truing.inference.fit import fit_model
from truing.inference.fitted_model import FittedModel, Fitter
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.settings_text import parsed_toml
from truing.simulation.bench.extended_model import is_sensor, read_sensor
from truing.simulation.bench.model import BenchModel
from truing.simulation.bench.prior import sensor_prior
from truing.simulation.cause import Cause
from truing.simulation.effects_model import EffectsModel
from truing.simulation.mechanisms.extended_model import read_model
from truing.simulation.mechanisms.model import MechanismModel
from truing.simulation.mechanisms.prior import mechanism_prior
from truing.simulation.prior_campaign import CampaignPrior
from truing.simulation.reported_numbers import alternatives, figures, numbers_of, reported_numbers
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.stages.diagnosis.diagnosis_data import DiagnosisData

ModelT = TypeVar("ModelT", bound=EffectsModel)

_UNNAMED = "the earlier campaign"


def started(gathered: DiagnosisData[Any], text: str, seed: int) -> DiagnosisData[Any]:
    """What is compared, with the effects and the knowledge of an earlier model.

    Numbers that have changed since are let free, and all of them where the machine is another one. Raises
    CampaignFaults where the text is no model.
    """
    try:
        campaign, causes, earlier = _known(text, gathered.model)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise CampaignFaults([Fault("start.toml", f"a model.toml that a run has written ({error})")]) from None
    alone = with_prior_campaign(gathered.model, earlier.nothing)
    try:
        stand = Fitter(alone, gathered.calibration, gathered.held_out, seed).prepared(gathered.given)
        assert isinstance(stand.model, MechanismModel | BenchModel)
        compared = _compared(earlier, stand.model, stand.fit.shared, stand.covariance())
    except np.linalg.LinAlgError:
        raise ValueError("with the effects of the earlier model the fit left what the legs can reach") from None
    changed = compared.changed()
    kept = earlier.nothing
    if changed is not None:
        kept = earlier.without(sorted({*changed, *chain.from_iterable(compared.instead(changed))}))
    said = _words(campaign, earlier, stand.model, compared)
    lost = {cause.id for cause in causes if cause.is_persistent} - {cause.id for cause in earlier.causes}
    missing = f"{', '.join(sorted(lost))} of {campaign}, whose columns are missing here" if lost else ""
    words = "; ".join(part for part in (gathered.left_out, missing, said) if part)
    return replace(gathered, model=with_prior_campaign(gathered.model, kept), left_out=words)


def _known(text: str, model: Any) -> tuple[str, tuple[Cause, ...], CampaignPrior]:
    """The earlier campaign's name, its effects, and what it tells of a model of points or of readings."""
    if is_sensor(parsed_toml(text)):
        sensor = read_sensor(text)
        return sensor.context.get("campaign", _UNNAMED), sensor.causes, sensor_prior(sensor, model)
    found = read_model(text)
    return found.context.get("campaign", _UNNAMED), found.model.causes, mechanism_prior(found, model)


def with_prior_campaign(model: ModelT, earlier: CampaignPrior) -> ModelT:
    """The model, of points or of readings, that starts from what an earlier campaign found."""
    return replace(model, prior_campaign=earlier).with_causes(())


def _compared(earlier: CampaignPrior, model: EffectsModel, shared: NDArray, covariance: NDArray) -> NumberComparison:
    """The earlier numbers against those of a model that was fitted without the earlier campaign's knowledge."""
    now = _now(earlier, model, shared, covariance)
    return compare(earlier.mean, earlier.covariance, *now, earlier.shared, earlier.frames)


def _now(earlier: CampaignPrior, model: EffectsModel, shared: NDArray, covariance: NDArray) -> tuple[NDArray, NDArray]:
    """The earlier numbers (n,) as a model has them, and their covariance (n, n)."""
    own, slopes = earlier.places(model), earlier.slopes(model, shared)
    return earlier.values(model, shared), slopes @ covariance[np.ix_(own, own)] @ slopes.T


def _words(campaign: str, earlier: CampaignPrior, model: EffectsModel, compared: NumberComparison) -> str:
    changed = compared.changed()
    if changed is None:
        return (
            f"all that {campaign} knew of the machine and its effects: it was of another machine, or much was rebuilt"
        )
    if not changed:
        return ""
    names = [number.label for number in numbers_of(earlier, model)]
    said = [" or ".join(names[i] for i in (one, *others)) for one, others in alternatives(compared, changed)]
    return f"what {campaign} knew of {', '.join(said)}, changed since"


def changes_table(final: FittedModel) -> pa.Table | None:
    """The rows of changes.parquet: what the final model says without the earlier knowledge, against that knowledge.

    None where the campaign starts from nothing.
    """
    assert isinstance(final.model, MechanismModel | BenchModel)
    earlier = final.model.prior_campaign
    if earlier is None:
        return None
    model = with_prior_campaign(final.model, earlier.nothing).with_causes(final.causes)
    fit = fit_model(model.predict, final.measured, final.fit.frames, final.fit.shared, final.fit.local)
    covariance = fit.whitened.covariance() * final.noise_ratio**2
    found = _compared(earlier, model, fit.shared, covariance)
    told = reported_numbers(earlier, model, fit.shared, covariance)
    rows = Rows("changes")
    rows.add(**told.columns, **figures(earlier, told, found, *_now(earlier, model, fit.shared, covariance)))
    return rows.table()
