"""A job's own tables: least ink, prices, room for its stone, a drifted press; and how a drift is learnt."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

from sim.kiln import random_recipes
from sim.press import CeramicPress, KilnState, measure
from tilefab.cli.profile import app
from tilefab.colour.drift import drifted
from tilefab.colour.encoding import decode_lab16
from tilefab.colour.press_model import PressModel
from tilefab.colour.spaces import absolute_lab, delta_e_2000
from tilefab.config import load_job
from tilefab.errors import ConfigError, OutputError, ProfileError
from tilefab.io.cgats import read_measurements
from tilefab.io.cgats_write import measurements_text
from tilefab.io.drift_file import DriftFile, read_drift_file, write_drift_file
from tilefab.io.icc import read_icc_profile
from tilefab.io.press_model_file import load_press_model, save_press_model
from tilefab.pipeline import Plan, carried, plan_job, press_tables
from tilefab.pipeline.carried import carried_press
from tilefab.pipeline.drifting import DriftReport, learn_drift
from tilefab.pipeline.maps import JobMaps, convert_map, job_maps, proof_map, texture_map
from tilefab.pipeline.plan import MAPS_FOLDER
from tilefab.pipeline.profiling import ProfileSettings, build_profile
from tilefab.pipeline.progress import Silent
from tilefab.sampling import TextureMap

CHART = Path(__file__).parents[3] / "profiles" / "demo_ceramic.ti3"
PRESS = CeramicPress()
NAMES = ("Blue", "Brown", "Yellow", "Black")
HOT = KilnState(45.0)
JOB = """\
[slab]
scans = ["slab.tif"]
dpi = 60
square = false
lighting = false
[texture]
design = "tile"
patches = 20
active_per_cell = 9
[tile]
size_mm = [20, 24]
dpi = 60
[colour]
press_profile = "press.icc"
ink_limit_percent = 260
[output]
directory = "out"
[report]
pdf = false
"""


def write_chart(path: Path, recipes: np.ndarray, lab: np.ndarray, names: tuple[str, ...] = NAMES) -> Path:
    text = measurements_text(recipes, lab, ink_names=names, description="chart", created="2026-11-24")
    path.write_text(text)
    return path


@pytest.fixture(scope="module", autouse=True)
def _small_tables() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(press_tables, "FORWARD_GRIDS", {4: 7})
        patch.setattr(press_tables, "BACKWARD_GRID", 13)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A profile of part of the demo's chart, small charts of the press as it was and after a drift, and a scan."""
    made = tmp_path_factory.mktemp("press")
    whole = read_measurements(CHART)
    rows = sorted({*range(0, 800, 9), *np.flatnonzero(np.isin(whole.ink_frac.sum(axis=1), (0.0, 1.0)))})
    chart = write_chart(made / "chart.ti3", whole.ink_frac[rows], whole.lab_d50[rows])
    build_profile(chart, made / "press.icc", ProfileSettings(forward_grid=5, backward_grid=9))
    random = np.random.default_rng(3)
    recipes = random_recipes(4, 48, random, 2.8)
    recipes[0] = 0.0
    write_chart(made / "hot.ti3", recipes, measure(PRESS, recipes, random, kiln=HOT))
    write_chart(made / "few.ti3", recipes[:11], PRESS.lab(recipes[:11]))
    write_chart(made / "other.ti3", recipes, PRESS.lab(recipes), ("Cyan", "Brown", "Yellow", "Black"))
    write_chart(made / "three.ti3", recipes[:, :3], PRESS.lab(recipes), NAMES[:3])
    right = PRESS.lab(recipes)
    write_chart(made / "wild.ti3", recipes, right[::-1])
    write_chart(made / "odd.ti3", recipes, 0.85 * right + 0.15 * right[::-1])
    pixels = np.random.default_rng(1).integers(0, 256, (6, 8, 3)).repeat(5, axis=0).repeat(5, axis=1)
    tifffile.imwrite(made / "slab.tif", pixels.astype(np.uint8), photometric="rgb")
    return made


@pytest.fixture(scope="module")
def learnt(folder: Path) -> DriftReport:
    return learn_drift(folder / "press.icc", folder / "hot.ti3", folder / "hot.json")


@pytest.fixture(scope="module")
def model(folder: Path) -> PressModel:
    return carried_press(read_icc_profile(folder / "press.icc"))[0].model


