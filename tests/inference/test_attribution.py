"""Inputs that predict the residuals are found; without such inputs, none is named."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from truing.inference.attribution import Attributed, _merged, attributed
from truing.inference.campaign_inputs import InTime, is_copy
from truing.inference.fitted_model import FittedModel
from truing.inference.input_sets import sets_of_inputs
from truing.inference.input_spectra import Spectra
from truing.inference.model import ErrorPathway
from truing.inference.random_functions import distinct_rows
from truing.inference.residual_courses import courses, residuals_of

EPOCHS, LEVEL = 60, 0.005
NAMES = ("temperature_c", "load_n", "rho1_mm", "rho2_mm")


def _columns(rng: np.random.Generator) -> dict[str, np.ndarray]:
    drawn = {name: rng.uniform(-1.0, 1.0, EPOCHS) for name in NAMES}
    return {"time_s": np.arange(EPOCHS) * 60.0, **drawn}


def _in_time() -> InTime:
    return InTime(np.arange(EPOCHS, dtype=float), None)


def _reported(rows: np.ndarray, columns: dict[str, np.ndarray]) -> set[str]:
    return {name for inputs, _, _ in sets_of_inputs(rows, Spectra(columns, _in_time()), LEVEL) for name in inputs}


@pytest.mark.slow
def test_noise_follows_nothing() -> None:
    alarms = 0
    for seed in range(25):
        rng = np.random.default_rng([seed, 1])
        alarms += bool(_reported(rng.standard_normal((EPOCHS, 3)), _columns(rng)))
    assert alarms <= 2  # more have a probability of 3e-4 at this level


@pytest.mark.slow
def test_heavy_tails_follow_nothing() -> None:
    alarms = 0
    for seed in range(25):
        rng = np.random.default_rng([seed, 2])
        alarms += bool(_reported(rng.standard_t(3.0, (EPOCHS, 1)), _columns(rng)))
    assert alarms <= 2


@pytest.mark.parametrize("driver", NAMES)
def test_a_nonlinear_function_of_one_input_is_reported_with_it_alone(driver: str) -> None:
    rng = np.random.default_rng([NAMES.index(driver), 3])
    columns = _columns(rng)
    rows = 2.0 * np.cos(3.0 * columns[driver])[:, None] + rng.standard_normal((EPOCHS, 1))
    assert _reported(rows, columns) == {driver}


def test_both_inputs_of_a_product_are_reported() -> None:
    rng = np.random.default_rng(4)
    columns = _columns(rng)
    course = np.sin(2.0 * columns["rho1_mm"]) * np.sin(2.0 * columns["load_n"])
    assert _reported(8.0 * course[:, None] + rng.standard_normal((EPOCHS, 1)), columns) == {"rho1_mm", "load_n"}


def test_friction_is_distinguished_by_the_history_of_its_input() -> None:
    rng = np.random.default_rng(5)
    columns = _columns(rng)
    history = _in_time().history(columns["rho2_mm"])
    assert history is not None
    assert _reported(3.0 * history[:, 1:2] + rng.standard_normal((EPOCHS, 1)), columns) == {"rho2_mm"}


def test_an_effect_in_one_run_is_attributed_though_it_passed_for_a_burst_of_noise() -> None:
    rng = np.random.default_rng(8)
    columns = _columns(rng)
    in_run = np.arange(EPOCHS) >= 40
    columns["load_n"] = np.where(in_run, columns["load_n"], 0.0)
    burst = np.where(in_run, 9.0, 1.0)[:, None]
    effect = 9.0 * np.sin(4.0 * columns["load_n"])[:, None]
    own = SimpleNamespace(
        measured=SimpleNamespace(values=np.zeros((EPOCHS, 1, 1)), is_observed=np.ones((EPOCHS, 1), bool), size=1),
        standardised=((effect + rng.standard_normal((EPOCHS, 1))) / burst)[..., None],
        fit=SimpleNamespace(whitened=None),
    )
    fitted = cast(FittedModel, own)
    (hidden,), (shown,) = (list(residuals_of(fitted, fitted, factor)) for factor in (None, burst))
    assert np.std(hidden.rows[in_run]) < 1.0
    assert _reported(shown.rows, columns) == {"load_n"}


@pytest.mark.slow
def test_a_walk_in_time_follows_time_and_no_input_that_walks_too() -> None:
    said = []
    for seed in range(10):
        rng = np.random.default_rng([seed, 6])
        columns = _columns(rng) | {"temperature_c": np.cumsum(rng.standard_normal(EPOCHS))}
        walk = np.cumsum(rng.standard_normal(EPOCHS))
        said.append(_reported(walk[:, None] + 0.3 * rng.standard_normal((EPOCHS, 1)), columns))
    assert sum("time_s" in one for one in said) >= 8
    assert sum(bool(one - {"time_s"}) for one in said) <= 1


def test_a_weak_course_common_to_many_channels_is_attributed_to_its_input() -> None:
    rng = np.random.default_rng(7)
    columns = _columns(rng)
    course, field = np.cos(3.0 * columns["load_n"]), rng.standard_normal(24)
    assert _reported(0.45 * np.outer(course, field) + rng.standard_normal((EPOCHS, 24)), columns) == {"load_n"}


def test_the_share_is_the_prediction_beyond_chance() -> None:
    shares = []
    for seed in range(8):
        rng = np.random.default_rng([seed, 8])
        columns = _columns(rng)
        course = np.cos(3.0 * columns["load_n"])
        rows = 2.0 * course + rng.standard_normal(EPOCHS)
        (_, share, _), *_ = sets_of_inputs(rows[:, None], Spectra(columns, _in_time()), LEVEL)
        shares.append(share - 4.0 * course.var() / (4.0 * course.var() + 1.0))
    assert abs(np.mean(shares)) < 4.0 * 0.06 / np.sqrt(8)  # a share of 60 epochs is known to some 6 %


def test_runs_are_independent_of_earlier_runs() -> None:
    values, groups = np.tile([0.0, 1.0, 0.0], 4), np.repeat(np.arange(4), 3)
    history = InTime(np.arange(12.0), groups.astype(float)).history(values)
    assert history is not None
    for run in range(1, 4):
        np.testing.assert_allclose(history[3 * run : 3 * run + 3], history[:3])


def test_a_known_history_comes_before_that_of_the_epochs_at_hand() -> None:
    """Of an input in another unit too; another one has that of these epochs."""
    values, past = np.linspace(0.0, 1.0, 12) ** 2, np.ones((12, 4))
    in_time = InTime(np.arange(12.0), None, ((values, past),))
    assert in_time.history(np.rad2deg(values)) is past
    assert in_time.history(values**2) is not past


def test_a_copy_of_a_column_is_no_input_of_its_own() -> None:
    """Neither the same time within runs, nor an angle in degrees next to radians."""
    time, groups = np.arange(12.0)[:, None], np.repeat([0, 1], 6)
    since = time - 6.0 * groups[:, None]
    assert is_copy(since, time, groups)
    assert is_copy(time, since, groups)
    assert is_copy(np.rad2deg(time), time, None)
    assert not is_copy(since, time, None)
    assert not is_copy(time**2, time, groups)
    for one, other in ((groups[:, None], time), (time, groups[:, None])):
        assert not is_copy(one, other, groups), "constant in each run"


def _bends(size: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Noise (60, 30) with one unknown pattern along a course (60,) of a signal-to-noise ratio."""
    course = np.sin(np.linspace(0.0, 9.0, 60)) + 0.3 * rng.normal(size=60)
    pattern = rng.normal(size=30)
    bend = np.outer(course - course.mean(), pattern)
    return rng.normal(size=(60, 30)) + size * bend / np.linalg.norm(bend), course


