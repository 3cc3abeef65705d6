"""The mechanism of docs/own-mechanism.md, installed as the page says, passes all stages without changes to them."""

from __future__ import annotations

import importlib
import re
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.blind.generator.folder import write_campaign
from tests.blind.generator.hexapod import draw_hexapod, hexapod_geometry, random_places
from tests.blind.generator.layout import Layout, Targets
from tests.conftest import PROJECT
from tests.stages.line import run_line
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3
from truing.schemas.campaign import read_campaign
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.closures import Legs, mechanism
from truing.simulation.mechanisms.legs.kinematics import forward, inverse

PAGE = (PROJECT / "docs" / "own-mechanism.md").read_text(encoding="utf-8")
CODE, CHECK = re.findall(r"```python\n(.*?)```", PAGE, re.S)
PACKAGE, MECHANISM = re.findall(r"```toml\n(.*?)```", PAGE, re.S)
KIND = tomllib.loads(MECHANISM)["mechanism"]["type"]
OFFSET_MM = 40.0
HOME = np.array([0.0, 0.0, 0.32])  # m


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The package of the page as an installation leaves it: modules, and what their metadata name."""
    project = tomllib.loads(PACKAGE)
    (module,) = project["tool"]["setuptools"]["py-modules"]
    metadata = tmp_path / f"{module}-{project['project']['version']}.dist-info"
    metadata.mkdir()
    (tmp_path / f"{module}.py").write_text(CODE, encoding="utf-8")
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['project']['name']}\nVersion: 1.0\n")
    groups = project["project"]["entry-points"]
    lines = [f"[{group}]\n" + "\n".join(f"{k} = {v}" for k, v in named.items()) for group, named in groups.items()]
    (metadata / "entry_points.txt").write_text("\n".join(lines), encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    monkeypatch.delitem(sys.modules, module, raising=False)


def _legs(count: int = 6) -> Legs:
    drawn = hexapod_geometry(count)
    length = _extended(drawn.length + drawn.rho0) - drawn.rho0
    return mechanism(KIND, drawn.a * 1e-3, drawn.b * 1e-3, None, length * 1e-3, drawn.rho0 * 1e-3)


def _extended(spans: np.ndarray) -> np.ndarray:
    """Lengths of cylinders, mm, for given distances between their joints."""
    return np.sqrt(spans**2 - OFFSET_MM**2)


@pytest.mark.usefixtures("installed")
def test_forward_and_inverse_kinematics_are_inverse_functions() -> None:
    legs, rng = _legs(), np.random.default_rng(1)
    p, R = HOME + rng.normal(0.0, 0.01, (5, 3)), exp_so3(rng.normal(0.0, 0.03, (5, 3)))
    reached = forward(legs, inverse(legs, p, R))
    assert reached.converged.all()
    assert_close(reached.p, p, atol=1e-12, what="p, m")
    assert_close(reached.R, R, atol=1e-12, what="R")


@pytest.mark.usefixtures("installed")
def test_derivatives_of_the_example_pass_the_check_of_the_page() -> None:
    legs, rng = _legs(), np.random.default_rng(2)
    upper, rho = HOME + rng.normal(0.0, 0.05, (4, 6, 3)), legs.rho0 + rng.normal(0.0, 0.01, (4, 6))
    for axis in range(3):
        exec(CHECK, {"np": np, "axis": axis, "closure": legs.closure, "legs": legs, "upper": upper, "rho": rho})
    for field, shape in (("a", (6, 3)), ("l", (6,))):
        count = int(np.prod(shape))
        eye = np.eye(count).reshape(*shape, count)
        found = legs.closure.close_change(legs, upper, rho, Change({field: eye}, count))
        for j in range(count):
            moved = legs.replace(**{field: getattr(legs, field) + 1e-30j * eye[..., j]})
            expected = legs.closure.close(moved, upper, rho)[0].imag / 1e-30
            assert_close(found[..., j], expected, atol=1e-14, what=f"{field} {j}")


def _campaign(folder: Path) -> Path:
    """A hexapod on such legs, measured: that of the generator, with what its cylinders would have read."""
    rng, targets = np.random.default_rng(7), Targets(on_attachments=(), per_leg=0)
    layout = Layout("lab", hexapod_geometry(6), targets=targets)
    drawn = draw_hexapod(layout, random_places(24, 6, rng), (), rng)
    geometry, spans = layout.geometry, drawn.truth.built.length + drawn.readings
    nominal = _extended(geometry.length + geometry.rho0) - geometry.rho0
    built = nominal + (drawn.truth.built.length - geometry.length)
    other = replace(layout, geometry=replace(geometry, length=nominal))
    write_campaign(replace(drawn, layout=other, readings=_extended(spans) - built), folder, 7)
    file = folder / "campaign.toml"
    file.write_text(file.read_text(encoding="utf-8").replace('type = "ups"', f'type = "{KIND}"'), encoding="utf-8")
    return folder


def _rigid(folder: Path, kind: str) -> dict[str, float]:
    """Figures of the calibration with legs of a kind on a rigid platform."""
    tables, _ = run_line(folder, "ingest", "qa", "pose", "deformation", "calibrate")
    wanted = {"model": kind, "deformation": "none", "estimator": "errors-in-variables"}
    rows = [row for row in tables["model_choice"].to_pylist() if wanted.items() <= row.items()]
    return {row["figure"]: row["value"] for row in rows}


@pytest.mark.usefixtures("installed")
def test_a_campaign_on_it_is_calibrated_to_its_noise_and_as_another_kind_it_is_not(tmp_path: Path) -> None:
    folder = _campaign(tmp_path / "lab")
    own = _rigid(folder, KIND)
    assert own["chosen"] == 1.0
    assert own["p_value"] > 1e-3
    assert own["poses_downweighted"] == 0.0
    file = folder / "campaign.toml"
    file.write_text(file.read_text(encoding="utf-8").replace(f'type = "{KIND}"', 'type = "ups"'), encoding="utf-8")
    taken = _rigid(folder, "ups")
    assert taken["p_value"] < 1e-9
    shown = re.search(r"leaves (\d+) µm mean position error .* as `ups` (\d+) µm", PAGE, re.S)
    assert shown
    for text, found in zip(shown.groups(), (own, taken), strict=True):
        assert float(text) == pytest.approx(found["position_mean_verification"], rel=0.2)  # a unit of the digit shown


def test_without_the_package_its_type_is_a_fault_that_names_the_others(tmp_path: Path) -> None:
    document = tomllib.loads((_campaign(tmp_path / "lab") / "campaign.toml").read_text(encoding="utf-8"))
    with pytest.raises(Exception, match="6-pus") as fault:
        read_campaign(document)
    assert KIND in str(fault.value)
