"""Choice of 40 configurations compared with SLSQP: python -m benchmarks.pose_selection [--repeats 9 --starts 3].

The sample telescope within the range of its actuators, seven parameters of each leg: how long it takes to reach 95, 97
and 99 % of the best possible (D-efficiency), and what certifies it. Ours: rows of all candidates, bound, rounding and
exchanges over the corners; the rows of a set are made anew at every call. Theirs: 240 readings between bounds by
scipy's SLSQP from random starts, with finite differences as fmincon has them, and with our exact gradient. A row that
does not reach a share prints none; times include everything but loading. One thread.
"""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.rows import Peer, PeerState, Row, record_row
from benchmarks.timing import interleaved, pin, run_pinned, seconds_now

POSES = 40
SHARES = (0.95, 0.97, 0.99)
_ITERATIONS = 200
SMALLEST = ("--repeats", "1", "--starts", "1", "--iterations", "2", "--threads", "1")
SAMPLE = Path(__file__).resolve().parents[1] / "sample_data" / "telescope" / "campaign.toml"


class Telescope:
    """The problem as both sides see it."""

    def __init__(self) -> None:
        from truing.schemas.campaign import read_campaign
        from truing.stages.configurations.problem import design_problem, limits_of

        settings = read_campaign(tomllib.loads(SAMPLE.read_text(encoding="utf-8")))
        limits = limits_of(settings, pose_too=False, avoid=None, avoid_file="")
        self.problem = design_problem(settings, limits, ("a_x", "a_y", "b_x", "b_y", "u_x", "u_y", "l"), None)
        self.corners = self.problem.region.corners()
        self.reach = float(limits.readings[0])
        dense = self.problem.region.draw(2000, np.random.default_rng(0))
        self.candidates = np.concatenate([self.corners, dense])
        self.upper = self.bound(self.candidates)

    def bound(self, x: np.ndarray) -> float:
        """Return the upper bound on the log determinant of any 40 of the candidates."""
        from truing.estimation.design.pose_selection import bound_design

        return bound_design(self.problem.rows_at(x), POSES).upper

    def share(self, log_det: float) -> float:
        """Return the D-efficiency."""
        return float(np.exp((log_det - self.upper) / self.problem.size))

    def choose(self, x: np.ndarray) -> float:
        """Return the log determinant of our choice from candidates, the bound found on the way."""
        from truing.estimation.design.pose_selection import bound_design, exchange, rounded_design

        rows = self.problem.rows_at(x)
        return exchange(rows, rounded_design(bound_design(rows, POSES), POSES)).log_det

    def log_det(self, levels: np.ndarray) -> float:
        """Return the log determinant at actuators moved by levels (240,) of their reach."""
        from truing.estimation.design.pose_selection import information_of, sum_log_det

        return sum_log_det(information_of(self.problem.rows(self._placed(levels))))

    def gradient(self, levels: np.ndarray) -> np.ndarray:
        """Return its exact gradient (240,)."""
        from truing.estimation.design.pose_selection import information_of

        regressors = self.problem.regressors
        x = regressors.coordinates(self._placed(levels))
        rows, changes = self.problem.rows_and_changes(x)
        solved = np.einsum("lqr,nlr->nlq", np.linalg.inv(information_of(rows)), rows)
        by_x = 2.0 * np.einsum("nlq,nlqi->ni", solved, changes)
        reading = regressors.quantities(x)[1][:, 6:] / self.reach
        return np.linalg.solve(np.swapaxes(reading, 1, 2), by_x[..., None])[..., 0].ravel()

    def _placed(self, levels: np.ndarray):  # type: ignore[no-untyped-def]
        rho0 = self.problem.regressors.machine.legs.rho0
        return self.problem.placed_at(rho0 + self.reach * levels.reshape(POSES, 6))


def slsqp(telescope: Telescope, exact: bool, seed: int, iterations: int) -> list[tuple[float, float]]:
    """Return seconds and share of the best after every iteration of SLSQP from one random start."""
    from scipy.optimize import minimize

    start = np.random.default_rng(seed).uniform(-1, 1, 6 * POSES)
    history: list[tuple[float, float]] = []
    begun = seconds_now()
    spent = 0.0

    def note(levels: np.ndarray) -> None:
        nonlocal spent
        now = seconds_now()
        history.append((now - begun - spent, telescope.share(telescope.log_det(levels))))
        spent += seconds_now() - now

    minimize(
        lambda levels: -telescope.log_det(levels),
        start,
        jac=(lambda levels: -telescope.gradient(levels)) if exact else None,
        method="SLSQP",
        bounds=[(-1.0, 1.0)] * len(start),
        callback=note,
        options={"maxiter": iterations, "ftol": 1e-9},
    )
    return history


