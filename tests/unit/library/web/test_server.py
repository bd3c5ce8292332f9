"""Where the process listens and who its users are: mistakes are one sentence each, and code 2."""

import hashlib
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from starlette.datastructures import Headers

from atoll.web.server import Listener, access_of, serve
from atoll_core.errors import UsageError
from atoll_core.wire.addresses import destination
from tests.certificates import Lab

HERE = Listener("127.0.0.1", 0)
AT = destination("tcp/127.0.0.1:1")


def entry(name: str, **fields: str) -> str:
    """Return an entry of a file of users; fields are TOML."""
    digest = hashlib.sha256(name.encode()).hexdigest()
    given = {"token_sha256": f'"{digest}"', "tls_ca": '"ca.pem"', "tls_cert": '"a.pem"', "tls_key": '"a.key"'} | fields
    return f"[{name}]\n" + "".join(f"{key} = {value}\n" for key, value in given.items() if value)


def users(place: Path, text: str | bytes, mode: int = 0o600) -> Path:
    file = place / "users.toml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    file.chmod(mode)
    return file


@pytest.mark.parametrize(
    ("text", "mode", "said"),
    [
        ("[ann", 0o600, "is not valid TOML"),
        (b"\xff", 0o600, "is not valid TOML"),
        ("", 0o600, "names no user"),
        ("ann = 1", 0o600, "ann needs exactly the keys tls_ca, tls_cert, tls_key, token_sha256, as texts"),
        (entry("ann", tls_ca="1"), 0o600, "ann needs exactly the keys tls_ca"),
        (entry("ann", tls_key=""), 0o600, "ann needs exactly the keys tls_ca"),
        (entry("ann", more='"x"'), 0o600, "needs exactly the keys"),
        (entry("ann") + entry("ann"), 0o600, "is not valid TOML"),
        (entry("ann", token_sha256='""'), 0o600, "token_sha256 of ann is no SHA-256"),
        (entry("ann", token_sha256='"a-token-in-clear"'), 0o600, "token_sha256 of ann is no SHA-256"),
        (
            entry("ann", token_sha256=f'"{hashlib.sha256(b"").hexdigest()}"'),
            0o600,
            "token_sha256 of ann is no SHA-256",
        ),
        (entry("ann"), 0o600, "ann: "),
        (entry("ann", tls_ca='"\\u0000"'), 0o600, "ann: "),
        (entry("ann"), 0o604, "run: chmod 600"),
        (entry("ann"), 0o620, "run: chmod 600"),
    ],
)
def test_a_mistake_in_the_file_of_users_is_said_in_a_sentence(text, mode, said, tmp_path) -> None:
    with pytest.raises(UsageError) as raised:
        access_of(HERE, AT, "t" * 16, users(tmp_path, text, mode))
    assert (said in str(raised.value), "\n" in str(raised.value), raised.value.exit_code) == (True, False, 2)


def test_two_users_have_two_tokens(lab: Lab, tmp_path) -> None:
    encrypted = destination("tls/127.0.0.1:1", lab.unchecked("ann"))
    authority, certificate, key = (f'"{file}"' for file in lab.files("ann"))
    files = {"tls_ca": authority, "tls_cert": certificate, "tls_key": key}
    digest = f'"{hashlib.sha256(b"one").hexdigest()}"'
    both = entry("ann", token_sha256=digest, **files) + entry("bob", token_sha256=digest.upper(), **files)
    with pytest.raises(UsageError, match="bob has the token of another user"):
        access_of(HERE, encrypted, "t" * 16, users(tmp_path, both))
    assert len(access_of(HERE, encrypted, "t" * 16, users(tmp_path, entry("ann", **files))).gateways) == 2


def test_a_file_of_users_that_is_not_there_is_said_so(tmp_path) -> None:
    for file in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(UsageError, match="cannot be read"):
            access_of(HERE, AT, "t" * 16, file)


@pytest.mark.parametrize("content", [None, b"no certificate"])
def test_what_is_no_certificate_of_the_page_is_said_so_before_an_address_is(content, tmp_path) -> None:
    file = tmp_path / "cert.pem"
    if content is not None:
        file.write_bytes(content)
    listener, said = Listener("127.0.0.1", 0, (), str(file), str(file)), list[str]()
    with pytest.raises(UsageError, match=r"cert\.pem cannot be used"):
        serve(listener, access_of(listener, AT, "t" * 16, None), said.append)
    assert said == []


def test_nobody_looks_without_a_token_unless_it_is_asked_for(lab: Lab) -> None:
    assert access_of(HERE, AT, "t" * 16, None).viewer is None
    assert access_of(HERE, AT, "t" * 16, None, look_without_token=True).viewer is not None


def test_nobody_looks_without_a_token_through_credentials_of_others_or_a_proxy(lab: Lab, tmp_path) -> None:
    encrypted = destination("tls/127.0.0.1:1", lab.unchecked("ann"))
    authority, certificate, key = (f'"{file}"' for file in lab.files("ann"))
    file = users(tmp_path, entry("ann", tls_ca=authority, tls_cert=certificate, tls_key=key))
    elsewhere = Listener("0.0.0.0", 0, (), "cert.pem", "key.pem")
    proxied = Listener("127.0.0.1", 0, ("lab.example",))
    for listener, at, of in (
        (HERE, encrypted, None), (HERE, encrypted, file), (elsewhere, AT, None), (proxied, AT, None),
    ):  # fmt: skip
        assert access_of(listener, at, "t" * 16, of).viewer is None
        with pytest.raises(UsageError, match="--look-without-token shows all jobs"):
            access_of(listener, at, "t" * 16, of, look_without_token=True)


@pytest.mark.parametrize("host", ["::1", "fd00::5", "fd00:0::5", "[fd00::5]", "127.0.0.2", "localhost"])
def test_a_listener_is_called_as_the_address_that_it_prints(host) -> None:
    listener = Listener(host.strip("[]"), 0, (host,), "cert.pem", "key.pem")
    printed = urlsplit(listener.url(7480)).netloc
    allowed = access_of(listener, AT, "t" * 16, None)
    problem = allowed.problem("GET", "/", Headers({"host": printed}))
    assert problem is None
