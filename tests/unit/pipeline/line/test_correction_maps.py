"""Maps of corrections in the run's folder: made beside the line, taken up again, let go in time."""

from __future__ import annotations

import asyncio
import os
import time
from dataclasses import replace
from pathlib import Path

import pytest

from tests.line_workshop import write_job, write_slab
from tilefab.config import load_job
from tilefab.errors import OutputError, TextureMapError
from tilefab.io.texture_map_file import save_texture_map
from tilefab.pipeline.line import correction_maps
from tilefab.pipeline.line.correction_maps import KeptMaps
from tilefab.pipeline.maps import job_maps, press_map_path
from tilefab.pipeline.plan import Plan, plan_job
from tilefab.pipeline.progress import Silent


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    write_slab(tmp_path)
    return plan_job(load_job(write_job(tmp_path)))


def of_key(plan: Plan, key: str) -> Plan:
    return replace(plan, press_key=key * 32)


def kept(plan: Plan, key: str, minutes_ago: float) -> Path:
    """A file where the map of a correction would lie, made so long ago."""
    path = press_map_path(of_key(plan, key))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"map")
    made_s = time.time() - 60 * minutes_ago
    os.utime(path, (made_s, made_s))
    return path


def test_maps_go_some_time_after_they_were_followed_by_others(plan: Plan) -> None:
    own = press_map_path(plan)
    own.parent.mkdir(parents=True)
    own.write_bytes(b"own")
    os.utime(own, (0, 0))
    old, older_but_used, lately, latest = (
        kept(plan, key, minutes) for key, minutes in (("aa", 400), ("bb", 350), ("cc", 300), ("dd", 10))
    )
    other_job = press_map_path(replace(of_key(plan, "ee"), map_key="f" * 64))
    other_job.write_bytes(b"other")
    os.utime(other_job, (0, 0))
    KeptMaps().tidy(plan, ["bb" * 32], keep_s=60 * 180)
    # The first was followed 350 minutes ago; the third only 10 minutes ago, so that its tiles are still in the kiln.
    assert [path.exists() for path in (own, old, older_but_used, lately, latest, other_job)] == [
        True,
        False,
        True,
        True,
        True,
        True,
    ]


def test_a_map_that_is_there_is_taken_up_and_counts_as_new(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    path = kept(plan, "aa", 400)
    monkeypatch.setattr(correction_maps.sys, "executable", "/nowhere")
    asyncio.run(KeptMaps().make(of_key(plan, "aa")))
    assert time.time() - path.stat().st_mtime < 100
    with pytest.raises(OutputError, match="can't be made: No such file"):
        asyncio.run(KeptMaps().make(of_key(plan, "bb")))


def test_what_the_maker_says_is_told(plan: Plan) -> None:
    plan.output.mkdir()
    (plan.output / "maps").symlink_to("nowhere/at/all")
    with pytest.raises(OutputError, match=r"its corrected map can't be made: .*/job/maps"):
        asyncio.run(KeptMaps().make(of_key(plan, "aa")))


def test_only_the_map_of_the_same_stone_is_loaded(plan: Plan) -> None:
    maps = job_maps(plan, Silent(), 1, must_keep=True)
    found = KeptMaps().load(plan, maps.texture.hash)
    assert found.hash == maps.press.hash
    with pytest.raises(TextureMapError, match="isn't of the texture map"):
        KeptMaps().load(plan, "0" * 64)
    with pytest.raises(TextureMapError):
        KeptMaps().load(of_key(plan, "aa"), maps.texture.hash)
    # Another correction's map under a name that fits is not taken for it.
    save_texture_map(press_map_path(of_key(plan, "bb")), maps.press)
    with pytest.raises(TextureMapError, match="isn't of the texture map"):
        KeptMaps().load(of_key(plan, "bb"), maps.texture.hash)
    KeptMaps().forget(plan)
    KeptMaps().forget(plan)
    assert not press_map_path(plan).exists()
