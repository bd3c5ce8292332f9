"""What pages say of the hares and lynxes is what the example prints and finds, and they say it alike."""

import re
from pathlib import Path

import pytest

from atoll.experiments.suggestion import DECIDED, UNDECIDED
from examples.quotes import (
    MARK,
    PAGES,
    ROOT,
    compared_block,
    numbers_of,
    printed_lines,
    requoted,
    run_example,
)

TEXTS = {name: (ROOT / name).read_text("utf-8") for name in PAGES}

PRINTED = """\
dhare/dyear = 2*hare
    constants: 2 ± 1
    good: It fits.
noise: hare 9 %
dlynx/dyear = 3*lynx
    constants: 3 ± 1
"""
PAGE = """\
So <!-- hares: rest -->5<!-- end -->.
```console
$ coordinator run
...
dhare/dyear = hare
    constants: 1 ± 1
    doubtful: It does not.
...
noise: hare 1 %
```
"""


def test_lines_and_numbers_are_written_where_they_stand() -> None:
    page = requoted(PAGE, printed_lines(PRINTED), {"rest": "6"})
    assert page == PAGE.replace(">5<", ">6<").replace("= hare", "= 2*hare").replace("1 ± 1", "2 ± 1").replace(
        "doubtful: It does not.", "good: It fits."
    ).replace("hare 1 %", "hare 9 %")


def test_a_comparison_is_quoted_as_it_is_printed_but_for_equations() -> None:
    """The numbers of the comparison in docs/analysis.md came of no program, and were those of an earlier version."""
    text = "A = the first: dx/dt = x\nB = the second: dx/dt = 2*x\ndx/dt: another form\n  A: 5 constants; dx/dt = x"
    assert compared_block(text) == "\n```text\ndx/dt: another form\n  A: 5 constants; …\n```\n"
    (mark,) = MARK.finditer(TEXTS["docs/analysis.md"])
    assert mark["name"] == "compare"
    assert mark["text"].startswith("\n```text\ndhare/dyear: ")


def test_pages_agree_with_each_other() -> None:
    said: dict[str, set[str]] = {}
    for text in TEXTS.values():
        for mark in MARK.finditer(text):
            said.setdefault(mark["name"], set()).add(mark["text"])
        for equation, line in re.findall(r"^(d(?:hare|lynx)/dyear = .*)\n    (constants: .*)$", text, re.MULTILINE):
            said.setdefault(equation, set()).add(line)
    assert {name: texts for name, texts in said.items() if len(texts) > 1} == {}
    balance, error = said["balance"], said["balance.error"]
    assert any(f"{balance.copy().pop()} ± {error.copy().pop()}" in line for lines in said.values() for line in lines)


@pytest.mark.slow
def test_pages_quote_what_the_example_prints_and_finds(tmp_path: Path) -> None:
    text, model = run_example(tmp_path / "hares")
    lines, numbers = printed_lines(text), numbers_of(model)
    changed = [name for name, page in TEXTS.items() if requoted(page, lines, numbers) != page]
    assert not changed, f"run python -m examples.quotes, and read what moved: {changed}"


def test_the_odds_at_which_data_decide_are_those_of_the_code() -> None:
    page = TEXTS["docs/analysis.md"]
    assert f"Odds below {UNDECIDED:.0f} to 1 do not decide; odds of {DECIDED:.0f} to 1 and more decide." in page
