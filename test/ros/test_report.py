"""Text for terminals: nothing from outside may command one."""

import unicodedata

from hypothesis import given
from hypothesis import strategies as st

from momrec_ros.report import printable


@given(st.text())
def test_printable_text_has_no_control_characters_and_one_line(text):
    shown = printable(text)
    assert not any(unicodedata.category(character).startswith("C") for character in shown)
    assert len(shown.splitlines()) <= 1


@given(st.text(st.characters(categories=["L", "N", "P", "S"])))
def test_harmless_text_stays_as_it_is(text):
    assert printable(text) == text


def test_escape_sequences_are_shown_and_not_obeyed():
    assert printable("\x1b[2Jcup\n") == r"\x1b[2Jcup\n"
