"""Inputs that predict residuals of the simulation, next to an unnamed effect of the final model."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from truing.inference.attribution import Attributed
from truing.simulation.bench.causes.nonparametric import NonparametricReadingEffect
from truing.stages.diagnosis.rows import _attributed_rows

LEVEL = 0.05
V5, V6 = 10, 11
NAMES = ("dx", "dy", "dz", "rx", "ry", "rz", "v1", "v2", "v3", "v4", "v5", "v6")


def _subjects(monkeypatch: pytest.MonkeyPatch, p_value: float, *attributed: Attributed) -> list[tuple[str, str]]:
    """Subjects and inputs of the rows where signal v5 was found to depend on the load fz; the final model fails a test
    at ``p_value``."""
    cause = NonparametricReadingEffect(("fz_n",), (0.0,), (1e3,), channel="v5")
    model = SimpleNamespace(
        channel_names=NAMES, channel_kinds=("channel",) * 6 + ("signal",) * 6, channel_word="channel", part_count=6
    )
    diagnosis = SimpleNamespace(
        end=SimpleNamespace(is_complete=True),
        adequacy=SimpleNamespace(p_value=p_value),
        final=SimpleNamespace(model=model),
        plain=SimpleNamespace(model=model),
        verdicts=[SimpleNamespace(cause=cause, verdict="found")],
        attributed=attributed,
    )
    monkeypatch.setattr("truing.stages.diagnosis.rows._without_mean_effect", lambda *_: {})
    shown = SimpleNamespace(of_target=lambda channel: None)
    return [(row["subject"], row["follows"]) for row in _attributed_rows(diagnosis, shown, LEVEL)]


OWN = Attributed((V5,), ("fz_n",), 0.98, 1e-9)
BESIDE = Attributed((V5,), ("fy_n", "mz_nm"), 0.012, 3.5e-5)
ELSEWHERE = Attributed((V6,), ("fy_n",), 0.3, 1e-9)


def test_residuals_of_the_channel_of_a_found_effect_are_no_finding_if_the_model_holds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert _subjects(monkeypatch, 1.0, OWN, BESIDE, ELSEWHERE) == [("signal v6", "fy_n")]
    assert _subjects(monkeypatch, 1.0, BESIDE) == [("signal v5", "fy_n mz_nm")]


def test_remaining_residuals_are_reported_if_the_model_does_not_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _subjects(monkeypatch, 1e-6, OWN, BESIDE) == [("signal v5", "fy_n mz_nm")]
