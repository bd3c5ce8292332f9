"""What `start_on` refuses before anything is sent to a cluster."""

import builtins
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from atoll.workers import start_on
from atoll.workers.start import _options
from atoll_core.errors import UsageError

ADDRESS = "tcp/127.0.0.1:7447"
RAY = ModuleType("ray")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"connect": None}, "connect must be an address such as 'tcp/HOST:7447', but None was given"),
        ({"connect": "tcp://host:7447"}, "address 'tcp://host:7447' was found where tcp/HOST:PORT was expected"),
        ({"workers": 0}, "workers must be a whole number from 1 to 1024, but 0 was given"),
        ({"workers": True}, "workers must be a whole number from 1 to 1024, but True was given"),
        ({"workers": "2"}, "workers must be a whole number from 1 to 1024, but '2' was given"),
        ({"wait": -1}, "wait must be a number of seconds, at least 0, but -1 was given"),
        ({"grace": float("nan")}, "grace must be a number of seconds, at least 0, but nan was given"),
        ({"grace": "30s"}, "grace must be a number of seconds, at least 0, but '30s' was given"),
        ({"tls": {"ca": "a.pem"}}, "tls must have the files ca, cert, key by these names, but"),
        ({"tls": {"ca": "a", "cert": "b", "key": "c"}}, "tcp/127.0.0.1:7447 is not encrypted, but tls was given"),
    ],
)
def test_wrong_arguments_are_named(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(UsageError) as raised:
        start_on(RAY, **{"connect": ADDRESS, **options})
    assert str(raised.value).startswith(sentence)


@pytest.mark.parametrize("client", [None, 3, SimpleNamespace(run=print), ModuleType("dask"), object])
def test_what_is_no_cluster_is_refused(client: object) -> None:
    with pytest.raises(UsageError, match=r"a distributed\.Client, the module ray, or the address of a cluster was exp"):
        start_on(client, connect=ADDRESS)


@pytest.mark.parametrize(
    ("client", "package", "extra"),
    [("tcp://scheduler:8786", "distributed", "dask"), ("auto", "ray", "ray"), ("ray://head:10001", "ray", "ray")],
)
def test_a_package_that_is_missing_is_named(
    client: str, package: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def find(name: str, *_: object) -> ModuleType:
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr("importlib.import_module", find)
    with pytest.raises(UsageError) as raised:
        start_on(client, connect=ADDRESS)
    assert str(raised.value) == (
        f"{package} is not installed, which workers on such a cluster need; pip install 'atoll[{extra}]'"
    )


def test_neither_dask_nor_ray_is_needed_to_import_it() -> None:
    import subprocess
    import sys

    script = (
        "import sys; sys.modules.update(dict.fromkeys(('distributed', 'dask', 'ray')));"
        "import atoll.workers; print(atoll.workers.start_on.__name__)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "start_on\n", done.stderr


def test_what_a_program_is_told_is_plain() -> None:
    files = {"ca": "a.pem", "cert": "c.pem", "key": "k.pem"}
    options = _options("tls/lab:7447", files, 5, 2.5)
    assert (options.connect, options.wait_s, options.grace_s, options.tls) == ("tls/lab:7447", 5.0, 2.5, files)
    kinds = {type(value) for value in (options.connect, options.wait_s, options.grace_s, *options.tls.values())}
    assert kinds <= {getattr(builtins, name) for name in ("str", "float")}
