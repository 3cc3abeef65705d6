"""A wrong name that was accepted early gives its place to the right one, once all other causes are in the model."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.mechanisms.chains.test_chain_model import diagnosed
from truing.inference import forward_search
from truing.inference.names_next_to_others import NamesNextToOthers
from truing.inference.rounds import Round
from truing.simulation.cause import Effect
from truing.simulation.mechanisms.chains.causes import ChainCause, JointGain
from truing.simulation.mechanisms.chains.link_causes import LinkBending
from truing.simulation.mechanisms.chains.loads import ColumnTilt

FLEXIBILITY, GAIN = 8e-5, 4e-4  # 1/(N m2), 1


@pytest.fixture
def _bending_is_never_accepted_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Links that bend are not asked while causes are accepted in turn: a tilt of the column takes their place."""
    plain_choice = forward_search.choose

    def without_bending(current: Round[ChainCause], refused: set[str], *rest: object, **keys: object):  # type: ignore[no-untyped-def]
        return plain_choice(current, refused | {LinkBending.id}, *rest, **keys)

    monkeypatch.setattr(forward_search, "choose", without_bending)


def _named() -> dict[tuple[str, str], str]:
    hidden = [
        Effect[ChainCause](LinkBending(link="link1"), np.array([FLEXIBILITY])),
        Effect[ChainCause](JointGain("j4"), np.array([GAIN])),
    ]
    verdicts = diagnosed(hidden, 4).verdicts
    return {(v.cause.id, v.cause.subject): v.verdict for v in verdicts if v.verdict in ("found", "suspected")}


@pytest.mark.slow
@pytest.mark.usefixtures("_bending_is_never_accepted_first")
def test_the_right_name_takes_the_place_of_a_wrong_one() -> None:
    assert _named() == {(LinkBending.id, "link link1"): "found", (JointGain.id, "joint j4"): "found"}


@pytest.mark.slow
@pytest.mark.usefixtures("_bending_is_never_accepted_first")
def test_without_the_exchange_the_wrong_name_stays_and_is_only_suspected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(NamesNextToOthers, "_exchanged", lambda *_: None)
    named = _named()
    assert named[ColumnTilt.id, "link base"] == "suspected"
    assert (LinkBending.id, "link link1") not in named
