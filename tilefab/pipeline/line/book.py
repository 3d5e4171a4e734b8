"""What the running line knows of its faces: which come next, which are under way, and what becomes of each."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

from tilefab.control.ledger import ArmState, FaceQueue
from tilefab.io.journal import Intent

INTENTS_AHEAD = 12
"""Faces put down in the journal before any tile asks for one: arming must never wait for a disk."""


@dataclass(frozen=True)
class ActiveArm:
    """An arm that the printer was told of and whose tile isn't decided.

    Attributes
    ----------
    intent
        Face and arm, as the journal has them.
    detect_seq, tile_seq
        Its tile, as the printer and the conveyor number it; ``tile_seq`` is ``None`` where it can't be known any more.
    state
        As the journal will have it as soon as its thread is through.
    recorded
        Whether the journal has it as printed, so that its tile may be released.
    asked_release
        Whether the conveyor was asked to let its tile pass, or may have been by an earlier daemon.
    released
        Whether the conveyor acknowledged that.
    """

    intent: Intent
    detect_seq: int
    tile_seq: int | None
    state: ArmState
    recorded: bool = False
    asked_release: bool = False
    released: bool = False


class FaceBook:
    """Faces of one run.

    Parameters
    ----------
    run_id
        In the journal.
    queue
        Which faces come next.
    """

    def __init__(self, run_id: int, queue: FaceQueue) -> None:
        self.run_id, self.queue = run_id, queue
        self.pool: deque[Intent] = deque()
        self.coming = 0
        """Faces that are being put down: taken from the queue, and not yet in the pool."""
        self.active: dict[int, ActiveArm] = {}

    def update(self, arm_id: int, **changes: object) -> ActiveArm:
        """Change what is known of an active arm."""
        self.active[arm_id] = replace(self.active[arm_id], **changes)  # type: ignore[arg-type]
        return self.active[arm_id]

    def close(self, arm_id: int, state: ArmState) -> None:
        """Let go of an arm that the journal has as decided; its face comes again if it wasn't printed."""
        intent = self.active.pop(arm_id).intent
        if intent.run_id == self.run_id:
            self.queue.give_back(intent.face, intent.attempt, state)

    def in_state(self, *states: ArmState) -> list[ActiveArm]:
        """Active arms in certain states, by arm."""
        return [arm for _, arm in sorted(self.active.items()) if arm.state in states]

    @property
    def armed(self) -> list[ActiveArm]:
        """Arms that the printer has yet to finish."""
        return self.in_state(ArmState.INTENT, ArmState.ARMED)

    @property
    def faces_to_go(self) -> int:
        """Faces that still want a tile."""
        return len(self.pool) + self.coming + self.queue.remaining

    @property
    def done(self) -> bool:
        """Whether no face wants a tile and none is under way."""
        return self.faces_to_go == 0 and not self.active
