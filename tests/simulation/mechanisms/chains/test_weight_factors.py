"""A payload or masses in another unit change the ratio of loads that deflections follow."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.simulation.mechanisms.chains.made_arms import campaign
from tests.simulation.mechanisms.chains.test_chain_model import diagnosed
from tests.tolerance import assert_close
from truing.inference import forward_search
from truing.inference.cause_forms import CauseForms
from truing.inference.rounds import Round
from truing.inference.search_result import contested_causes
from truing.simulation.cause import Effect
from truing.simulation.mechanisms.chains.causes import ChainCause, ChainScene, JointCompliance
from truing.simulation.mechanisms.chains.link_causes import LinkBending
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.weight_factors import LINKS, MASS_UNITS, PAYLOAD, WeightFactor

NEWTON = MASS_UNITS["N"]


def with_payload(model: ChainModel, factor: float) -> ChainModel:
    conditions = model.conditions
    return model.at(replace(conditions, payload_kg=factor * conditions.payload_kg))


def with_masses(model: ChainModel, factor: float) -> ChainModel:
    nodes = tuple(replace(node, mass=factor * node.mass) for node in model.tree.nodes)
    return replace(model, tree=replace(model.tree, nodes=nodes))


def test_a_payload_times_its_factor_deflects_as_the_right_payload_does() -> None:
    model = campaign(np.random.default_rng(1), 20)
    right = JointCompliance("j2").deviations(model.machine)[..., 0]
    read_in_newton = with_payload(model, 1.0 / NEWTON).machine
    assert_close(WeightFactor("j2", factor=NEWTON).deviations(read_in_newton)[..., 0], right, atol=1e-9)


def test_masses_times_their_factor_deflect_as_the_right_masses_do() -> None:
    model = campaign(np.random.default_rng(1), 20)
    right = JointCompliance("j2").deviations(model.machine)[..., 0]
    read_in_pounds = with_masses(model, 1.0 / MASS_UNITS["lb"]).machine
    found = WeightFactor("j2", part=LINKS, factor=MASS_UNITS["lb"]).deviations(read_in_pounds)[..., 0]
    assert_close(found, right, atol=1e-9)


@pytest.mark.parametrize("factor", [0.0, 1.0])
def test_a_ratio_is_sought_only_where_there_is_a_payload(factor: float) -> None:
    model = with_payload(campaign(np.random.default_rng(1), 20), factor)
    found = WeightFactor().candidates(ChainScene(model.machine))
    assert bool(found) == bool(factor)
    assert {cause.part for cause in found} == ({PAYLOAD, LINKS} if factor else set())


@pytest.mark.parametrize(
    ("deviation", "sigma", "units", "is_claimed"),
    [
        (0.0, 0.1, "N", True),  # 0.102 +- 0.010
        (0.5, 0.1, "", False),  # 0.153 +- 0.010
        (0.0, 3.0, "g lb N", False),  # 0.10 +- 0.31
        (3.4, 0.9, "lb", True),  # 0.45 +- 0.09, though newtons were assumed
    ],
)
def test_a_unit_is_claimed_only_if_the_fitted_factor_is_clear(
    deviation: float, sigma: float, units: str, is_claimed: bool
) -> None:
    cause = WeightFactor("j2", factor=NEWTON).refined()
    values, covariance = np.array([1e-5, deviation]), np.diag([1e-14, sigma**2])
    assert cause.is_distinct(values, covariance) is is_claimed
    assert cause.reported(values, covariance, 0)[-1].value == units


def test_a_payload_in_newtons_is_named_and_not_a_gain_of_the_joint() -> None:
    """The payload is 1.5 kg; 14.7 is declared."""
    true = Effect(JointCompliance("j2", load=20.0), np.array([6e-5]))
    found = diagnosed([true], 4, described=lambda model: with_payload(model, 1.0 / NEWTON))
    (verdict,) = (v for v in found.verdicts if v.verdict == "found")
    assert isinstance(verdict.cause, WeightFactor)
    assert (verdict.cause.joint, verdict.cause.part) == ("j2", PAYLOAD)
    assert verdict.cause.reported(verdict.values, verdict.covariance, 0)[-1].value == "N"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 5, 6])
def test_two_compliant_joints_under_the_declared_weights_have_no_other_ratio(seed: int) -> None:
    true = [Effect(JointCompliance(joint, load=20.0), np.array([4e-5])) for joint in ("j2", "j3")]
    found = [v.cause for v in diagnosed(true, seed).verdicts if v.verdict in ("found", "suspected")]
    assert found
    assert not any(isinstance(cause, WeightFactor) for cause in found)


@pytest.mark.slow
def test_a_factor_whose_plain_form_fails_is_refused_and_not_chosen_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every cause predicts held-out poses worse here: each kind is asked for once, and the search ends."""
    asked: list[str] = []
    plain_choice = forward_search.choose

    def counted(*arguments: object, **keys: object) -> object:
        found = plain_choice(*arguments, **keys)  # type: ignore[arg-type]
        if found is not None:
            asked.append(found.candidate.cause.id)
            assert len(asked) < 30, "the search does not end"
        return found

    def first_asked_for_the_factor(current: Round[ChainCause], refused: set[str], *rest: object, **keys: object):  # type: ignore[no-untyped-def]
        """Choose a weight factor before others, as where it is a little more probable than the plain compliance."""
        if asked and not refused:  # at its end the search asks what is left, refused or not
            return plain_choice(current, refused, *rest, **keys)
        others = {c.kind for c in current.candidates} - {WeightFactor.id}
        return counted(current, refused | others, *rest, **keys) or counted(current, refused, *rest, **keys)

    monkeypatch.setattr(forward_search, "choose", first_asked_for_the_factor)
    monkeypatch.setattr(forward_search, "predicts_worse", lambda *_: True)
    found = diagnosed([Effect(JointCompliance("j2", load=20.0), np.array([6e-5]))], 4)
    assert WeightFactor.id in asked
    assert asked.count(WeightFactor.id) == 1
    assert not [v for v in found.verdicts if v.verdict == "found" and v.cause.catalogued]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4])