def test_inputs_within_others_of_the_same_channels_are_one_entry() -> None:
    pair = Attributed((), ("rho1_mm", "load_n"), 0.2, 1e-3)
    part = Attributed((), ("load_n",), 0.3, 1e-2)
    elsewhere = Attributed((2,), ("load_n",), 0.1, 1e-4)
    assert set(_merged([part, elsewhere, pair])) == {replace(pair, share=0.3), elsewhere}


def test_a_set_of_inputs_remains_if_any_of_its_entries_remains() -> None:
    pair = Attributed((), ("rho1_mm", "load_n"), 0.2, 1e-3, remains=False)
    part = Attributed((), ("load_n",), 0.1, 1e-2, remains=False)
    (explained,), (left,) = (list(_merged([pair, one])) for one in (part, replace(part, remains=True)))
    assert explained == pair
    assert left == replace(pair, remains=True, is_partial=True)  # the larger share is that of the model without causes


def _of_numbers(residuals: np.ndarray, columns: dict[str, np.ndarray]) -> FittedModel:
    """A fitted model of one channel, as far as its residuals (60,) are asked on what they depend."""
    conditions = SimpleNamespace(readings=np.zeros((EPOCHS, 0)))
    own = SimpleNamespace(
        measured=SimpleNamespace(values=np.zeros((EPOCHS, 1, 1)), is_observed=np.ones((EPOCHS, 1), bool), size=1),
        standardised=residuals[:, None, None],
        fit=SimpleNamespace(whitened=None),
        model=SimpleNamespace(error_groups=None, error_pathways=(), conditions=conditions),
        scene=SimpleNamespace(covariates=columns, inputs={}, histories={}),
    )
    return cast(FittedModel, own)


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_residuals_explained_by_accepted_causes_do_not_remain(size: float) -> None:
    """``size``: the part of the effect that they leave."""
    rng = np.random.default_rng(14)
    columns = _columns(rng)
    effect, noise = 6.0 * np.cos(3.0 * columns["load_n"]), rng.standard_normal(EPOCHS)
    plain, final = (_of_numbers(part * effect + noise, columns) for part in (1.0, size))
    found = attributed(plain, (plain, final), LEVEL, LEVEL).found
    assert [(one.inputs, one.remains) for one in found] == [(("load_n",), size > 0.0)]


