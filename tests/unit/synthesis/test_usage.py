"""The use of an exemplar, counted as the equations count it, and dearer wherever it is uneven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from tilefab.synthesis.patch_kernels import PATCH_PX
from tilefab.synthesis.usage import CROWDED, NO_SHIFTS, PATCH_UNIT, Usage, UsageOptions, window_counts, window_means_of

SHAPE = (26, 31)
STEADY = UsageOptions(gain=0.0)


def allowed_places() -> NDArray[np.bool_]:
    """Where patches fit that don't touch a hole."""
    valid = np.ones(SHAPE, dtype=bool)
    valid[12, 20:23] = False
    allowed = np.zeros(SHAPE, dtype=bool)
    for row, col in np.ndindex(SHAPE[0] - PATCH_PX + 1, SHAPE[1] - PATCH_PX + 1):
        allowed[row, col] = valid[row : row + PATCH_PX, col : col + PATCH_PX].all()
    return allowed


def random_field(seed: int, size: tuple[int, int] = (18, 15)) -> NDArray[np.int32]:
    places = np.flatnonzero(allowed_places())
    # Some are shown more often than others.
    chosen = np.random.default_rng(seed).geometric(0.02, size) % len(places)
    return np.random.default_rng(9).permutation(places)[chosen].astype(np.int32)


def occurrence_plain(field: NDArray[np.int32]) -> NDArray[np.int64]:
    """Eq. 3, patch by patch."""
    shown = np.zeros(SHAPE, dtype=np.int64)
    for place in field.ravel():
        row, col = divmod(int(place), SHAPE[1])
        shown[row : row + PATCH_PX, col : col + PATCH_PX] += 1
    return shown


