"""The pose stage: frames, targets, reasons for rejections, and correct uncertainties."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from tests.estimation.scatter import body, move, pose_error, random_motions, squared_pulls
from tests.tolerance import assert_close
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.rotation import exp_so3
from truing.pipeline.campaign_folder import SettingsView
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import read_campaign
from truing.stages import pose

SIGMA_MM = 0.005


def settings(**sections):
    campaign = read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}, **sections})
    return SettingsView(campaign, pose.DECLARATION.settings)


def points_table(points, names, poses=None, sigma=SIGMA_MM, seen=None, leg=None):
    """Observations (poses given) or a survey of bodies: {body: (B, N, 3) or (N, 3) in m}."""
    rows = []
    for name, cloud in points.items():
        clouds = cloud if poses is not None else [cloud]
        for b, one in enumerate(clouds):
            for k, target in enumerate(names[name]):
                if seen is None or seen[name][b, k]:
                    rows.append((poses[b] if poses else None, name, target, *(1e3 * one[k]), (leg or {}).get(target)))
    pose_id, body_name, target, x, y, z, at_leg = zip(*rows, strict=True)
    columns = {"body": body_name, "target": target, "x_mm": x, "y_mm": y, "z_mm": z}
    sigmas = sigma if isinstance(sigma, tuple) else (sigma,) * 3
    columns |= {f"sigma_{a}_mm": pa.array([s] * len(rows), pa.float64()) for a, s in zip("xyz", sigmas, strict=True)}
    columns |= {"pose": pose_id} if poses is not None else {"leg": pa.array(at_leg, pa.int64())}
    return pa.table(columns)


@pytest.fixture
def campaign():
    """A base and a platform with one attachment, in 30 poses, with a gross error and a target unseen."""
    rng = np.random.default_rng(41)
    names = {"base": [f"B{k}" for k in range(8)], "platform": [f"P{k}" for k in range(7)] + ["A1"]}
    shape = {"base": body(rng, 8), "platform": body(rng, 8, 0.2)}
    noise = dict.fromkeys(names, 1e-3 * SIGMA_MM)
    surveys = {n: shape[n] + noise[n] * rng.normal(size=(8, 3)) for n in names}
    motions = {n: random_motions(rng, 30) for n in names}
    points = {n: move(*motions[n], shape[n]) + noise[n] * rng.normal(size=(30, 8, 3)) for n in names}
    points["platform"][:, 7] += motions["platform"][0][:, :, 2] * 50e-6
    points["base"][4, 2] += [0.0, 2e-3, 1e-3]
    seen = {n: np.ones((30, 8), bool) for n in names}
    seen["platform"][6, 3] = False
    return {
        "names": names,
        "shape": shape,
        "motions": motions,
        "poses": list(range(30)),
        "observations": points_table(points, names, list(range(30)), seen=seen),
        "survey": points_table(surveys, names, leg={"A1": 1}),
        "surveys": surveys,
    }


def run(campaign, **sections):
    tables = {k: campaign[k] for k in ("observations", "survey") if k in campaign}
    outcome = pose.run(tables, settings(**{"bodies": {"reference": "base"}, **sections}), lambda *_: None)
    for name, table in outcome.artifacts.items():
        assert not ARTIFACTS[name].faults(table)
    return outcome


def default_rows(outcome, name):
    rows = outcome.artifacts["poses"].to_pandas()
    return rows[rows["default"] & (rows["body"] == name)].set_index("pose")


def numbers(rows):
    """R (B, 3, 3), p (B, 3) in m and covariance (B, 6, 6) of rows of the poses artifact."""
    R = exp_so3(rows[["rx_rad", "ry_rad", "rz_rad"]].to_numpy(float))
    p = 1e-3 * rows[["px_mm", "py_mm", "pz_mm"]].to_numpy(float)
    covariance = np.zeros((len(rows), 6, 6))
    for i in range(6):
        for j in range(i, 6):
            covariance[:, i, j] = covariance[:, j, i] = rows[f"cov_{i}_{j}"]
    return R, p, covariance


def test_platform_is_seen_from_the_base_and_the_base_from_the_measurement(campaign):
    outcome = run(campaign)
    platform, base = default_rows(outcome, "platform"), default_rows(outcome, "base")
    assert set(platform["parent"]) == {"base"}
    assert set(base["parent"]) == {"measurement"}
    (R_b, t_b), (R_p, t_p) = campaign["motions"]["base"], campaign["motions"]["platform"]
    R, p, _ = numbers(platform)
    expected = np.einsum("bji,bj->bi", R_b, t_p - t_b)
    assert_close(R, np.swapaxes(R_b, 1, 2) @ R_p, atol=5e-4)
    assert_close(p, expected, atol=5e-4)


def test_without_a_reference_all_poses_are_in_the_frame_of_the_measurement(campaign):
    outcome = run(campaign, bodies={})
    assert set(outcome.artifacts["poses"].column("parent").to_pylist()) == {"measurement"}


def test_every_method_has_a_row_and_one_is_the_default(campaign):
    rows = run(campaign).artifacts["poses"].to_pandas()
    assert set(rows["method"]) == {"umeyama", "haralick", "maximum_likelihood"}
    assert (rows.groupby(["pose", "body"])["default"].sum() == 1).all()
    assert set(rows[rows["default"]]["method"]) == {"maximum_likelihood"}


def test_residuals_say_what_became_of_each_point(campaign):
    outcome = run(campaign)
    rows = outcome.artifacts["residuals"].to_pandas().set_index(["pose", "body", "target"])
    attached = rows.xs("A1", level="target")
    assert (attached["weight"] == 0).all()
    assert not attached["rejected"].any()
    assert set(attached["reason"]) == {"attachment: not part of the frame"}
    assert attached["dz_mm"].mean() == pytest.approx(0.05, abs=0.01)
    gross = rows.loc[(4, "base", "B2")]
    assert gross["rejected"]
    assert gross["weight"] == 0
    assert gross["reason"].startswith("gross error: 2.2")
    assert rows["rejected"].sum() == 1
    assert (6, "platform", "P3") not in rows.index
    assert "base B2 in pose 4" in outcome.left_out
    default = default_rows(outcome, "base")
    assert default.loc[4, "n_rejected"] == 1
    assert default.loc[4, "n_used"] == 7


def test_residual_is_measured_minus_fitted_in_the_body_frame(campaign):
    outcome = run(campaign)
    R, p, _ = numbers(default_rows(outcome, "base"))
    rows = outcome.artifacts["residuals"].to_pandas()
    observed = campaign["observations"].to_pandas().merge(rows, on=["pose", "body", "target"])
    one = observed[(observed["body"] == "base") & (observed["pose"] == 9)].sort_values("target")
    measured = 1e-3 * one[["x_mm", "y_mm", "z_mm"]].to_numpy()
    expected = (measured - p[9]) @ R[9] - campaign["surveys"]["base"]
    assert_close(1e-3 * one[["dx_mm", "dy_mm", "dz_mm"]].to_numpy(), expected, atol=1e-12)


def test_a_person_excludes_and_keeps_by_name_and_reason(campaign):
    outcome = run(
        campaign,
        exclude=[{"body": "platform", "target": "P0", "by": "A. Nyman", "reason": "target loose"}],
        keep=[{"pose": 4, "body": "base", "target": "B2", "by": "A. Nyman", "reason": "really moved"}],
    )
    rows = outcome.artifacts["residuals"].to_pandas().set_index(["pose", "body", "target"])
    loose = rows.xs("P0", level="target")
    assert loose["rejected"].all()
    assert set(loose["decision"]) == {"excluded"}
    assert set(loose["reason"].str.partition(" by ")[2]) == {"A. Nyman: target loose"}
    assert loose["dx_mm"].notna().all()
    kept = rows.loc[(4, "base", "B2")]
    assert kept["decision"] == "kept"
    assert kept["weight"] == 1
    assert kept["reason"].partition(" by ")[2] == "A. Nyman: really moved"


def test_the_covariance_is_that_of_the_frame_which_the_survey_defines():
    """Over campaigns with surveys of their own, missing points and anisotropic noise."""
    rng = np.random.default_rng(42)
    pulls = []
    sigma = SIGMA_MM * 1e-3
    for _ in range(40):
        shape = body(rng, 8)
        survey = shape + sigma * rng.normal(size=(8, 3))
        R, t = random_motions(rng, 50)
        points = move(R, t, shape) + sigma * rng.normal(size=(50, 8, 3)) * [1.0, 1.0, 4.0]
        is_observed = rng.uniform(size=(50, 8)) < 0.8
        is_observed[:, :4] = True
        names, poses = {"b": list("abcdefgh")}, list(range(50))
        campaign = {
            "observations": points_table(
                {"b": points}, names, poses, (SIGMA_MM, SIGMA_MM, 4 * SIGMA_MM), {"b": is_observed}
            ),
            "survey": points_table({"b": survey}, names),
        }
        frame = umeyama(survey, shape)
        R_true, t_true = R @ frame.R, np.einsum("bij,j->bi", R, frame.t) + t
        R_fit, p, covariance = numbers(default_rows(run(campaign, bodies={}), "b"))
        pulls.append(squared_pulls(pose_error(R_fit, p, R_true, t_true), covariance))
    from scipy.stats import binom, chi2

    inside = np.concatenate(pulls) < chi2.ppf(0.95, 6)
    low, high = binom.ppf([1e-4, 1 - 1e-4], inside.size, 0.95)
    assert low <= inside.sum() <= high


def test_too_few_points_give_a_status_row_and_empty_numbers(campaign):
    table = campaign["observations"].to_pandas()
    short = table[~((table["pose"] == 3) & (table["body"] == "base") & (table["target"] > "B1"))]
    campaign["observations"] = pa.Table.from_pandas(short, preserve_index=False)
    outcome = run(campaign)
    base, platform = default_rows(outcome, "base"), default_rows(outcome, "platform")
    assert base.loc[3, "status"] == "too-few-points"
    assert platform.loc[3, "status"] == "base: too-few-points"
    assert np.isnan(platform.loc[3, "px_mm"])
    rows = outcome.artifacts["residuals"].to_pandas()
    here = rows[(rows["pose"] == 3) & (rows["body"] == "base")]
    assert set(here["reason"]) == {"no pose: too-few-points"}
    assert not here["rejected"].any()


def test_one_wrong_target_of_three_is_the_one_rejected():
    rng = np.random.default_rng(43)
    shape = body(rng, 3)
    R, t = random_motions(rng, 10)
    points = move(R, t, shape) + 1e-3 * SIGMA_MM * rng.normal(size=(10, 3, 3))
    points[6, 1] += [0.02, 0.03, 0.0]
    names, poses = {"tool": ["T1", "T2", "T3"]}, list(range(10))
    campaign = {
        "observations": points_table({"tool": points}, names, poses),
        "survey": points_table({"tool": shape}, names),
    }
    outcome = run(campaign, bodies={})
    rows = outcome.artifacts["residuals"].to_pandas()
    wrong = rows[rows["rejected"]]
    assert wrong[["pose", "target"]].to_numpy().tolist() == [[6, "T2"]]
    assert default_rows(outcome, "tool").loc[6, "status"] == "no-consensus"
    assert (default_rows(outcome, "tool").drop(6)["status"] == "ok").all()


def test_noise_larger_than_declared_rejects_nothing(campaign):
    table = campaign["observations"].to_pandas()
    table = table[~((table["pose"] == 4) & (table["target"] == "B2"))]
    rng = np.random.default_rng(44)
    table[["x_mm", "y_mm", "z_mm"]] += 6 * SIGMA_MM * rng.normal(size=(len(table), 3))
    campaign["observations"] = pa.Table.from_pandas(table, preserve_index=False)
    outcome = run(campaign)
    assert outcome.left_out == "no point"
    assert set(outcome.artifacts["poses"].column("status").to_pylist()) == {"ok"}


def test_a_platform_with_few_targets_of_its_own_is_framed_by_all(campaign):
    legs = {"A1": 1, "P0": 2, "P1": 3, "P2": 4, "P3": 5, "P4": 6}
    campaign["survey"] = points_table(campaign["surveys"], campaign["names"], leg=legs)
    rows = run(campaign).artifacts["residuals"].to_pandas()
    platform = rows[rows["body"] == "platform"]
    assert (platform.groupby("target")["weight"].max() > 0).all()


def test_without_a_survey_shape_and_poses_come_from_the_poses_alone(campaign):
    del campaign["survey"]
    outcome = run(campaign, bodies={})
    rows = default_rows(outcome, "base")
    assert set(outcome.artifacts["poses"].column("method").to_pylist()) == {"procrustes"}
    assert (rows["status"] == "ok").all()
    R, _, covariance = numbers(rows)
    R_true, _ = campaign["motions"]["base"]
    # the frame without a survey is free: compare motions between poses
    turn = np.swapaxes(R_true[:1], 1, 2) @ R[:1]
    assert_close(R, R_true @ turn, atol=5e-4)
    assert np.all(np.linalg.eigvalsh(covariance) > 0)
    points = outcome.artifacts["residuals"].to_pandas()
    assert points[points["rejected"]][["pose", "target"]].to_numpy().tolist() == [[4, "B2"]]


def test_without_declared_noise_the_distances_between_points_show_it(campaign):
    observations = campaign["observations"].to_pandas()
    observations[["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]] = np.nan
    campaign["observations"] = pa.Table.from_pandas(observations, preserve_index=False)
    outcome = run(campaign)
    rows = outcome.artifacts["residuals"].to_pandas()
    assert rows[rows["rejected"]][["pose", "target"]].to_numpy().tolist() == [[4, "B2"]]


@pytest.mark.parametrize("surveyed", [True, False])
def test_exact_points_of_undeclared_noise_lose_none(surveyed):
    rng = np.random.default_rng(45)
    shape, names, poses = body(rng, 4), {"tool": ["T1", "T2", "T3", "T4"]}, list(range(8))
    campaign = {"observations": points_table({"tool": move(*random_motions(rng, 8), shape)}, names, poses, sigma=None)}
    if surveyed:
        campaign["survey"] = points_table({"tool": shape}, names, sigma=None)
    outcome = run(campaign, bodies={})
    assert set(outcome.artifacts["poses"].column("status").to_pylist()) == {"ok"}
    assert outcome.left_out == "no point"


def test_poses_named_by_text_and_targets_outside_the_survey(campaign):
    observations = campaign["observations"].to_pandas()
    observations["pose"] = "set-" + observations["pose"].astype(str)
    observations.loc[observations["target"] == "B7", "target"] = "unknown"
    campaign["observations"] = pa.Table.from_pandas(observations, preserve_index=False)
    rows = run(campaign).artifacts["residuals"].to_pandas()
    outside = rows[rows["target"] == "unknown"]
    assert set(outside["reason"]) == {"not in the survey"}
    assert outside["dx_mm"].isna().all()
    assert rows["pose"].iloc[0] == "set-0"


def test_no_points_is_not_evaluated():
    outcome = pose.run({}, settings(), lambda *_: None)
    assert outcome.why_not
    assert outcome.artifacts["poses"].num_rows == 0
