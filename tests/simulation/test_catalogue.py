"""The catalogue: the project's causes, and those of installed packages."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import EntryPoint, EntryPoints

import numpy as np
import pytest

from tests.simulation.mechanisms.telescope import readings, sample_model, telescope
from tests.tolerance import assert_close
from truing.schemas import installed
from truing.simulation import catalogue as causes
from truing.simulation.bench.causes.channels import ZeroDrift
from truing.simulation.cause import Cause, Effect, Parameter, Step
from truing.simulation.change import Change
from truing.simulation.mechanisms.causes.nonparametric import NonparametricMechanismEffect
from truing.simulation.mechanisms.forward_pass import simulate
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.state import State

COVARIATES = {
    "time_s": np.array([0.0, 60.0, 120.0]),
    "temperature_c": np.array([20.0, 21.0, 22.5]),
    "payload_kg": np.array([10.0, 20.0, 10.0]),
    "approach": np.array([[1.0] * 6, [-1.0] * 6, [1.0] * 6]),
    "order": np.arange(3.0),
}


class LegsTooLong(PointCause):
    """A laboratory's own cause, whole: all legs are longer by the same length."""

    id = "legs-too-long"
    step = Step.STRUCTURE
    says = "all legs are too long by the same length"
    confirm = "Measure a leg."

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        return (Parameter("excess", "mm", 1e-5, 1e-3),)

    def change(self, state: State, values: np.ndarray) -> Change:
        return Change({"l": np.ones((1, state.legs.count, 1))}, 1)


def _installed(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    points = EntryPoints(EntryPoint(name, f"{__name__}:LegsTooLong", causes.ENTRY_POINTS) for name in names)
    monkeypatch.setattr(installed, "entry_points", lambda group: points.select(group=group))


def test_a_cause_of_another_package_joins_the_catalogue(monkeypatch: pytest.MonkeyPatch) -> None:
    _installed(monkeypatch, "legs-too-long")
    assert "legs-too-long" in causes.catalogue()


class BeamsWarm(ZeroDrift):
    """A laboratory's own cause of readings."""

    id = "beams-warm"


def test_a_cause_of_readings_joins_those_of_a_bench_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    own = EntryPoints(
        EntryPoint(name, f"{__name__}:{name}", causes.ENTRY_POINTS) for name in ("LegsTooLong", "BeamsWarm")
    )
    monkeypatch.setattr(installed, "entry_points", lambda group: own.select(group=group))
    on_bench, elsewhere = causes.catalogue_of_readings(), (causes.catalogue(), causes.catalogue_of_bodies())
    assert ("beams-warm" in on_bench, "legs-too-long" in on_bench) == (True, False)
    assert all("beams-warm" not in known and "legs-too-long" in known for known in elsewhere)


class OfNoSort(Cause):
    """A laboratory's own cause that says neither what it changes nor how."""

    id = "of-no-sort"


def test_a_cause_of_no_known_base_class_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    own = EntryPoints([EntryPoint("OfNoSort", f"{__name__}:OfNoSort", causes.ENTRY_POINTS)])
    monkeypatch.setattr(installed, "entry_points", lambda group: own.select(group=group))
    with pytest.raises(ValueError, match="cause of-no-sort: found a class of no sort, expected a PointCause"):
        causes.catalogue()


def test_two_causes_of_one_name_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    _installed(monkeypatch, "one", "other")
    with pytest.raises(ValueError, match="cause legs-too-long: found in two places"):
        causes.catalogue()


def test_a_cause_with_one_function_is_simulated() -> None:
    legs, rho = telescope(), readings(np.random.default_rng(1), 4)
    longer = simulate(legs, rho, [Effect(LegsTooLong(), np.array([2e-5]))])
    expected = simulate(legs.replace(l=legs.l + 2e-5), rho)
    assert_close(longer.p, expected.p, atol=1e-15, what="p, m")


@pytest.mark.parametrize(
    "cause",
    [
        cause for name, cause in causes.catalogue().items() if not name.startswith(("body-", "gravity-"))
    ],  # they have tests of their own
    ids=lambda cause: cause.id,
)
def test_every_cause_says_what_the_contract_asks_of_it(cause: PointCause) -> None:
    state = replace(
        simulate(telescope(), readings(np.random.default_rng(2), 3), (), COVARIATES), points=np.ones((3, 2, 3))
    )
    parameters = cause.parameters(6)
    assert cause.change(state, np.zeros(len(parameters))).size == len(parameters)
    assert len({parameter.name for parameter in parameters}) == len(parameters)
    assert all(parameter.scale > 0 for parameter in parameters)


def test_a_nonparametric_form_claims_nothing_beyond_the_range_of_its_inputs() -> None:
    own = NonparametricMechanismEffect(columns=("time_s",), centres=(50.0,), half_ranges=(50.0,), degree=3)
    assert own.covers({"time_s": np.array([0.0, 100.0, 101.0, -1.0])}, 4).tolist() == [True, True, False, False]
    assert own.covers({}, 2).all()


def sample_scene(poses: int = 12) -> PointScene:
    """A campaign that offers something to every cause of a telescope."""
    rng = np.random.default_rng(3)
    scene = sample_model(rng, poses).scene
    bodies = [
        ("base", "platform", f"leg{leg + 1}")[body]
        for body, leg in zip(scene.targets.body, scene.targets.leg, strict=True)
    ]
    columns = {name: rng.normal(size=poses) for name in ("temperature_c", "humidity")}
    actuators = {name: rng.choice([-1.0, 1.0], (poses, 6)) for name in ("approach", "last step", "memory")}
    return replace(
        scene,
        targets=replace(scene.targets, names=tuple(f"T{n}" for n in range(len(bodies))), bodies=tuple(bodies)),
        covariates={**scene.covariates, "order": np.arange(float(poses)), **columns, **actuators},
        poses=tuple(range(poses)),
        span_s=(0.0, 3600.0),
        flexure_length_m=0.01,
    )


@pytest.mark.parametrize("cause", causes.catalogue().values(), ids=lambda cause: cause.id)
def test_every_found_candidate_has_all_results(cause: PointCause) -> None:
    scene = sample_scene()
    members = [own.member(0, shape) for own in cause.channel_candidates(scene) for shape in range(len(own.values))]
    for candidate in [*cause.candidates(scene), *members]:
        values = np.zeros(len(candidate.parameters(6)))
        assert candidate.covers(scene.covariates, 12).tolist() == [True] * 12
        assert len(candidate.reported(values, np.eye(len(values)), 6)) >= len(values)
        assert candidate.with_settings(**candidate.settings()) == candidate
        assert isinstance(candidate.inputs(6), tuple)
        assert isinstance(candidate.needs(6), tuple)
