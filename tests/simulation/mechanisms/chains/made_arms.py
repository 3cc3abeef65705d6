"""A synthetic arm of five joints with known masses, and campaigns of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.chains.conditions import ChainConditions, MeasuredChannels, movements
from truing.simulation.mechanisms.chains.model import ChainModel, KnownChain
from truing.simulation.mechanisms.chains.notations import DenavitHartenberg, tree_of_rows
from truing.simulation.mechanisms.chains.tree import Tree, geometry_modes

ROWS = [
    DenavitHartenberg(0.05, np.pi / 2, 0.35, 0.0),
    DenavitHartenberg(0.4, 0.0, 0.0, 0.3),
    DenavitHartenberg(0.03, np.pi / 2, 0.0, 0.1),
    DenavitHartenberg(0.0, -np.pi / 2, 0.38, 0.0),
    DenavitHartenberg(0.08, 0.0, 0.0, 0.2),
]


def arm() -> Tree:
    tree = tree_of_rows(ROWS, ("j1", "j2", "j3", "j4", "j5"))
    mass = (0.0, 8.0, 6.0, 4.0, 2.0, 1.0, 0.0)
    centre = np.array([0.0, 0.05, 0.1])
    nodes = [replace(node, mass=m, com=centre) for node, m in zip(tree.nodes, mass, strict=True)]
    return Tree(tuple(nodes), tree.readings)


def campaign(rng: np.random.Generator, poses: int, targets: int = 2, orientation: bool = False) -> ChainModel:
    tree = arm()
    q = rng.uniform(-1.2, 1.2, (poses, 5))
    names = [*(f"P{k}" for k in range(targets)), *(["tip"] if orientation else [])]
    turned = np.array([False] * targets + [True] * orientation)
    channels = MeasuredChannels(tuple(names), ("tip",) * len(names), np.full(len(names), 6), turned)
    order = np.arange(poses, dtype=float)
    waits = 2.0 + 40.0 * (np.arange(poses) * 0.618 % 1.0)
    covariates = {
        "time_s": 60.0 * order,
        "order": order,
        "temperature_c": 20.0 + 3.0 * np.sin(order / 7.0) + 0.02 * order,
        "since_motion_s": waits,
        **{f"j{k + 1}_deg": np.degrees(q[:, k]) for k in range(5)},
    }
    covariates |= movements(q, covariates, np.full(5, 1e-3))
    conditions = ChainConditions(
        q,
        covariates,
        tuple(range(poses)),
        np.zeros(poses, int),
        np.tile(np.eye(3), (poses, len(names), 1, 1)),
        np.full(poses, 1.5),
        tuple(f"j{k + 1}_deg" for k in range(5)),
    )
    count = len(names)
    modes = geometry_modes(tree, np.array([2e-4] * 3 + [3e-4] * 3), True)
    shape = np.where(turned[:, None], 0.0, rng.normal(0.0, 0.05, (count, 3)))
    known = KnownChain(
        exp_so3(np.array([[0.1, 0.2, 2.0]])),
        np.array([[1.5, 0.3, 0.2]]),
        True,
        modes,
        True,
        np.full(5, 2e-4),
        shape,
        0.05 * np.eye(3 * count).reshape(count, 3, -1),
        np.zeros(3 * count, bool),
        np.tile(np.eye(3), (count, 1, 1)),
        np.zeros(5),
        np.array([0.0, 0.0, -1.0]),
        (6, np.array([0.0, 0.0, 0.05])),
    )
    return ChainModel(tree, channels, known, conditions)
