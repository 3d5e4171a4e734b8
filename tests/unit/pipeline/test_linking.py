"""Device links: the same colours from less ink, limits kept, prices heeded, any maker's profile taken."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tilefab.colour.spaces import delta_e_2000
from tilefab.errors import ProfileError
from tilefab.io.icc import IccProfile, parse_icc_profile, read_icc_profile
from tilefab.io.icc_tables import device_to_pcs, link_table, pcs_to_device
from tilefab.pipeline import linking
from tilefab.pipeline.linking import LinkReport, LinkSettings, limit_of, make_link

SHIPPED = Path(__file__).parents[3] / "profiles" / "demo_ceramic.icc"


@pytest.fixture(scope="module")
def press() -> IccProfile:
    return read_icc_profile(SHIPPED)


@pytest.fixture(scope="module")
def quick(press: IccProfile) -> Iterator[pytest.MonkeyPatch]:
    """Small tables and one fit, for all tests of this module."""
    patch = pytest.MonkeyPatch()
    fitted = linking.press_of(press)
    patch.setattr(linking, "press_of", lambda _profile: fitted)
    patch.setattr(linking, "FORWARD_GRIDS", {4: 7})
    patch.setattr(linking, "_TRIED_COLOURS", 200)
    patch.setattr(linking, "_JUDGED_COLOURS", 800)
    patch.setattr("tilefab.colour.link._COLOUR_NODES", 17)
    patch.setattr("tilefab.colour.link._PLACES", 8_000)
    yield patch
    patch.undo()


@pytest.fixture(scope="module")
def saving(press: IccProfile, quick: pytest.MonkeyPatch) -> tuple[bytes, LinkReport]:
    return make_link(press, press, LinkSettings(tolerance_delta_e=0.0))


@pytest.fixture(scope="module")
def printed(press: IccProfile) -> np.ndarray:
    """Inks that the profile makes of stone-like colours."""
    draw = np.random.default_rng(4)
    lab = np.column_stack([draw.uniform(35, 90, 2000), draw.uniform(-4, 10, 2000), draw.uniform(-6, 22, 2000)])
    return np.asarray(pcs_to_device(press, "relative")(lab))


def colours(press: IccProfile, inks: np.ndarray) -> np.ndarray:
    return np.asarray(device_to_pcs(press, "relative")(inks))


def test_prints_the_same_colours_with_less_ink(
    press: IccProfile, saving: tuple[bytes, LinkReport], printed: np.ndarray
) -> None:
    table = link_table(parse_icc_profile(saving[0], "link"))
    out = table(printed)
    apart = delta_e_2000(colours(press, out), colours(press, printed))
    assert float(apart.mean()) < 0.5
    assert out.sum() < 0.95 * printed.sum()
    assert table(np.zeros((1, 4))).sum() == 0.0


def test_the_report_says_what_the_link_does(saving: tuple[bytes, LinkReport]) -> None:
    report = saving[1]
    assert report.ink_out_percent < report.ink_in_percent
    assert report.saved_percent == pytest.approx(100 * (1 - report.ink_out_percent / report.ink_in_percent))
    assert report.cost_saved_percent == pytest.approx(report.saved_percent)
    assert report.ink_names_in == report.ink_names_out == ("Blue", "Brown", "Yellow", "Black")
    assert report.size_bytes == len(saving[0])


def test_the_limit_is_kept_between_nodes(press: IccProfile, saving: tuple[bytes, LinkReport]) -> None:
    table = link_table(parse_icc_profile(saving[0], "link"))
    anything = np.random.default_rng(1).random((5000, 4))
    assert float(table(anything).sum(axis=1).max()) <= limit_of(press) / 100.0 + 1e-4


def test_a_limit_that_is_asked_for_holds_in_8_bits(press: IccProfile, quick: pytest.MonkeyPatch) -> None:
    data, _ = make_link(press, press, LinkSettings(ink_limit_percent=200.0, tolerance_delta_e=0.0))
    out = link_table(parse_icc_profile(data, "link"))(np.random.default_rng(2).random((5000, 4)))
    assert int(np.rint(255 * out).sum(axis=1).max()) <= 510


def test_a_tolerance_saves_more_and_is_kept(
    press: IccProfile, quick: pytest.MonkeyPatch, saving: tuple[bytes, LinkReport]
) -> None:
    _, looser = make_link(press, press, LinkSettings(tolerance_delta_e=0.6))
    assert looser.saved_percent > saving[1].saved_percent
    assert looser.delta_e_mean < 0.8


def test_a_dear_ink_is_used_less(
    press: IccProfile, quick: pytest.MonkeyPatch, saving: tuple[bytes, LinkReport], printed: np.ndarray
) -> None:
    data, _ = make_link(press, press, LinkSettings(tolerance_delta_e=0.0, ink_prices={"black": 8.0}))
    dear = link_table(parse_icc_profile(data, "link"))(printed)
    even = link_table(parse_icc_profile(saving[0], "link"))(printed)
    assert dear[:, 3].sum() < 0.9 * even[:, 3].sum()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (LinkSettings(tolerance_delta_e=-1.0), "tolerance"),
        (LinkSettings(ink_limit_percent=900.0), "ink limit"),
        (LinkSettings(ink_prices={"Gold": 2.0}), "Gold"),
        (LinkSettings(ink_prices={"Blue": 0.0}), "Blue"),
    ],
)
def test_senseless_settings_are_refused(
    press: IccProfile, quick: pytest.MonkeyPatch, settings: LinkSettings, said: str
) -> None:
    with pytest.raises(ProfileError, match=said):
        make_link(press, press, settings)