def planned(folder: Path, more: str = "", *, intent: str = "perceptual", out: str = "out") -> Plan:
    path = folder / "job.toml"
    path.write_text(JOB.replace("[output]", f'intent = "{intent}"\n{more}\n[output]'))
    return plan_job(load_job(path), folder / out)


@pytest.fixture(scope="module")
def texture(folder: Path) -> TextureMap:
    return texture_map(planned(folder), Silent())


@pytest.fixture(scope="module")
def calm(texture: TextureMap) -> TextureMap:
    """The same as a dark grey stone, whose colours the press all has."""
    base = np.asarray(texture.base).astype(np.float64)
    base[..., 0] = 65535 * 0.38 + 0.12 * (base[..., 0] - 32768.0)
    base[..., 1:] = 32896 + 0.06 * (base[..., 1:] - 32896.0)
    return texture.with_base(base.astype(np.uint16), space=texture.space, channels=texture.channels)


def inks_of(folder: Path, texture: TextureMap, more: str, intent: str = "perceptual") -> np.ndarray:
    counts = convert_map(planned(folder, more, intent=intent), texture, Silent()).base
    return np.asarray(counts.reshape(-1, 4) / 255.0)


def lab_of(texture: TextureMap, model: PressModel) -> np.ndarray:
    """Absolute colours of the stone."""
    return absolute_lab(decode_lab16(texture.base).reshape(-1, 3).astype(np.float64), model.white_lab)


def test_a_drift_is_learnt_from_a_small_chart(folder: Path, learnt: DriftReport, model: PressModel) -> None:
    assert learnt.patches == learnt.patches_all == 48
    assert learnt.before_mean > 2.0
    assert learnt.after_mean < learnt.before_mean / 3.0
    assert learnt.known_mean is None
    assert not learnt.warnings
    # Brown fades most with heat, then yellow; see `sim.press.CeramicPress.fade_per_kelvin`.
    assert [change.name for change in learnt.changes[:2]] == ["Brown", "Yellow"]
    assert "weaker in full" in learnt.changes[0].words
    drift, _ = read_drift_file(folder / "hot.json")
    assert drift.ink_names == NAMES
    assert drift.profile_sha256 == read_icc_profile(folder / "press.icc").sha256
    fresh = random_recipes(4, 300, np.random.default_rng(8), 2.8)
    true = PRESS.lab(fresh, HOT)
    error = delta_e_2000(drifted(model, drift.state).lab(fresh), true).mean()
    assert error < delta_e_2000(model.lab(fresh), true).mean() / 3.0


def test_a_state_is_gone_on_from(folder: Path, learnt: DriftReport) -> None:
    report = learn_drift(
        folder / "press.icc", folder / "hot.ti3", folder / "more.json", from_path=folder / "hot.json", noise_lab=0.5
    )
    assert report.patches_all == 96
    assert report.known_mean == pytest.approx(learnt.after_mean)
    assert report.after_mean <= learnt.after_mean + 0.02


def test_what_no_drift_explains_is_said(folder: Path) -> None:
    report = learn_drift(folder / "press.icc", folder / "odd.ti3", folder / "odd.json")
    assert "profile anew" in report.warnings[0]


def test_hopeless_data_make_no_state(folder: Path) -> None:
    with pytest.raises(ProfileError, match="rows or ink columns are mixed up"):
        learn_drift(folder / "press.icc", folder / "wild.ti3", folder / "wild.json")
    assert not (folder / "wild.json").exists()


@pytest.mark.parametrize("taken", ["press.icc", "hot.ti3"])
def test_a_state_never_takes_the_place_of_what_it_is_learnt_from(folder: Path, taken: str) -> None:
    before = (folder / taken).read_bytes()
    with pytest.raises(OutputError, match="one of the files to read"):
        learn_drift(folder / "press.icc", folder / "hot.ti3", folder / taken)
    assert (folder / taken).read_bytes() == before


@pytest.mark.parametrize(
    ("chart", "message"),
    [("few", "11 patches, but a drift needs 12"), ("other", "Cyan, Brown"), ("three", "has 3 inks, but .* drives 4")],
)
def test_charts_of_others_are_refused(folder: Path, chart: str, message: str) -> None:
    with pytest.raises(ProfileError, match=message):
        learn_drift(folder / "press.icc", folder / f"{chart}.ti3", folder / "x.json")
    assert not (folder / "x.json").exists()


