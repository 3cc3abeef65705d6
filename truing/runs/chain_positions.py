"""Places of a chain's links in the poses of a campaign, for its page; nominal geometry, frame of the base."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from truing.simulation.mechanisms.chains.joint_table import joint_column, tree_from_rows
from truing.simulation.mechanisms.chains.tree import Tree

if TYPE_CHECKING:
    import pandas as pd

_MM = 1e3
_ENTRIES = [f"r{i}{j}" for i in range(3) for j in range(3)]


def chain_positions(frames: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Return ``chain_nodes``, ``chain_tip`` of a chain's tables; empty for other machines and without readings.

    ``chain_nodes``: a row per node in the first ``pose``: joint, link, below, joint_kind, place of the link
    (x_mm .. z_mm), of the joint (ox_mm .. oz_mm), direction of its axis (ax .. az), rotation of the link (r00 .. r22),
    ``is_tip``. ``chain_tip``: place of the tip in each pose.
    """
    import pandas as pd

    if not len(frames.get("joints", ())) or not len(frames.get("configurations", ())):
        return {}
    joints = frames["joints"]
    tree = tree_from_rows(joints.to_dict("records"))
    readings = _readings(tree, frames["configurations"])
    if readings is None or not len(readings):
        return {}
    frames_found, tip = tree.frames(readings.to_numpy(float)), _tip(tree, frames)
    parts = [joints[["joint", "link", "below", "joint_kind"]].reset_index(drop=True)]
    directions = np.stack([frames_found.R[0, k] @ node.axis for k, node in enumerate(tree.nodes)])
    for values, names in (
        (frames_found.t[0] * _MM, ["x_mm", "y_mm", "z_mm"]),
        (frames_found.origin[0] * _MM, ["ox_mm", "oy_mm", "oz_mm"]),
        (directions, ["ax", "ay", "az"]),
        (frames_found.R[0].reshape(tree.size, 9), _ENTRIES),
    ):
        parts.append(pd.DataFrame(values, columns=names))
    nodes = pd.concat(parts, axis=1).assign(pose=readings.index[0], is_tip=np.arange(tree.size) == tip)
    positions = pd.DataFrame(frames_found.t[:, tip] * _MM, columns=["x_mm", "y_mm", "z_mm"]).assign(pose=readings.index)
    return {"chain_nodes": nodes, "chain_tip": positions}


def _readings(tree: Tree, table: pd.DataFrame) -> pd.DataFrame | None:
    """Return the readings (B, n), rad or m, of the poses that have them all, indexed by pose; None without columns."""
    import pandas as pd

    columns = [joint_column(tree, joint, map(str, table.columns)) for joint in tree.readings]
    known = {c.name: table[c.name].astype(float) * c.si for c in columns if c is not None}
    return pd.DataFrame(known).set_index(table["pose"]).dropna() if len(known) == len(columns) else None


def _tip(tree: Tree, frames: Mapping[str, pd.DataFrame]) -> int:
    """Return the node of the last link that was measured, or of the last link."""
    tables = [frames[name] for name in ("observations", "poses") if name in frames]
    nodes = [tree.links[body] for table in tables for body in set(table["body"]) & set(tree.links)]
    return max(nodes, default=tree.size - 1)