@pytest.mark.parametrize("in_error", range(3))
def test_an_error_of_one_channel_is_no_error_of_others_that_share_its_input(in_error: int) -> None:
    """Three encoders see one scattering position, which is estimated from them: an error of one moves all residuals."""
    rng = np.random.default_rng(15)
    columns = _columns(rng)
    seen = np.array([2.0, 5.0, 2.0, 1.0])  # the position in noise of the encoders, and in its own scatter
    basis = seen / np.linalg.norm(seen)
    rows = rng.standard_normal((EPOCHS, 4))
    rows[:, in_error] += 12.0 * np.cos(3.0 * columns["load_n"])
    rest = rows - np.outer(rows @ basis, basis)
    plain = _of_numbers(np.zeros(EPOCHS), columns)
    plain.measured.values, plain.measured.is_observed = np.zeros((EPOCHS, 3, 1)), np.ones((EPOCHS, 3), bool)
    plain.standardised = (rest / np.sqrt(1.0 - basis**2))[:, :3, None]
    plain.fit.whitened = SimpleNamespace(local_basis=np.tile(basis[:, None], (EPOCHS, 1, 1)))
    found = attributed(plain, (plain,), LEVEL, LEVEL).found
    assert [(one.channels, one.inputs) for one in found] == [((in_error,), ("load_n",))]


def _of_parts(errors: np.ndarray, columns: dict[str, np.ndarray], last: str = "leg2") -> FittedModel:
    """A fitted model of two parts with errors (60, 2), which move its observations in directions that differ.

    ``last``: subject of the second part; the base has none.
    """
    rng = np.random.default_rng(21)
    moved = rng.standard_normal((EPOCHS, 6, 2))
    residual = (moved @ errors[..., None])[..., 0] + rng.standard_normal((EPOCHS, 6))
    pathways = ErrorPathway("rho", 0, "leg1", "rho1_mm"), ErrorPathway("rho", 1, last, "rho2_mm" if last else "")
    whitened = SimpleNamespace(
        whole=np.zeros((EPOCHS * 6, 0)),
        own=np.zeros((EPOCHS, 6, 0)),
        residual=residual.ravel(),
        rest=residual.ravel(),
        without_shared=lambda rows: rows,
    )
    readings = {name: columns[name] for name in ("rho1_mm", "rho2_mm")}
    own = SimpleNamespace(
        measured=SimpleNamespace(values=np.zeros((EPOCHS, 0, 1)), is_observed=np.ones((EPOCHS, 0), bool), size=1),
        standardised=np.zeros((EPOCHS, 0, 1)),
        fit=SimpleNamespace(whitened=whitened),
        model=SimpleNamespace(error_groups=None, error_pathways=pathways),
        scene=SimpleNamespace(covariates={**columns, "order": np.arange(EPOCHS)}, inputs=readings, histories={}),
        pathways=SimpleNamespace(columns=moved, places={"rho": slice(0, 2)}),
    )
    return cast(FittedModel, own)


@pytest.mark.parametrize(
    ("driver", "expected"),
    [("rho2_mm", [("leg1", ("rho2_mm",), True)]), ("temperature_c", [])],
)
def test_the_error_of_a_part_is_reported_with_readings_alone(driver: str, expected: list[object]) -> None:
    """Temperature is slow, and may imitate any slow quantity."""
    columns = _columns(np.random.default_rng(22))
    errors = np.column_stack([4.0 * np.cos(3.0 * columns[driver]), np.zeros(EPOCHS)])
    plain = _of_parts(errors, columns)
    found = attributed(plain, (plain,), LEVEL, 0.05).found
    assert [(one.subject, one.inputs, one.remains) for one in found] == expected


