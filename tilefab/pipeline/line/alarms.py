"""Every alarm that a line can raise: what it means and what an operator does about it.

The table in ``docs/line_operator.md`` is made from this: ``python -m tilefab.pipeline.line.alarms docs/line_operator.md``.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from tilefab.control.line_machine import Alarm
from tilefab.io.atomic import atomic_write_bytes
from tilefab.pipeline.line.status import AlarmView

_BEGIN = "<!-- alarms: made from the code by make docs -->\n"
_END = "<!-- end of alarms -->\n"


@dataclass(frozen=True)
class AlarmKind:
    """A kind of alarm.

    Attributes
    ----------
    meaning
        What it tells.
    cause
        What is usually behind it.
    what_to_do
        What an operator does before he acknowledges it.
    stops
        Whether the line holds or stops for it.
    """

    meaning: str
    cause: str
    what_to_do: str
    stops: bool = True


CATALOGUE: Mapping[str, AlarmKind] = {
    "e_stop": AlarmKind(
        "an emergency stop was pressed",
        "somebody saw danger",
        "See that nobody is in danger and nothing lies where it can be caught. Pull the button out, acknowledge, start.",
    ),
    "jam": AlarmKind(
        "tiles are jammed on the belt",
        "a tile turned, broke or caught on a guide",
        "Clear the belt: take every tile between eye and diverter off it. Acknowledge, resume.",
    ),
    "double_feed": AlarmKind(
        "two tiles came at once, or one of the wrong length",
        "loader out of step, a broken tile, the wrong format loaded, dirt on the photo-eye",
        "Take the tiles off the belt, see to loader and photo-eye, compare the format with the job. Acknowledge, resume.",
    ),
    "diverter_fault": AlarmKind(
        "the diverter doesn't move as it should",
        "no air, a piece of tile in its way, a limit switch",
        "Free the diverter and see that it swings by hand. Until it does every tile goes to scrap. Acknowledge, resume.",
    ),
    "tiles_disagree": AlarmKind(
        "printer and conveyor don't agree where tiles are",
        "dirt on the photo-eye, one of the two signal cables loose, the encoder's wheel slipping",
        "Wipe the photo-eye, see to the cables of eye and encoder at both cabinets. Acknowledge, resume: tiles on the "
        "belt go to scrap.",
    ),
    "tiles_missed": AlarmKind(
        "tiles passed the eye without the line hearing of them in time",
        "the connection to the printer was disturbed",
        "See to the printer's serial cable. Acknowledge, resume: those tiles go to scrap.",
    ),
    "tile_lost": AlarmKind(
        "the conveyor no longer knows what became of a tile",
        "the line was cut off from the conveyor for long",
        "Look whether the tile passed or was scrapped, and settle its face. Acknowledge, resume.",
    ),
    "tile_missing": AlarmKind(
        "nothing was printed for a tile",
        "the tile was taken off the belt before the head",
        "Nothing: the face comes again on a later tile.",
        stops=False,
    ),
    "armed_late": AlarmKind(
        "a tile got no face in time and goes to scrap",
        "the computer was busy, or the eye is too near to the head for this speed",
        "If it comes often: end other programs on the line's computer, or slow the recipe's belt.",
        stops=False,
    ),
    "good_tile_diverted": AlarmKind(
        "a tile with a good face went to scrap",
        "released too late, or the diverter swung by itself",
        "Order a reprint of that face if the batch must be whole. See to the diverter. Acknowledge, resume.",
    ),
    "partial": AlarmKind(
        "a face was printed only in part",
        "the belt stopped hard, ink or data ran out in the middle of a face",
        "The tile goes to scrap by itself. Find out what stopped the print; order a reprint of the face. Acknowledge, "
        "resume.",
    ),
    "wrong_data": AlarmKind(
        "a face was printed from other data than was sent",
        "a defect of the printer's memory or network",
        "The tile goes to scrap by itself. Order a reprint; if it comes again call the printer's maker.",
    ),
    "underrun": AlarmKind(
        "data of a face reached the printer too late",
        "network or computer too slow for this speed",
        "See to the network between computer and printer; slow the recipe's belt if it comes again. Acknowledge, resume.",
    ),
    "streaming": AlarmKind(
        "faces can't be sent to the printer",
        "network to the printer broken, its data port off",
        "See to the network cable of the printer. Acknowledge, resume.",
    ),
    "ink_out": AlarmKind(
        "the printer is out of an ink",
        "tank empty, a valve closed",
        "Fill the tank, run the printer's own purge, look at a test print. Acknowledge, resume.",
    ),
    "nozzle_out": AlarmKind(
        "the printer reports a nozzle that doesn't fire",
        "dried or dirty nozzle",
        "Clean the head as its maker says, look at a test print. Acknowledge, resume.",
    ),
    "printer_held": AlarmKind(
        "the printer holds by itself",
        "somebody pressed hold at its panel, a cover is open",
        "Look at the printer's panel and covers. Acknowledge, resume.",
    ),
    "printer_not_ready": AlarmKind(
        "the printer can't be made ready",
        "ink or nozzles out, its own stop pressed",
        "See to its ink, nozzles and stop button. Acknowledge, resume.",
    ),
    "printer_rebooted": AlarmKind(
        "the printer was restarted",
        "its power failed, somebody switched it",
        "Nothing to find out: it is asked what it printed. Acknowledge, resume; tiles on the belt go to scrap.",
    ),
    "printer_changed": AlarmKind(
        "another printer answers than before, or it was set up anew",
        "inks or encoder were changed",
        "Compare inks and encoder with the job's profile. Acknowledge, start.",
    ),
    "printer_confused": AlarmKind(
        "the printer tells of faces that it wasn't given like that",
        "another computer commands it, or it has a defect",
        "See that no other computer is connected to it. Settle the faces in doubt. Acknowledge, resume.",
    ),
    "arm_refused": AlarmKind(
        "the printer refused a face",
        "another computer commands it, or job and printer don't fit",
        "See that no other computer is connected to it; check size and resolution of the job. Acknowledge, resume.",
    ),
    "deadman_printer": AlarmKind(
        "the printer heard nothing for half a second and holds",
        "cable, or a busy computer",
        "See to the printer's serial cable and to what else runs on the computer. Acknowledge, resume.",
    ),
    "deadman_plc": AlarmKind(
        "the conveyor heard nothing for half a second and stopped",
        "cable, or a busy computer",
        "See to the conveyor's cable and to what else runs on the computer. Acknowledge, resume.",
    ),
    "plc_rebooted": AlarmKind(
        "the conveyor's controller was restarted",
        "its power failed, somebody switched it or loaded a program",
        "See why. Acknowledge, resume; tiles on the belt go to scrap.",
    ),
    "plc_refused": AlarmKind(
        "the conveyor's controller refused a command",
        "the recipe asks for more than it allows, or its program was changed",
        "Compare speed and tile size with the conveyor's limits. Acknowledge, resume.",
    ),
    "plc_lost": AlarmKind(
        "the conveyor's controller doesn't answer",
        "power, cable, network",
        "See to its power and cable; the line notices by itself when it is back. Acknowledge, resume.",
    ),
    "printer_lost": AlarmKind(
        "the printer doesn't answer",
        "power, cable",
        "See to its power and cable; the line notices by itself when it is back. Acknowledge, resume.",
    ),
    "kiln_lost": AlarmKind(
        "the kiln's controller doesn't answer",
        "power, cable, network",
        "See to the kiln itself first, then to its controller's power and cable. Acknowledge, resume.",
    ),
    "gauge_lost": AlarmKind(
        "the gauge doesn't answer",
        "power, cable",
        "See to its power and cable; the line notices by itself when it is back. Acknowledge, resume.",
    ),
    "kiln_burner": AlarmKind(
        "a burner of the kiln failed",
        "gas, ignition",
        "See to the burner as its maker says; no tile may be fed until the zone is hot again. Acknowledge, resume.",
    ),
    "kiln_over_temp": AlarmKind(
        "the kiln is too hot",
        "a zone's control or thermocouple failed",
        "Act as the kiln's maker says. Acknowledge and resume only when it is back within bounds.",
    ),
    "kiln_blocked": AlarmKind(
        "the kiln takes no tiles",
        "its entry is full or its rollers stand",
        "Clear its entry. Acknowledge, resume.",
    ),
    "kiln_zone": AlarmKind(
        "a zone of the kiln is off its set-point",
        "a burner, a draught, a gap in the ware",
        "See to the zone; hold the line if the colour of fired tiles changes.",
        stops=False,
    ),
    "faces_in_doubt": AlarmKind(
        "nobody can tell whether some faces were printed",
        "power or memory was lost in the wrong moment",
        "Their tiles go to scrap. Look at them, and tell for each: `tilefab line settle FACE printed` or `unprinted`. "
        "Acknowledge, resume.",
    ),
    "not_ready": AlarmKind(
        "the line can't be brought up",
        "what the alarm says",
        "Put right what it says. Acknowledge, resume.",
    ),
    "not_reconciled": AlarmKind(
        "it couldn't be found out what became of the last faces",
        "a device stopped answering meanwhile, or the belt was moved",
        "See that the belt stands and all devices answer. Acknowledge, resume.",
    ),
    "changeover_failed": AlarmKind(
        "the next job can't be taken up",
        "its maps or its profile are gone, or it doesn't fit the printer",
        "Put right what it says. Acknowledge, resume; or stop, and queue another job.",
    ),
    "no_job": AlarmKind(
        "there is no job to print",
        "the queue is empty",
        "Queue a job: `tilefab line queue JOB`. Acknowledge, resume.",
    ),
    "journal": AlarmKind(
        "the journal can't be written",
        "disk full or failing, database gone",
        "Make room on the disk, or bring the database back. Acknowledge, start. Nothing is printed without a journal.",
    ),
    "journal_behind": AlarmKind(
        "the printer remembers faces that the journal doesn't know",
        "the journal was lost, or restored from an old copy",
        "Find out which faces of the batch were printed since that copy was made, before more are printed.",
        stops=False,
    ),
    "defect": AlarmKind(
        "a defect of tilefab",
        "unknown",
        "Keep the log and report it. Acknowledge, start.",
    ),
}
"""By code."""

UNKNOWN = AlarmKind("unknown to this version", "unknown", "See what it says, put it right. Acknowledge, resume.")


def alarm_views(alarms: Iterable[Alarm], since: Mapping[int, datetime]) -> tuple[AlarmView, ...]:
    """Alarms as an operator sees them.

    Parameters
    ----------
    alarms
        Those that are up.
    since
        When each was raised, by number.
    """
    return tuple(
        AlarmView(
            number=alarm.number,
            code=alarm.code,
            since=since[alarm.number].isoformat(timespec="seconds") if alarm.number in since else "",
            message=alarm.text,
            what_to_do=CATALOGUE.get(alarm.code, UNKNOWN).what_to_do,
            acked=alarm.acked,
        )
        for alarm in alarms
    )


def alarm_table() -> str:
    """All kinds of alarms as a table in Markdown."""
    rows = ["| alarm | it means | usual cause | what to do |", "| --- | --- | --- | --- |"]
    for code, kind in sorted(CATALOGUE.items()):
        name = f"`{code}`" if kind.stops else f"`{code}` (the line goes on)"
        rows.append(f"| {name} | {kind.meaning} | {kind.cause} | {kind.what_to_do} |")
    return "\n".join(rows) + "\n"


def with_table(page: str) -> str:
    """A page with its table of alarms made anew.

    Raises
    ------
    ValueError
        If the page has no place for it.
    """
    before, begin, rest = page.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    if not begin or not end:
        raise ValueError("the page has no place for the table of alarms")
    return f"{before}{begin}\n{alarm_table()}\n{end}{after}"


if __name__ == "__main__":
    PAGE = Path(sys.argv[1])
    atomic_write_bytes(PAGE, with_table(PAGE.read_text()).encode())