def reached(history: list[tuple[float, float]]) -> str:
    """Return the time until each share, and the final share with its time."""
    times = [next((f"{s:8.2f} s" for s, share in history if share >= wanted), "    never ") for wanted in SHARES]
    return " ".join(times) + f"   ends at {100 * history[-1][1]:.2f} % after {history[-1][0]:.2f} s"


def measure(repeats: int, starts: int, iterations: int) -> None:
    """Print all rows."""
    telescope = Telescope()
    count = len(telescope.candidates)
    print(f"certificate: no {POSES} configurations exceed {telescope.upper:.6f}, over {count} candidates")
    tasks: dict[str, Callable[[], object]] = {
        "bound and choice, 64 corners": lambda: telescope.choose(telescope.corners),
        f"the same, {count} candidates": lambda: telescope.choose(telescope.candidates),
    }
    shares = [telescope.share(telescope.choose(x)) for x in (telescope.corners, telescope.candidates)]
    seconds = interleaved(tasks, repeats)
    for (name, times), share in zip(seconds.items(), shares, strict=True):
        low, middle, high = 1e3 * times.min(), 1e3 * np.median(times), 1e3 * times.max()
        print(f"truing: {name:32} {low:8.2f} {middle:8.2f} {high:8.2f} ms   {100 * share:.2f} % of the best possible")
    print(f"{'':40} " + " ".join(f"{100 * share:.0f} % after" for share in SHARES))
    peers = []
    for name, exact in (("finite differences", False), ("exact gradient", True)):
        histories = [slsqp(telescope, exact, seed, iterations) for seed in range(starts)]
        peers.append(_peer(f"scipy SLSQP, {name}", histories, seconds["bound and choice, 64 corners"]))
        for history in histories:
            print(f"scipy SLSQP, {name:27} {reached(history)}", flush=True)
        print(f"{'':40} {verdict(histories, seconds['bound and choice, 64 corners'], shares[0])}")

    own = 1e3 * float(np.median(seconds["bound and choice, 64 corners"]))
    record_row(
        Row(
            f"{POSES} configurations, {100 * shares[0]:.2f} % of the best possible", own, "ms", tuple(peers), limit=10.0
        )
    )


def _peer(name: str, histories: list[list[tuple[float, float]]], ours: np.ndarray) -> Peer:
    """SLSQP by the quickest start that reaches 99 %; without one it missed the solution."""
    times = [next((s for s, found in history if found >= SHARES[-1]), None) for history in histories]
    reached = [s for s in times if s is not None]
    if not reached:
        return Peer(name, 1e3 * min(history[-1][0] for history in histories), state=PeerState.MISSED)
    return Peer(name, 1e3 * min(reached), min(reached) / float(np.median(ours)), PeerState.MEASURED)


def verdict(histories: list[list[tuple[float, float]]], ours: np.ndarray, share: float) -> str:
    """Return the ratio of the peer's time to ours until 99 %, in words, or the reason why there is none."""
    if share < SHARES[-1]:
        return "no ratio: ours does not reach 99 %"
    times = [next((s for s, found in history if found >= SHARES[-1]), np.inf) for history in histories]
    if np.isfinite(times).any():
        return f"99 % took {np.min(times) / np.median(ours):.0f} times as long, in the quickest of {len(times)} starts"
    ends = [history[-1][0] for history in histories]
    return (
        f"no ratio for 99 %: not reached; to their own ends {np.min(ends) / np.median(ours):.0f} times as long or more"
    )


def main() -> None:
    """Measure all of it in a pinned process of one thread."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--repeats", type=int, default=9)
    arguments.add_argument("--starts", type=int, default=3)
    arguments.add_argument("--iterations", type=int, default=_ITERATIONS, help="of SLSQP, at most")
    arguments.add_argument("--threads", type=int, default=0, help="measure in this process, with so many threads")
    given = arguments.parse_args()
    if not given.threads:
        options = {"--repeats": given.repeats, "--starts": given.starts, "--iterations": given.iterations}
        words = [str(word) for option in options.items() for word in option]
        run_pinned("benchmarks.pose_selection", words, 1)
        return
    pin(given.threads)
    measure(given.repeats, given.starts, given.iterations)


if __name__ == "__main__":
    main()
