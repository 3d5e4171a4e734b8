"""What each alarm of a line means, and what an operator does about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class AlarmText:
    """What is said about a kind of alarm.

    Attributes
    ----------
    title
        In a few words.
    meaning
        What happened, and what the line has done about it by itself.
    what_to_do
        By the operator.
    """

    title: str
    meaning: str
    what_to_do: str


_THEN_RESUME = "Then acknowledge and resume."
_CABLES = "See to its power and cable. The line notices by itself when it is back; then acknowledge and resume."
_CLEAR_BELT = "Look at the belt between eye and diverter and put right what lies wrong; take off what can't stay."
_LINE_GOES_ON = "The line goes on."
_SCRAP = "Tiles whose place isn't known any more go to scrap by themselves."

ALARMS: Mapping[str, AlarmText] = {
    "e_stop": AlarmText(
        "Emergency stop",
        "A button was pressed. Belt and printer stopped at once; a face that was being printed is incomplete and its "
        "tile goes to scrap. Nothing starts again by itself.",
        "Make sure that nobody is in danger, then pull out the button, acknowledge, and start.",
    ),
    "jam": AlarmText(
        "Tiles are jammed",
        "The conveyor saw a tile that doesn't move on. The belt stands.",
        f"Clear the jam. {_SCRAP} {_THEN_RESUME}",
    ),
    "double_feed": AlarmText(
        "Two tiles at once",
        "A tile was too long, or too close to the one before: two may lie on each other or end to end. The belt stands "
        "before a face is printed across both.",
        f"{_CLEAR_BELT} See to the loader if it comes again, and to the tile size of the job. {_THEN_RESUME}",
    ),
    "tile_missing": AlarmText(
        "A tile didn't come to the head",
        "The eye saw a tile, but nothing was printed when its turn came. Its face was not printed and comes again by "
        "itself on a later tile. The line goes on.",
        "Acknowledge. If it comes often, see whether tiles slip, or are taken off between eye and head.",
    ),
    "no_tiles": AlarmText(
        "No tiles come",
        "The loader was told to feed and the belt ran on, but no tile came to the eye. The line goes on waiting.",
        "See whether the loader is empty or jammed, and clean the eye; then acknowledge.",
    ),
    "tiles_missed": AlarmText(
        "Tiles went by unnoticed",
        "The printer saw more tiles than the daemon heard of in time. They have no face; the diverter scraps them.",
        "Acknowledge and resume. If it comes again, see whether the printer's serial line is disturbed.",
    ),
    "tiles_disagree": AlarmText(
        "Printer and conveyor disagree about tiles",
        "The two count the same tiles and the same belt, but don't agree any more: one of them missed a tile or an "
        "encoder count. The line can't be sure which face lies on which tile.",
        f"{_CLEAR_BELT} Clean the eye; check the encoder's coupling and cables. {_SCRAP} {_THEN_RESUME}",
    ),
    "tile_lost": AlarmText(
        "A tile's fate isn't known",
        "The conveyor no longer remembers whether a printed tile passed. Its face is in doubt.",
        "Find out whether the tile went to the kiln or to scrap and settle its face; then acknowledge and resume.",
    ),
    "good_tile_diverted": AlarmText(
        "A good tile went to scrap",
        "A tile with a whole face was diverted: it was released too late, or the diverter didn't obey. The face counts "
        "as printed and doesn't come again by itself.",
        f"Order a reprint of the face if it is wanted. See to the diverter if it comes again. {_THEN_RESUME}",
    ),
    "diverter_fault": AlarmText(
        "The diverter doesn't move",
        "The diverter isn't where the conveyor wants it. The belt stands, so that no scrap gets into the kiln.",
        f"See to the diverter. {_SCRAP} {_THEN_RESUME}",
    ),
    "armed_late": AlarmText(
        "A tile came too late for a face",
        "A tile was too close to the head when its face was ready. It stays blank and goes to scrap; no face is lost. "
        "The line goes on.",
        "Acknowledge. If it comes often, lower the belt's speed in the recipe, or widen the gap between tiles.",
    ),
    "arm_refused": AlarmText(
        "The printer refused a face",
        "The printer didn't take a command that it should have taken; another program may command it.",
        f"Make sure that only this daemon is connected to the printer. {_THEN_RESUME}",
    ),
    "underrun": AlarmText(
        "A face reached the printer too late",
        "Rows were missing when the head needed them. The face is incomplete and its tile goes to scrap; the printer "
        "holds.",
        "See whether the computer or its network is busy with something else, or lower the belt's speed in the recipe. "
        f"{_THEN_RESUME} Order a reprint of the face if it is wanted.",
    ),
    "partial": AlarmText(
        "A face is incomplete",
        "The printer printed only some of a face's rows. Its tile goes to scrap, and the face doesn't come again by "
        "itself.",
        f"See what stopped the printer. {_THEN_RESUME} Order a reprint of the face if it is wanted.",
    ),
    "wrong_data": AlarmText(
        "A face was printed from damaged data",
        "The checksum that the printer tells isn't that of the face that was sent. Its tile goes to scrap.",
        f"Check the network to the printer. {_THEN_RESUME} Order a reprint of the face if it is wanted.",
    ),
    "streaming": AlarmText(
        "Faces can't be sent to the printer",
        "The connection that faces are sent over failed again and again, or a face couldn't be rendered.",
        f"Read the alarm's text; check the network to the printer. {_THEN_RESUME}",
    ),
    "ink_out": AlarmText(
        "No ink",
        "An ink of the printer is empty. No further face is begun.",
        f"Refill it. {_THEN_RESUME}",
    ),
    "nozzle_out": AlarmText(
        "A nozzle failed",
        "The printer found a nozzle that doesn't print. No further face is begun.",
        f"Clean the head as the printer's maker says. {_THEN_RESUME}",
    ),
    "printer_held": AlarmText(
        "The printer holds",
        "The printer holds without having been told so: at its own panel, or after a fault of its own.",
        f"Look at the printer's panel. {_THEN_RESUME}",
    ),
    "printer_rebooted": AlarmText(
        "The printer was restarted",
        "The printer lost its counts of belt and tiles. What it had begun is incomplete; what it hadn't comes again.",
        f"See why it restarted. {_SCRAP} {_THEN_RESUME}",
    ),
    "printer_changed": AlarmText(
        "Another printer",
        "The printer tells of other inks or another encoder than when the daemon started. Nothing is printed with it.",
        "Put the right printer back, or end the daemon, correct line file and jobs, and start it anew.",
    ),
    "printer_confused": AlarmText(
        "The printer contradicts itself",
        "What the printer tells of a face doesn't fit what it was given. The face is in doubt or goes to scrap.",
        "Restart the printer. Settle faces in doubt, if there are any; then acknowledge and resume.",
    ),
    "deadman_printer": AlarmText(
        "The printer heard nothing",
        "The daemon was silent towards the printer for more than half a second, so the printer holds by itself.",
        f"See whether the computer was overloaded or the cable was off. {_THEN_RESUME}",
    ),
    "deadman_plc": AlarmText(
        "The conveyor heard nothing",
        "The daemon was silent towards the conveyor for more than half a second, so the belt stopped by itself.",
        f"See whether the computer was overloaded or the cable was off. {_THEN_RESUME}",
    ),
    "plc_rebooted": AlarmText(
        "The conveyor's controller was restarted",
        "It lost its counts and every release. Tiles on the belt go to scrap unless it is certain which they are.",
        f"See why it restarted. {_THEN_RESUME}",
    ),
    "plc_refused": AlarmText(
        "The conveyor refused a command",
        "The conveyor's controller didn't take what the recipe asks for.",
        "Compare the recipe's speed and the job's tile size with what the conveyor can do. " + _THEN_RESUME,
    ),
    "plc_lost": AlarmText(
        "The conveyor doesn't answer",
        "No sound answer for more than 0.35 s. The belt stops by itself after half a second.",
        _CABLES,
    ),
    "printer_lost": AlarmText(
        "The printer doesn't answer",
        "No sound answer for more than 0.35 s. It finishes the face it has begun and holds by itself.",
        _CABLES,
    ),
    "kiln_lost": AlarmText(
        "The kiln doesn't answer",
        "No sound answer from its controller. It goes on firing as it is set; no further tile is printed.",
        _CABLES,
    ),
    "job_refused": AlarmText(
        "A queued job can't be printed",
        "A job that was queued has a fault, or its maps can't be made. The line goes on with the others.",
        "Put right what the alarm says, check it with `tilefab job check`, and queue it again.",
    ),
    "gauge_lost": AlarmText(
        "The gauge doesn't answer",
        "No sound answer from the instrument behind the kiln.",
        _CABLES,
    ),
    "kiln_burner": AlarmText(
        "A burner failed",
        "The kiln reports a burner out of order. No further tile is sent in.",
        f"See to the kiln as its maker says. {_THEN_RESUME}",
    ),
    "kiln_over_temp": AlarmText(
        "The kiln is too hot",
        "A zone is above what the kiln's own guard allows. No further tile is sent in.",
        f"See to the kiln as its maker says. {_THEN_RESUME}",
    ),
    "kiln_blocked": AlarmText(
        "The kiln takes no tiles",
        "Its entry is blocked, or it is full.",
        f"See to its entry. {_THEN_RESUME}",
    ),
    "kiln_zone": AlarmText(
        "A zone is off its set-point",
        "A zone of the kiln has been farther from its set-point than the line's file allows for a while. The line goes "
        "on.",
        "See to the zone; hold the line if the tiles come out wrong. Acknowledge.",
    ),
    "faces_in_doubt": AlarmText(
        "Faces in doubt",
        "Nobody can tell from the devices whether these faces were printed, or where their tiles are. The tiles go to "
        "scrap; the faces come again only if you say so.",
        "`tilefab line status` names the faces. Settle each: passed or diverted if you found its tile, unprinted if it "
        "is to come again. Acknowledge and resume; they may also be settled later.",
    ),
    "changeover_failed": AlarmText(
        "The next job can't be taken up",
        "The job can't be opened and was taken out of the queue, or there is none: the alarm's text says why.",
        "Put right what the text says and queue the job again, or go on with those behind it: acknowledge and resume.",
    ),
    "not_ready": AlarmText(
        "A device isn't ready",
        "A device reports something that keeps the line from running: the alarm's text says what.",
        "Put right what the text says; then acknowledge and resume.",
    ),
    "not_reconciled": AlarmText(
        "What became of the last faces isn't known yet",
        "A device failed while the line was finding out what became of the last faces. Nothing moved.",
        "Put right what the text says; then acknowledge and resume.",
    ),
    "journal": AlarmText(
        "The journal can't be written",
        "Without its journal the line would not know what it has printed, so it doesn't print.",
        "See to the disk or the database that holds it: full, read-only, not reachable. Acknowledge, then start.",
    ),
    "journal_slow": AlarmText(
        "The journal is slow",
        "A commit took more than a second. Tiles are released only once their faces are put down, so the line holds.",
        "See what keeps the disk or the database busy, or locks the journal; then acknowledge and resume.",
    ),
    "journal_behind": AlarmText(
        "The journal is older than the printer's memory",
        "The printer remembers faces that this journal doesn't know: the journal was lost, or put back from a copy. "
        "Faces printed meanwhile may come again.",
        "Compare the last tiles with the journal before going on. Then acknowledge.",
    ),
    "defect": AlarmText(
        "A defect of tilefab",
        "Something happened in the daemon that must not happen. It stopped the line.",
        "Send the log to tilefab's makers. Acknowledge and start; restart the daemon if it comes again.",
    ),
    "camera_silent": AlarmText(
        "The camera is silent",
        f"Tiles should be leaving the kiln, but no image of one has come for a while. {_LINE_GOES_ON} Colours aren't "
        "corrected meanwhile.",
        "See whether tiles leave the kiln, and to the camera's power, cable, trigger and disk; acknowledge.",
    ),
    "camera_folder": AlarmText(
        "The camera's folder can't be read",
        f"The folder that images come to isn't there or can't be read. {_LINE_GOES_ON} Nothing is inspected meanwhile.",
        "See to the folder that the line's file names under [camera], and its permissions; acknowledge.",
    ),
    "inspection_images": AlarmText(
        "Images can't be used",
        "Several images in a row are black, blown out, torn, or show no tile or more than one. "
        f"{_LINE_GOES_ON} Their tiles aren't inspected, and colours aren't corrected by them.",
        "Look at the last images: clean the lens, see to light, exposure and trigger; acknowledge.",
    ),
    "inspection_strangers": AlarmText(
        "Tiles aren't recognised",
        f"Several tiles in a row show no face that was printed lately. {_LINE_GOES_ON} Nothing is learnt from them.",
        "See whether other tiles went through the kiln, whether the camera sees the right side of them sharply, and "
        "whether its clock is right; acknowledge.",
    ),
    "inspection_behind": AlarmText(
        "Inspection is behind",
        f"Images come faster than they are inspected; some are left out. {_LINE_GOES_ON}",
        "See what keeps the computer busy; acknowledge.",
    ),
    "inspection_run": AlarmText(
        "A run can't be inspected",
        "The job of a run, its maps or its profile can't be opened as they were printed from: the alarm's text says "
        f"why. {_LINE_GOES_ON} The run's tiles aren't inspected.",
        "Put right what the text says; the inspector tries again. Acknowledge.",
    ),
    "colour_held": AlarmText(
        "Corrections are held",
        "What is seen of the tiles' colours is too old, too contradictory or too unlikely to correct by: the alarm's "
        f"text says which. {_LINE_GOES_ON} Coming faces are printed with the last correction.",
        "Compare a tile with its proof, and see to kiln and camera; acknowledge. Corrections go on by themselves once "
        "what is seen makes sense again.",
    ),
    "colour_signal": AlarmText(
        "Colours go astray",
        "The tiles' colours differ from what was predicted by more than chance explains: a control chart gave a "
        f"signal. {_LINE_GOES_ON}",
        "See whether kiln, glaze, ink or moisture changed; compare a tile with its proof, and hold the line if it is "
        "bad. Acknowledge.",
    ),
    "defect_run": AlarmText(
        "The same defect on several tiles",
        f"Several of the last tiles have the same defect, such as a line of a failed nozzle. {_LINE_GOES_ON}",
        "Clean the head at that place, or see to what the text says; hold the line if tiles are scrap. Acknowledge.",
    ),
    "correction_refused": AlarmText(
        "A correction was refused",
        f"The inspector's correction wasn't taken: the alarm's text says why. {_LINE_GOES_ON} Coming faces are printed "
        "as before.",
        "Put right what the text says; acknowledge.",
    ),
}
"""By code, in the order in which they are documented."""

FROM_INSPECTION = frozenset(
    {
        "camera_silent",
        "camera_folder",
        "inspection_images",
        "inspection_strangers",
        "inspection_behind",
        "inspection_run",
        "colour_held",
        "colour_signal",
        "defect_run",
        "correction_refused",
    }
)
"""Codes of alarms that the inspector raises from outside the daemon. None of them stops the line."""

GENERAL = AlarmText(
    "Something is wrong",
    "The alarm's text says what.",
    "Put right what the text says; then acknowledge and resume.",
)
"""For codes that nothing else is said about."""


def alarm_text(code: str) -> AlarmText:
    """What is said about an alarm.

    >>> alarm_text("ink_out").title
    'No ink'
    """
    return ALARMS.get(code, GENERAL)


def alarm_table() -> str:
    """All alarms, as a table in Markdown."""
    rows = ["| alarm | what it means | what to do |", "| --- | --- | --- |"]
    for code, text in ALARMS.items():
        rows.append(f"| **{text.title}** (`{code}`) | {text.meaning} | {text.what_to_do} |")
    return "\n".join(rows) + "\n"
