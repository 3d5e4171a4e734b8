"""Which faces an operator asks for."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilefab.errors import ConfigError
from tilefab.pipeline.selection import parse_faces


@pytest.mark.parametrize(
    ("text", "faces"),
    [
        (None, list(range(10))),
        ("0:3", [0, 1, 2]),
        ("7", [7]),
        (":2", [0, 1]),
        ("8:", [8, 9]),
        (":", list(range(10))),
        (" 3 , 1 : 2 ", [3, 1]),
        ("5,3,0:3", [5, 3, 0, 1, 2]),
        ("1:4,2,0:2", [1, 2, 3, 0]),
    ],
)
def test_faces_come_in_the_order_asked_for_and_once(text: str | None, faces: list[int]) -> None:
    assert list(parse_faces(text, 10)) == faces


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is not a face or a range"),
        ("a", "is not a face or a range"),
        ("-1", "is not a face or a range"),
        ("1-3", "is not a face or a range"),
        ("1:2:3", "is not a face or a range"),
        ("1,,2", "is not a face or a range"),
        ("1.0", "is not a face or a range"),
        ("²", "is not a face or a range"),
        ("٣", "is not a face or a range"),
        ("1" * 5000, "is not a face or a range"),
        ("3:3", "is empty"),
        ("5:2", "is empty"),
        ("10:", "is empty"),
        ("10", "the job has 10 faces, 0 to 9; raise count"),
        ("0:11", "the job has 10 faces"),
        ("0:3,99999999999999999999", "the job has 10 faces"),
    ],
)
def test_what_can_t_be_meant_is_refused(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_faces(text, 10)
    assert message in caught.value.message
    assert caught.value.message.startswith(f"--faces {text}: ")


def test_a_trillion_faces_take_no_memory() -> None:
    faces = parse_faces(None, 1 << 40)
    assert len(faces) == 1 << 40
    assert len(parse_faces("1:", 1 << 40)) == (1 << 40) - 1


@given(st.text(max_size=12), st.integers(1, 50))
def test_any_text_gives_faces_of_the_job_or_a_problem(text: str, count: int) -> None:
    try:
        faces = list(parse_faces(text, count))
    except ConfigError:
        return
    assert faces
    assert len(set(faces)) == len(faces)
    assert all(0 <= face < count for face in faces)
