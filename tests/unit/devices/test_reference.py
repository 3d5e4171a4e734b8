"""The page on the protocols is made from the code."""

from __future__ import annotations

import re
from pathlib import Path

from tilefab.devices.maps import KILN_MAP, PLC_MAP
from tilefab.devices.printer_messages import MESSAGES
from tilefab.devices.reference import reference

PAGE = Path(__file__).parents[3] / "docs" / "line_protocols.md"


def test_the_page_is_as_the_code_makes_it():
    assert PAGE.read_text() == reference()


def test_it_shows_every_register_and_every_message():
    page = reference()
    for registers in (PLC_MAP, KILN_MAP):
        for one in registers.registers:
            assert re.search(rf"^\| {one.address}( to \d+)? \| `{one.name}` \|", page, re.MULTILINE)
    for message in MESSAGES:
        assert f"### 0x{message.code:02X} {message.name}\n" in page


def test_every_row_of_a_table_has_its_columns():
    columns = 0
    for line in reference().splitlines():
        if not line.startswith("|"):
            columns = 0
            continue
        found = len(re.findall(r"(?<!\\)\|", line))
        assert columns in (0, found), line
        columns = found
