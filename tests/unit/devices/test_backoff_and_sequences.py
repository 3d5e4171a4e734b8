"""Pauses between attempts, numbers that don't come twice, and how long a device has stood still."""

from __future__ import annotations

import pytest

from tilefab.devices import Backoff
from tilefab.devices.sequences import Memory, memory_of


def test_pauses_double_to_the_longest_and_begin_anew():
    backoff = Backoff(0.05, 0.5)
    assert [backoff.next_s() for _ in range(6)] == [0.05, 0.1, 0.2, 0.4, 0.5, 0.5]
    backoff.reset()
    assert backoff.next_s() == 0.05


@pytest.mark.parametrize(("first", "most"), [(0, 1), (-1, 1), (2, 1)])
def test_pauses_that_make_no_sense_are_refused(first, most):
    with pytest.raises(ValueError, match="first pause"):
        Backoff(first, most)


def test_a_number_comes_once_in_65535_and_never_is_0():
    memory = Memory(sequence=65000)
    numbers = [memory.next_sequence() for _ in range(65535)]
    assert sorted(numbers) == list(range(1, 65536))
    assert memory.next_sequence() == numbers[0]


def test_numbers_begin_anywhere():
    assert len({Memory().sequence for _ in range(8)}) > 1


def test_an_endpoint_is_remembered_as_long_as_the_process_lives():
    assert memory_of("tcp://127.0.0.1:1") is memory_of("tcp://127.0.0.1:1")
    assert memory_of("tcp://127.0.0.1:1") is not memory_of("tcp://127.0.0.1:2")


def test_a_counter_that_moves_isnt_still():
    memory = Memory()
    assert memory.still_for_s(5, 10, now=100.0) == 0
    assert memory.still_for_s(5, 10, now=100.25) == 0.25
    assert memory.still_for_s(5, 11, now=100.5) == 0
    assert memory.still_for_s(5, 11, now=101.5) == 1
    assert memory.still_for_s(6, 11, now=101.5) == 0, "another start of the device"
