"""Two serial arms: models of one plan of poses tested on another, and on held-out poses; writes docs/serial-arms.md."""

from __future__ import annotations

import tempfile
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd

from tests.real.campaigns import HERE, PROJECT, data_folder, prepare, run, tables_of
from truing.inference.fitter import Fitter
from truing.pipeline.in_memory import stage_line
from truing.schemas.campaign import read_campaign
from truing.simulation.mechanisms.chains.causes import ChainCause, ChainScene, JointCompliance, JointGain, JointOffset
from truing.simulation.mechanisms.chains.extended_model import read_chain, write_chain
from truing.simulation.mechanisms.chains.harmonics import JointEccentricity, JointHarmonic
from truing.simulation.mechanisms.chains.joint_curves import JointErrorCurve
from truing.simulation.mechanisms.chains.link_causes import LinkBending
from truing.stages.diagnosis.chain_points import assemble
from truing.stages.diagnosis.chain_results import text_of_model
from truing.stages.second_campaign.compared import SecondCampaign
from truing.stages.second_campaign.errors import second_campaign_errors

PAGE = PROJECT / "docs" / "serial-arms.md"
RANDOM, GRID = "ipa-ur10-random", "ipa-ur10-grid"
_LEVERS = ("shoulder_lift_joint", "elbow_joint")
_ZEROS = (*_LEVERS, "wrist_1_joint", "wrist_2_joint")  # those that base and tool cannot stand for
_KNOTS = 72
_BEST = "and error curves, compliance and zeros"
_FEWEST_IN_COMMON = 20  # values of two curves of a joint


def _compliance(scene: ChainScene) -> list[ChainCause]:
    return [cause for cause in JointCompliance().candidates(scene) if cause.joint in _LEVERS]


def _curves(scene: ChainScene) -> list[ChainCause]:
    """Error curves of all joints that turn, with one knot every five degrees."""
    found = [cause for cause in JointErrorCurve().candidates(scene) if max(cause.knots) == _KNOTS]
    return [max(found, key=lambda cause: len(cause.joints))]


# Effects that are added to the geometry, one kind at a time.
ADDED: dict[str, Callable[[ChainScene], Sequence[ChainCause]]] = {
    "geometry": lambda scene: (),
    "and compliance of shoulder and elbow": _compliance,
    "and bending of all links": lambda scene: LinkBending().candidates(scene),
    "and gains of all joints": lambda scene: JointGain().candidates(scene),
    "and errors once per turn of all joints": lambda scene: JointEccentricity().candidates(scene),
    "and second and fourth harmonics of all joints": lambda scene: [
        JointHarmonic(joint=joint, order=order) for joint in scene.inputs_of_machine.tree.readings for order in (2, 4)
    ],
    "and error curves of all joints": _curves,
    "and error curves and compliance": lambda scene: [*_curves(scene), *_compliance(scene)],
    "and error curves, compliance and zeros": lambda scene: [
        *_curves(scene),
        *_compliance(scene),
        *(cause for cause in JointOffset().candidates(scene) if cause.joint in _ZEROS),
    ],
}


def campaign(name: str, folder: Path) -> SecondCampaign:
    """A campaign with the tables that its diagnosis needs."""
    return _read(prepare(name, folder))


