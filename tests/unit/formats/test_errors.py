"""The text of a format error is one line for any input."""

from hypothesis import given
from hypothesis import strategies as st

from camber.formats.errors import FormatError


def test_message_contains_place_field_actual_and_expected() -> None:
    error = FormatError(
        "rover.pos", "latitude(deg)", "a number from -90 to 90", actual=b"95.0", line_number=23
    )
    assert str(error) == "rover.pos:23: latitude(deg) is '95.0', expected a number from -90 to 90"
    error = FormatError("ttyACM0", "sentence", "checksum 4F", byte_offset=120)
    assert str(error) == "ttyACM0 at byte 120: sentence, expected checksum 4F"


@given(st.binary(max_size=200) | st.text(max_size=200))
def test_any_input_gives_one_short_line(decoded: bytes | str) -> None:
    message = str(FormatError("f", "field", "something", actual=decoded))
    assert len(message.splitlines()) == 1
    assert message.isprintable()
    assert len(message) < 500
