"""A missing target under an unknown name is suggested, never renamed; later surveys are tested by moved targets."""

from __future__ import annotations

import re
import tomllib

import numpy as np
import pytest

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.effects import TargetMoved
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Layout, Targets
from tests.blind.generator.schedule import random_moves
from tests.stages.line import run_line

PLAIN = Layout(name="plain", targets=Targets(per_leg=0))


@pytest.fixture
def folder(tmp_path):
    return drawn(tmp_path)


def drawn(tmp_path, *effects):
    rng = np.random.default_rng(3)
    moves = random_moves(16, 2, rng)
    again = [(101 + k, "calibration", moves[k][2]) for k in range(3)]
    made = write_campaign(draw_campaign(PLAIN, [*moves, *again], list(effects), rng), tmp_path / "campaign", 3)
    for name, at in (("points", 2), ("targets", 1)):  # no target at an attachment
        lines = (made / f"{name}.csv").read_text(encoding="utf-8").splitlines()
        kept = [line for line in lines if not line.split(",")[at].startswith("A")]
        (made / f"{name}.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")
    return made


def rewritten(folder, change):
    lines = (folder / "points.csv").read_text(encoding="utf-8").splitlines()
    (folder / "points.csv").write_text("\n".join(change(line) for line in lines) + "\n", encoding="utf-8")


def poses_of(folder):
    rows = (folder / "configurations.csv").read_text(encoding="utf-8").splitlines()
    time = rows[0].split(",").index("time_s")
    return [row.split(",")[0] for row in sorted(rows[1:], key=lambda row: float(row.split(",")[time]))]


def quality(folder):
    tables, said = run_line(folder, "ingest", "qa")
    qa = tables["qa"].to_pandas()
    return tables, qa.set_index(["check", "subject"]), said["qa"]


def added(folder, text):
    with (folder / "campaign.toml").open("a", encoding="utf-8") as file:
        file.write(text)


def toml_of(row):
    keys = {"body": row["body"], "target": row["target"], "called": row["called"], "from_pose": row["from_pose"]}
    return "\n[[renamed]]\n" + "\n".join(f'{key} = "{value}"' for key, value in keys.items() if value) + "\n"


def test_a_target_that_vanishes_and_an_unknown_at_its_place_are_suggested_to_be_one(folder):
    late = set(poses_of(folder)[12:])
    rewritten(folder, lambda line: re.sub("^(.*?),platform,P03,", lambda m: f"{m[1]},platform,X77,"
              if m[1] in late else m[0], line))  # fmt: skip
    tables, qa, said = quality(folder)
    row = tables["likely_names"].to_pylist()
    assert [(one["called"], one["target"], one["from_pose"], one["rows"]) for one in row] == [
        ("X77", "P03", poses_of(folder)[12], (folder / "points.csv").read_text(encoding="utf-8").count(",X77,"))
    ]
    assert qa.loc[("names-known", "target X77"), "verdict"] == "warn"
    assert "X77" in tables["observations"].column("target").to_pylist()  # nothing is renamed by itself
    assert not said.failed_checks
    added(folder, toml_of(row[0]))
    tables, qa, _ = quality(folder)
    assert "X77" not in tables["observations"].column("target").to_pylist()
    assert qa.loc[("names-known", "platform"), "verdict"] == "pass"
    assert "likely_names" not in tables


def test_declared_repeats_are_assessed_though_actuators_stood_elsewhere(folder):
    lines = (folder / "configurations.csv").read_text(encoding="utf-8").splitlines()
    of = [str(int(pose) - 100) if int(pose) > 100 else "" for pose in (line.split(",")[0] for line in lines[1:])]
    reported = [f"{lines[0]},repeat_of", *(f"{line},{name}" for line, name in zip(lines[1:], of, strict=True))]
    (folder / "configurations.csv").write_text("\n".join(reported) + "\n", encoding="utf-8")
    row = quality(folder)[1].loc[("repeatability", "platform")]
    assert row["verdict"] == "pass"
    assert "3 repeats" in row["message"]
    assert "repeat_of" in row["message"]


def test_a_further_target_of_its_own_is_no_other_name(folder):
    first = poses_of(folder)[0]
    extra = [
        line for line in (folder / "points.csv").read_text(encoding="utf-8").splitlines() if ",platform,P03," in line
    ]
    with (folder / "points.csv").open("a", encoding="utf-8") as file:
        file.writelines(line.replace(",P03,", ",X77,") + "\n" for line in extra if not line.startswith(f"{first},"))
    tables, qa, _ = quality(folder)
    assert "likely_names" not in tables
    assert qa.loc[("names-known", "platform"), "verdict"] == "pass"
    assert "X77" in qa.loc[("names-known", "platform"), "message"]


