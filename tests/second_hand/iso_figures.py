"""Figures of ISO 230-2 and ISO 9283 by their formulas, with plain sums in place of the project's arrays.

Positions of ISO 230-2: deviations x_ij of each target i by side, as lists of any length. ISO 9283: attained poses
(x, y, z, a, b, c) of one command, and the command; angles in rad.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

Readings = Mapping[float, Sequence[float]]  # deviations by target


def mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)


def spread(values: Sequence[float]) -> float:
    """Standard deviation with n - 1."""
    centre = mean(values)
    return math.sqrt(math.fsum((value - centre) ** 2 for value in values) / (len(values) - 1))


def one_way(side: Readings) -> dict[str, float]:
    """E, R and A of one side."""
    means = [mean(own) for own in side.values()]
    found = {"E": max(means) - min(means)}
    if all(len(own) > 1 for own in side.values()):
        found["R"] = max(4 * spread(own) for own in side.values())
        highest = max(mean(own) + 2 * spread(own) for own in side.values())
        found["A"] = highest - min(mean(own) - 2 * spread(own) for own in side.values())
    return found


def both_ways(up: Readings, down: Readings) -> dict[str, float]:
    """B, M, E, R and A of targets that were approached from both sides."""
    targets = sorted(set(up) & set(down))
    of_up, of_down = {i: mean(up[i]) for i in targets}, {i: mean(down[i]) for i in targets}
    middle = [(of_up[i] + of_down[i]) / 2 for i in targets]
    every = [*of_up.values(), *of_down.values()]
    found = {
        "B": max(abs(of_up[i] - of_down[i]) for i in targets),
        "M": max(middle) - min(middle),
        "E": max(every) - min(every),
    }
    if all(len(side[i]) > 1 for side in (up, down) for i in targets):
        repeats = []
        for i in targets:
            above, below = spread(up[i]), spread(down[i])
            repeats.append(max(2 * above + 2 * below + abs(of_up[i] - of_down[i]), 4 * above, 4 * below))
        found["R"] = max(repeats)
        tops = [mean(side[i]) + 2 * spread(side[i]) for side in (up, down) for i in targets]
        found["A"] = max(tops) - min(mean(side[i]) - 2 * spread(side[i]) for side in (up, down) for i in targets)
    return found


Pose = Sequence[float]


def nearest(angle: float) -> float:
    """The same angle within half a turn of zero."""
    return math.remainder(angle, math.tau)


def pose_accuracy(attained: Sequence[Pose], command: Pose) -> dict[str, float]:
    """AP and AP_a, AP_b, AP_c: mean attained pose against the command."""
    offsets = [mean([pose[k] - command[k] for pose in attained]) for k in range(3)]
    turns = [mean([nearest(pose[k] - command[k]) for pose in attained]) for k in range(3, 6)]
    return {"AP": math.hypot(*offsets), **dict(zip(("AP_a", "AP_b", "AP_c"), turns, strict=True))}


def pose_repeatability(attained: Sequence[Pose], command: Pose) -> dict[str, float]:
    """RP: mean distance from the mean position plus three of its standard deviations; RP_a, RP_b, RP_c: three of the
    angles'."""
    centre = [mean([pose[k] for pose in attained]) for k in range(3)]
    lengths = [math.dist(pose[:3], centre) for pose in attained]
    turns = [3 * spread([nearest(pose[k] - command[k]) for pose in attained]) for k in range(3, 6)]
    return {"RP": mean(lengths) + 3 * spread(lengths), **dict(zip(("RP_a", "RP_b", "RP_c"), turns, strict=True))}


def multidirectional(groups: Sequence[Sequence[Pose]], command: Pose) -> dict[str, float]:
    """vAP and vAP_a, vAP_b, vAP_c: largest distance between the mean poses of the directions of approach."""
    means = [
        [mean([pose[k] for pose in group]) for k in range(3)]
        + [mean([nearest(pose[k] - command[k]) for pose in group]) for k in range(3, 6)]
        for group in groups
    ]
    pairs = list(combinations(means, 2))
    found = {"vAP": max(math.dist(one[:3], other[:3]) for one, other in pairs)}
    for place, name in enumerate("abc", 3):
        found[f"vAP_{name}"] = max(abs(one[place] - other[place]) for one, other in pairs)
    return found


def distances(first: Sequence[Pose], second: Sequence[Pose], commands: tuple[Pose, Pose]) -> dict[str, float]:
    """AD and RD of two commands that were attained in turn, and the same of the angles."""
    lengths = [math.dist(one[:3], other[:3]) for one, other in zip(first, second, strict=True)]
    found = {"AD": mean(lengths) - math.dist(commands[0][:3], commands[1][:3]), "RD": 3 * spread(lengths)}
    for place, name in enumerate("abc", 3):
        commanded = nearest(commands[1][place] - commands[0][place])
        turns = [nearest(other[place] - one[place] - commanded) for one, other in zip(first, second, strict=True)]
        found |= {f"AD_{name}": mean(turns), f"RD_{name}": 3 * spread(turns)}
    return found


def drift(attained: Sequence[Pose], command: Pose, cycles: int) -> dict[str, float]:
    """dAP and dRP: largest change of AP and RP from the first cycles on."""
    looks = [attained[n : n + cycles] for n in range(0, len(attained) - cycles + 1, cycles)]
    each = [pose_accuracy(look, command) | pose_repeatability(look, command) for look in looks]
    return {f"d{name}": max(abs(own[name] - each[0][name]) for own in each) for name in each[0]}
