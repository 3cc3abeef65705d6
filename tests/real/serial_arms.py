"""Two serial arms: models of one plan of poses tested on another, and on held-out poses; writes docs/serial-arms.md."""

from __future__ import annotations

import tempfile
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd

from tests.real.campaigns import HERE, PROJECT, prepare, run
from truing.inference.fitted_model import Fitter
from truing.pipeline.in_memory import stage_line
from truing.schemas.campaign import read_campaign
from truing.simulation.mechanisms.chains.causes import (
    ChainCause,
    ChainScene,
    JointCompliance,
    JointGain,
    LinkBending,
)
from truing.simulation.mechanisms.chains.harmonics import JointEccentricity, JointHarmonic
from truing.stages.diagnosis.chain_points import assemble
from truing.stages.diagnosis.chain_results import text_of_model
from truing.stages.second_campaign.compared import SecondCampaign
from truing.stages.second_campaign.errors import second_campaign_errors

PAGE = PROJECT / "docs" / "serial-arms.md"
RANDOM, GRID = "ipa-ur10-random", "ipa-ur10-grid"
# Effects that are added to the geometry, one kind at a time.
ADDED: dict[str, Callable[[ChainScene], Sequence[ChainCause]]] = {
    "geometry": lambda scene: (),
    "and compliance of shoulder and elbow": lambda scene: [
        cause for cause in JointCompliance().candidates(scene) if cause.joint in ("shoulder_lift_joint", "elbow_joint")
    ],
    "and bending of all links": lambda scene: LinkBending().candidates(scene),
    "and gains of all joints": lambda scene: JointGain().candidates(scene),
    "and errors once per turn of all joints": lambda scene: JointEccentricity().candidates(scene),
    "and second and fourth harmonics of all joints": lambda scene: [
        JointHarmonic(joint=joint, order=order) for joint in scene.inputs_of_machine.tree.readings for order in (2, 4)
    ],
}


def campaign(name: str, folder: Path) -> SecondCampaign:
    """A campaign with the tables that its diagnosis needs."""
    line = stage_line(prepare(name, folder) / "campaign.toml", None).call("ingest", "pose")
    tables = {key: table for key, table in line.tables.items() if not isinstance(table, str)}
    return SecondCampaign(name, read_campaign(tomllib.loads((HERE / name / "campaign.toml").read_text())), tables)


def transfers(first: SecondCampaign, second: SecondCampaign) -> pd.DataFrame:
    """Rms errors of position (mm) and orientation (deg) of both campaigns, by models that were fitted to the first."""
    data = assemble(first.tables, first.settings)
    fitter = Fitter(data.model, data.calibration, None, 0)
    scene: Any = fitter.fitted(()).scene
    rows = []
    for name, causes in ADDED.items():
        text = text_of_model(fitter.fitted(tuple(causes(scene))), first.settings)
        errors = [_errors(text, one) for one in (first, second)]
        if not rows:
            rows.append({"model": "base and tool alone", **_both(errors, "nominal")})
        rows.append({"model": name, **_both(errors, "extended")})
    return pd.DataFrame(rows).set_index("model")


def _errors(text: str, one: SecondCampaign) -> pd.Series:
    found = second_campaign_errors(text, one, {})[0].to_pandas()
    return found.set_index(["prediction_by", "quantity"])["rms_error"]


def _both(errors: list[pd.Series], by: str) -> dict[str, float]:
    return {
        f"{quantity}_{place}": float(own[by, f"{quantity} of tip"]) / unit
        for place, own in zip(("own", "other"), errors, strict=True)
        for quantity, unit in (("position", 1e3), ("orientation", 3600.0))
    }


def facts(folder: Path) -> dict[str, Any]:
    """Every figure of the page: both directions of transfer, and what the diagnosis says of each campaign."""
    of = {name: campaign(name, folder / "tables") for name in (RANDOM, GRID)}
    found: dict[str, Any] = {"forth": transfers(of[RANDOM], of[GRID]), "back": transfers(of[GRID], of[RANDOM])}
    for key, name in (("random", RANDOM), ("irb", "irb120-faro-chain")):
        tables = run([name], folder / key)[name]
        found[key] = _said(tables)
        if name == RANDOM:
            text = (folder / key / "runs" / name / "model.toml").read_text(encoding="utf-8")
            found["as_selected"] = _errors(text, of[GRID])
    return found


def _said(tables: dict[str, pd.DataFrame]) -> dict[str, Any]:
    """Findings with their errors at held-out poses, and points and poses that were left out as gross errors."""
    rows = tables["diagnosis"]
    named = rows[rows["verdict"].isin(["found", "suspected"]) & ~rows["reason_code"].isin(["noise", "remainder"])]
    verdict = tables["verdict"].set_index("section")["explanation"]
    return {"rows": named.to_dict("records"), "verdict": str(verdict["adequacy"])}


def render(found: dict[str, Any]) -> str:
    """docs/serial-arms.md from the figures."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE), trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    tables = {way: list(found[way].reset_index().to_dict("records")) for way in ("forth", "back")}
    return environment.get_template("serial-arms.md.jinja").render(found | tables).rstrip() + "\n"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        PAGE.write_text(render(facts(Path(place))), encoding="utf-8")
