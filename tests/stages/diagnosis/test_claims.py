"""Every cause has one wording, which describes each of its candidates from the tables."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.bench.sensor_benches import bench
from tests.simulation.mechanisms.chains.made_arms import campaign
from tests.simulation.test_catalogue import LegsTooLong, sample_scene
from truing.report.wordings.catalogue import WORDINGS, cause_words, clause, confirming
from truing.simulation import catalogue as causes
from truing.simulation.axis.nonparametric import LOOP, STRETCH, NonparametricAxisEffect
from truing.simulation.axis.rows import DIRECTION, SINCE_TURN
from truing.simulation.bench.causes.counts import FringeSlip
from truing.simulation.bench.causes.reading_causes import ReadingCause
from truing.simulation.bench.causes.rows_exchanged import RowsExchanged, SignalsExchanged
from truing.simulation.bodies.causes.deformation import BodyDeformation
from truing.simulation.bodies.causes.drift import BodyDrift
from truing.simulation.cause import Cause
from truing.simulation.mechanisms.causes.targets import TargetMoved, TargetsSwapped
from truing.simulation.mechanisms.chains.causes import ChainCause, JointScatter, JointsExchanged
from truing.simulation.mechanisms.chains.harmonics import JointHarmonic, JointPitchError
from truing.simulation.mechanisms.chains.target_causes import ChainTargetMoved
from truing.simulation.mechanisms.point_causes import PointCause
from truing.simulation.photographs.causes.camera_instability import CameraInstability
from truing.simulation.photographs.causes.nonparametric import NonparametricRayEffect
from truing.simulation.photographs.causes.refraction import Refraction
from truing.simulation.photographs.causes.scale_bar_temperature import OneBar
from truing.stages.diagnosis.rows import claim_of, with_fitted_settings

OWN = (
    *causes.OWN_CAUSES,
    *causes.OWN_CAUSES_OF_READINGS,
    *causes.OWN_CAUSES_OF_RAYS,
    *causes.OWN_CAUSES_OF_PHOTOGRAPHED_POINTS,
    *causes.OWN_CAUSES_OF_AXES,
    *causes.OWN_CAUSES_OF_CHAINS,
)
SCENES = (
    (PointCause, sample_scene()),
    (ReadingCause, bench().model().scene),
    (ChainCause, campaign(np.random.default_rng(1), 20).scene),
)
FORMS = ("jump", "drift", "settles", "temperature", "scatter")
DRIFTS = ({}, {"tau": 60.0}, {"waves": 3}, {"late": True, "start": 60.0}, {"from_pose": 12, "from_order": 11.0})
ROWS = ((2, 12), (2, 17))


MADE = (
    ChainTargetMoved("tip", "P1", 5, 5.0),
    JointsExchanged(("j2", "j3")),
    JointScatter("j2", 1),
    JointScatter(),
    JointScatter("j2", is_angle=False),
    JointPitchError("j3", is_angle=False, order=2.0 * np.pi / 0.01),
    JointPitchError("j3", is_angle=False, order=60.0, beside=2.0, free=True),
    TargetMoved("platform", "P07", 12, 11.0),
    TargetsSwapped("platform", ("P04", "P07"), (3, 4)),
    FringeSlip("dz", 4, 7),
    FringeSlip("dz", 4, 7, lone=True),
    *(
        CameraInstability("1", what, form, 0.5, 12)
        for what in (("c",), ("x0", "y0"), ("c", "x0", "y0"))
        for form in FORMS
    ),
    NonparametricRayEffect(owner="1"),
    NonparametricAxisEffect(element="load", columns=("command",), degree=3),
    NonparametricAxisEffect(columns=("time_s", "command"), centres=(0.0, 0.0), half_ranges=(60.0, 1.0)),
    NonparametricAxisEffect(columns=("time_s",), half_ranges=(90.0,), form=STRETCH),
    NonparametricAxisEffect(
        columns=(DIRECTION, SINCE_TURN), centres=(0.0, 1.0), half_ranges=(1.0, 1.0), form=LOOP, degree=3
    ),
    Refraction("1"),
    OneBar("A"),
    *(BodyDrift("mirror", ("1", "2"), whole=whole, **how) for whole in (True, False) for how in DRIFTS),
    *(BodyDeformation("mirror", ("1", "2"), terms=t, columns=t[:1]) for t in (("temperature_c",), ("approach el",))),
    BodyDeformation("mirror", terms=("el", "el*el"), columns=("el",), whole=True),
    BodyDeformation("mirror", terms=("base x", "base y", "base z"), columns=("base x", "base y", "base z")),
)


def candidates(kind: Cause) -> list[Cause]:
    """Candidates of a telescope or a bench, and some that were made by hand."""
    scene = next((offered for sort, offered in SCENES if isinstance(kind, sort)), None)
    made = [cause for cause in MADE if isinstance(cause, type(kind))]
    if scene is None or made:
        return made or [kind]
    members = [own.member(0, shape) for own in kind.channel_candidates(scene) for shape in range(len(own.values))]
    return [*kind.candidates(scene), *members] or [kind]


def test_every_cause_of_the_project_has_a_wording_and_nothing_else_has():
    assert {cause.id for cause in OWN} == set(WORDINGS)
    assert len({cause_words(name) for name in WORDINGS}) == len(WORDINGS)


@pytest.mark.parametrize("cause", OWN, ids=lambda cause: type(cause).__name__)
def test_every_candidate_has_its_clause_and_its_advice(cause):
    for candidate in candidates(cause):
        claim = claim_of(candidate, 6)
        kept = replace(claim, settings=json.loads(json.dumps(claim.settings)))
        assert clause(kept) == clause(claim)
        said, advice = clause(claim), confirming(claim).words
        assert said
        assert advice.endswith((".", "?"))
        for words in (said, advice):
            assert "None" not in words
            assert "  " not in words
        assert "this joint" not in advice
        for name in (word for part in claim.subject.split() for word in [part.removeprefix("leg")] if word.isdigit()):
            assert name in said


def test_exchanged_rows_say_whether_loads_or_signals_are_in_the_wrong_one():
    loads, signals = (clause(claim_of(kind(ROWS, ("fz",)), 0)) for kind in (RowsExchanged, SignalsExchanged))
    assert ("loads" in loads, "signals" in loads) == (True, False)
    assert ("loads" in signals, "signals" in signals) == (False, True)
    for words in (loads, signals):
        assert "of steps 12 and 17 of run 2" in words


def test_a_cause_of_a_lab_s_own_brings_its_words():
    claim = claim_of(LegsTooLong(), 6)
    assert clause(claim) == LegsTooLong.says
    assert confirming(claim, LegsTooLong.confirm).words == "Measure a leg."


def test_a_searched_order_is_named_as_fitted() -> None:
    cause = JointHarmonic("j2", order=81.0, beside=4.0, free=True)
    claim, values = claim_of(cause, 3), np.array([1e-4, 0.0, -1.25])
    fitted = cause.order_at(values)
    assert abs(fitted - 81.0) > 1.0
    reported = {p.name: {"value": p.value} for p in cause.reported(values, 1e-4 * np.eye(3), 3)}
    assert with_fitted_settings(claim, reported).settings == {**claim.settings, "order": fitted}
    assert f"{fitted:.4g} times per turn" in clause(with_fitted_settings(claim, reported))
