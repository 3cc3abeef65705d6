"""Stage transfer: errors in a second campaign of the same machine, by models fitted to this one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign
    from truing.stages.second_campaign.compared import SecondCampaign

DECLARATION = Stage(
    name="transfer",
    reads=(
        *("model?", "applied_model?", "diagnosis_choices?", "calibration?", "model_choice?", "qa?"),
        *("readings?", "signals?", "sensor_matrix?", "calibrations_compared?"),
    ),
    leaves=("second_campaign_errors",),
    settings=(
        *("campaign.kind", "diagnosis.judge_on", "mechanism.reference_temperature_c", "exclude", "keep"),
        *("noise.signal_mv", "noise.load_n", "noise.load_nm"),
    ),
    summary="errors of a second campaign of the same machine by models fitted to this one",
)


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress, second: SecondCampaign) -> Outcome:
    """Predict the second campaign by every model of this one."""
    from truing.schemas.artifacts import ARTIFACTS
    from truing.stages.common.applied_findings import applied_findings
    from truing.stages.common.belonging import reason_withheld
    from truing.stages.second_campaign.compared import ARTIFACT
    from truing.stages.second_campaign.errors import second_campaign_errors

    nothing = {ARTIFACT: ARTIFACTS[ARTIFACT].empty()}
    text = applied_findings(tables).text
    if why := reason_withheld(tables) or ("" if text else "the diagnosis was not evaluated, and left no model"):
        return Outcome.not_evaluated(nothing, why)
    assert text is not None
    try:
        errors, left_out = second_campaign_errors(text, second, tables, settings)
    except ValueError as why_not:
        return Outcome.not_evaluated(nothing, str(why_not))
    named = str(settings.diagnosis.judge_on)
    return Outcome({ARTIFACT: errors}, read=named, left_out=left_out or "nothing", figure=_figure(errors))


def _figure(errors: pa.Table) -> str:
    """The error of every model in the first quantity that all of them predict."""
    rows = errors.to_pylist()
    of = {row["quantity"]: [result for result in rows if result["quantity"] == row["quantity"]] for row in rows}
    quantity, results = max(of.items(), key=lambda item: len(item[1]))
    sizes = ", ".join(f"{row['prediction_by']} {row['rms_error']:.4g}" for row in results)
    return f"rms error of {quantity} in {results[0]['campaign']} ({results[0]['unit']}): {sizes}"
