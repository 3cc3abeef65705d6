"""A signal that responds to no load is named."""

from __future__ import annotations

import numpy as np

from truing.stages.quality.signal_checks import _signals_independent


def test_a_dead_signal_is_named_and_a_weak_one_is_not() -> None:
    rng = np.random.default_rng(1)
    names = tuple(f"v{k}" for k in range(1, 7))
    loads = rng.normal(size=(60, 6))
    signals = 1e-3 * loads @ rng.normal(size=(6, 6))
    signals[:, 2] = 0.0
    dead = _signals_independent(signals + 1e-6 * rng.normal(size=signals.shape), names, 6, 1e-3)
    assert dead.verdict == "warn"
    assert "v3 responds to no load" in dead.message
    signals[:, 2] = 0.1 * signals[:, 1]
    weak = _signals_independent(signals, names, 6, 1e-3)
    assert "responds" not in weak.message
