import pytest

from tilefab.pipeline.line.orders import ORDERS, check_order

RIGHT: dict[str, dict[str, object]] = {
    "start": {},
    "hold": {},
    "resume": {},
    "stop": {},
    "ack": {"up_to": 0},
    "queue": {"job": "/jobs/demo.toml"},
    "reprint": {"face": (1 << 40) - 1},
    "settle": {"face": 0, "state": "unprinted"},
}


def test_every_order_is_known() -> None:
    assert set(RIGHT) == set(ORDERS)
    for name, arguments in RIGHT.items():
        assert check_order(name, arguments) == arguments


def test_a_run_may_be_named_where_faces_are() -> None:
    assert check_order("settle", {"face": 0, "state": "passed", "run": 7})["run"] == 7
    assert check_order("reprint", {"face": 0, "run": 7})["run"] == 7
    with pytest.raises(ValueError, match="takes no 'run'"):
        check_order("start", {"run": 7})


@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("explode", {}, "there is no command 'explode'"),
        ("start", {"face": 3}, "start takes no 'face', but nothing"),
        ("ack", {}, "ack needs 'up_to'"),
        ("ack", {"up_to": -1}, "up_to must be a whole number from 0"),
        ("ack", {"up_to": True}, "up_to must be a whole number"),
        ("ack", {"up_to": 1.0}, "up_to must be a whole number"),
        ("ack", {"up_to": "1"}, "up_to must be a whole number"),
        ("queue", {"job": "demo.toml"}, "whole path"),
        ("queue", {"job": "/a\nb"}, "whole path"),
        ("queue", {"job": "/" + "a" * 5000}, "whole path"),
        ("reprint", {"face": 1 << 40}, "face must be"),
        ("settle", {"face": 0, "state": "printed"}, "one of passed, diverted, unprinted"),
        ("settle", {"face": 0, "state": ["passed"]}, "one of passed, diverted, unprinted"),
        ("settle", {"face": 0, "state": "passed", "run": 0}, "run must be a whole number from 1"),
        ("settle", {"face": 0, "state": "passed", "why": ""}, "settle takes no 'why', but face, state"),
    ],
)
def test_a_wrong_order_is_refused_in_words(name: str, arguments: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        check_order(name, arguments)
