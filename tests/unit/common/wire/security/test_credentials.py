"""Certificates are looked at before anybody is dialled, and whatever is wrong is one sentence."""

from pathlib import Path

import pytest

from atoll_core.errors import UsageError
from atoll_core.wire.addresses import destination
from atoll_core.wire.security.credentials import credentials_of, load
from tests.certificates import Lab


def test_good_files_tell_whose_they_are(lab: Lab) -> None:
    assert load(*lab.files("ann"), use="connect").name == "ann"
    hosts = load(*lab.files("coordinator"), use="serve").hosts
    assert hosts == ("lab.example", "localhost", "127.0.0.1", "::1")


def test_options_go_before_the_environment_and_all_three_are_needed(lab: Lab) -> None:
    variables = dict(zip(("ATOLL_TLS_CA", "ATOLL_TLS_CERT", "ATOLL_TLS_KEY"), map(str, lab.files("ann")), strict=True))
    credentials = credentials_of({"tls_ca": None, "tls_cert": None}, variables, "connect")
    assert credentials is not None
    assert credentials.name == "ann"
    _, certificate, key = map(str, lab.files("bob"))
    credentials = credentials_of({"tls_cert": certificate, "tls_key": key}, variables, "connect")
    assert credentials is not None
    assert credentials.name == "bob"
    assert credentials_of({}, {}, "connect") is None
    with pytest.raises(
        UsageError, match=r"--tls-ca \(or ATOLL_TLS_CA\) and --tls-key \(or ATOLL_TLS_KEY\) is not given"
    ):
        credentials_of({"tls_cert": certificate}, {}, "connect")


def test_files_that_are_not_there_or_hold_something_else_are_named(lab: Lab, tmp_path: Path) -> None:
    authority, certificate, key = lab.files("ann")
    with pytest.raises(UsageError, match=r"nowhere.pem cannot be read \(no such file or directory\); check --tls-key"):
        load(authority, certificate, tmp_path / "nowhere.pem", "connect")
    with pytest.raises(UsageError, match="does not hold a private key in PEM form; check --tls-key"):
        load(authority, certificate, certificate, "connect")
    with pytest.raises(UsageError, match="does not hold the certificate of an authority in PEM form; check --tls-ca"):
        load(key, certificate, key, "connect")
    garbage = tmp_path / "garbage.pem"
    garbage.write_text("-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n")
    with pytest.raises(UsageError, match="damaged or of an unknown kind"):
        load(authority, garbage, key, "connect")
    with pytest.raises(UsageError, match="does not hold the certificate of an authority; check --tls-ca"):
        load(garbage, certificate, key, "connect")


def test_a_key_of_another_certificate_or_an_encrypted_one_is_refused(lab: Lab, tmp_path: Path) -> None:
    authority, certificate, _ = lab.files("ann")
    with pytest.raises(UsageError, match="does not belong to the certificate"):
        load(authority, certificate, lab.files("bob")[2], "connect")
    encrypted = tmp_path / "key.pem"
    encrypted.write_text("-----BEGIN ENCRYPTED PRIVATE KEY-----\nAAAA\n-----END ENCRYPTED PRIVATE KEY-----\n")
    with pytest.raises(UsageError, match="is encrypted"):
        load(authority, certificate, encrypted, "connect")


def test_a_certificate_of_another_authority_is_refused_before_dialling(lab: Lab, other_lab: Lab) -> None:
    _, certificate, key = lab.files("ann")
    with pytest.raises(UsageError, match="was not issued by the authority in"):
        load(other_lab.files("ann")[0], certificate, key, "connect")


@pytest.mark.parametrize(
    ("name", "usage", "days", "subject", "use", "reason"),
    [
        ("old", "clientAuth", -1, None, "connect", r"has expired \(.* GMT\)"),
        ("wrong", "serverAuth", 1, None, "connect", "is not one for workers and clients"),
        ("client", "clientAuth", 1, None, "serve", "is not one for a coordinator"),
        ("nameless", "clientAuth", 1, "/O=lab", "connect", "one of 1 to 48 letters"),
        ("spaced", "clientAuth", 1, "/CN=two words", "connect", "'two words'"),
        ("hostless", "serverAuth", 1, None, "serve", "no subject alternative name"),
    ],
)
def test_a_certificate_that_cannot_work_is_refused_with_its_reason(
    lab: Lab, name: str, usage: str, days: int, subject: str | None, use: str, reason: str
) -> None:
    certificate, key = lab.issue(name, usage, days, subject)
    with pytest.raises(UsageError, match=reason) as caught:
        load(lab.files("ann")[0], certificate, key, use)  # type: ignore[arg-type]
    assert "PRIVATE" not in str(caught.value)


def test_addresses_and_certificates_go_together(lab: Lab) -> None:
    credentials = load(*lab.files("ann"), use="connect")
    assert str(destination("tls/lab.example:7447", credentials)) == "tls/lab.example:7447"
    with pytest.raises(UsageError, match="needs certificates; give --tls-ca"):
        destination("tls/lab.example:7447")
    with pytest.raises(UsageError, match=r"is not encrypted, but TLS files were given; write tls/lab\.example:7447"):
        destination("tcp/lab.example:7447", credentials)
