"""An accepted cause is doubted if a random course of its own effect explains the data equally well."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.inference.toy_campaign import DRIVES, POINTS, POSES, READINGS, TEMPLATE, channels, measured
from truing.inference.free_course import CourseRival, course_rival, spans_more
from truing.inference.noise import components

ASKED = np.random.default_rng(1).uniform(-1, 1, (POSES, DRIVES))
TIME = np.linspace(0.0, 1.0, POSES)
GAIN, DRIFT = ASKED[:, 0], TIME - 0.5
SIDE = np.where(np.random.default_rng(2).random(POSES) > 0.5, 1.0, -1.0)
SIZE = 4.0  # of an effect's course over its root mean square, in sigmas of a reading
CAMPAIGNS = 8


def _fitted(rng: np.random.Generator, moved: NDArray, design: NDArray, values: NDArray) -> tuple[Any, Any]:
    """A cause of a design (B, drives, P), and what stands in for a fit that leaves moved drives (B, drives)."""
    effect = np.einsum("bmd,bd->bm", TEMPLATE.by_local[..., READINGS], moved)
    whitened = measured(rng, effect)
    cause = SimpleNamespace(key="own", parameters=lambda _: [SimpleNamespace(scale=1.0)] * design.shape[-1])
    inputs = {"side": SIDE} | {f"drive{one}": ASKED[:, one] for one in range(DRIVES)}
    return cause, SimpleNamespace(
        pathways=channels(whitened),
        fit=SimpleNamespace(whitened=whitened),
        noise=components(whitened, 3 * POINTS, READINGS),
        model=SimpleNamespace(part_count=DRIVES, error_groups=None),
        measured=SimpleNamespace(values=np.zeros((POSES, 1))),
        scene=SimpleNamespace(covariates={"order": TIME, "time": TIME}, inputs=inputs, histories={}),
        design_matrix=lambda _: {"drive": design},
        values=lambda _: (values, np.eye(len(values))),
    )


def _against(moved: NDArray, design: NDArray, values: NDArray) -> list[CourseRival]:
    """Random courses against a cause with these values, where ``moved`` (B, drives) is what acts."""
    found = []
    for seed in range(CAMPAIGNS):
        cause, final = _fitted(np.random.default_rng(seed), moved - design @ values, design, values)
        _, without = _fitted(np.random.default_rng(seed), moved, design, values)
        rival = course_rival(final, without, cause, len(values), 1.0)
        assert rival is not None
        found.append(rival)
    return found


def _of_first(course: NDArray) -> NDArray:
    return course[:, None] * np.eye(DRIVES)[0]


def _rivals(moved: NDArray, course: NDArray) -> list[CourseRival]:
    """Random courses against a cause of the first drive along ``course``, where it moves by ``moved`` (B,)."""
    moved = SIZE * moved / np.sqrt(np.mean(moved**2))
    value = float(course @ moved / (course @ course))
    return _against(_of_first(moved), _of_first(course)[..., None], np.array([value]))


def _clear(moved: NDArray, course: NDArray) -> int:
    return sum(rival.is_clear for rival in _rivals(moved, course))


def test_names_of_the_right_course_stand() -> None:
    assert _clear(GAIN, GAIN) >= CAMPAIGNS - 1
    assert _clear(DRIFT, DRIFT) >= CAMPAIGNS - 1


def test_a_name_that_depends_on_a_side_is_not_its_own_rival() -> None:
    """Any function of an input with two values is one effect, which the name claims; other inputs still compete."""
    assert _clear(SIDE, SIDE) >= CAMPAIGNS - 1
    assert _clear(SIDE * (1.0 + GAIN), SIDE) <= 1


def test_a_large_effect_is_compared_after_its_refit() -> None:
    """Linear in its parameters, the name leaves errors that random courses absorb."""
    moved = SIZE * GAIN / np.sqrt(np.mean(GAIN**2))
    cause, final = _fitted(np.random.default_rng(0), 0.0 * _of_first(moved), _of_first(GAIN)[..., None], np.ones(1))
    _, without = _fitted(np.random.default_rng(0), _of_first(moved + moved**3), _of_first(GAIN)[..., None], np.ones(1))
    rival = course_rival(final, without, cause, 1, 1.0)
    assert rival is not None
    assert rival.is_clear


def test_a_name_of_several_patterns_holds_where_each_depends_on_all_inputs() -> None:
    design = np.einsum("di,bj->bdij", np.eye(DRIVES), ASKED).reshape(POSES, DRIVES, -1)
    values = SIZE * np.random.default_rng(3).normal(size=DRIVES**2)
    assert sum(rival.is_clear for rival in _against(design @ values, design, values)) >= CAMPAIGNS - 1


def test_many_parameters_that_fit_a_course_in_time_are_no_law() -> None:
    """A drive errs along a smooth course in time; a name with an amplitude for each of twelve inputs fits it."""
    waves = np.cos(np.pi * np.arange(1, 13) * TIME[:, None])
    design = waves[:, None, :] * np.eye(DRIVES)[0][:, None]
    design = np.concatenate([design, waves[:, None, :6] * np.eye(DRIVES)[1][:, None]], -1)
    moved = SIZE * np.sin(5.0 * TIME + 0.4)
    values = np.r_[np.linalg.lstsq(waves, moved, rcond=None)[0], np.zeros(6)]
    rivals = _against(_of_first(moved), design, values)
    assert sum(rival.is_clear for rival in rivals) <= 1


def test_a_gain_is_doubted_where_a_drive_errs_smoothly() -> None:
    rivals = _rivals(GAIN + np.sin(4.0 * GAIN + 0.5), GAIN)
    assert sum(rival.is_clear for rival in rivals) <= 1
    assert sum(rival.follows == ("drive0",) for rival in rivals) >= CAMPAIGNS - 1


def test_a_size_that_varies_with_an_input_acts_next_to_a_name() -> None:
    """The name holds on average; its share is that of the mean size, reported with the input."""
    factor = 1.0 + 0.7 * GAIN / GAIN.std()
    rivals = _rivals(SIDE * factor, SIDE)
    assert sum(rival.is_beside and rival.follows == ("drive0",) for rival in rivals) >= CAMPAIGNS - 1
    assert abs(np.mean([rival.share for rival in rivals]) - 1.0 / 1.49) < 0.1


def test_a_drift_is_doubted_where_counts_are_lost() -> None:
    lost = np.searchsorted(np.array([0.12, 0.2, 0.7]), TIME).astype(float)
    rivals = _rivals(lost - lost.mean(), DRIFT)
    assert sum(rival.is_clear for rival in rivals) <= 1
    assert all(rival.follows in {(), ("time",)} for rival in rivals)


def test_a_named_cause_reports_its_share_of_the_effect() -> None:
    shares = [rival.share for rival in _rivals(GAIN + np.sin(4.0 * GAIN + 0.5), GAIN) if rival.is_beside]
    assert shares
    assert all(0.2 < share < 1.0 for share in shares)
    assert all(rival.share == 1.0 for rival in _rivals(GAIN, GAIN) if not rival.is_beside)


def test_functions_span_more_than_their_rank_only() -> None:
    """Also where they differ in size by a thousand, or there are fewer epochs than functions."""
    rng = np.random.default_rng(7)
    for epochs, count in ((40, 12), (8, 12)):
        for rank in (1, 2, 5):
            sizes = np.geomspace(1.0, 1e-3, rank)
            functions = rng.normal(size=(epochs, rank)) * sizes @ np.linalg.qr(rng.normal(size=(count, rank)))[0].T
            assert [spans_more(functions, most) for most in range(1, 7)] == [rank > most for most in range(1, 7)]
