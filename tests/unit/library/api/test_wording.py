"""Options of the command line are keyword arguments in what Python says."""

import pickle

import pytest

from atoll.api.discover import config_of, submit
from atoll.api.wording import in_python, python_words
from atoll_core.errors import DataError, Field, UsageError


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        ("--max-size must be above 0", "max_size must be above 0"),
        ("leave --order 2 out", "leave order=2 out"),
        ("make it an input with --inputs u", "make it an input with inputs='u'"),
        ("name it with --time, or use --target COLUMN", "name it with time, or use target='COLUMN'"),
        (
            "or mark trajectories (--trajectory COLUMN or blank rows)",
            "or mark trajectories (trajectory='COLUMN' or blank rows)",
        ),
        ("if so, add --hold u, since", "if so, add hold='u', since"),
        ("(--states x,y,n keeps it)", "(states='x,y,n' keeps it)"),
        ("(--states 'x,packet no.' keeps it)", "(states='x,packet no.' keeps it)"),
        ("--inputs if only other states have noise", "inputs if only other states have noise"),
        ("check --tls-ca", "check tls['ca']"),
        ("a - b -- c", "a - b -- c"),
    ],
)
def test_options_become_arguments(sentence: str, expected: str) -> None:
    assert in_python(sentence) == expected


def test_an_error_has_words_for_python_and_for_the_command_line() -> None:
    error = pickle.loads(pickle.dumps(UsageError("there is no time", python="give t", command="give --until")))
    assert (str(error), error.on_command_line) == ("there is no time; give t", "there is no time; give --until")
    error = pickle.loads(pickle.dumps(UsageError("%s must be 5 %% of %s", Field("max_time"), Field("order", 2))))
    assert (str(error), error.on_command_line) == (
        "max_time must be 5 % of order=2",
        "--max-time must be 5 % of --order 2",
    )
    assert error.fields == ("max_time", "order")
    with pytest.raises(DataError, match=r"^name it with time$") as raised, python_words():
        raise DataError("name it with --time")
    assert raised.value.on_command_line == "name it with --time"


def test_errors_keep_their_kind() -> None:
    with pytest.raises(DataError, match=r"^name it with time$"), python_words():
        raise DataError("name it with --time")
    with pytest.raises(UsageError, match=r"^seed must be a whole number"):
        config_of({"seed": "x"})


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"connect": 3}, "connect must be an address such as 'tcp/HOST:7447', but 3"),
        ({"connect": "tls/h:1", "tls": "x"}, "tls must have the files ca, cert, key"),
        ({"connect": "tls/h:1", "tls": {"key": 1, "foo": 2}}, "tls must have the files ca, cert, key"),
        ({"connect": "tls/h:1"}, "needs certificates; give tls..ca.., tls..cert.., tls..key.."),
    ],
)
def test_addresses_and_files_that_are_none_are_refused(options: dict, sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        submit({"t": [0.0, 1.0], "x": [1.0, 2.0]}, **options)
