"""The extended model in the tables of calibrations: parameters, correlations, and pose errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.blind.generator.effects import ActuatorGain as Hidden
from tests.stages.line import run_line, settings_of
from tests.stages.two_campaigns import fitted, gathered, measured, model_text
from truing.calibration.accuracy import MODEL, Extended
from truing.simulation.mechanisms.causes.drive import ActuatorGain
from truing.stages.calibration.extended import extended_correlations, extended_figures, extended_of, extended_parameters
from truing.stages.calibration.model_rows import accuracy_rows
from truing.stages.common.calibration_data import assemble

GAIN, LEG = 0.06, 3


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory):
    """Tables of a campaign whose actuator 3 goes too far, what calibrations compare, and the models fitted to it."""
    folder = measured(tmp_path_factory.mktemp("extended"), 21, [Hidden(GAIN * (np.arange(6) == LEG - 1))])
    tables, _ = run_line(folder, "ingest", "pose", "deformation")
    compared = assemble(tables, settings_of(folder))
    found = gathered(folder)
    texts = [model_text(fitted(found, *causes), "it") for causes in ((), (ActuatorGain((LEG,)),))]
    return tables, compared, texts


@pytest.fixture(scope="module")
def both(campaign) -> tuple[Extended, Extended]:
    """The plain model and the one with the gain, held against all poses."""
    tables, compared, texts = campaign
    took_part = compared.measured.roles != "verification"
    plain, found = (extended_of(text, tables, compared.measured, took_part) for text in texts)
    return plain, found


def test_every_number_of_the_machine_and_of_the_effect_has_its_row(both) -> None:
    rows = extended_parameters(both[1]).table().to_pandas()
    assert set(rows["model"]) == {MODEL}
    assert set(rows["deformation"]) == {"none"}
    own = rows[rows["effect_of"].isna()]
    assert own.groupby("parameter").size().to_dict() == dict.fromkeys(
        ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l"), 6
    )
    (gain,) = rows[rows["effect_of"].notna()].to_dict("records")
    assert (gain["parameter"], gain["leg"], gain["effect_of"]) == ("gain", LEG, f"actuator-gain leg{LEG}")
    assert abs(gain["identified"] - GAIN) < 4 * gain["sigma"]
    assert np.isnan(gain["tolerance"])
    reported = own[own["identifiable"]]
    expected = (reported["identified"] - reported["nominal"]) / np.sqrt(
        reported["tolerance"] ** 2 - reported["sigma"] ** 2
    )
    assert np.allclose(reported["pull"], expected)
    assert own.loc[~own["identifiable"], "pull"].isna().all()


def test_poses_are_predicted_to_the_noise_with_the_effect_and_not_without(campaign, both) -> None:
    measured_poses = campaign[1].measured
    held = measured_poses.roles == "verification"
    ratios = []
    for one in both:
        error, noise = one.errors.error[held], one.errors.noise[held]
        ratios.append(float(np.mean(np.einsum("bi,bij,bj->b", error, np.linalg.inv(noise), error))) / 6)
    freedom = 6 * held.sum()
    low, high = chi2.ppf([5e-4, 1 - 5e-4], freedom) / freedom
    assert low < ratios[1] < high
    assert ratios[0] > high
    rows = accuracy_rows("accuracy", [((MODEL, "none"), both[1].errors)], measured_poses).table().to_pandas()
    assert set(rows["pose"]) == set(measured_poses.poses)


def test_the_gain_correlates_with_what_it_can_be_mistaken_for(both) -> None:
    rows = extended_correlations(both[1]).table().to_pandas()
    assert (rows["correlation"].abs() >= 0.05).all()
    assert not rows[(rows["other_parameter"] == "gain") & (rows["leg"] == LEG)].empty


def test_realistic_tolerances_are_reported_as_realistic(both) -> None:
    figures = {name: value for name, value, _ in extended_figures(both[1])}
    assert figures["pull_p_value"] > 1e-3
    assert 0.5 < figures["rms_pull"] < 1.6
    assert figures["parameters"] == 6 * 9 + 1


def test_a_pose_without_its_temperature_has_no_error(campaign, both) -> None:
    """An effect that follows a column says nothing of a pose where the column holds no number."""
    from truing.calibration.accuracy import _has_all_inputs
    from truing.simulation.mechanisms.causes.warmth import LegThermal

    found = both[1].found
    warm = replace(found, model=found.model.with_causes((LegThermal(),)))
    covariates = {"temperature_c": np.array([20.0, np.nan, 21.0])}
    conditions = replace(found.model.conditions, readings=np.zeros((3, 6)), covariates=covariates)
    assert _has_all_inputs(warm, conditions).tolist() == [True, False, True]
