"""`truing predict`: the extended model's prediction where nothing was measured."""

from __future__ import annotations

import sys
from pathlib import Path

import pyarrow as pa

from truing import __version__
from truing.pipeline.artifacts import Stamp, write_table
from truing.pipeline.given_files import ENDINGS, check_file, read_given, table_bytes
from truing.pipeline.ledger import digest_of
from truing.pipeline.problems import ExitCode
from truing.pipeline.voice import Voice
from truing.pipeline.whole_file import write_whole
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.settings_text import parsed_toml, read_settings_text
from truing.stages.predict import predict

# What is predicted, by a column that tells it from poses.
_ARTIFACTS = {"reading": "readings", "encoder": "axis_prediction"}


def predict_file(model: Path, inputs: Path, out: Path | None) -> ExitCode:
    """Predict poses, or readings of a loaded sensor; CSV on stdout, or the file ``out``. Raises CampaignFaults."""
    if out is not None and out.suffix not in ENDINGS:
        raise CampaignFaults([Fault("--out", "a file that ends in .csv or .parquet", value=str(out))])
    if out is not None:
        check_file(out, reads=(model, inputs))
    text = _model_text(model)
    predicted = _predicted(model, text, inputs)
    if out is None:
        sys.stdout.write(_csv(predicted).decode())
        return ExitCode.DONE
    _write(out, predicted, _campaign(model, text), [text, _csv(predicted).decode()])
    Voice(quiet=False).say(f"{predicted.num_rows} {_artifact(predicted)}: {out}")
    return ExitCode.DONE


def _model_text(model: Path) -> str:
    try:
        return read_settings_text(model)
    except (FileNotFoundError, ValueError):
        raise CampaignFaults([Fault(str(model), "a model.toml that a run has written")]) from None


def _predicted(model: Path, text: str, inputs: Path) -> pa.Table:
    table = read_given(inputs, "a table of configurations, or of load steps")
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
        write_whole(out, _csv(predicted))
        return
    name = _artifact(predicted)
    stamp = Stamp("predict", digest_of(made_from), campaign, __version__, (name,))
    write_table(out, ARTIFACTS[name], predicted, stamp)


def _artifact(predicted: pa.Table) -> str:
    return next((artifact for mark, artifact in _ARTIFACTS.items() if mark in predicted.schema.names), "poses")
