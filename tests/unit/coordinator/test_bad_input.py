"""Bad data and options, decided before any process is there: one sentence that names what was found and helps."""

from pathlib import Path

import pytest

from atoll.cli.parser import parse
from atoll.cli.request import request_of
from atoll_coordinator.tasks.preparing import PreparationOutcome, prepare
from atoll_core.errors import DataError, UsageError
from atoll_core.wire.values import decode_value

GOOD = "t,x,y\n" + "".join(f"{0.1 * i:.1f},{i * i * 0.01},{1 + 0.1 * i}\n" for i in range(40))


def changed(line: int, text: str) -> str:
    lines = GOOD.splitlines()
    lines[line] = text
    return "\n".join(lines) + "\n"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refusal(text: str | None, *options: str) -> str:
    """Return the sentence with which a table of this text is refused: when it is read, or when it is prepared."""
    if text is not None:
        Path("data.csv").write_text(text)
    try:
        request = request_of(parse(["run", "data.csv", *options]))
        table = request.read()
    except (DataError, UsageError) as error:
        return error.on_command_line
    made = prepare(table.to_bytes(), request.config.model_dump_json().encode())
    outcome = decode_value(made, PreparationOutcome)
    assert not outcome.is_prepared
    return outcome.sentence


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, ["data.csv", "does not exist"]),
        ("", ["data.csv", "empty"]),
        ("t,x,y\n", ["data.csv"]),
        ("t,x,y\n0,1,2\n", ["1 row"]),
        (changed(5, "0.4,abc,1.4"), ["data.csv", "6", "x", "'abc'"]),
        (changed(5, "0.4,nan,1.4"), ["x", "row", "5", "--missing drop"]),
        (changed(5, "0.4,inf,1.4"), ["x", "row", "5", "--missing drop"]),
        (changed(5, "0.25,1,1.4"), ["t", "0.25"]),
        (changed(5, "0.3,1,1.4"), ["t", "0.3"]),
        (GOOD.replace("t,x,y", "t,x,x"), ["'x'", "name"]),
        (GOOD.replace("t,x,y", "s,x,y"), ["time", "t"]),
        (GOOD.replace("t,x,y", "Times,x,y"), ["no time column", "--time (perhaps Times)"]),
        ("t,x,y\n" + "".join(f"{i},{i * i},3\n" for i in range(40)), ["y", "constant"]),
    ],
)
def test_bad_data_are_refused_with_one_sentence(text: str | None, words: list[str]) -> None:
    sentence = refusal(text)
    assert [word for word in words if word not in sentence] == []


def test_a_device_is_not_called_missing(folder: Path) -> None:
    (folder / "data.csv").symlink_to("/dev/null")
    assert "a pipe or a device" in refusal(None)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--states x,z", ["'z'", "x, y"]),
        ("--states x,Y", ["'Y'", "did you mean 'y'?"]),
        ("--known dy=sim(x)", ["'sim'", "did you mean 'sin'?"]),
        ("--operators +,tanx", ["'tanx'", "did you mean 'tanh'?"]),
        ("--preset papr", ["'papr'", "did you mean 'paper'?"]),
        ("--missing drops", ["'drops'", "did you mean 'drop'?"]),
        ("--time when", ["'when'", "t"]),
        ("--target q", ["'q'"]),
        ("--only z", ["'z'"]),
        ("--angle phi", ["'phi'"]),
        ("--operators +,foo", ["'foo'", "tanh"]),
        ("--target y --order 2", ["--order 2", "--target"]),
        ("--states x --inputs x", ["'x'", "--states", "--inputs"]),
        ("--known dz=x", ["--known", "'dz'", "x, y"]),
        ("--known d2x=y", ["'d2x'", "--order 2"]),
        ("--guess x=3*w", ["--guess", "'w'", "x, y"]),
        ("--guess x=tanh(y)", ["tanh(y)", "'tanh'"]),
        ("--guess x=1 --known x=2", ["--guess", "'x'", "known"]),
        ("--allow x=z", ["--allow", "'z'", "x, y"]),
        ("--operators z=+", ["--operators", "'z'", "x, y"]),
    ],
)
def test_bad_options_are_refused_with_one_sentence(options: str, words: list[str]) -> None:
    sentence = refusal(GOOD, *options.split())
    assert [word for word in words if word not in sentence] == []
