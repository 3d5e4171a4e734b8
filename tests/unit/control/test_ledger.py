"""States of an arm, and which faces come next."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilefab.control.ledger import (
    FINAL,
    MOST_FACES,
    OPEN,
    TRANSITIONS,
    UNSETTLED,
    ArmState,
    FaceQueue,
    FaceStates,
    check_transition,
)

WAYS = {
    ("intent", "armed"),
    ("intent", "unprinted"),
    ("intent", "in_doubt"),
    ("intent", "printed"),
    ("intent", "partial"),
    ("armed", "printed"),
    ("armed", "partial"),
    ("armed", "unprinted"),
    ("armed", "in_doubt"),
    ("printed", "passed"),
    ("printed", "diverted"),
    ("printed", "in_doubt"),
}
SETTLED = {("in_doubt", "passed"), ("in_doubt", "diverted"), ("in_doubt", "unprinted")}


@pytest.mark.parametrize(("old", "new"), list(itertools.product(ArmState, ArmState)))
def test_only_the_known_ways_are_open(old: ArmState, new: ArmState) -> None:
    for by_operator, ways in ((False, WAYS), (True, SETTLED)):
        if (old, new) in ways:
            check_transition(old, new, by_operator=by_operator)
        else:
            with pytest.raises(ValueError, match=old):
                check_transition(old, new, by_operator=by_operator)


def test_every_state_is_final_or_left_by_someone() -> None:
    assert set(ArmState) == FINAL | UNSETTLED
    assert not FINAL & UNSETTLED
    assert set(TRANSITIONS) == UNSETTLED
    assert UNSETTLED.difference(OPEN) == {ArmState.IN_DOUBT}


def test_what_may_have_been_printed_never_leads_back() -> None:
    for state in (ArmState.PRINTED, ArmState.PASSED, ArmState.DIVERTED, ArmState.PARTIAL):
        assert ArmState.UNPRINTED not in TRANSITIONS.get(state, frozenset())


def test_faces_come_again_first_then_reprints_then_gaps_then_new_ones() -> None:
    states = FaceStates(
        faces=12, next_new=10, gaps=((3, 5),), unprinted=((7, 2), (1, 1)), reprints=((9, 1), (0, 3)), unsettled=()
    )
    queue = FaceQueue(states)
    assert queue.remaining == 8
    assert queue.take(20) == [(1, 2), (7, 3), (9, 2), (0, 4), (3, 1), (4, 1), (10, 1), (11, 1)]
    assert queue.remaining == 0
    assert queue.take() == []


def test_a_run_of_the_most_faces_is_held_without_listing_them() -> None:
    queue = FaceQueue(FaceStates(faces=MOST_FACES, next_new=5, gaps=((1, 3),)))
    assert queue.remaining == MOST_FACES - 3
    assert queue.take(4) == [(1, 1), (2, 1), (5, 1), (6, 1)]
    end = FaceQueue(FaceStates(faces=MOST_FACES, next_new=MOST_FACES - 1))
    assert end.take(3) == [(MOST_FACES - 1, 1)]


@pytest.mark.parametrize("state", sorted(set(ArmState) - {ArmState.UNPRINTED}))
def test_a_face_given_back_comes_again_only_if_nothing_was_printed(state: ArmState) -> None:
    queue = FaceQueue(FaceStates(faces=2))
    assert queue.take(2) == [(0, 1), (1, 1)]
    queue.give_back(0, 1, state)
    assert queue.take() == []
    queue.give_back(1, 1, ArmState.UNPRINTED)
    queue.give_back(1, 1, ArmState.UNPRINTED)
    assert queue.take(5) == [(1, 2)]


def test_a_reprint_comes_once_however_often_it_is_told() -> None:
    queue = FaceQueue(FaceStates(faces=1, next_new=1, reprints=((0, 1),)))
    queue.reprint(0, 2)
    assert queue.take(5) == [(0, 2)]
    queue.reprint(0, 3)
    assert queue.take(5) == [(0, 3)]


@pytest.mark.parametrize(("face", "attempt"), [(-1, 1), (2, 1), (0, 0)])
def test_faces_of_no_run_are_refused(face: int, attempt: int) -> None:
    queue = FaceQueue(FaceStates(faces=2))
    with pytest.raises(ValueError, match="isn't one"):
        queue.give_back(face, attempt, ArmState.UNPRINTED)
    with pytest.raises(ValueError, match="isn't one"):
        queue.reprint(face, attempt)


@pytest.mark.parametrize(("faces", "next_new"), [(0, 0), (MOST_FACES + 1, 0), (5, 6), (5, -1)])
def test_runs_that_cannot_be_are_refused(faces: int, next_new: int) -> None:
    with pytest.raises(ValueError, match="can't go on"):
        FaceQueue(FaceStates(faces=faces, next_new=next_new))


@given(st.integers(1, 30), st.data())
def test_every_face_is_printed_once_whatever_fails_to_print(faces: int, data: st.DataObject) -> None:
    queue = FaceQueue(FaceStates(faces=faces))
    attempts = dict.fromkeys(range(faces), 0)
    printed: list[int] = []
    failures = data.draw(st.integers(0, 40))
    while taken := queue.take(data.draw(st.integers(1, 5))):
        for face, attempt in taken:
            attempts[face] += 1
            assert attempt == attempts[face]
            fails = failures > 0 and data.draw(st.booleans())
            failures -= fails
            printed += [] if fails else [face]
            queue.give_back(face, attempt, ArmState.UNPRINTED if fails else ArmState.PASSED)
        assert queue.remaining == faces - len(printed)
    assert sorted(printed) == list(range(faces))
