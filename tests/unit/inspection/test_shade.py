"""Shade lots: tiles of one lot match, order of arrival decides, noise doesn't make lots take turns."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilefab.colour import delta_e_2000
from tilefab.inspection.shade import ShadeSettings, ShadeState, assign_lot, lot_name

REFERENCE = (62.0, 3.0, 11.0)
small = st.tuples(*(st.floats(-3.0, 3.0),) * 3)


def lots_of(differences: Sequence[tuple[float, ...]], settings: ShadeSettings) -> tuple[ShadeState, list[str]]:
    state, names = ShadeState(), []
    for l_star, a_star, b_star in differences:
        state, name = assign_lot(state, (l_star, a_star, b_star), settings)
        names.append(name)
    return state, names


@given(st.lists(small, min_size=2, max_size=30), st.floats(0.4, 2.0))
def test_any_two_tiles_of_a_lot_match(differences: list[tuple[float, ...]], match: float) -> None:
    _, names = lots_of(differences, ShadeSettings(match, REFERENCE))
    colours = np.array(REFERENCE) + np.array(differences)
    for name in set(names):
        members = colours[[place for place, one in enumerate(names) if one == name]]
        # CIEDE2000 keeps the triangle inequality only nearly.
        assert delta_e_2000(members[:, np.newaxis], members[np.newaxis]).max() <= 1.05 * match


@given(st.lists(small, min_size=1, max_size=30))
def test_state_survives_a_restart(differences: list[tuple[float, ...]]) -> None:
    settings, state, names = ShadeSettings(1.0, REFERENCE), ShadeState(), []
    for l_star, a_star, b_star in differences:
        state, name = assign_lot(state, (l_star, a_star, b_star), settings)
        state = ShadeState.from_plain(json.loads(json.dumps(state.plain())))
        names.append(name)
    whole, together = lots_of(differences, settings)
    assert names == together
    assert state == whole


@given(st.lists(small, min_size=1, max_size=30))
def test_lots_are_counted(differences: list[tuple[float, ...]]) -> None:
    state, names = lots_of(differences, ShadeSettings(1.0, REFERENCE))
    assert sum(lot.tiles for lot in state.lots) == len(differences)
    for lot in state.lots:
        members = np.array([diff for diff, name in zip(differences, names, strict=True) if name == lot.name])
        assert lot.tiles == len(members)
        np.testing.assert_allclose(lot.mean_lab, members.mean(axis=0), atol=1e-9)
        away = delta_e_2000(np.array(REFERENCE) + lot.middle_lab, np.array(REFERENCE) + members)
        assert lot.spread_delta_e == pytest.approx(float(away.max()), abs=1e-9)
        assert lot.spread_delta_e <= 0.5
    assert [lot.name for lot in state.lots] == [lot_name(place) for place in range(len(state.lots))]


def test_one_lot_while_nothing_drifts() -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.08, (2000, 3))
    state, _ = lots_of([tuple(row) for row in noise], ShadeSettings(1.0, REFERENCE))
    assert state.lots[0].tiles > 1980


def test_noise_near_a_border_does_not_make_lots_take_turns() -> None:
    # The drift stops just where lot A ends.
    generator = np.random.default_rng(7)
    steps = np.linspace(0.0, 2.0, 401)
    away = delta_e_2000(REFERENCE, np.array(REFERENCE) + steps[:, np.newaxis] * [0.0, 0.0, 1.0])
    border = float(np.interp(0.5, away, steps))
    drift = np.concatenate([np.linspace(0.0, border, 300), np.full(1000, border)])
    noise = generator.normal(0.0, 0.02, drift.size)
    noise[0] = 0.0
    _, names = lots_of([(0.0, 0.0, value) for value in drift + noise], ShadeSettings(1.0, REFERENCE))
    changes = sum(one != other for one, other in itertools.pairwise(names))
    assert set(names) == {"A", "B"}
    assert changes == 1


def test_a_slow_drift_opens_lots_one_after_another() -> None:
    drift = [(0.0, 0.0, 0.01 * place) for place in range(600)]
    _, names = lots_of(drift, ShadeSettings(1.0, REFERENCE))
    assert "".join(dict.fromkeys(names)) == "ABCDEFGHIJKLMNOPQRSTUVWXYZ"[: len(set(names))]
    assert sorted(names) == names


def test_what_comes_back_goes_to_its_old_lot() -> None:
    settings = ShadeSettings(1.0, REFERENCE)
    _, names = lots_of([(0, 0, 0), (4, 0, 0), (0.1, 0, 0), (4.1, 0, 0), (-4, 0, 0)], settings)
    assert names == ["A", "B", "A", "B", "C"]


def test_strong_colours_stand_more() -> None:
    step = [(0.0, 0.0, 0.0), (0.0, 0.0, 1.2)]
    assert lots_of(step, ShadeSettings(1.0, (60.0, 0.0, 0.0)))[1] == ["A", "B"]
    assert lots_of(step, ShadeSettings(1.0, (60.0, 0.0, 60.0)))[1] == ["A", "A"]


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_tile_that_was_not_measured_has_no_lot(bad: float) -> None:
    with pytest.raises(ValueError, match="has no lot"):
        assign_lot(ShadeState(), (0.0, bad, 0.0), ShadeSettings())


def test_settings_are_checked() -> None:
    for match in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="above 0"):
            ShadeSettings(match)
    with pytest.raises(ValueError, match="finite"):
        ShadeSettings(1.0, (math.nan, 0.0, 0.0))
    with pytest.raises(ValueError, match="counted from 0"):
        lot_name(-1)