def test_the_command_reports_for_programs_and_people(folder: Path) -> None:
    arguments = ["drift", str(folder / "press.icc"), str(folder / "hot.ti3"), "-o", str(folder / "cli.json")]
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert report["after_mean"] < report["before_mean"] / 3.0
    assert (folder / "cli.json").is_file()
    result = CliRunner().invoke(app, [*arguments, "--from", str(folder / "cli.json")])
    assert result.exit_code == 0, result.output
    for words in ("press as profiled", "state before", "state now", "weaker in full"):
        assert words in result.stdout
    assert CliRunner().invoke(app, [*arguments, "--noise", "0"]).exit_code == 2


def test_a_plain_job_takes_the_profile_as_it_is(folder: Path) -> None:
    plain = planned(folder)
    said = planned(folder, 'separation = "profile"\ngamut = "any"')
    assert (said.press_key, said.job_hash) == (plain.press_key, plain.job_hash)
    assert not plain.job.colour.rebuilds_tables


def test_least_ink_uses_less_and_prices_shift_it(folder: Path, calm: TextureMap, model: PressModel) -> None:
    usual = inks_of(folder, calm, 'separation = "standard"', "relative")
    least = inks_of(folder, calm, 'separation = "least_ink"', "relative")
    prices = 'separation = "least_ink"\nink_prices = { brown = 30.0 }'
    dear = inks_of(folder, calm, prices, "relative")
    assert least.sum() < 0.95 * usual.sum()
    assert dear[:, 1].sum() < 0.98 * least[:, 1].sum()
    cost = np.array([1.0, 30.0, 1.0, 1.0])
    assert (dear @ cost).sum() < (least @ cost).sum()
    assert least.sum(axis=1).max() <= 2.6
    print_usual, print_least = model.lab(usual), model.lab(least)
    assert np.median(delta_e_2000(print_usual, print_least)) < 1.0


def test_room_for_this_stone_alone_keeps_more_of_it(folder: Path, calm: TextureMap, model: PressModel) -> None:
    wanted = lab_of(calm, model)
    anything = inks_of(folder, calm, 'separation = "standard"')
    fitted = inks_of(folder, calm, 'gamut = "image"')
    off = [float(delta_e_2000(model.lab(inks), wanted).mean()) for inks in (anything, fitted)]
    assert off[1] < off[0]
    with pytest.raises(ValueError, match="needs its texture map"):
        press_tables.job_press(planned(folder, 'gamut = "image"'), "perceptual")


def test_a_drift_remakes_the_press_map_alone(folder: Path, learnt: DriftReport, model: PressModel) -> None:
    plans = {
        "as profiled": planned(folder, 'separation = "standard"', intent="relative", out="drifting"),
        "drifted": planned(folder, 'drift = "hot.json"', intent="relative", out="drifting"),
    }
    assert len({plan.map_key for plan in plans.values()}) == 1
    assert len({plan.press_key for plan in plans.values()}) == 2
    maps: dict[str, JobMaps] = {}
    stamps = set()
    for name, plan in plans.items():
        maps[name] = job_maps(plan, Silent())
        stamps |= {one.stat().st_mtime_ns for one in (plan.output / MAPS_FOLDER).glob("*.texture.tfmap")}
    assert len(stamps) == 1
    assert len(list((folder / "drifting" / MAPS_FOLDER).glob("*.press.tfmap"))) == 2
    inks = {name: made.press.base.reshape(-1, 4) / 255.0 for name, made in maps.items()}
    cold = PRESS.lab(inks["as profiled"])
    stale = delta_e_2000(PRESS.lab(inks["as profiled"], HOT), cold).mean()
    mended = delta_e_2000(PRESS.lab(inks["drifted"], HOT), cold).mean()
    assert stale > 1.0
    assert mended < stale / 2.0
    # The proof shows what the drifted press fires to, not what the profile says.
    proof = proof_map(plans["drifted"], maps["drifted"].press).base.astype(float)
    before = proof_map(plans["as profiled"], maps["as profiled"].press).base.astype(float)
    unaware = proof_map(plans["as profiled"], maps["drifted"].press).base.astype(float)
    assert np.abs(proof - before).mean() < np.abs(unaware - before).mean() / 2.0


