"""Loops of a delta robot, as a lab writes them."""

import numpy as np

from truing.simulation.mechanisms.chains.closed_tree import LoopClosure


class Delta(LoopClosure):
    """Each forearm reaches from its elbow to its ball on the platform; parallelograms keep the platform level."""

    name = "delta"
    passive = ("platform_x", "platform_y", "platform_z")
    links = tuple(f"{part}_{k}" for part in ("forearm", "forearm_end", "ball") for k in (1, 2, 3))

    def gaps(self, at):
        """Return squared distance of ball and elbow less the squared length of the forearm (..., 3), m2."""
        elbow, end, ball = (
            np.stack([at[f"{part}_{k}"] for k in (1, 2, 3)], -2) for part in ("forearm", "forearm_end", "ball")
        )
        return np.sum((ball - elbow) ** 2, -1) - np.sum((end - elbow) ** 2, -1)