def test_masses_in_pounds_are_named_after_a_plain_compliance_was_accepted(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plain compliance is taken up first, as if large errors had hidden the ratio; then its form is asked again."""
    plain_choice = forward_search.choose

    def first_plain(current: Round[ChainCause], refused: set[str], *rest: object, **keys: object):  # type: ignore[no-untyped-def]
        held = {cause.id for cause in current.fitted.causes}
        refused = refused if held else refused | {WeightFactor.id, LinkBending.id}
        return plain_choice(current, refused, *rest, **keys)

    monkeypatch.setattr(forward_search, "choose", first_plain)
    monkeypatch.setattr(CauseForms, "is_contested", lambda *_: False)
    true = Effect(JointCompliance("j2", load=20.0), np.array([6e-5]))
    found = diagnosed([true], seed, described=lambda model: with_masses(model, 1.0 / MASS_UNITS["lb"]))
    verdicts = [v for v in found.verdicts if v.verdict in ("found", "suspected")]
    assert [(type(v.cause), v.cause.subject) for v in verdicts] == [(WeightFactor, "joint j2")]
    assert verdicts[0].cause.reported(verdicts[0].values, verdicts[0].covariance, 0)[-1].value == "lb"


def test_causes_by_declared_weights_contest_a_factor_and_are_contested_by_it() -> None:
    factor, other = WeightFactor("j2"), JointCompliance("j3")
    steps = [SimpleNamespace(cause=cause, is_contested=False) for cause in (factor, other)]
    assert contested_causes(steps) == {factor.key, other.key}  # type: ignore[arg-type]
    assert contested_causes(steps[:1]) == contested_causes(steps[1:]) == set()  # type: ignore[arg-type]


def test_causes_accepted_after_a_contested_form_are_contested_too() -> None:
    causes = (JointCompliance("j1"), JointCompliance("j2"), JointCompliance("j3"))
    steps = [SimpleNamespace(cause=cause, is_contested=cause.joint == "j2") for cause in causes]
    assert contested_causes(steps) == {causes[1].key, causes[2].key}  # type: ignore[arg-type]
