"""A dead device is noticed, and used again once it is back; `benchmarks/line_reconnect.py` says how soon."""

from __future__ import annotations

import asyncio
import random

import pytest

from tests.unit.devices.reconnects import KINDS, Times


@pytest.mark.parametrize("kind", KINDS)
def test_a_dead_device_is_noticed_and_used_again_once_it_is_back(kind):
    times = Times()

    async def work() -> None:
        async with asyncio.timeout(30):
            await KINDS[kind](1, random.Random(kind), times)

    asyncio.run(work())
    assert (len(times.notice), len(times.recovery)) == (1, 1)
