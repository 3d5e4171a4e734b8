from __future__ import annotations

from tilefab.control.ledger import ArmState, FaceQueue, FaceStates
from tilefab.io.journal import Intent
from tilefab.pipeline.line.book import ActiveArm, FaceBook


def book(faces: int = 3) -> FaceBook:
    return FaceBook(7, FaceQueue(FaceStates(faces=faces)))


def arm(arm_id: int, face: int, state: ArmState = ArmState.ARMED, *, run_id: int = 7, attempt: int = 1) -> ActiveArm:
    return ActiveArm(Intent(arm_id, run_id, face, attempt), arm_id, arm_id, state)


def test_a_face_without_a_print_comes_again() -> None:
    run = book()
    assert run.queue.take(3) == [(0, 1), (1, 1), (2, 1)]
    run.active[5] = arm(5, 1)
    run.close(5, ArmState.UNPRINTED)
    assert not run.active
    assert run.queue.take(3) == [(1, 2)]


def test_a_face_that_may_have_been_printed_does_not_come_again() -> None:
    run = book()
    run.queue.take(3)
    for arm_id, state in enumerate((ArmState.PASSED, ArmState.DIVERTED, ArmState.PARTIAL, ArmState.IN_DOUBT)):
        run.active[arm_id] = arm(arm_id, 0)
        run.close(arm_id, state)
    assert run.queue.remaining == 0
    assert run.done


def test_a_face_of_another_run_comes_again_in_that_run_only() -> None:
    run = book()
    run.active[5] = arm(5, 99, run_id=6)
    run.close(5, ArmState.UNPRINTED)
    assert run.queue.remaining == 3


def test_faces_that_are_being_put_down_are_to_go_still() -> None:
    run = book()
    run.coming = len(run.queue.take(3))
    assert run.faces_to_go == 3
    assert not run.done
    run.coming = 0
    assert run.done


def test_a_run_is_not_done_while_a_tile_is_under_way() -> None:
    run = book()
    run.queue.take(3)
    run.active[5] = arm(5, 1, ArmState.PRINTED)
    assert run.faces_to_go == 0
    assert not run.done


def test_arms_are_told_by_state_and_in_order() -> None:
    run = book()
    for arm_id, state in ((9, ArmState.ARMED), (4, ArmState.INTENT), (6, ArmState.PRINTED), (5, ArmState.ARMED)):
        run.active[arm_id] = arm(arm_id, arm_id, state)
    assert [one.intent.arm_id for one in run.armed] == [4, 5, 9]
    assert [one.intent.arm_id for one in run.in_state(ArmState.PRINTED)] == [6]


def test_what_is_known_of_an_arm_is_changed_in_place() -> None:
    run = book()
    run.active[5] = arm(5, 1)
    assert run.update(5, state=ArmState.PRINTED, recorded=True).recorded
    assert run.active[5].state is ArmState.PRINTED
