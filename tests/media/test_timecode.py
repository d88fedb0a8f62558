"""Frame numbers and timecodes: of any rate, with and without drops."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from supple import SuppleError
from supple.media.timecode import Numbering
from tests.refusals import refused

RATES = [Fraction(24000, 1001), Fraction(24), Fraction(25), Fraction(30000, 1001), Fraction(30), Fraction(60000, 1001)]


def labels(base: int, drops: int, minutes: int) -> list[str]:
    """All timecodes of some minutes from midnight on, one after the other, by the rule as it is written."""
    return [
        f"{m // 60:02d}:{m % 60:02d}:{s:02d}{';' if drops else ':'}{f:02d}"
        for m in range(minutes)
        for s in range(60)
        for f in range(base)
        if not (s == 0 and f < drops and m % 10)
    ]


@pytest.mark.parametrize(("rate", "start"), [(RATES[3], "00:00:00;00"), (RATES[5], "00:00:00;00"), (RATES[0], "")])
def test_timecodes_are_those_that_are_counted(rate: Fraction, start: str) -> None:
    base = round(rate)
    expected = labels(base, base // 15 if start else 0, 21)
    numbering = Numbering("clip", len(expected), rate, 0, start)
    for k in range(0, len(expected), 31):
        assert numbering.timecode(k) == expected[k]
        assert numbering.read("frame", expected[k]) == k


@given(st.sampled_from(RATES), st.integers(0, 23), st.integers(0, 10**6), st.booleans(), st.integers(0, 2000))
def test_what_is_written_is_read(rate: Fraction, hours: int, k: int, drop: bool, first: int) -> None:
    start = f"{hours:02d}:59:30{';' if drop and round(rate) % 30 == 0 else ':'}05"
    numbering = Numbering("clip", 10**6 + 1, rate, first, start)
    assert numbering.timecode(0) == start
    assert numbering.read("frame", numbering.timecode(k)) == k
    assert numbering.read("frame", str(k + first)) == k


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("1000", "x must be from 1001 to 1100, the frames of clip.mov, found 1000"),
        ("1101", "found 1101"),
        (
            "00:00:12;08",
            "x 00:00:12;08 is no timecode of clip.mov, which is of 30 frames a second, written as 01:",
        ),
        ("00:59:59:29", "x must be from 01:00:00:00 to 01:00:03:09, the frames of clip.mov, found 00:59:59:29"),
        ("01:00:00:30", "is no timecode"),
        ("01:61:00:00", "is no timecode"),
        ("now", "x must be the number of a frame (1001, say) or a timecode (01:00:00:00), found 'now'"),
    ],
)
def test_others_are_refused(text: str, wanted: str) -> None:
    assert wanted in refused(Numbering("clip.mov", 100, RATES[3], 1001, "01:00:00:00").read, "x", text)


@pytest.mark.parametrize(
    ("rate", "text", "varies", "wanted"),
    [
        (RATES[3], "00:01:00;01", False, "x 00:01:00;01 is no timecode of clip"),
        (RATES[2], "00:01:00;02", False, "of 25 frames a second, written as 00:00:00:00"),
        (RATES[2], "00:01:00:02", True, "the frame rate of clip varies"),
    ],
)
def test_dropped_numbers_and_rates_without_are_refused(rate: Fraction, text: str, varies: bool, wanted: str) -> None:
    with pytest.raises(SuppleError, match=wanted):
        Numbering("clip", 9999, rate, varies=varies).read("x", text)
