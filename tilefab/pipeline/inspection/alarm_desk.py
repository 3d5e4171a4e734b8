"""The inspector's alarms: put down once each, told to the line's daemon, cleared when what they are about is over."""

from __future__ import annotations

from collections.abc import Callable

from tilefab.io.inspection_store import InspectionStore
from tilefab.pipeline.inspection.messages import Answer, Daemon, Messages

TOPIC = "warning"
_AGAIN_AFTER_S = 30.0


class AlarmDesk:
    """Raises and clears alarms.

    Parameters
    ----------
    store
        Where they are put down.
    daemon
        Who is told, so that an operator sees them with the line's own.
    messages
        How.
    log
        Told of each.
    """

    def __init__(self, store: InspectionStore, daemon: Daemon, messages: Messages, log: Callable[..., None]) -> None:
        self._store, self._daemon, self._messages, self._log = store, daemon, messages, log
        up = store.alarms(up=True)
        self._up = {(alarm.code, alarm.subject) for alarm in up}
        self._untold = {alarm.alarm_id: alarm for alarm in up if not alarm.told}
        self._not_before_s = float("-inf")

    def is_up(self, code: str, subject: str = "") -> bool:
        """Whether an alarm is up."""
        return (code, subject) in self._up

    def subjects(self, code: str) -> list[str]:
        """What alarms of a code are up about."""
        return sorted(subject for up, subject in self._up if up == code)

    def raise_alarm(self, code: str, text: str, *, subject: str = "", run_id: int | None = None) -> None:
        """Raise an alarm, unless one about the same is up."""
        if (code, subject) in self._up:
            return
        number = self._store.raise_alarm(code, text, subject=subject, run_id=run_id)
        self._up.add((code, subject))
        self._untold |= {alarm.alarm_id: alarm for alarm in self._store.alarms(up=True) if alarm.alarm_id == number}
        self._log("alarm", code=code, text=text, run=run_id)

    def clear(self, code: str, subject: str = "") -> None:
        """Say that what an alarm was about is over."""
        if (code, subject) not in self._up:
            return
        self._store.clear_alarm(code, subject=subject)
        self._up.discard((code, subject))
        # What is over before anybody heard of it isn't worth an operator's time.
        self._untold = {
            number: alarm for number, alarm in self._untold.items() if (alarm.code, alarm.subject) != (code, subject)
        }
        self._log("alarm cleared", code=code, about=subject)

    def tell(self, now_s: float) -> None:
        """Tell the daemon of the next alarm that it hasn't heard of; ``now_s`` is a clock that is never set."""
        if not self._untold or self._messages.busy(TOPIC) or now_s < self._not_before_s:
            return
        alarm, daemon = next(iter(self._untold.values())), self._daemon

        def warn() -> None:
            daemon.warn(alarm.code, alarm.text)

        self._messages.send(TOPIC, alarm.alarm_id, warn)

    def told(self, answer: Answer, now_s: float) -> None:
        """Take in what came of telling: if the daemon is away, it is told later."""
        if answer.error:
            self._not_before_s = now_s + _AGAIN_AFTER_S
            return
        self._untold.pop(answer.number, None)
        self._store.alarm_told(answer.number)
