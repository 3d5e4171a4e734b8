"""Messages to the line's daemon, sent beside the inspector's work: an answer may take as long as a map is made."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from tilefab.errors import TilefabError


class Daemon(Protocol):
    """The daemon of a line, as its inspector needs it. Called from threads of their own."""

    def correct(self, run_id: int, drift: Mapping[str, Any], reason: str) -> int:
        """Have further faces of a run printed for a state of the press; number of the correction.

        Raises
        ------
        TilefabError
            If the daemon refuses, or there is none.
        """

    def warn(self, code: str, text: str) -> None:
        """Raise an alarm that doesn't stop the line.

        Raises
        ------
        TilefabError
            If there is no daemon.
        """


@dataclass(frozen=True)
class Answer:
    """What became of a message.

    Attributes
    ----------
    topic, number
        As it was sent with.
    result
        What the daemon answered; ``None`` if it refused.
    error
        Why it refused, or didn't answer; empty if it did as asked.
    """

    topic: str
    number: int
    result: int | None
    error: str = ""


class Messages:
    """Sends one message of each topic at a time."""

    def __init__(self) -> None:
        self._answers: queue.SimpleQueue[Answer] = queue.SimpleQueue()
        self._under_way: set[str] = set()

    def busy(self, topic: str) -> bool:
        """Whether a message of a topic is under way."""
        return topic in self._under_way

    def send(self, topic: str, number: int, work: Callable[[], int | None]) -> None:
        """Have a message sent.

        Parameters
        ----------
        topic
            Of which none is under way.
        number
            Comes back with the answer.
        work
            Sends it; what it returns or raises is the answer.
        """
        if topic in self._under_way:
            raise ValueError(f"a message about {topic} is under way already")
        self._under_way.add(topic)
        # A daemon thread: whoever ends the inspector need not wait for the line.
        name = f"tilefab-{topic}"
        threading.Thread(target=self._run, args=(topic, number, work), name=name, daemon=True).start()

    def answers(self, *, wait_s: float = 0.0) -> list[Answer]:
        """Answers that came; waits for the first of them if none did."""
        found: list[Answer] = []
        while True:
            try:
                answer = self._answers.get(block=wait_s > 0.0 and not found, timeout=wait_s or None)
            except queue.Empty:
                return found
            self._under_way.discard(answer.topic)
            found.append(answer)

    def _run(self, topic: str, number: int, work: Callable[[], int | None]) -> None:
        try:
            answer = Answer(topic, number, work())
        except TilefabError as error:
            answer = Answer(topic, number, None, error.message)
        except Exception as error:  # whatever happened, the inspector must not wait for ever
            answer = Answer(topic, number, None, f"{type(error).__name__}: {error}")
        self._answers.put(answer)
