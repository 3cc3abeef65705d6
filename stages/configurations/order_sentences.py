"""Sentences on the order of a plan: travel between its poses, and drift that its regressors can imitate."""

from __future__ import annotations

from truing.estimation.design.pose_order import PoseOrder


def percent_of(share: float) -> str:
    """Return a share in per cent, with two decimals."""
    return f"{100 * share:.2f} %"


def order_sentences(order: PoseOrder, factor: float, unit: str, mover: str, imitating: str) -> list[str]:
    """Return the sentences; travel times factor is in unit, mover is the drive that counts in each move."""
    return [
        f"travel {factor * order.travel:.1f} {unit} in this order, {factor * order.random_travel:.1f} {unit} in a "
        f"random one ({mover} of each move)",
        f"drift: of a line in time, {imitating} can imitate {percent_of(order.drift)} "
        f"({percent_of(order.random_drift)} in a random order)",
    ]
