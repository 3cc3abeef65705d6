"""A case: effects of a required strength hidden in an arm of a given layout, with its truth for the blind tests."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from tests.blind.generator.arms.draw import ArmCampaign, draw
from tests.blind.generator.arms.effects import ADDED, CAUSES, OF_GRAVITY, OF_MANY_POSES, OF_SLIDES, Effect, parameters
from tests.blind.generator.arms.folder import joint_columns, truth, write
from tests.blind.generator.arms.layouts import LAYOUTS
from tests.blind.generator.folder import truth_path

CATALOGUE = (*CAUSES, *ADDED)
MANY_POSES = 400
WITHOUT_SIZE = frozenset({"joints-exchanged"})
# Names and units of the tables that a diagnosis writes.
TURNS = {"rx": "turn_x", "ry": "turn_y", "rz": "turn_z"}
UNITS = {"m": ("mm", 1e3), "m/(N m)": ("mm/(N m)", 1e3), "1/(N m^2)": ("1/(N m2)", 1.0)}
Parameters = dict[str, dict[str, float | str]]


@dataclass(frozen=True)
class Case:
    """A campaign of an arm with effects in it, each as strong alone as stated."""

    campaign: ArmCampaign

    def write(self, folder: Path) -> Path:
        """Write the campaign under the folder's name, and its truth next to it."""
        write(self.campaign, folder)
        effects = self.campaign.effects
        strengths = [float("inf") if e.cause in WITHOUT_SIZE else round(e.strength, 3) for e in effects]
        reported = {"legs": 0, "effects": [self._reported(effect) for effect in effects], "strengths": strengths}
        truth_path(folder).write_text(json.dumps(truth(self.campaign) | reported, indent=1) + "\n", encoding="utf-8")
        return folder

    def _reported(self, effect: Effect) -> Mapping[str, object]:
        own = {"cause": effect.cause, "subject": effect.subject}
        if effect.cause != "foreign":
            return {**own, "parameters": reported_parameters(effect, self.campaign)}
        columns = [joint_columns(self.campaign).get(name, name) for name in inputs(effect)]
        own |= {"cause": "unexplained", "kind": str(effect.fixed["kind"])}
        return {**own, "follows": " ".join(columns), "parameters": {}}


def hide(names: Sequence[str], layout: str, wanted: float, seed: int) -> Case:
    """Effects by their names in ``CATALOGUE`` and ``FOREIGN``, each of the wanted strength, in a layout."""
    poses = MANY_POSES if set(names) & set(OF_MANY_POSES) else None
    return Case(draw(seed, layout=layout, causes=tuple(names), strength=wanted, poses=poses))


def layouts_for(names: Sequence[str]) -> list[str]:
    """The layouts in which effects of these names can be hidden."""
    # A joint whose load nobody knows has to turn, to carry no slide and to be in no loop.
    without = {"cylindrical", "delta"} if "joint-sag" in names else set[str]()
    slide = {"scara", "cylindrical", "gantry", "rail-6r", "column-lift"}
    return [own for own in LAYOUTS if own not in without and (own in slide or not set(OF_SLIDES) & set(names))]


def draw_two(rng: np.random.Generator) -> tuple[str, str]:
    """Two effects of the catalogue that can be distinguished.

    An exchange of columns stands alone; where masses are unknown, what needs them cannot be named.
    """
    pairs = [pair for pair in combinations(sorted(CAUSES), 2) if "joints-exchanged" not in pair]
    pairs = [pair for pair in pairs if "joint-sag" not in pair or not set(pair) <= set(OF_GRAVITY)]
    first, second = rng.permutation(pairs[rng.integers(len(pairs))]).tolist()
    return str(first), str(second)


def inputs(effect: Effect) -> list[str]:
    """Joints, or the column, that an effect of no catalogue follows: none where it is mere scatter."""
    kind = effect.fixed["kind"]
    if kind == "two-joints":
        return str(effect.fixed["inputs"]).split()
    return {"remanence": [effect.subject.removeprefix("joint ")], "slow-base": ["time_s"]}.get(str(kind), [])


def reported_parameters(effect: Effect, campaign: ArmCampaign) -> Parameters:
    """Parameters of an effect by names and units of a diagnosis; a lag is reported as what remains at the shortest
    wait.

    None of a curve, whose teeth are sharper than any spline.
    """
    reported: Parameters = {}
    if effect.cause in OF_MANY_POSES:
        return reported
    for name, entry in parameters(effect, campaign.bench.design.arm).items():
        unit, factor = UNITS.get(str(entry["unit"]), (entry["unit"], 1.0))
        if effect.cause == "joint-settling" and name != "tau":
            factor *= float(np.exp(-shortest_wait(effect, campaign) / float(effect.fixed["tau"])))
        reported[TURNS.get(name, name)] = {"value": float(entry["value"]) * factor, "unit": unit}
    return reported


def shortest_wait(effect: Effect, campaign: ArmCampaign) -> float:
    """The shortest wait, s, after a movement of the effect's joint, of the poses that are not held out."""
    schedule = campaign.bench.schedule
    moved = (schedule.steps[:, effect.where] != 0.0) & ~schedule.held_out
    return float(schedule.waits[moved].min())
