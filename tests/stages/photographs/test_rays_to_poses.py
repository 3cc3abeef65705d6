"""A photographed machine from rays to poses: errors against the truth, rejections, common errors, and checks."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from numpy.typing import NDArray

from tests.photographs.hidden import UnstableCamera
from tests.photographs.machine import LINE, photograph, stated_covariance
from tests.photographs.rays import Photographed
from tests.stages.line import run_line, settings_of
from truing.pipeline.in_memory import call_stage

Array = NDArray[np.float64]
Tables = dict[str, pa.Table]


def _truth(photographed: Photographed, pose: int, names: list[str]) -> Array:
    place = {"/".join(name): k for k, name in enumerate(photographed.names)}
    number = list(photographed.campaign.schedule.pose).index(pose)
    return np.asarray(photographed.points[number][[place[name] for name in names]])


def _brought_over(found: Array, truth: Array) -> tuple[Array, Array]:
    """The true points in the frame of those found, and the derivatives (3n, 6) of points by a rigid motion."""
    u, _, vt = np.linalg.svd((found - found.mean(0)).T @ (truth - truth.mean(0)))
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    moved = (truth - truth.mean(0)) @ R.T + found.mean(0)
    x = moved - moved.mean(0)
    turns = np.stack([np.cross(axis, x) for axis in np.eye(3)], axis=-1)
    return moved, np.concatenate([np.tile(np.eye(3), (len(x), 1)), turns.reshape(-1, 3)], axis=1)


def test_errors_of_points_agree_with_their_full_covariance(adjusted: Any) -> None:
    photographed, _, tables = adjusted
    for pose in photographed.campaign.schedule.pose:
        names, found, cov = stated_covariance(tables, pose)
        moved, J = _brought_over(found, _truth(photographed, pose, names))
        free = np.linalg.svd(J)[0][:, 6:]  # what rigid motions leave
        error = free.T @ (found - moved).ravel()
        chi2 = error @ np.linalg.solve(free.T @ cov @ free, error)
        freedom = len(error)
        assert abs(chi2 / freedom - 1.0) < 4.0 * np.sqrt(2.0 / freedom)


def test_errors_of_relative_poses_agree_with_their_covariance(adjusted: Any) -> None:
    """Base and platform as the survey has them, on the true points; one in a thousand of chi-square with 9."""
    photographed, _, tables = adjusted
    assert _offsets(photographed, tables["survey"], tables["poses"]) < 27.9


def test_without_the_correlations_heights_would_be_stated_far_too_well(adjusted: Any) -> None:
    """Errors of cameras and scale bars are common to all points, so the mean of many points does not reduce them."""
    _, folder, tables = adjusted
    alone = {name: table for name, table in tables.items() if name != "point_correlations"}
    found = call_stage("pose", alone, settings_of(folder)).artifacts["poses"]
    assert isinstance(found, pa.Table)
    both = [t.to_pandas().query("default and body == 'platform'")["cov_2_2"] for t in (tables["poses"], found)]
    assert np.sqrt(both[0] / both[1]).min() > 2.0


def test_shifts_scatter_as_the_whole_covariance_of_points_says(drawn: Tables) -> None:
    """One pose again and again, each time with errors of its points drawn from their whole covariance."""
    found = drawn["deformation"].to_pandas()
    off = found["delta_bz_um"] - found.groupby("leg")["delta_bz_um"].transform("mean")
    squares = ((off / found["scatter_sigma_um"]) ** 2).groupby(found["pose"]).mean()  # legs have errors in common
    assert len(squares) == 100
    assert abs(squares.mean() - 1.0) < 4.0 * squares.std() / np.sqrt(100) < 0.3
    survey = found["sigma_um"] ** 2 - found["scatter_sigma_um"] ** 2
    assert survey.groupby(found["leg"]).std().max() < 1e-6 * survey.min()


def _offsets(photographed: Photographed, survey: pa.Table, table: pa.Table) -> float:
    """Chi-square of where the platform is in the base, over all poses, three degrees each."""
    names = ["/".join(name) for name in photographed.names]
    surveyed = survey.to_pandas().query("leg.isna()")
    total = 0.0
    for row in table.to_pandas().query("default and body == 'platform'").itertuples():
        truth = _truth(photographed, row.pose, names)
        motion = {}
        for body, own in surveyed.groupby("body"):
            at = [names.index(f"{body}/{target}") for target in own["target"]]
            motion[body] = _motion(own[["x_mm", "y_mm", "z_mm"]].to_numpy(), truth[at])
        (R0, t0), (_, t1) = motion["base"], motion["platform"]
        offset = np.array([row.px_mm, row.py_mm, row.pz_mm]) - R0.T @ (t1 - t0)
        cov = np.array([[getattr(row, f"cov_{min(i, j)}_{max(i, j)}") for j in range(3)] for i in range(3)]) * 1e6
        total += float(offset @ np.linalg.solve(cov, offset))
    return total


def _motion(source: Array, target: Array) -> tuple[Array, Array]:
    u, _, vt = np.linalg.svd((target - target.mean(0)).T @ (source - source.mean(0)))
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return R, target.mean(0) - R @ source.mean(0)


def test_wrong_rays_are_listed_with_their_reason_and_hardly_any_good_one(adjusted: Any) -> None:
    photographed, _, tables = adjusted
    residuals = tables["image_residuals"].to_pandas()
    rejected = residuals[residuals["rejected"]]
    assert len(residuals) == len(photographed.pose)
    assert rejected["reason"].notna().all()
    assert residuals[~residuals["rejected"]]["reason"].isna().all()
    order = photographed.gross  # the rows of image_points, in their order
    assert rejected.index.isin(np.flatnonzero(order)).sum() >= order.sum() - 1
    assert (~rejected.index.isin(np.flatnonzero(order))).sum() <= 6  # one in a thousand of 1000, four times


def test_the_datum_changes_no_residual_and_no_relative_pose(adjusted: Any, tmp_path: Path) -> None:
    _, folder, tables = adjusted
    other = tmp_path / "minimal"
    shutil.copytree(folder, other)
    with (other / "campaign.toml").open("a", encoding="utf-8") as file:
        file.write('\n[photographs]\ndatum = "minimal"\n')
    found = run_line(other, *LINE)[0]
    for name in ("vx_px", "vy_px"):
        first, second = (t["image_residuals"].column(name).to_numpy(zero_copy_only=False) for t in (tables, found))
        np.testing.assert_allclose(second, first, atol=1e-6, equal_nan=True)
    columns = [*(f"p{a}_mm" for a in "xyz"), *(f"r{a}_rad" for a in "xyz"), "cov_0_0", "cov_2_2", "cov_3_4", "cov_5_5"]
    first, second = (
        t["poses"].to_pandas().query("default and body == 'platform'")[columns].to_numpy() for t in (tables, found)
    )
    sigma = np.sqrt(first[:, 6])[:, None] * 1e3
    assert np.abs(first[:, :3] - second[:, :3]).max() < 0.02 * sigma.min()
    np.testing.assert_allclose(second[:, 6:], first[:, 6:], rtol=0.02)


def test_ends_of_bars_are_no_targets_and_what_is_left_out_is_counted(adjusted: Any) -> None:
    _, _, tables = adjusted
    assert set(tables["observations"].column("body").to_pylist()) == {"base", "platform"}
    assert "point" in tables["observations"].column_names
    (row,) = [r for r in tables["exclusions"].to_pylist() if "scale bars" in r["reason"]]
    assert row["rows"] == 12  # two ends of two bars in three poses


def test_parameters_common_to_all_poses_have_sensitivities(adjusted: Any) -> None:
    _, _, tables = adjusted
    reported = set(tables["pose_sensitivities"].column("parameter").to_pylist())
    assert {"camera c", "bar S", "bar T"} <= reported
    bar = tables["scale_bar_lengths"].to_pandas()
    assert (bar["deviation_mm"].abs() < 4.0 * bar["deviation_sigma_mm"]).all()


def test_the_budget_of_a_pose_shows_what_is_common_to_all(adjusted: Any) -> None:
    _, _, tables = adjusted
    budget = tables["uncertainty_budget"].to_pandas().query("result == 'pose' and evaluation != 'not evaluated'")
    stated = tables["uncertainty"].to_pandas().query("result == 'pose' and stated")
    sources = budget["input_source"].unique()
    assert [source for source in sources if "common to all" in source] == list(sources[:2])
    squares = (budget["contribution"] ** 2).groupby([budget["subject"], budget["quantity"]]).sum()
    whole = stated.set_index(["subject", "quantity"])["standard_uncertainty"] ** 2
    np.testing.assert_allclose(squares.loc[whole.index], whole, rtol=0.05)
    height = budget[budget["quantity"] == "pz"]
    common = height[height["input_source"].str.contains("common")].groupby("subject")["share_of_variance"].sum()
    assert common.between(0.01, 0.99).all()
    assert not any(
        "no scale bar" in str(reason) for reason in tables["uncertainty_budget"].column("reason").to_pylist()
    )


def test_a_good_campaign_fails_no_check_and_warns_of_nothing_in_its_photographs(adjusted: Any) -> None:
    from truing.schemas.point_checks import OF_PHOTOGRAPHS

    _, _, tables = adjusted
    rows = [row for row in tables["qa"].to_pylist() if row["check"] in OF_PHOTOGRAPHS]
    assert {row["check"] for row in rows} == set(OF_PHOTOGRAPHS)
    assert [row["message"] for row in rows if row["verdict"] not in ("pass", "not evaluated")] == []


def test_a_camera_that_jumps_is_reported(tmp_path: Path) -> None:
    photograph(tmp_path / "jump", UnstableCamera("c", jump_px=2.0, from_pose=3))
    tables = run_line(tmp_path / "jump", "images", "bundle", "ingest", "qa")[0]
    (row,) = [row for row in tables["qa"].to_pylist() if row["check"] == "camera-stability"]
    assert row["verdict"] == "fail"
    assert "pose 3" in row["message"]


def test_reference_lengths_show_errors_of_length(tmp_path: Path) -> None:
    photograph(tmp_path / "lengths", poses=2)
    bars = tmp_path / "lengths" / "scale_bars.csv"
    header, first, second = bars.read_text(encoding="utf-8").splitlines()
    fields = second.split(",")
    place = header.split(",").index("length_mm")
    length = float(fields[place])
    fields[place] = f"{length / (1 + 300e-6):.6f}"  # what is measured is 300 um/m too long against it
    reported = [f"{header},serves", f"{first},scale", f"{','.join(fields)},check"]
    bars.write_text("\n".join(reported) + "\n", encoding="utf-8")
    tables = run_line(tmp_path / "lengths", "images", "bundle", "ingest", "qa")[0]
    (row,) = [row for row in tables["qa"].to_pylist() if row["check"] == "length-errors"]
    assert row["verdict"] == "warn"
    assert row["value"] == pytest.approx(300, abs=30)
    assert "1 measuring lines of 7" in row["message"]


def test_the_page_shows_every_camera_and_lists_every_ray_that_was_left_out(adjusted: Any) -> None:
    from truing.report.photographs.section import photographs

    _, _, tables = adjusted
    frames = {name: table.to_pandas() for name, table in tables.items() if isinstance(table, pa.Table)}
    section = photographs(frames)
    assert section is not None
    (network, _), (residuals, _) = section.figures
    assert [step.label for step in network.layout.sliders[0].steps] == ["1", "2", "3"]
    seen = [trace for trace in network.data if trace.visible]
    cameras = next(trace for trace in seen if trace.name == "projection centre")
    assert len(cameras.x) == (frames["image_orientations"]["pose"] == 1).sum()
    assert {trace.name for trace in seen} >= {"base", "platform", "bars", "camera"}
    assert len(residuals.layout.sliders[0].steps) == 1 + len(frames["image_orientations"])
    left = [listing for listing in section.listings if listing.caption.startswith("Rays left out")]
    assert sum(len(listing.rows) for listing in left) == frames["image_residuals"]["rejected"].sum()
    assert {listing.caption.partition("): ")[2] for listing in left} == set(
        frames["image_residuals"]["reason"].dropna()
    )


def test_the_page_says_what_gives_the_scale_and_lists_distances_of_a_survey_once(adjusted: Any) -> None:
    from truing.report.photographs.section import photographs

    _, _, tables = adjusted
    frames = {name: table.to_pandas() for name, table in tables.items() if isinstance(table, pa.Table)}
    section = photographs(frames)
    assert section is not None
    assert section.lead.endswith("from scale bars S, T, checked by each other and the survey.")
    own = frames["scale_bar_lengths"]
    distances = own.assign(bar="survey, " + own["bar"], deviation_mm=own["pose"] * own["deviation_sigma_mm"])
    section = photographs(frames | {"scale_bar_lengths": distances})
    assert section is not None
    (listing,) = [listing for listing in section.listings if listing.caption.startswith("Distances of the survey")]
    assert [row[:2] for row in listing.rows] == [("S", "3"), ("T", "3")]


def test_a_campaign_without_photographs_has_no_such_section() -> None:
    from truing.report.photographs.section import photographs

    assert photographs({}) is None


def test_known_points_give_the_frame_and_the_scale(tmp_path: Path) -> None:
    """Without bars, by five points whose places in the scene are known to a hundredth of a millimetre."""
    photographed = photograph(tmp_path / "known", poses=1)
    folder = tmp_path / "known"
    (folder / "scale_bars.csv").unlink()
    names = ["/".join(name) for name in photographed.names]
    truth = _truth(photographed, 1, names)
    rows = [f"{names[k]},{','.join(f'{v:.5f}' for v in truth[k])},0.01,0.01,0.01" for k in (0, 5, 11, 20, 28)]
    head = "point,x_mm,y_mm,z_mm,sigma_x_mm,sigma_y_mm,sigma_z_mm"
    (folder / "known_points.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    (folder / "targets.csv").rename(folder / "survey.csv")
    origins = run_line(folder, "images", "bundle")[0]["bundle_statistics"].to_pandas()["figure"]
    assert (origins == "scale from none").sum() == 1  # as no datum they give it to the start alone
    (folder / "survey.csv").rename(folder / "targets.csv")
    with (folder / "campaign.toml").open("a", encoding="utf-8") as file:
        file.write('\n[photographs]\ndatum = "known"\n')
    tables = run_line(folder, "images", "bundle")[0]
    found, place, cov = stated_covariance(tables, 1)
    error = (place - _truth(photographed, 1, found)).ravel()
    chi2 = error @ np.linalg.solve(cov, error)
    assert abs(chi2 / len(error) - 1.0) < 4.0 * np.sqrt(2.0 / len(error))
    origins = tables["bundle_statistics"].to_pandas()["figure"]
    assert (origins == "scale from known points").sum() == 1


def test_without_bars_distances_of_the_survey_give_the_scale(tmp_path: Path) -> None:
    """Each target of the base in one distance at most, so that their errors are independent, as their prior says."""
    photographed = photograph(tmp_path / "surveyed", poses=2)
    (tmp_path / "surveyed" / "scale_bars.csv").unlink()
    tables = run_line(tmp_path / "surveyed", "images", "bundle", "ingest", "pose")[0]
    lengths = tables["scale_bar_lengths"].to_pandas().query("pose == 1")
    ends = [*lengths["first"], *lengths["second"]]
    assert len(set(ends)) == len(ends) > 6
    assert all(end.startswith("base/") for end in ends)
    names, found, cov = stated_covariance(tables, 1)
    truth = _truth(photographed, 1, names)
    moved, _ = _brought_over(found, truth)
    x = (moved - moved.mean(0)).ravel()
    scale, sigma = x @ (found - moved).ravel() / (x @ x), np.sqrt(x @ cov @ x) / (x @ x)
    assert abs(scale) < 4.0 * sigma < 1e-4  # the survey's 5 um in half a metre, several times over


def test_without_anything_that_gives_the_scale_it_is_said_what_would(tmp_path: Path) -> None:
    photograph(tmp_path / "unscaled", poses=2)
    for name in ("scale_bars.csv", "targets.csv"):
        (tmp_path / "unscaled" / name).unlink()
    tables = run_line(tmp_path / "unscaled", "images", "bundle")[0]
    origins = tables["bundle_statistics"].to_pandas()["figure"]
    assert (origins == "scale from none").sum() == 2


def test_points_whose_scale_is_open_give_poses_only_where_a_person_accepts_it(tmp_path: Path) -> None:
    """All of a network in one body, and nothing that gives the scale: the whole covariance has more null directions
    than motions have, so that accepted poses are those of their own fit."""
    photograph(tmp_path / "open", poses=2)
    for name in ("scale_bars.csv", "targets.csv"):
        (tmp_path / "open" / name).unlink()
    toml = (tmp_path / "open" / "campaign.toml").read_text(encoding="utf-8")
    start = toml.index("[mechanism")
    rest = [part for part in ("[" + part for part in toml[start:].split("\n[")) if "mechanism" not in part[:12]]
    (tmp_path / "open" / "campaign.toml").write_text(toml[:start] + "\n".join(rest), encoding="utf-8")
    rays = tmp_path / "open" / "image_points.csv"
    text = rays.read_text(encoding="utf-8")
    rays.write_text(text.replace(",platform,", ",base,").replace(",bars,", ",base,"), encoding="utf-8")
    stages = ("images", "bundle", "ingest", "qa", "pose", "report")
    assert not run_line(tmp_path / "open", *stages)[0]["poses"].num_rows
    with (tmp_path / "open" / "campaign.toml").open("a", encoding="utf-8") as file:
        file.write('\n[[accept]]\ncheck = "scale"\nby = "M. Keller"\nreason = "shapes alone are asked for"\n')
    tables = run_line(tmp_path / "open", *stages)[0]
    assert (tables["poses"].to_pandas()["status"] == "ok").any()
    assert "scale" in tables["qa"].to_pandas().query("verdict == 'fail'")["check"].tolist()


def test_centres_of_ellipses_are_corrected_to_those_of_circles(tmp_path: Path) -> None:
    """Centres of ellipses of large circles, corrected, fit like the images of the circles' centres."""
    photographed = photograph(tmp_path / "circles", poses=1)
    folder = tmp_path / "circles"
    plain = run_line(folder, "images", "bundle")[0]
    rays = _as_ellipses(folder, plain, radius_m=0.02)
    with (folder / "campaign.toml").open("a", encoding="utf-8") as file:
        file.write("\n[photographs]\ntarget_mm = 40.0\n")
    tables = run_line(folder, "images", "bundle")[0]
    residuals = tables["image_residuals"].to_pandas()
    taken = residuals[["eccentricity_x_px", "eccentricity_y_px"]].to_numpy()
    used = ~residuals["rejected"].to_numpy()
    assert np.abs(rays[used]).max() > 0.2
    assert np.abs(taken - rays)[used].max() < 0.01
    figures = tables["bundle_statistics"].to_pandas().set_index(["figure", "subject"])["value"]
    before = plain["bundle_statistics"].to_pandas().set_index(["figure", "subject"])["value"]
    assert figures["noise over stated", "camera circle"] < 1.1 * before["noise over stated", "camera circle"]
    assert len(photographed.pose) == len(residuals)


