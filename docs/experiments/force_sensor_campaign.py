"""Tables of docs/force-sensor-campaign.md: one run of the force sensor's sample campaign, stage by stage.

python -m docs.experiments.force_sensor_campaign

runs every stage on sample_data/force-sensor, and the diagnosis on parts of it, and renews the tables of the page.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from docs.experiments.marked_tables import renew, table
from truing.report.diagnosis.assessed_causes import assessed_causes
from truing.report.diagnosis.detectable_sizes import hidden
from truing.report.diagnosis.effect_units import size_text
from truing.report.diagnosis.prediction_errors import reading_misses, root_mean_square
from truing.report.numbers import plain, printed, with_uncertainty
from truing.report.page_head import build_head
from truing.report.tables import CHANNELS, LOADS, WHY_NOT

if TYPE_CHECKING:
    import pandas as pd

DOCS = Path(__file__).resolve().parents[1]
PAGE = DOCS / "force-sensor-campaign.md"
CAMPAIGN = DOCS.parent / "sample_data" / "force-sensor"
STAGES = ("ingest", "qa", "pose", "deformation", "diagnose", "calibrate")
# What a bench may lack, and the stages whose answer depends on it.
_NO_ELEMENTS = re.compile(r"^elements = \[.*?^\]\n", re.M | re.S)
_HIDDEN = ("load eccentricity", "load imbalance", "stiffness scale", "hysteresis", "creep", "zero drift", "crosstalk")
_PER_KILO = {"m/N": (1e9, "µm/kN"), "rad/(N m)": (1e3 * 3600.0 * 180.0 / np.pi, "arcsec/(kN·m)")}
_MIXED = {"rad/N": (1e3 * 3600.0 * 180.0 / np.pi, "arcsec/kN"), "m/(N m)": (1e9, "µm/(kN·m)")}

Frames = Mapping[str, "pd.DataFrame"]


@cache
def whole_run() -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the tables of all stages on the sample, and the closing line of each."""
    from tests.stages.line import run_line

    return run_line(CAMPAIGN, *STAGES)


def frames_of(tables: Mapping[str, Any], said: Mapping[str, Any] | None = None) -> dict[str, pd.DataFrame]:
    """Return the tables as the page reads them, the diagnosis with what its stage ``said``."""
    frames = {name: one.to_pandas() for name, one in tables.items() if hasattr(one, "to_pandas")}
    if said is not None:
        frames["diagnosis"].attrs[WHY_NOT] = said["diagnose"].why_not
    return frames


def stage_table(said: Mapping[str, Any]) -> str:
    """Return the table of inputs, exclusions and result of each stage."""
    rows = [[f"`{name}`", one.read, one.left_out, printed(one.figure)] for name, one in said.items()]
    return table(["stage", "read", "left out", "found"], rows)


def first_lines(tables: Frames) -> str:
    """Return the sentences at the head of the page."""
    return "\n>\n".join(f"> {sentence}" for _, sentence in build_head("force-sensor", tables).verdicts)


def checks_table(qa: pd.DataFrame) -> str:
    """Return the checks by kind: how many passed, and a sentence of one."""
    rows = [
        [
            f"`{check}`",
            ", ".join(f"{n} {verdict}" for verdict, n in own["verdict"].value_counts().items()),
            printed(str(own["message"].iloc[0])).replace("+-", "±"),
        ]
        for check, own in qa.groupby("check", sort=False)
    ]
    return table(["check", "verdicts", "for instance"], rows)


def compliance_table(compliance: pd.DataFrame) -> str:
    """Return each axis' own entry, measured and simulated, and all others that differ from the simulation."""
    whole = compliance[compliance["model"] == "matrix"]
    own = whole["load"].map(dict(zip(LOADS, CHANNELS, strict=True))) == whole["response"]
    rows = [
        [f"{r.response} under {r.load}", *_entry(r), f"{r.pull:+.1f}", str(r.verdict)]
        for r in whole[own | (whole["verdict"] == "differs")].itertuples()
    ]
    return table(["entry", "measured", "simulated", "unit", "apart, in sigma", ""], rows)


def _entry(r: Any) -> tuple[str, str, str]:
    factor, unit = {**_PER_KILO, **_MIXED}[r.unit]
    measured = with_uncertainty(factor * r.coefficient, factor * r.sigma)
    return measured, with_uncertainty(factor * r.simulated, factor * r.simulated_sigma), unit


def found_table(tables: Frames) -> str:
    """Return findings next to hidden effects, and the nearest rejected cause."""
    truth = json.loads(CAMPAIGN.with_suffix(".truth.json").read_text(encoding="utf-8"))["effects"][0]["parameters"]
    rows = []
    for row in (row for row in assessed_causes(tables) if row.verdict == "found"):
        for size in row.sizes:
            hidden_size = truth[size.name]
            reported = size_text(size.name, size.value, size.sigma, size.unit)
            hid = f"{plain(hidden_size['value'])} {hidden_size['unit']}"
            rows.append([f"`{row.cause}`, `{row.subject}`", f"`{size.name}`", reported, hid])
    return table(["found", "parameter", "value", "hidden in the sample"], rows)


