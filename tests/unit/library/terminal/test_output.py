"""Numbers and tables as people meet them."""

import json

import pytest

from atoll.terminal.output import (
    as_json,
    note,
    say,
    shorten,
    table,
)


@pytest.mark.parametrize(
    ("expression", "short"),
    [
        ("3.0000000000000004*x - x**2", "3*x - x**2"),
        ("x_1.5", "x_1.5"),
        ("1.0*u - 1.0*x*(1.0*y + 2.1*x)", "u - x*(y + 2.1*x)"),
        ("x**1.0*u + 2/1.0*u + 1.0**u + 1e-11*u", "x**1*u + 2/1*u + 1**u + 1e-11*u"),
        ("x12345678*0.12345678901", "x12345678*0.123457"),
        ("1.23456789e-07*sin(x2)", "1.23457e-07*sin(x2)"),
        ("12345678*x", "12345678*x"),
    ],
)
def test_constants_are_rounded_and_names_are_not(expression: str, short: str) -> None:
    assert shorten(expression) == short


def test_a_table_is_aligned_and_has_no_trailing_blanks() -> None:
    assert table(("ID", "STATE"), [("abcdef", "done"), ("x", "-")]) == "ID      STATE\nabcdef  done\nx       -"


def test_json_has_no_nan() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        as_json({"error": float("nan")})


def test_rows_of_numbers_stand_on_one_line_and_stay_the_same():
    value = {"times": [1.0, 2.5e-7, None], "nested": [[1, 2], []], "texts": ["[\n 1,\n 2]"], "objects": [{"a": [3]}]}
    text = as_json(value)
    assert json.loads(text) == value
    assert '"times": [1.0, 2.5e-07, null]' in text
    assert "    [1, 2]," in text
    assert "3" in next(line for line in text.splitlines() if '"a"' in line)


STEERING = "a\x1b]0;owned\x07\x9b2J\r\u202eb\x7f"


def test_no_name_steers_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    say(f"one\ttwo\n{STEERING}")
    say(as_json({"name": STEERING}))
    note(STEERING)
    printed = capsys.readouterr()
    assert printed.out.startswith("one\ttwo\na\\u001b]0;owned\\u0007\\u009b2J\\u000d\\u202eb\\u007f\n")
    assert json.loads(printed.out[printed.out.index("{") :]) == {"name": STEERING}
    assert {*printed.out + printed.err} & {*STEERING} == {*"a]0;owned2Jb"}


@pytest.mark.parametrize(
    "unseen", ["\u200b", "\U000e0041", "\ue000", "\U0010fffd", "\u00ad", "\ufeff", "\ud800", "\u2060"]
)
def test_what_has_no_picture_is_escaped_as_in_json(unseen: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Two names that look alike are two names."""
    say(as_json({"name": f"lynx{unseen}"}))
    printed = capsys.readouterr().out
    assert printed.isascii()
    assert json.loads(printed) == {"name": f"lynx{unseen}"}


def test_letters_signs_and_spaces_of_all_scripts_stay(capsys: pytest.CaptureFixture[str]) -> None:
    say("dθ/dt = −2·x²\u00a0±\u202f3 µm, 山猫, 🐇")
    assert capsys.readouterr().out == "dθ/dt = −2·x²\u00a0±\u202f3 µm, 山猫, 🐇\n"


def test_a_name_is_one_cell_of_its_row() -> None:
    assert table(["NAME"], [["a\nb\tc"], [STEERING]]).count("\n") == 2
