"""Causes in positioning runs of an axis: errors hidden by an independent generator are named with their size."""

from __future__ import annotations

import pickle
from copy import deepcopy
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
import pytest

from tests.blind.judging import fewest_of
from tests.sentences import assert_says
from truing.inference.selection import CauseDiagnosis
from truing.schemas.campaign import read_campaign
from truing.schemas.settings_text import parsed_toml
from truing.stages.common.approaches import axis_of_approaches, has_only_approaches, noise_mm
from truing.stages.diagnosis.search import assembled_data, cause_faults, search_causes

SETTINGS = """
[campaign]
name = "positions"
kind = "interferometer"
"""
SIGMA_MM = 2e-4


@dataclass(frozen=True)
class Axis:
    """Errors of an axis at T targets in C cycles, mm; ``waves``: amplitude and period; by what its parts grow."""

    scale: float = 0.0
    backlash: float = 0.0
    waves: tuple[float, float] = (0.0, 1.0)
    growth: float = 0.0
    drift: float = 0.0
    cycles: int = 5
    targets: tuple[float, ...] = field(default_factory=lambda: tuple(np.cumsum([7.0, *[11.0, 13.0, 9.0] * 5]).tolist()))

    def measured(self, rng: np.random.Generator) -> pa.Table:
        """Approaches up and down, cycle by cycle, in the order of measurement."""
        rows = []
        for cycle in range(self.cycles):
            for way, targets in (("forward", self.targets), ("backward", self.targets[::-1])):
                rows += [(cycle + 1, way, target) for target in targets]
        cycle, way, target = (np.array(column) for column in zip(*rows, strict=True))
        warmth = 20.0 + 2.0 * np.sin(np.arange(len(rows)) / 17.0)
        position = target * (1.0 + self.scale + self.growth * (warmth - warmth.mean())) + self.drift * cycle
        position += np.where(way == "forward", -self.backlash, self.backlash)
        position += self.waves[0] * np.sin(2.0 * np.pi * target / self.waves[1])
        position += rng.normal(0.0, SIGMA_MM, len(rows))
        names = ("run", "target_mm", "direction", "cycle", "position_mm", "row_order", "material_temperature_c")
        columns = (["X"] * len(rows), target, way, cycle, position, np.arange(1, len(rows) + 1), warmth)
        return _sorted(pa.table(dict(zip(names, columns, strict=True))))


def _sorted(table: pa.Table) -> pa.Table:
    """Rows in the order of the artifact: target, forward before backward, cycle."""
    keys = [("target_mm", "ascending"), ("direction", "descending"), ("cycle", "ascending")]
    return table.sort_by(keys)


def _diagnosed(table: pa.Table) -> CauseDiagnosis:
    tables, settings = axis_of_approaches({"positions": table}, read_campaign(parsed_toml(SETTINGS)))
    return search_causes(assembled_data(tables, settings), settings, lambda done, total, what: None)


def _found(diagnosis: CauseDiagnosis) -> dict[str, tuple[float, float]]:
    """First parameter of each cause found, with its standard deviation."""
    return {
        verdict.cause.id: (float(verdict.values[0]), float(np.sqrt(verdict.covariance[0, 0])))
        for verdict in diagnosis.verdicts
        if verdict.verdict == "found"
    }


@pytest.mark.parametrize(
    ("axis", "cause", "size"),
    [
        (Axis(scale=2e-5), "scale-error", 2e-5),
        (Axis(backlash=5e-4), "lost-motion", -5e-7),
        (Axis(growth=1.2e-5), "axis-growth", 1.2e-5),
    ],
)
def test_a_clear_error_is_named_alone_with_its_size(axis: Axis, cause: str, size: float) -> None:
    found = _found(_diagnosed(axis.measured(np.random.default_rng([4, len(cause)]))))
    assert set(found) == {cause}
    value, sigma = found[cause]
    assert abs(abs(value) - abs(size)) < 3.5 * sigma
    assert sigma < 0.2 * abs(size)


def test_a_wave_of_the_screw_is_named_with_its_period() -> None:
    diagnosis = _diagnosed(Axis(waves=(1.0e-3, 37.0)).measured(np.random.default_rng(12)))
    (own,) = [verdict for verdict in diagnosis.verdicts if verdict.verdict == "found"]
    assert own.cause.id == "periodic-error"
    assert own.cause.period == pytest.approx(0.037, rel=0.05)  # type: ignore[attr-defined]


def test_without_hidden_effects_false_alarms_stay_within_the_declared_rate() -> None:
    clean = [_diagnosed(Axis().measured(np.random.default_rng([9, number]))) for number in range(16)]
    quiet = [one for one in clean if not _found(one) and not one.noisy]
    assert len(quiet) >= fewest_of(len(clean), 0.95)


def test_a_file_in_order_of_targets_gives_the_same_lost_motion() -> None:
    table = Axis(backlash=5e-4).measured(np.random.default_rng(5))
    by_target = table.set_column(
        table.column_names.index("row_order"), "row_order", pa.array(np.arange(1, table.num_rows + 1))
    )
    first, second = _found(_diagnosed(table)), _found(_diagnosed(by_target))
    assert first["lost-motion"][0] == pytest.approx(second["lost-motion"][0], rel=1e-6)