@pytest.mark.parametrize(
    ("last", "driver", "expected"),
    [
        ("", "time_s", [("", ("time_s",), True)]),
        ("leg2", "time_s", []),
        ("", "temperature_c", []),
        ("", "rho1_mm", [("", ("rho1_mm",), True)]),
    ],
)
def test_a_slow_motion_of_the_base_depends_on_time(last: str, driver: str, expected: list[object]) -> None:
    """A slow error of any other part may be that of something else; a slow course may pass for a temperature's."""
    columns = _columns(np.random.default_rng(24))
    course = columns[driver] / np.ptp(columns[driver])
    plain = _of_parts(np.column_stack([np.zeros(EPOCHS), 4.0 * np.cos(6.0 * course)]), columns, last)
    found = attributed(plain, (plain,), LEVEL, 0.05).found
    assert [(one.subject, one.inputs, one.remains) for one in found] == expected


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_an_error_of_a_part_that_accepted_causes_explain_does_not_remain(size: float) -> None:
    columns = _columns(np.random.default_rng(23))
    errors = np.column_stack([4.0 * np.cos(3.0 * columns["rho2_mm"]), np.zeros(EPOCHS)])
    plain, final = (_of_parts(part * errors, columns) for part in (1.0, size))
    found = attributed(plain, (plain, final), LEVEL, 0.05).found
    assert [(one.subject, one.inputs, one.remains) for one in found] == [("leg1", ("rho2_mm",), size > 0.0)]


def test_a_model_that_holds_is_not_asked_on_errors_of_parts() -> None:
    columns = _columns(np.random.default_rng(23))
    errors = np.column_stack([4.0 * np.cos(3.0 * columns["rho2_mm"]), np.zeros(EPOCHS)])
    plain = _of_parts(errors, columns)
    assert not attributed(plain, (plain,), LEVEL, LEVEL).found


@pytest.mark.parametrize(("most", "is_early"), [(EPOCHS * 6 * 1, True), (-1, True), (1e12, False)])
def test_a_search_for_errors_of_parts_that_is_too_large_ends_early(
    most: float, is_early: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ends next to the first dependence, or before any."""
    columns = _columns(np.random.default_rng(23))
    plain = _of_parts(np.column_stack([4.0 * np.cos(3.0 * columns["rho2_mm"]), np.zeros(EPOCHS)]), columns)
    monkeypatch.setattr("truing.inference.part_errors._MOST_PRODUCTS", most)
    attributions = attributed(plain, (plain,), LEVEL, 0.05)
    assert attributions.ended_early == is_early
    assert [one.subject for one in attributions.found] == ([] if most < 0 else [""] if is_early else ["leg1"])


def test_noise_of_any_size_has_no_course() -> None:
    rng = np.random.default_rng(11)
    found = [len(list(courses(5.0 * rng.normal(size=(60, 30))))) for _ in range(100)]
    assert np.mean(np.array(found) > 0) <= 0.12
    assert max(found) <= 1


def test_the_course_of_an_unknown_pattern_is_recovered() -> None:
    rng = np.random.default_rng(12)
    for _ in range(10):
        rows, truth = _bends(25.0, rng)
        (found, *others) = list(courses(rows))
        assert not others
        assert abs(np.corrcoef(found[:, 0], truth)[0, 1]) > 0.9


@pytest.mark.parametrize("shape", [(60, 0), (2, 30), (0, 30)])
def test_few_epochs_and_nothing_measured_have_no_course(shape: tuple[int, int]) -> None:
    assert not list(courses(np.random.default_rng(13).normal(size=shape)))
    assert not list(courses(np.zeros((60, 30))))


def test_distinct_rows_are_those_of_numpy() -> None:
    rows = np.random.default_rng(3).integers(-2, 3, (40, 3)).astype(float)
    assert len(np.unique(rows, axis=0)) < len(rows)
    assert np.array_equal(distinct_rows(rows), np.unique(rows, axis=0))


def test_noise_that_is_correlated_in_time_follows_time_alone() -> None:
    wrong = 0
    for seed in range(25):
        rng = np.random.default_rng([seed, 11])
        sweep = np.linspace(-1.0, 1.0, 11)
        command = np.concatenate([sweep, sweep[::-1]] * 4)
        count, kept = len(command), np.exp(-1.0 / rng.uniform(4.0, 40.0))
        course = np.zeros(count)
        for row in range(1, count):
            course[row] = kept * course[row - 1] + np.sqrt(1.0 - kept**2) * rng.standard_normal()
        direction = np.where(np.diff(command, prepend=-2.0) >= 0.0, 1.0, -1.0)
        columns = {"time_s": 20.0 * np.arange(count), "command": command, "direction": direction}
        rows = (4.0 * course + rng.standard_normal(count))[:, None]
        sets = sets_of_inputs(rows, Spectra(columns, InTime(np.arange(count, dtype=float), None)), LEVEL)
        wrong += any(set(inputs) != {"time_s"} for inputs, _, _ in sets)
    assert wrong <= 3  # 1 in 8; smooth functions of time alone give more than 6