def shown_by_patches(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Eq. 6's sums, patch by patch; beyond the edge there is nothing."""
    sums = np.zeros(SHAPE, dtype=np.int64)
    for row, col in np.ndindex(SHAPE):
        sums[row, col] = values[row : row + PATCH_PX, col : col + PATCH_PX].sum()
    return sums


@pytest.mark.parametrize("seed", [1, 2])
def test_occurrence_is_counted_patch_by_patch(seed: int) -> None:
    field = random_field(seed)
    occurrence = Usage(allowed_places(), STEADY).occurrence(field)
    assert_array_equal(occurrence, occurrence_plain(field))
    assert occurrence.sum() == field.size * PATCH_PX**2
    assert not occurrence[12, 20:23].any()


def test_windows_are_summed_on_both_sides() -> None:
    values = np.random.default_rng(3).integers(0, 50, SHAPE)
    assert_array_equal(window_means_of(values), shown_by_patches(values))
    # A patch covers its own pixel, and none above or left of it: one is the other turned round.
    assert_array_equal(window_counts(values), window_means_of(values[::-1, ::-1])[::-1, ::-1])


def test_prices_are_those_of_the_equations() -> None:
    field, allowed = random_field(4), allowed_places()
    prices = Usage(allowed, STEADY).prices(field, raise_prices=True)
    crowd = shown_by_patches(occurrence_plain(field))
    usable = np.count_nonzero(occurrence_plain(np.flatnonzero(allowed).astype(np.int32)))
    assert usable == SHAPE[0] * SHAPE[1] - np.count_nonzero(occurrence_plain(np.flatnonzero(allowed)) == 0)
    fair = field.size * PATCH_PX**2 / usable
    share = crowd / (fair * PATCH_PX**2)
    expected = STEADY.price * share + STEADY.barrier * np.maximum(share - STEADY.barrier_share, 0.0)
    assert (share > STEADY.barrier_share).any()
    expected -= expected[allowed].min()
    assert_allclose(prices.price.reshape(SHAPE), expected * PATCH_UNIT, atol=0.51)
    assert_array_equal(prices.crowd.reshape(SHAPE), crowd)
    assert prices.most == int(CROWDED * fair * PATCH_PX**2)
    assert prices.price.dtype == prices.crowd.dtype == np.int64


def test_nobody_is_paid_and_somebody_is_free() -> None:
    usage, allowed = Usage(allowed_places(), UsageOptions()), allowed_places().ravel()
    for turn in range(6):
        price = usage.prices(random_field(turn), raise_prices=True).price
        assert price[allowed].min() == 0


def test_prices_of_what_is_overused_rise_with_the_iterations() -> None:
    allowed = allowed_places()
    usage = Usage(allowed, UsageOptions())
    places = np.flatnonzero(allowed)
    favourite, forgotten = int(places[0]), int(places[-1])
    field = np.full((18, 15), favourite, dtype=np.int32)
    asked = []
    for _ in range(4):
        price = usage.prices(field, raise_prices=True).price
        assert_array_equal(usage.prices(field, raise_prices=False).price, price)
        asked.append(int(price[favourite] - price[forgotten]))
    assert asked[0] > 0
    assert np.all(np.diff(asked) > 0)
    # Once it's shown no more, it stays dearer for a while, and gets cheaper.
    elsewhere = np.full((18, 15), places[len(places) // 2], dtype=np.int32)
    later = [usage.prices(elsewhere, raise_prices=True).price for _ in range(3)]
    assert later[0][favourite] > later[0][forgotten]
    # A controller with a limit: no price grows without end.
    for _ in range(200):
        price = usage.prices(field, raise_prices=True).price
    # What adds up has one, beside what is in proportion to the use now.
    steady = Usage(allowed, UsageOptions(gain=0.0)).prices(field, raise_prices=True).price
    assert price[favourite] - steady[favourite] < 500 * PATCH_UNIT


def test_without_gain_nothing_is_remembered() -> None:
    usage = Usage(allowed_places(), STEADY)
    first = usage.prices(random_field(1), raise_prices=True).price
    usage.prices(random_field(2), raise_prices=True)
    assert_array_equal(usage.prices(random_field(1), raise_prices=True).price, first)


def test_an_even_use_costs_the_same_everywhere() -> None:
    allowed = np.zeros((60, 60), dtype=bool)
    allowed[:51, :51] = True
    places = np.flatnonzero(allowed).astype(np.int32).reshape(51, 51)
    price = Usage(allowed, UsageOptions()).prices(places, raise_prices=True).price.reshape(60, 60)
    inside = price[9:42, 9:42]
    assert inside.max() == inside.min() > 0
    # Less is shown of what lies at the edge: it's cheaper.
    assert price[0, 0] == 0
    assert price[0, 20] < price[20, 20]


def test_a_field_that_repeats_itself_is_dear_at_that_shift() -> None:
    random = np.random.default_rng(5)
    rows, cols, period = 20, 24, 8
    places = random.choice(np.flatnonzero(allowed_places()), (rows, period), replace=False)
    field = np.tile(places, (1, cols // period)).astype(np.int32)
    options = UsageOptions()
    shifts = Usage(allowed_places(), options).shifts(field)
    assert shifts.price.shape == (rows, 2 * cols + 1)
    for right in (period, 2 * period):
        # All of what overlaps shows the same again.
        assert shifts.price[0, cols + right] >= 0.9 * PATCH_UNIT * options.again
        # A pixel beside it is as dear: it looks alike.
        beside = [shifts.price[0, cols + right + 1], shifts.price[1, cols + right]]
        assert_allclose(beside, shifts.price[0, cols + right], rtol=0.2)
    priced = np.argwhere(shifts.price > 0) - [0, cols]
    assert len(priced) > 0
    assert (priced[:, 0] <= 1).all()
    assert np.isin(np.abs(priced[:, 1]), [7, 8, 9, 15, 16, 17]).all()
    for place in (int(places[0, 0]), int(places[7, 3])):
        shown = shifts.order[shifts.starts[place] : shifts.starts[place + 1]]
        assert_array_equal(shown, np.flatnonzero(field.ravel() == place))
    assert shifts.starts[-1] == len(shifts.order) == field.size


def test_chance_and_small_shifts_cost_nothing() -> None:
    random = np.random.default_rng(6)
    usage = Usage(allowed_places(), UsageOptions())
    places = np.flatnonzero(allowed_places())
    assert not usage.shifts(random.permutation(places)[:200].reshape(10, 20).astype(np.int32)).price.any()
    # Each place twice, side by side: neighbours that look alike are no repetition.
    pairs = np.repeat(random.permutation(places)[:200].reshape(20, 10), 2, axis=1).astype(np.int32)
    assert not usage.shifts(pairs).price.any()
    assert Usage(allowed_places(), replace(UsageOptions(), chance=-1.0)).shifts(pairs).price.any()


def test_no_shifts_price_nothing() -> None:
    assert len(NO_SHIFTS.order) == 0
    assert not NO_SHIFTS.price.any()
