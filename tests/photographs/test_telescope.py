"""The photographs of the sample are those of their command."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

from tests.blind.generator.folder import truth_path
from tests.photographs.sensor import save
from tests.photographs.telescope import SAMPLE_POSES, Session, write_tables

PROJECT = Path(__file__).resolve().parents[2]
SAMPLE = PROJECT / "sample_data" / "telescope-images"


def test_a_photograph_of_the_sample_is_made_again_grey_level_by_grey_level(tmp_path: Path) -> None:
    session, path = Session(), tmp_path / "again.jpg"
    save(session.photograph(1, 4), path, session.lens, session.quality)
    with Image.open(path) as again, Image.open(SAMPLE / "images" / "1" / "01-05.jpg") as kept:
        apart = np.abs(np.asarray(again, int) - np.asarray(kept, int))
    # Processors differ in the last digit of a sine: a grey level in a million may be rounded the other way.
    assert np.count_nonzero(apart) < 1000
    assert apart.max() <= 3


def test_the_tables_of_the_sample_are_written_again_to_the_byte(tmp_path: Path) -> None:
    folder = write_tables(Session(), tmp_path / "telescope-images", SAMPLE_POSES)
    for written in folder.iterdir():
        assert written.read_bytes() == (SAMPLE / written.name).read_bytes(), written.name


def test_the_sample_is_complete_and_small() -> None:
    session = Session()
    photographs = sorted(SAMPLE.glob("images/*/*.jpg"))
    assert len(photographs) == len(SAMPLE_POSES) * session.stations.count
    assert sum(path.stat().st_size for path in SAMPLE.rglob("*.*")) < 4e6
    for path in photographs[::7]:
        with Image.open(BytesIO(path.read_bytes())) as image:
            assert image.size == (session.lens.width_px, session.lens.height_px)


def test_the_truth_says_where_every_centre_is() -> None:
    session = Session()
    truth = json.loads(truth_path(SAMPLE).read_text(encoding="utf-8"))
    reported = {(one["pose"], one["station"]): np.array(one["pixels"]) for one in truth["photographs"]}
    assert len(reported) == len(SAMPLE_POSES) * session.stations.count
    assert np.abs(reported[(2, 3)] - session.true_pixels(2)[2]).max() < 1e-4
    # A dot is light where its centre is said to be, its sticker dark next to it.
    inside = [k for k, (x, y) in enumerate(reported[(2, 3)]) if 30 < x < 1570 and 30 < y < 1170]
    with Image.open(SAMPLE / "images" / "2" / "02-03.jpg") as image:
        grey = np.asarray(image)
    levels = np.array([grey[round(y), round(x)] for x, y in reported[(2, 3)][inside]])
    assert np.mean(levels > 60) > 0.8