def missed_table(tables: Frames) -> str:
    """Return the rms of measured minus predicted over the noise, channel by load, before and after."""
    misses = reading_misses(tables)
    assert misses is not None
    rows = [[f"**{channel}**", *(_over_noise(misses, channel, axis) for axis in LOADS)] for channel in CHANNELS]
    return table(["", *LOADS], rows)


def _over_noise(misses: pd.DataFrame, channel: str, axis: str) -> str:
    own = misses[(misses["channel"] == channel) & misses[axis].ne(0.0).groupby(misses["run"]).transform("any")]
    noise = root_mean_square(own["noise"])
    return " → ".join(f"{root_mean_square(own[when]) / noise:.1f}" for when in ("before", "after"))


def hidden_table(tables: Frames) -> str:
    """Return the smallest sizes that would have been found."""
    listing = hidden(assessed_causes(tables), tables).listings[0]
    rows = [[r[0], r[1], r[3], r[4]] for r in listing.rows if r[0] in _HIDDEN]
    return table(["cause", "parameter", "detectable from, at best", "wherever it is"], rows)


def calibration_table(tables: Frames) -> str:
    """Return the table of rms errors at held-out loads, of the chosen calibration and of the printed one."""
    choice = tables["sensor_choice"]
    chosen = choice[(choice["figure"] == "chosen") & (choice["value"] == 1.0)]["model"].iloc[0]
    printed_one = next(m for m in choice["model"].unique() if "zero none" in m)
    errors = choice[choice["figure"] == "heldout_rms"].set_index(["model", "subject"])["value"]
    named = {f"{chosen} (chosen)": chosen, f"{printed_one} (as the paper prints it)": printed_one}
    rows = [[words, *(plain(errors[model, axis]) for axis in LOADS)] for words, model in named.items()]
    heads = [f"{axis}, {'N' if axis[0] == 'f' else 'N·m'}" for axis in LOADS]
    return table(["G_B by", *heads], rows)


def matrix_table(tables: Frames) -> str:
    """Return the table of errors of G_B, in its sigmas, with loads as recorded and with the finding applied."""
    from tests.blind.generator.sensor.force_sensor import force_sensor_campaign

    truth = force_sensor_campaign().truth
    true = np.linalg.inv(truth.gain[:, :1] * truth.machine.tension).ravel()
    matrix = tables["sensor_matrix"].query("matrix == 'G_B'")
    rows = []
    for words, own in (
        ("as written down", matrix[matrix["chosen"]]),
        ("with `load-eccentricity` applied", matrix[matrix["model"].str.endswith("findings applied")]),
    ):
        off = (own["value"] - true) / own["sigma"]
        rows.append([words, f"{root_mean_square(off):.1f}", f"{off.abs().max():.1f}"])
    return table(["loads", "G_B off the truth, in its sigmas, rms", "the worst entry"], rows)


def parts_table() -> str:
    """Return the diagnosis of parts of the sample."""
    from tests.stages.line import run_line

    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for words, without in _PARTS.items():
            part = _without(Path(folder) / without, without)
            tables, said = run_line(part, *STAGES)
            verdicts = [sentence for _, sentence in build_head("part", frames_of(tables, said)).verdicts]
            verdict = next((v for v in verdicts if v.startswith("Diagnosis not")), verdicts[0])
            idle = [name for name, one in said.items() if one.figure.startswith("not evaluated")]
            rows.append([words, verdict, ", ".join(f"`{name}`" for name in idle) or "none"])
    return table(["the sample without", "what the page says", "not evaluated"], rows)


_PARTS = {
    "signals (readings alone)": "signals.csv",
    "readings (signals alone)": "interferometer.csv",
    "`elements` of the legs": "elements",
}


def _without(folder: Path, left_out: str) -> Path:
    """Return a copy of the sample that lacks a file, or the elements of its legs."""
    shutil.copytree(CAMPAIGN, folder, ignore=shutil.ignore_patterns(left_out))
    settings = folder / "campaign.toml"
    if left_out == "elements":  # no file, so nothing was left out yet
        settings.write_text(_NO_ELEMENTS.sub("", settings.read_text(encoding="utf-8")), encoding="utf-8")
    return folder


def page_tables(tables: Frames) -> dict[str, Any]:
    """Return the makers of all tables that follow from one run."""
    return {
        "checks": lambda: checks_table(tables["qa"]),
        "first": lambda: first_lines(tables),
        "compliance": lambda: compliance_table(tables["compliance"]),
        "found": lambda: found_table(tables),
        "missed": lambda: missed_table(tables),
        "hidden": lambda: hidden_table(tables),
        "calibration": lambda: calibration_table(tables),
        "matrix": lambda: matrix_table(tables),
    }


if __name__ == "__main__":
    every, words = whole_run()
    renew(PAGE, {**page_tables(frames_of(every)), "stages": partial(stage_table, words), "parts": parts_table})