def _read(folder: Path) -> SecondCampaign:
    line = stage_line(folder / "campaign.toml", None).call("ingest", "pose")
    tables = {key: table for key, table in line.tables.items() if not isinstance(table, str)}
    settings = read_campaign(tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8")))
    return SecondCampaign(folder.name, settings, tables)


def transfers(first: SecondCampaign, second: SecondCampaign, models: Sequence[str] = tuple(ADDED)) -> pd.DataFrame:
    """Rms errors of position (mm) and orientation (deg) of both campaigns, by models that were fitted to the first."""
    fitter = _fitter(first)
    scene: Any = fitter.fitted(()).scene
    rows = []
    for name in models:
        text = text_of_model(fitter.prepared(tuple(ADDED[name](scene))), first.settings)
        errors = [_errors(text, one) for one in (first, second)]
        if not rows:
            rows.append({"model": "base and tool alone", **_both(errors, "nominal")})
        rows.append({"model": name, **_both(errors, "extended")})
    return pd.DataFrame(rows).set_index("model")


def hidden_parts(judged: SecondCampaign, other: SecondCampaign) -> list[dict[str, Any]]:
    """Errors (mm) of the best model of a campaign on its own poses, without parts of its curves that another one, with
    readings elsewhere, cannot show: of one joint at a time, of the first three, and of all."""
    fitter = _fitter(judged)
    text = text_of_model(fitter.prepared(tuple(ADDED[_BEST](fitter.fitted(()).scene))), judged.settings)
    readings = _fitter(other).fitted(()).scene.inputs
    chain = read_chain(text)
    (curve,) = (effect for effect in chain.effects if isinstance(effect.cause, JointErrorCurve))
    joints = curve.cause.joints
    rows = []
    sets = {"none": (), **{joint: (joint,) for joint in joints}, "the first three": joints[:3], "all": joints}
    for name, own in sets.items():
        values, place = curve.values.copy(), 0
        for k, (joint, knots) in enumerate(zip(joints, curve.cause.knots, strict=True)):
            shown = curve.cause.basis(readings[joint], k).any(0)
            values[place : place + knots] *= shown | (joint not in own)
            place += knots
        left = tuple(replace(effect, values=values) if effect is curve else effect for effect in chain.effects)
        errors = _errors(write_chain(replace(chain, effects=left)), judged)
        rows.append({"hidden": name, "position": float(errors["extended", "position of tip"]) / 1e3})
    return rows


def _fitter(one: SecondCampaign) -> Fitter[Any]:
    data = assemble(one.tables, one.settings).whole
    return Fitter(data.model, data.calibration, None, 0)


def with_some_poses(folder: Path, every: Sequence[int] = (200, 100, 50, 25)) -> list[dict[str, Any]]:
    """Errors (mm) on held-out poses of the grid by the best model of the random poses and every so manyth fitted pose
    of the grid, each plan with a place of the base of its own."""
    source, rows = data_folder() / "ipa-ur10", []
    random, grid = (
        pd.read_csv(source / file, sep=";", dtype=str)
        for file in ("Series_C/measurements_random_poses.csv.gz", "Series_A/measurements_grid.csv.gz")
    )
    text = (HERE / RANDOM / "campaign.toml").read_text(encoding="utf-8")
    path = "../../../../shared/data/ipa-ur10/Series_C/measurements_random_poses.csv.gz"
    role = text[text.index("number_rows = { pose = 1, role = 1 }") : text.index("ignore =")]
    columns = 'columns]\nseries = "series"\nrole = "role"\n'
    text = text.replace(role, "number_rows = { pose = 1 }\n").replace(path, "poses.csv.gz")
    text = text.replace('frame = "campaign"', 'frame = "series"').replace("columns]\n", columns, 1)
    judged = [(grid.iloc[1::2], "grid", "verification"), (grid.iloc[:1], "grid", "calibration")]
    held = _written(folder / "held", text, judged)
    for step in every:
        some = grid.iloc[::2].iloc[::step]
        parts = [(random.iloc[::2], "random", "calibration"), (some, "grid", "calibration")]
        both = _written(folder / f"every-{step}", text, parts)
        fitter = _fitter(both)
        model = text_of_model(fitter.prepared(tuple(ADDED[_BEST](fitter.fitted(()).scene))), both.settings)
        position = float(_errors(model, held)["extended", "position of tip"]) / 1e3
        rows.append({"poses": len(some), "position": position})
    return rows


def _written(folder: Path, text: str, parts: Sequence[tuple[pd.DataFrame, str, str]]) -> SecondCampaign:
    """A campaign of rows of the files, with their series and their role."""
    folder.mkdir(parents=True)
    rows = pd.concat([own.assign(series=series, role=role) for own, series, role in parts], ignore_index=True)
    rows.to_csv(folder / "poses.csv.gz", sep=";", index=False)
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    return _read(folder)


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
    found["hidden"] = hidden_parts(of[GRID], of[RANDOM])
    found["some"] = with_some_poses(folder / "some")
    curves = {}
    for key, name in (("random", RANDOM), ("grid", GRID), ("irb", "irb120-faro-chain")):
        run([name], folder / key)
        tables = tables_of([name], folder / key)[name]
        found[key] = _said(tables)
        if name in of:
            curves[name] = tables["joint_curves"]
            text = (folder / key / "runs" / name / "model.toml").read_text(encoding="utf-8")
            found[f"from_{key}"] = _errors(text, of[GRID if name == RANDOM else RANDOM])
    found["repeats"] = repeats(curves[RANDOM], curves[GRID])
    return found


def repeats(first: pd.DataFrame, second: pd.DataFrame) -> list[dict[str, Any]]:
    """Agreement of the error curves of two campaigns where both determine them, by joint; mdeg."""
    rows = []
    for joint in dict.fromkeys(first["joint"]):
        curves = [own[(own["joint"] == joint) & own["is_determined"]].copy() for own in (first, second)]
        for curve in curves:  # both have knots on whole degrees
            curve["deg"] = np.degrees(curve["joint_reading_si"]).round(3)
        both = curves[0].merge(curves[1], on="deg", suffixes=("_a", "_b"))
        if len(both) >= _FEWEST_IN_COMMON:
            a, b = (np.degrees(both[f"deviation_si_{k}"].to_numpy()) * 1e3 for k in "ab")
            rows.append(
                {
                    "joint": joint,
                    "from_deg": float(both["deg"].min()),
                    "to_deg": float(both["deg"].max()),
                    "degrees": len(both) * float(np.diff(curves[0]["deg"]).min()),
                    "rms": float(np.std(a)),
                    "difference": float(np.std(a - b)),
                    "correlation": float(np.corrcoef(a, b)[0, 1]),
                }
            )
    return rows


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
