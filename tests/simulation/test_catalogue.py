"""The catalogue: the project's causes, and those that a laboratory brings along."""

from __future__ import annotations

from importlib.metadata import EntryPoint, EntryPoints

import numpy as np
import pytest

from tests.simulation.telescope import readings, telescope
from tests.tolerance import assert_close
from truing.simulation import causes
from truing.simulation.chain import Cause, Effect, Parameter, State, Step, simulate
from truing.simulation.legs import Change


class LegsTooLong(Cause):
    """A laboratory's own cause, whole: all legs are longer by the same length."""

    id = "legs-too-long"
    step = Step.STRUCTURE
    says = "all legs are too long by the same length"
    confirm = "Measure a leg."

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        return (Parameter("excess", "mm", 1e-5, 1e-3),)

    def change(self, state: State) -> Change:
        return Change({"l": np.ones((1, state.legs.count, 1))}, 1)


def _installed(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    points = EntryPoints(EntryPoint(name, f"{__name__}:LegsTooLong", causes.ENTRY_POINTS) for name in names)
    monkeypatch.setattr(causes, "entry_points", lambda group: points.select(group=group))


def test_a_cause_of_another_package_joins_the_catalogue(monkeypatch: pytest.MonkeyPatch) -> None:
    _installed(monkeypatch, "legs-too-long")
    assert "legs-too-long" in causes.catalogue()


def test_two_causes_of_one_name_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    _installed(monkeypatch, "one", "other")
    with pytest.raises(ValueError, match="cause legs-too-long: found in two places"):
        causes.catalogue()


def test_one_function_is_all_that_its_effect_takes() -> None:
    legs, rho = telescope(), readings(np.random.default_rng(1), 4)
    longer = simulate(legs, rho, [Effect(LegsTooLong(), np.array([2e-5]))])
    expected = simulate(legs.replace(l=legs.l + 2e-5), rho)
    assert_close(longer.p, expected.p, atol=1e-15, what="p, m")


@pytest.mark.parametrize("cause", causes.catalogue().values(), ids=lambda cause: cause.id)
def test_every_cause_says_what_the_contract_asks_of_it(cause: Cause) -> None:
    state = simulate(telescope(), readings(np.random.default_rng(2), 3))
    parameters = cause.parameters(6)
    assert cause.change(state).size == len(parameters)
    assert len({parameter.name for parameter in parameters}) == len(parameters)
    assert all(parameter.scale > 0 for parameter in parameters)
    assert cause.says
    assert cause.confirm
