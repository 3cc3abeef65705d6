"""Two campaigns of the sample's robot: the same errors of its links, other poses; effects may change between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.blind.generator.arms.draw import record
from tests.blind.generator.arms.effects import Effect
from tests.blind.generator.arms.folder import write
from tests.blind.generator.arms.robot import _hidden, _schedule, robot_campaign
from tests.blind.generator.arms.strength import Bench

MACHINE = 20240611  # seed of the errors of the links


def offset(joint: int, size: float) -> Effect:
    """A joint that stands ``size``, rad, from its reading."""
    name = ("turn", "shoulder", "elbow", "roll", "bend", "twist")[joint]
    return Effect("joint-offset", f"joint {name}", joint, np.ones(75), size)


def measured(
    folder: Path, seed: int, added: Sequence[Effect] = (), *, tolerance: bool = True, soft: float = 1.0
) -> Path:
    """A campaign of the robot by poses of their own; ``soft`` multiplies the compliance of its shoulder.

    Without ``tolerance``, campaign.toml declares none, and the zeros of the joints are right.
    """
    sample = robot_campaign()
    rng, own = np.random.default_rng(seed), sample.bench
    assert own.tolerance is not None
    errors = own.design.sigmas(own.tolerance if tolerance else replace(own.tolerance, offset=0.0))
    arm = own.design.changed(errors * np.random.default_rng(MACHINE).normal(size=len(errors)))
    bench: Bench = replace(own, schedule=_schedule(own.design.arm, own.joint_noise, rng))
    compliance, eccentric = _hidden(bench)
    effects = (replace(compliance, size=soft * compliance.size), eccentric, *added)
    built = replace(bench, design=replace(bench.design, arm=arm), tolerance=None)
    made = record(seed, "robot", built, effects, rng)
    return write(replace(made, bench=replace(bench, tolerance=own.tolerance if tolerance else None)), folder)