def surveyed_again(folder, target, by_mm, seed=4):
    noise = tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))["noise"]["point_mm"]
    rng, rows = np.random.default_rng(seed), ["survey,body,target,x_mm,y_mm,z_mm"]
    for line in (folder / "targets.csv").read_text(encoding="utf-8").splitlines()[1:]:
        body, name, *rest = line.split(",")
        place = np.array(rest[:3], float) + (by_mm if name == target else 0.0)
        at = place[[1, 2, 0]] + [100.0, 20.0, 3.0] + noise * rng.standard_normal(3)
        rows.append(f"end,{body},{name},{','.join(f'{v:.5f}' for v in at)}")
    (folder / "resurveys.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


def test_a_survey_at_the_end_is_not_evaluated_passes_or_fails(folder):
    assert quality(folder)[1].loc[("resurvey", ""), "verdict"] == "not evaluated"
    surveyed_again(folder, "P03", np.zeros(3))
    rows = quality(folder)[1].loc["resurvey"]
    assert set(rows["verdict"]) == {"pass"}
    surveyed_again(folder, "P03", np.array([0.3, 0.0, -0.2]))
    _, qa, said = quality(folder)
    row = qa.loc[("resurvey", "target P03 survey end")]
    assert row["verdict"] == "fail"
    assert row["limit"] == 10.0
    assert re.search(r"lies 0\.3[56]\d mm elsewhere", row["message"])
    assert said.failed_checks == ("resurvey target P03 survey end",)
    added(folder, "\n[qa.limits.resurvey]\nfail = 1000.0\n")
    assert quality(folder)[1].loc[("resurvey", "target P03 survey end"), "verdict"] == "warn"


def test_a_target_that_moved_is_not_mixed_with_what_it_was(tmp_path):
    by = np.array([0.3, 0.0, -0.2])
    folder = drawn(tmp_path, TargetMoved("platform", "P03", tuple(by), 13))
    surveyed_again(folder, "P03", by)
    assert quality(folder)[1].loc[("moved-targets", "target P03"), "verdict"] == "warn"
    added(folder, '\n[[resurvey]]\nsurvey = "end"\nfrom_pose = 13\n')
    _, qa, said = quality(folder)
    assert qa.loc[("moved-targets", "platform"), "verdict"] == "pass"
    assert not said.failed_checks
    residuals = run_line(folder, "ingest", "pose")[0]["residuals"].to_pandas()
    own = residuals[residuals["target"].isin(["P03", "P03@end"]) & ~residuals["rejected"]]
    assert own["weight"].all()  # both take part in the frame
    size = np.linalg.norm(own[["dx_mm", "dy_mm", "dz_mm"]], axis=1)
    assert size.max() < 10.0 * 0.005 < np.linalg.norm(by)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ('[[resurvey]]\nsurvey = "end"\nfrom_pose = "{pose}"\n', "on it is P03@end"),
        ('[[exclude]]\nbody = "platform"\ntarget = "P03"\nby = "Ann"\nreason = "loose"\n', "it was excluded by Ann"),
    ],
)
def test_a_declared_new_survey_passes_the_resurvey_check(folder, entry, words):
    surveyed_again(folder, "P03", np.array([0.3, 0.0, -0.2]))
    added(folder, "\n" + entry.format(pose=poses_of(folder)[12]))
    _, qa, said = quality(folder)
    row = qa.loc[("resurvey", "target P03 survey end")]
    assert (row["verdict"], words in row["message"]) == ("pass", True)
    assert qa.loc[("completeness", "platform"), "verdict"] == "pass"
    assert not [name for name in said.failed_checks if "resurvey" in name]


def test_without_a_survey_names_are_neither_known_nor_unknown(folder):
    (folder / "targets.csv").unlink()
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    (folder / "campaign.toml").write_text(
        text.split("[mechanism]")[0] + "[noise]\npoint_mm = 0.005\n", encoding="utf-8"
    )
    _, qa, _ = quality(folder)
    for body in ("base", "platform"):
        assert qa.loc[("names-known", body), "verdict"] == "not evaluated"
        assert "no survey" in qa.loc[("names-known", body), "message"]
