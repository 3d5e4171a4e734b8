"""Messages go out beside the work, one of a topic at a time, and their answers come back."""

from __future__ import annotations

import threading

import pytest

from tilefab.errors import DeviceRefused
from tilefab.pipeline.inspection.messages import Answer, Messages


def test_answers_come_back_with_what_they_answer() -> None:
    messages = Messages()
    messages.send("correction", 7, lambda: 3)
    assert messages.answers(wait_s=10.0) == [Answer("correction", 7, 3)]
    assert messages.answers() == []
    assert not messages.busy("correction")


def test_refusals_and_defects_are_answers_too() -> None:
    messages = Messages()

    def refuse() -> int:
        raise DeviceRefused("too soon")

    def fail() -> int:
        raise KeyError("x")

    messages.send("correction", 1, refuse)
    assert messages.answers(wait_s=10.0) == [Answer("correction", 1, None, "too soon")]
    messages.send("correction", 2, fail)
    assert messages.answers(wait_s=10.0) == [Answer("correction", 2, None, "KeyError: 'x'")]


def test_topics_dont_wait_for_each_other_and_a_topic_has_one_message_at_a_time() -> None:
    messages, going_on = Messages(), threading.Event()

    def slow() -> None:
        going_on.wait(10.0)

    messages.send("correction", 1, slow)
    assert messages.busy("correction")
    with pytest.raises(ValueError, match="under way"):
        messages.send("correction", 2, slow)
    messages.send("warning", 5, lambda: None)
    assert messages.answers(wait_s=10.0) == [Answer("warning", 5, None)]
    assert messages.busy("correction")
    going_on.set()
    assert messages.answers(wait_s=10.0) == [Answer("correction", 1, None)]