def test_a_changed_state_changes_the_key_and_an_equal_one_does_not(folder: Path, learnt: DriftReport) -> None:
    drift, _ = read_drift_file(folder / "hot.json")
    write_drift_file(folder / "same.json", drift)
    other = DriftFile(drift.state, drift.ink_names, drift.profile_sha256, drift.patches + 1, drift.note)
    write_drift_file(folder / "changed.json", other)
    keys = [planned(folder, f'drift = "{name}.json"').press_key for name in ("hot", "same", "changed")]
    assert keys[0] == keys[1] != keys[2]


def test_what_belongs_to_another_press_is_refused(folder: Path, learnt: DriftReport) -> None:
    drift, _ = read_drift_file(folder / "hot.json")
    write_drift_file(folder / "far.json", DriftFile(drift.state, drift.ink_names, "0" * 64, 48))
    with pytest.raises(ProfileError, match="from another profile than"):
        planned(folder, 'drift = "far.json"')
    write_drift_file(folder / "far.json", DriftFile(drift.state, NAMES[::-1], drift.profile_sha256, 48))
    with pytest.raises(ProfileError, match="in this order"):
        planned(folder, 'drift = "far.json"')
    with pytest.raises(ConfigError, match=r"colour\.drift: there is no file"):
        planned(folder, 'drift = "gone.json"')
    bare = (folder / "press.icc").read_bytes().replace(b"targ", b"tarx")
    (folder / "bare.icc").write_bytes(bare)
    (folder / "bare.toml").write_text(JOB.replace('"press.icc"', '"bare.icc"\nseparation = "standard"'))
    job = load_job(folder / "bare.toml")
    with pytest.raises(ProfileError, match="carries no measurements"):
        plan_job(job, folder / "out")


@pytest.mark.parametrize(
    ("more", "intent", "message"),
    [
        ("ink_prices = { Blue = 2 }", "perceptual", 'only for separation = "least_ink"'),
        ('separation = "least_ink"\nink_prices = { Red = 2 }', "perceptual", "there is no ink 'Red'"),
        ('separation = "least_ink"\nink_prices = { Blue = 0 }', "perceptual", "ink_prices: 0"),
        ('separation = "cheap"', "perceptual", "'cheap' is not allowed"),
        ('gamut = "image"', "relative", 'for intent = "perceptual" only'),
    ],
)
def test_settings_that_mean_nothing_are_refused(folder: Path, more: str, intent: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        planned(folder, more, intent=intent)


def test_a_kept_model_is_the_fitted_one_or_none(folder: Path, model: PressModel, tmp_path: Path) -> None:
    path = tmp_path / "kept.tfpress"
    save_press_model(path, model, "key", {"black": 3})
    found = load_press_model(path, "key")
    assert found is not None
    again, notes = found
    assert notes == {"black": 3}
    assert (again.max_total, again.errors.expected_mean) == (model.max_total, model.errors.expected_mean)
    recipes = random_recipes(4, 50, np.random.default_rng(1), 2.8)
    np.testing.assert_array_equal(again.lab(recipes), model.lab(recipes))
    assert load_press_model(path, "another") is None
    assert load_press_model(tmp_path / "none", "key") is None
    whole = path.read_bytes()
    for data in (b"", whole[:-200], whole.replace(b"PK", b"KP"), b"\x93NUMPY"):
        path.write_bytes(data)
        assert load_press_model(path, "key") is None


def test_a_damaged_kept_model_is_fitted_anew(
    folder: Path, model: PressModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    profile = read_icc_profile(folder / "press.icc")
    press, _ = carried_press(profile)
    fits: list[str] = []
    monkeypatch.setattr(carried, "fit_press", lambda _data, name: fits.append(name) or press)

    def again() -> PressModel:
        carried._carried_press.cache_clear()
        return carried_press(profile, tmp_path)[0].model

    again()
    assert len(fits) == 1
    np.testing.assert_array_equal(again().arrays.strengths, model.arrays.strengths)
    assert len(fits) == 1
    kept = next(tmp_path.iterdir())
    kept.write_bytes(b"no model")
    again()
    assert len(fits) == 2
    assert kept.stat().st_size > 1000
