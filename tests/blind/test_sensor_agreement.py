"""Generator and ``truing.simulation`` of the force sensor, written independently, agree.

One sums energies along the legs at the platform's origin, the other moves compliances of elements from end to end.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.blind.generator.quaternions import Array
from tests.blind.generator.sensor import air
from tests.blind.generator.sensor.campaign import Campaign, draw_campaign
from tests.blind.generator.sensor.designs import leaved, nominal_a, notched
from tests.blind.generator.sensor.elements import Element
from tests.blind.generator.sensor.layout import Layout, Noise, Tolerance
from tests.blind.generator.sensor.machine import Sensor, build, flawless
from tests.tolerance import assert_close
from truing.simulation import air as their_air
from truing.simulation.bench.six_upur import elements
from truing.simulation.bench.six_upur.assembly import SOURCES
from truing.simulation.bench.six_upur.geometry import joint_centres
from truing.simulation.bench.six_upur.stiffness import ElasticSensor, elastic_sensor
from truing.simulation.bench.six_upur.uncertain_sensor import compliance_change

SENSORS = {
    "A": nominal_a(),
    "notches": notched(np.random.default_rng(3)),
    "leaves": leaved(np.random.default_rng(3)),
}
# Forces and torques that bend each of them by hundreds of the noise.
RANGES = {"A": (10e3, 5e3), "notches": (500.0, 30.0), "leaves": (20e3, 4e3)}


def theirs(sensor: Sensor) -> ElasticSensor:
    joints = joint_centres(sensor.lower_mm / 1e3, sensor.upper_mm / 1e3, sensor.height_mm / 1e3)
    return elastic_sensor(joints, [_element(element) for element in sensor.elements])


def _element(one: Element) -> elements.LegElement:
    length = None if one.length_mm is None else one.length_mm / 1e3
    of = {name: value / 1e3 if name.endswith("_mm") else value for name, value in one.numbers.items()}
    steel = (1e9 * of.get("youngs_gpa", 0.0), of.get("poisson", 0.0))
    if one.kind == "cylinder":
        return elements.cylinder(length, of["diameter_mm"], *steel)
    if one.kind == "leaf":
        return elements.leaf(length, of["width_mm"], of["thickness_mm"], *steel, one.soft)
    if one.kind == "notch":
        return elements.notch(of["width_mm"], of["web_mm"], of["radius_mm"], *steel, one.soft)
    if one.kind == "spring":
        return elements.spring(of.get("axial_n_per_m"), of.get("torsion_n_m_per_rad"), length)
    return elements.rigid(length) if one.matrix is None else elements.compliance(one.matrix, length)


@pytest.mark.parametrize("name", SENSORS)
def test_both_give_the_platform_and_the_legs_the_same(name: str) -> None:
    found, expected = build(SENSORS[name], flawless(SENSORS[name])), theirs(SENSORS[name])
    size = np.sqrt(np.diag(expected.compliance))
    assert_close(found.compliance / np.outer(size, size), expected.compliance / np.outer(size, size), atol=1e-10)
    assert_close(found.tension, expected.axial_forces, atol=1e-10, what="tension by wrench")


def _exact(name: str, seed: int = 5) -> Campaign:
    force, torque = RANGES[name]
    layout = Layout(
        "exact",
        SENSORS[name],
        (force,) * 3 + (torque,) * 3,
        Tolerance(stiffness=0.0),
        Noise(exact=True),
        signals=6,
    )
    return draw_campaign(layout, [], np.random.default_rng(seed))


@pytest.mark.parametrize("name", SENSORS)
def test_readings_of_a_sensor_with_errors_agree_to_a_tenth_of_the_noise(name: str) -> None:
    """The generator closes the loops of a sensor with errors; what truing knows of them is their first order."""
    campaign, nominal = _exact(name), theirs(SENSORS[name])
    errors = np.stack([getattr(campaign.truth.errors, source) for source in SOURCES], axis=1)
    compliance = nominal.compliance + np.einsum("ls,lsij->ij", errors, compliance_change(nominal).by_source)
    off = campaign.readings - campaign.schedule.load @ compliance.T
    assert np.abs(off / campaign.layout.noise.channels).max() < 0.1
    nominal_off = campaign.readings - campaign.schedule.load @ nominal.compliance.T
    assert np.abs(nominal_off / campaign.layout.noise.channels).max() > 0.1, "the errors would not show"


def test_softer_legs_move_further_as_the_derivative_says() -> None:
    sensor, nominal = SENSORS["leaves"], theirs(SENSORS["leaves"])
    softer = np.exp(1e-5 * np.random.default_rng(2).normal(size=(6, sensor.elastic)))
    found = build(sensor, replace(flawless(sensor), softer=softer)).compliance - nominal.compliance
    expected = -np.einsum("lp,lpij->ij", np.log(softer), compliance_change(nominal).by_stiffness)
    size = np.sqrt(np.diag(nominal.compliance))
    assert_close(found / np.outer(size, size), expected / np.outer(size, size), atol=1e-9, what="change of compliance")


def test_signals_show_the_tension_of_the_legs() -> None:
    campaign, nominal = _exact("A"), theirs(SENSORS["A"])
    tension = campaign.schedule.load @ nominal.axial_forces.T
    gain, offset = campaign.truth.gain.T
    shown: Array = gain * tension + offset
    assert_close(campaign.signals, shown, atol=0.01, what="mV, of a sensor with errors")


def test_both_simulations_have_the_same_refractive_index() -> None:
    t, p, humidity = (axis.ravel() for axis in np.meshgrid([18.0, 20.0, 23.0], [980.0, 1013.0, 1030.0], [30.0, 60.0]))
    found = air.index(np.stack([t, p, humidity, t], axis=1))
    vapour = their_air.vapour_pressure_pa(t, humidity / 100)
    assert_close(found, their_air.edlen_index(632.990577e-9, t, 100 * p, vapour), atol=1e-7, what="refractive index")