def _as_ellipses(folder: Path, tables: Tables, radius_m: float) -> Array:
    """Write the folder's rays anew as the ellipses of circles that face upwards; returns what that shifts them by."""
    from truing.estimation.bundle.eccentricity import network_eccentricity
    from truing.estimation.bundle.network import NetworkState, linearise
    from truing.estimation.rotation import exp_so3
    from truing.stages.bundle_adjustment.rays_as_network import given_cameras, image_points, named_network

    rays = image_points(tables["image_points"], tables["photographs"])
    cameras, _ = given_cameras(tables["photographs"], tables.get("cameras_given"))
    network = named_network(rays, tables["photographs"], cameras, tables, None).network
    orientation = tables["image_orientations"].to_pandas()
    adjusted = tables["cameras"].to_pandas()["value"].to_numpy()[None]
    points = tables["object_points"].to_pandas()[["x_mm", "y_mm", "z_mm"]].to_numpy() * 1e-3
    centre = orientation[["px_mm", "py_mm", "pz_mm"]].to_numpy() * 1e-3
    R = exp_so3(orientation[["rx_rad", "ry_rad", "rz_rad"]].to_numpy())
    state = NetworkState(adjusted, R, centre, points, np.zeros(0))
    up = (centre - points.mean(0)).mean(0)
    normal = np.broadcast_to(up / np.linalg.norm(up), points.shape)
    image, point = network.rays.image, network.rays.point
    J = linearise(network, state, image, point).by_point
    shape = radius_m**2 * J @ (np.eye(3) - normal[point][:, :, None] * normal[point][:, None]) @ J.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(shape)
    off = network_eccentricity(network, state, image, point, normal, np.full(len(points), radius_m))
    frame = tables["image_points"].to_pandas()
    frame[["x_px", "y_px"]] += off
    frame["semi_major_px"], frame["semi_minor_px"] = np.sqrt(values[:, 1]), np.sqrt(values[:, 0])
    frame["axis_angle_rad"] = np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])
    frame.to_csv(folder / "image_points.csv", index=False)
    return np.asarray(off)
