"""Cameras, bars and air common to all poses: derivatives, and recovery of causes from rays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.photographs.ray_findings import NUMBERS, POSES, measured_epochs, place, ray_poses
from tests.tolerance import assert_close
from truing.inference.selection import CauseDiagnosis, CauseSelection, Settings
from truing.simulation.catalogue import catalogue_of_rays
from truing.simulation.cause import Cause
from truing.simulation.photographs.causes.camera_instability import CameraInstability
from truing.simulation.photographs.model import RayModel

RAYS = ray_poses(1)
KINDS = list(catalogue_of_rays().values())


def one_of_each_form() -> list[Cause]:
    """A candidate of every form that any kind proposes, as it is fitted."""
    found: dict[tuple[str, ...], Cause] = {}
    for kind in KINDS:
        for cause in kind.candidates(RayModel.of(RAYS).scene):
            form = str(cause.settings().get("form", "")), str(bool(cause.subject))
            found.setdefault((cause.id, *form), cause.refined())
    return list(found.values())


@pytest.mark.parametrize("cause", one_of_each_form(), ids=lambda cause: cause.key)
def test_channels_follow_the_unknowns_as_their_derivatives_say(cause: Cause) -> None:
    model = RayModel.of(RAYS).with_causes([cause])
    shared, none = 0.1 * np.random.default_rng(2).standard_normal(model.shared_size), np.zeros((POSES, 0))
    slopes = model.predict(shared, none).by_shared[:, :, 0]
    for j, step in enumerate(1e-6 * np.eye(model.shared_size)):
        ahead, behind = (model.points(shared + sign * step, none)[..., 0] for sign in (1.0, -1.0))
        assert_close(slopes[..., j], (ahead - behind) / 2e-6, atol=1e-6 * max(1.0, np.abs(slopes[..., j]).max()))


def search(off: np.ndarray, seed: int = 3) -> CauseDiagnosis:
    poses = measured_epochs(RAYS, off, seed)
    return CauseSelection(RayModel.of(RAYS), poses, None, Settings(0.05, 200, 1)).run(KINDS)


def found_causes(diagnosis: CauseDiagnosis) -> list[tuple[str, str]]:
    return [(v.cause.id, v.cause.subject) for v in diagnosis.verdicts if v.verdict == "found"]


def off_by(name: str, course: np.ndarray) -> np.ndarray:
    off = np.zeros((POSES, len(NUMBERS)))
    off[:, place(name)] = course
    return off


def test_nothing_is_found_where_all_poses_share_what_they_should() -> None:
    common = np.zeros((POSES, len(NUMBERS)))
    common[:, [place("camera left c"), place("camera left x0")]] = 0.4, -0.3
    assert found_causes(search(common)) == []


def test_a_camera_that_jumps_is_reported_with_the_pose_and_by_how_much() -> None:
    diagnosis = search(off_by("camera left c", 0.5 * (np.arange(POSES) >= 10)))
    assert found_causes(diagnosis) == [("camera-instability", "camera left")]
    verdict = diagnosis.verdicts[0]
    reported_of = {one.name: one for one in verdict.cause.reported(verdict.values, verdict.covariance, 0)}
    assert reported_of["from_pose"].value == 11
    assert abs(reported_of["c"].value - 0.5) < 4 * reported_of["c"].sigma < 0.5


def test_a_camera_that_follows_the_temperature_is_reported_per_kelvin() -> None:
    diagnosis = search(off_by("camera left y0", 0.5 * RAYS.temperature_rise))
    assert found_causes(diagnosis) == [("camera-instability", "camera left")]
    assert isinstance(diagnosis.verdicts[0].cause, CameraInstability)
    assert diagnosis.verdicts[0].cause.form == "temperature"


def test_a_camera_that_differs_from_pose_to_pose_is_reported_by_its_scatter() -> None:
    loose = np.random.default_rng(7).normal(0.0, 0.6, POSES)
    diagnosis = search(off_by("camera left c", loose))
    assert found_causes(diagnosis) == [("camera-instability", "camera left")]
    verdict = diagnosis.verdicts[0]
    reported_of = {one.name: one for one in verdict.cause.reported(verdict.values, verdict.covariance, 0)}
    assert abs(reported_of["c_scatter"].value - np.std(loose, ddof=1)) < 0.2


def test_a_growing_bar_is_confounded_with_a_shrinking_second_bar() -> None:
    diagnosis = search(off_by("bar S strain", 30.0 * RAYS.temperature_rise / 10.0))
    (verdict,) = (v for v in diagnosis.verdicts if v.verdict == "found")
    assert verdict.cause.id == "scale-bar-temperature"
    assert {verdict.cause.subject, *(subject for subject, _ in verdict.subjects)} == {"bar S", "bar T"}


def test_errors_of_a_bar_refer_to_its_certificate() -> None:
    # A long way above the reference all the time: its mean strain went into the adjusted length.
    warm = replace(RAYS, reference_temperature_c=10.0)
    strain = 3e-5 * warm.temperature_rise
    mean = float(strain.mean())
    numbers = tuple(replace(n, mean=-mean) if n.called == "bar S strain" else n for n in NUMBERS)
    rays = replace(warm, parameters=numbers)
    poses = measured_epochs(rays, off_by("bar S strain", (strain - mean) / 1e-5), 3)
    found_there = CauseSelection(RayModel.of(rays), poses, None, Settings(0.05, 200, 1)).run(KINDS).verdicts[0]
    assert found_there.cause.id == "scale-bar-temperature"
    assert abs(abs(found_there.values[0]) - 3e-5) < 4 * np.sqrt(found_there.covariance[0, 0]) < 2e-5


def test_an_effect_of_an_unassigned_column_is_reported_as_unexplained() -> None:
    column = RAYS.covariates["rho1_mm"]
    diagnosis = search(off_by("camera left x0", 0.4 * column))
    verdict = diagnosis.verdicts[0]
    assert verdict.cause.id == "unexplained"
    assert verdict.cause.subject == "camera left"
    assert verdict.cause.inputs(0) == ("rho1_mm",)


def test_layers_of_air_and_panes_are_reported_though_they_are_the_same_in_all_poses() -> None:
    assert found_causes(search(off_by("air zz", np.full(POSES, 6.0)))) == [("refraction", "")]
    assert found_causes(search(off_by("window left thickness", np.full(POSES, 12.0)))) == [
        ("refraction", "camera left")
    ]