@pytest.mark.parametrize("sides", ["ascending", "descending"])
def test_a_row_for_each_target_is_no_order_of_measurement(sides: str) -> None:
    table = Axis().measured(np.random.default_rng(5))
    side_by_side = table.sort_by([("target_mm", "ascending"), ("cycle", "ascending"), ("direction", sides)])
    numbers = pa.array(np.arange(1, table.num_rows + 1))
    numbered = side_by_side.set_column(table.column_names.index("row_order"), "row_order", numbers)
    tables, _ = axis_of_approaches({"positions": _sorted(numbered)}, read_campaign(parsed_toml(SETTINGS)))
    command = tables["configurations"].column("command_mm").to_numpy()[1::2]
    there_and_back = [*Axis().targets, *Axis().targets[::-1]]
    assert command.tolist() == there_and_back * Axis().cycles


@pytest.mark.parametrize("drift", [0.0, 5e-3])
def test_the_noise_is_that_of_an_approach_whatever_drifts_between_cycles(drift: float) -> None:
    squares = [noise_mm(Axis(drift=drift).measured(np.random.default_rng([3, n]))) ** 2 for n in range(60)]
    # 2 x 15 x 4 degrees of freedom in each: the mean of 60 is known to 1.7 %
    assert np.mean(squares) == pytest.approx(SIGMA_MM**2, rel=0.06)


def test_a_gross_error_is_left_out_and_changes_no_finding() -> None:
    table = Axis(scale=2e-5).measured(np.random.default_rng(8))
    position = table.column("position_mm").to_numpy().copy()
    position[33] += 0.05
    wrong = table.set_column(table.column_names.index("position_mm"), "position_mm", pa.array(position))
    tables, settings = axis_of_approaches({"positions": wrong}, read_campaign(parsed_toml(SETTINGS)))
    assert_says(assembled_data(tables, settings).left_out, "1 approach")
    assert set(_found(_diagnosed(wrong))) == {"scale-error"}


def test_several_runs_and_too_few_approaches_are_refused_with_the_reason() -> None:
    table = Axis().measured(np.random.default_rng(1))
    other = table.set_column(0, "run", pa.array(["Y"] * table.num_rows))
    settings = read_campaign(parsed_toml(SETTINGS))
    with pytest.raises(ValueError, match="found 2"):
        axis_of_approaches({"positions": pa.concat_tables([table, other])}, settings)
    short = Axis(cycles=2, targets=(0.0, 10.0, 20.0)).measured(np.random.default_rng(1))
    with pytest.raises(ValueError, match="4 degrees of freedom"):
        axis_of_approaches({"positions": short}, settings)


def test_cycles_that_are_equal_in_every_digit_give_no_noise() -> None:
    table = Axis().measured(np.random.default_rng(1))
    position = table.column("position_mm").to_numpy().reshape(-1, 5)  # rows of a target and direction
    copied = np.repeat(position[:, :1], 5, axis=1).ravel()
    same = table.set_column(table.column_names.index("position_mm"), "position_mm", pa.array(copied))
    with pytest.raises(ValueError, match="the noise is unknown: approaches of a target repeat"):
        axis_of_approaches({"positions": same}, read_campaign(parsed_toml(SETTINGS)))


def test_a_cause_of_an_axis_can_be_ignored() -> None:
    settings = read_campaign(parsed_toml(SETTINGS + '[diagnosis]\nignore = ["lost-motion"]\n'))
    assert not list(cause_faults(settings, "campaign.toml"))
    table = Axis(backlash=5e-4).measured(np.random.default_rng(5))
    tables, own = axis_of_approaches({"positions": table}, settings)
    diagnosis = search_causes(assembled_data(tables, own), own, lambda done, total, what: None)
    assert "lost-motion" not in {verdict.cause.id for verdict in diagnosis.verdicts}


def test_positions_next_to_readings_are_no_axis_alone() -> None:
    table = Axis().measured(np.random.default_rng(1))
    assert has_only_approaches({"positions": table})
    assert not has_only_approaches({"positions": table, "readings": table})
    assert not has_only_approaches({"readings": table})


def test_settings_of_an_axis_survive_pickle_and_copy() -> None:
    """Other processes receive settings by pickle."""
    settings = read_campaign(parsed_toml(SETTINGS))
    _, axis = axis_of_approaches({"positions": Axis().measured(np.random.default_rng(1))}, settings)
    for same in (pickle.loads(pickle.dumps(axis)), deepcopy(axis)):
        assert same.campaign.name == "positions"
        assert same.noise == axis.noise


@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5, 6])
def test_lost_motion_is_named_next_to_a_larger_error_of_the_place(seed: int) -> None:
    """An error of the place is equal from both sides, so the difference between the sides is lost motion alone."""
    rng = np.random.default_rng(seed)
    axis = Axis(backlash=0.0127, targets=tuple(np.linspace(-20.0, 20.0, 9).tolist()))
    table = axis.measured(rng)
    rough = np.interp(table.column("target_mm").to_numpy(), axis.targets, rng.normal(0.0, 0.04, 9))
    position = table.column("position_mm").to_numpy() + rough + rng.normal(0.0, 2e-3, table.num_rows)
    at = table.schema.get_field_index("position_mm")
    verdicts = _diagnosed(table.set_column(at, "position_mm", pa.array(position))).verdicts
    (lost,) = [verdict for verdict in verdicts if verdict.cause.id == "lost-motion"]
    assert lost.verdict in ("found", "suspected")
    assert abs(abs(float(lost.values[0])) - 12.7e-6) < 4.0 * float(np.sqrt(lost.covariance[0, 0]))
    assert lost.share_explained is None or lost.share_explained > 0.9
