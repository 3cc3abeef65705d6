"""Statements of docs/identifiability.md hold, and its tables and figure are those of its command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from docs.experiments import absorption_map, identifiability
from docs.experiments.sample_telescope import SIX, scales
from tests.docs.shown import shown

DOCS = Path(identifiability.__file__).resolve().parents[1]


@pytest.mark.parametrize("name", identifiability.TABLES)
def test_the_page_shows_what_the_command_writes(name):
    page = (DOCS / "identifiability.md").read_text(encoding="utf-8")
    made = identifiability.TABLES[name]()
    assert _words(shown(page, name)) == _words(made)
    for old, new in zip(_numbers(shown(page, name)), _numbers(made), strict=True):
        assert old == pytest.approx(new, rel=0.06, abs=0.011)  # a unit of the last digit shown


def test_the_figure_is_of_these_numbers(tmp_path):
    absorption_map.draw(tmp_path / "map.svg")
    made = (tmp_path / "map.svg").read_text(encoding="utf-8")
    shown = (DOCS / "figures" / "absorption-map.svg").read_text(encoding="utf-8")
    for old, new in zip(_cells(shown), _cells(made), strict=True):
        assert old == pytest.approx(new, rel=0.06, abs=0.011)


def test_figures_of_the_absorption_map_are_those_on_the_page():
    shift, _, left, share = absorption_map.absorption_map()
    tolerances = scales(SIX)[:, None]
    names = [effect.name.split("\n")[0] for effect in absorption_map.effects()]
    assert share[0] == pytest.approx(0.92, abs=0.01)
    assert left[0] == pytest.approx(8.5, abs=0.2)
    bending = names.index("flexures of")
    assert np.all(shift[:, bending : bending + 1] < tolerances)
    assert left[bending] == pytest.approx(0.1, abs=0.01)
    gain = names.index("actuators")
    assert share[gain] > 0.99
    assert np.argmax(shift[:, [gain]] / tolerances) == SIX.index("u_x")


def test_predicted_sigmas_are_those_of_simulated_calibrations_where_u_is_known():
    simulated, predicted = identifiability.scatter()
    leaning_along_x = [0, 1, 3, 4]
    few_draws = 4 / np.sqrt(2 * identifiability.DRAWS)
    # the square of u_x, relative to the slope that makes it visible, is a twentieth on these legs
    assert np.all(np.abs(simulated / predicted - 1)[leaning_along_x] < few_draws + 0.05)
    assert np.all(predicted[[2, 5], 4] > 0.03)


def _numbers(text: str) -> list[float]:
    return [float(word) for word in _split(text) if _is_number(word)]


def _words(text: str) -> list[str]:
    return [word for word in _split(text) if not _is_number(word)]


def _cells(svg: str) -> list[float]:
    return _numbers(svg.replace("<", " <").replace(">", "> "))


def _split(text: str) -> list[str]:
    return text.replace(",", " ").replace("|", " ").replace("(", " ").replace(")", " ").split()


def _is_number(word: str) -> bool:
    return word.replace(".", "", 1).replace("e-", "", 1).replace("e+", "", 1).lstrip("-").isdigit()
