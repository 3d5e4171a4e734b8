"""Which ink is the black one."""

import pytest

from tilefab.colour.inks import black_channel

BLUE, BLACK, BROWN, GREY = [22.0, 5.0, -42.0], [28.0, 1.0, -1.0], [35.0, 22.0, 20.0], [52.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("names", "channel"),
    [
        (("Cyan", "Magenta", "Yellow", "Black"), 3),
        (("BLUE", "NERO", "Giallo"), 1),
        (("Schwarz",), 0),
        (("Negro mate", "Azul"), 0),
        (("C", "M", "Y", "k"), 3),
        (("Blue", "Key"), 1),
        (("Noir 2", "Bleu"), 0),
        (("Process_Black", "Pink"), 0),
        (("Blue", "Brown"), None),
        (("Blackish", "Kobalt", "Keyhole"), None),
    ],
)
def test_by_name(names: tuple[str, ...], channel: int | None) -> None:
    assert black_channel(names) == channel
    # A name decides, whatever the colour.
    if channel is not None:
        assert black_channel(names, [BLACK if ink != channel else BLUE for ink in range(len(names))]) == channel


def test_by_colour() -> None:
    assert black_channel(("1", "2", "3"), [BLUE, BLACK, BROWN]) == 1
    assert black_channel(("1", "2", "3"), [[33.0, 2.0, 2.0], BLACK, BROWN]) == 1
    assert black_channel(("1", "2", "3"), [BLUE, GREY, BROWN]) is None


def test_as_many_solids_as_names() -> None:
    with pytest.raises(ValueError, match=r"\(2, 3\)"):
        black_channel(("1", "2"), [BLUE])
