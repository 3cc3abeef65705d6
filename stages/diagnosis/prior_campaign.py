"""Start from an earlier campaign of the same machine: its results as prior, and changes since then."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from truing.inference.changes import NumberComparison, compare
from truing.inference.fit import fit_model
from truing.inference.fitted_model import FittedModel
from truing.inference.fitter import Fitter
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


def started(data: DiagnosisData, text: str, seed: int) -> DiagnosisData:
    """Data with the effects and the prior of an earlier model.

    Changed parameters are free, all of them for another machine. Raises CampaignFaults if the text is no model.
    """
    try:
        campaign, causes, prior = _parsed_prior(text, data.model)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise CampaignFaults([Fault("start.toml", f"a model.toml that a run has written ({error})")]) from None
    alone = with_prior_campaign(data.model, prior.without_information)
    try:
        fitted = Fitter(alone, data.calibration, data.held_out, seed).prepared(data.given)
        assert isinstance(fitted.model, MechanismModel | BenchModel)
        compared = _number_comparison(prior, fitted.model, fitted.fit.shared, fitted.covariance())
    except np.linalg.LinAlgError:
        raise ValueError(
            "the fit with the effects of the earlier model led to poses that the legs cannot reach"
        ) from None
    changed = compared.changed()
    information = prior.without_information
    if changed is not None:
        information = prior.without(sorted({*changed, *chain.from_iterable(compared.alternatives_to(changed))}))
    sentence = _words(campaign, prior, fitted.model, compared)
    lost = {cause.id for cause in causes if cause.is_persistent} - {cause.id for cause in prior.causes}
    missing = f"{', '.join(sorted(lost))} of {campaign}, whose columns are missing here" if lost else ""
    words = "; ".join(part for part in (data.left_out, missing, sentence) if part)
    return replace(data, model=with_prior_campaign(data.model, information), left_out=words)


def _parsed_prior(text: str, model: Any) -> tuple[str, tuple[Cause, ...], CampaignPrior]:
    """The earlier campaign's name, its effects, and its information on a model of points or of readings."""
    if is_sensor(parsed_toml(text)):
        sensor = read_sensor(text)
        return sensor.context.get("campaign", _UNNAMED), sensor.causes, sensor_prior(sensor, model)
    extended = read_model(text)
    return extended.context.get("campaign", _UNNAMED), extended.model.causes, mechanism_prior(extended, model)


def with_prior_campaign(model: ModelT, prior: CampaignPrior) -> ModelT:
    """The model of points or readings with the prior from an earlier campaign."""
    return replace(model, prior_campaign=prior).with_causes(())


def _number_comparison(
    prior: CampaignPrior, model: EffectsModel, shared: NDArray, covariance: NDArray
) -> NumberComparison:
    """Comparison of the earlier parameters with those of a fit without the earlier prior."""
    now = _prior_in_model(prior, model, shared, covariance)
    return compare(prior.mean, prior.covariance, *now, prior.shared, prior.frames)


def _prior_in_model(
    prior: CampaignPrior, model: EffectsModel, shared: NDArray, covariance: NDArray
) -> tuple[NDArray, NDArray]:
    """The earlier numbers (n,) as a model has them, and their covariance (n, n)."""
    places, slopes = prior.places(model), prior.slopes(model, shared)
    return prior.values(model, shared), slopes @ covariance[np.ix_(places, places)] @ slopes.T


def _words(campaign: str, prior: CampaignPrior, model: EffectsModel, compared: NumberComparison) -> str:
    changed = compared.changed()
    if changed is None:
        return f"all information of {campaign} on the machine: it was another machine, or much was rebuilt"
    if not changed:
        return ""
    names = [number.label for number in numbers_of(prior, model)]
    texts = [" or ".join(names[i] for i in (index, *like_it)) for index, like_it in alternatives(compared, changed)]
    return f"information of {campaign} on {', '.join(texts)}, which changed since"


def changes_table(final: FittedModel) -> pa.Table | None:
    """Rows of changes.parquet: final model without the earlier prior against that prior.

    None without an earlier campaign.
    """
    assert isinstance(final.model, MechanismModel | BenchModel)
    prior = final.model.prior_campaign
    if prior is None:
        return None
    model = with_prior_campaign(final.model, prior.without_information).with_causes(final.causes)
    fit = fit_model(model.predict, final.measured, final.fit.frames, final.fit.shared, final.fit.local)
    covariance = fit.whitened.covariance() * final.noise_ratio**2
    comparison = _number_comparison(prior, model, fit.shared, covariance)
    reported = reported_numbers(prior, model, fit.shared, covariance)
    rows = Rows("changes")
    rows.add(
        **reported.columns,
        **figures(prior, reported, comparison, *_prior_in_model(prior, model, fit.shared, covariance)),
    )
    return rows.table()
