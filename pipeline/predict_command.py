"""`truing predict`: poses, readings or wrenches for new inputs, or errors of predictions for a second campaign."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import cast

import pyarrow as pa

from truing import __version__
from truing.pipeline.artifacts import Stamp, Unreadable, read_artifact, write_table
from truing.pipeline.atomic_file import write_atomically
from truing.pipeline.campaign_folder import FILE, identity_faults, open_campaign, suggested_folder
from truing.pipeline.console import JsonConsole, RunConsole
from truing.pipeline.given_files import ENDINGS, check_file, read_given, table_bytes
from truing.pipeline.manifest import digest_of
from truing.pipeline.problems import ExitCode
from truing.pipeline.second_campaign import campaign_of
from truing.pipeline.stage_order import OF_SECOND_CAMPAIGNS
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.settings_text import parsed_toml, read_settings_text
from truing.stages.predict import predict
from truing.stages.second_campaign.errors import second_campaign_errors
from truing.stages.sensor.wrenches_of_signals import is_of_signals

# Artifact of a prediction, by a column that only it has.
_ARTIFACTS = {"reading": "readings", "encoder": "axis_prediction", "prediction_by": "second_campaign_errors"}
_ARTIFACTS |= {"cov_fx_fy": "wrenches"}
_INPUTS = "a table of configurations, load steps, commands or signals"
_CALIBRATION = ("calibration", "model_choice")  # of the run that wrote the model, if they are in its folder


def predict_file(model: Path, inputs: Path, out: Path | None, console: RunConsole) -> ExitCode:
    """Predict poses, readings of a loaded sensor, or wrenches of its signals; CSV on stdout (or JSON), or the file
    ``out``.

    model: a model file, or a run's folder (sensor.toml for signals, else model.toml). If ``inputs`` is a campaign's
    folder, the result is the errors of the models in that campaign. Raises CampaignFaults.
    """
    check_file(out, reads=(model, inputs))
    model = _model_in(model, inputs) if model.is_dir() else model
    text = _model_text(model)
    is_campaign = inputs.is_dir() or inputs.name == FILE
    predicted = _errors(model, text, inputs) if is_campaign else _predicted(model, text, inputs)
    if isinstance(console, JsonConsole):
        for row in predicted.to_pylist():
            console.add_fact(_artifact(predicted), row)
    elif out is None:
        sys.stdout.write(_csv(predicted).decode())
    if is_campaign:
        _print_errors(predicted, console, is_printed=out is None)
    if out is None:
        return ExitCode.DONE
    _write(out, predicted, _campaign(model, text), [text, _csv(predicted).decode()])
    console.line(f"{predicted.num_rows} {_artifact(predicted)}: {out}")
    return ExitCode.DONE


def _model_in(run: Path, inputs: Path) -> Path:
    """File of a run's folder that predicts for the inputs."""
    is_table = inputs.suffix in ENDINGS and inputs.is_file()
    of_signals = is_table and is_of_signals(read_given(inputs, _INPUTS))
    return run / ARTIFACTS["sensor" if of_signals else "model"].file


def _errors(model: Path, text: str, path: Path) -> pa.Table:
    """Errors of a second campaign by nominal and extended model, and by the calibration in the model's folder."""
    try:
        beside = {
            name: read_artifact(model.parent, ARTIFACTS[name]) for name in _CALIBRATION if _run_has_table(model, name)
        }
    except Unreadable as error:
        raise CampaignFaults(
            [Fault(str(model.parent), f"readable tables of the run in the model's folder ({error})")]
        ) from None
    campaign = open_campaign(path)
    if faults := identity_faults(campaign):
        raise CampaignFaults(faults)
    stages = OF_SECOND_CAMPAIGNS["transfer"]
    try:
        return second_campaign_errors(text, campaign_of(campaign, stages), cast("dict[str, pa.Table]", beside))[0]
    except ValueError as error:
        raise CampaignFaults([Fault(str(path), f"a campaign that {model} can predict ({error})")]) from None


def _run_has_table(model: Path, name: str) -> bool:
    return (model.parent / ARTIFACTS[name].file).is_file()


def _print_errors(errors: pa.Table, console: RunConsole, *, is_printed: bool) -> None:
    """Print the errors and their verdict; of a table that is printed itself, the verdict alone, beside it."""
    from truing.report.transfer_section import verdict_elsewhere

    verdict = verdict_elsewhere(errors.to_pandas())
    sentence = f"{verdict.state}: {verdict.explanation}"
    if is_printed and not isinstance(console, JsonConsole):
        console.aside(sentence)
        return
    for row in errors.to_pylist():
        size = f"{row['rms_error']:.4g} {row['unit']} rms, {row['largest_error']:.4g} {row['unit']} at most"
        console.line(f"{row['quantity']:<12} {row['prediction_by']:<11} {size} ({row['model']})")
    console.sentence(sentence)


def _model_text(model: Path) -> str:
    try:
        return read_settings_text(model)
    except (FileNotFoundError, ValueError):
        raise CampaignFaults(
            [Fault(str(model), f"the folder of a run, or a model.toml that a run has written{suggested_folder(model)}")]
        ) from None


def _predicted(model: Path, text: str, inputs: Path) -> pa.Table:
    table = read_given(inputs, _INPUTS)
    try:
        return predict(text, table, str(inputs))
    except ValueError as error:
        raise CampaignFaults([Fault(str(model), f"a model.toml that a run has written ({error})")]) from None


def _csv(table: pa.Table) -> bytes:
    return table_bytes(table, ".csv", quoting="needed")


def _campaign(model: Path, text: str) -> str:
    carried = parsed_toml(text).get("provenance", {})
    return str(carried.get("campaign", model.name))


def _write(out: Path, predicted: pa.Table, campaign: str, made_from: list[str]) -> None:
    if out.suffix == ".csv":
        write_atomically(out, _csv(predicted))
        return
    name = _artifact(predicted)
    stamp = Stamp("predict", digest_of(made_from), campaign, __version__, (name,))
    write_table(out, ARTIFACTS[name], predicted, stamp)


def _artifact(predicted: pa.Table) -> str:
    return next((artifact for mark, artifact in _ARTIFACTS.items() if mark in predicted.schema.names), "poses")
