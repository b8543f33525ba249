"""Texts of strangers: nothing that is printed moves the cursor."""

from __future__ import annotations

import json
import unicodedata

from tramstream.shown import cell, shown, shown_json

HOSTILE = {
    "\x1b[2J": "\\x1b[2J",
    "\x9b2J": "\\x9b2J",
    "\x7f\x08": "\\x7f\\x08",
    "a\rb": "a\\rb",
    "a\nb": "a\\nb",
    "a\tb": "a\\tb",
    "\u202egnp.exe": "\\u202egnp.exe",
    "\u2066x\u2069": "\\u2066x\\u2069",
    "\u200b\ufeff": "\\u200b\\ufeff",
    "\u2028": "\\u2028",
    "\udcff": "\\udcff",
    "\U000e0041": "\\U000e0041",
}


def test_what_moves_the_cursor_becomes_a_visible_escape() -> None:
    for text, expected in HOSTILE.items():
        assert shown(text) == expected


def test_no_character_of_unicode_passes_that_a_terminal_obeys() -> None:
    for number in range(0x110000):
        if unicodedata.category(chr(number)) in ("Cc", "Cf", "Cs", "Zl", "Zp"):
            assert chr(number) not in shown(chr(number))
            assert chr(number) not in shown(chr(number), lines=True) or chr(number) == "\n"
            assert chr(number) not in shown_json(chr(number)) or chr(number) == "\n"


def test_letters_of_every_script_stay() -> None:
    for text in ("Radlická", "Ελλάδα", "東京", "12\u202f345 kB", "1\xa0m", "°²₂ → – …"):
        assert shown(text) == text
        assert shown_json(text) == text


def test_lines_are_kept_where_they_are_wanted() -> None:
    assert shown("one\ntwo\x1b", lines=True) == "one\ntwo\\x1b"


def test_json_says_the_same_when_it_is_read() -> None:
    for text in HOSTILE:
        dumped = shown_json(json.dumps({"text": text}, ensure_ascii=False))
        assert json.loads(dumped) == {"text": text}
        assert dumped.isprintable()


def test_texts_that_a_spreadsheet_would_run_are_made_harmless_and_numbers_are_not() -> None:
    for text in ("=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "\n=1", "＝1"):
        assert cell(text) == f"'{text}"
    for value in (-1, -0.5, 3, float("nan"), True, "", "a=1", "raw/gnss/fix", " =1"):
        assert cell(value) is value
