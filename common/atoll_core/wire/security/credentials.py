"""Certificates: the three files of a program, checks before they are used, and reasons why the other side refuses them.

Before dialling, our certificate is checked by a handshake in memory with a verifier that trusts only our authority.
When the bus cannot connect, it does not say why; a separate TLS handshake with the same files finds the reason.
Contents of keys are never written to a message or a log.
"""

import contextlib
import ipaddress
import socket
import ssl
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, TypedDict, cast

from atoll_core.command_line import TLS_OPTIONS
from atoll_core.errors import RefusedError, UsageError
from atoll_core.wire.security.roles import MAX_NAME
from atoll_core.wire.topics import is_id

Use = Literal["serve", "connect"]

_PROBE_LIMIT_S: Final = 2.0
_NO_CHECK_TIME: Final = 0x200000  # X509_V_FLAG_NO_CHECK_TIME of OpenSSL, which Python does not name

# X509_V_ERR_* of OpenSSL: self-signed, or an issuer that cannot be found; dates; purpose; names.
_FOREIGN: Final = (18, 19, 20, 21)
_UNTIMELY: Final = (9, 10)
_PURPOSE: Final = 26
_NAMES: Final = (62, 64)

_ALERTS: Final = {
    "CERTIFICATE_REQUIRED": "it asks for a certificate and got none",
    "UNKNOWN_CA": "it trusts another authority than the one that issued our certificate {certificate}",
    "CERTIFICATE_EXPIRED": "it finds our certificate {certificate} expired, or its clock is wrong",
    "UNSUPPORTED_CERTIFICATE": "our certificate {certificate} is not meant for workers and clients",
    "BAD_CERTIFICATE": "it does not accept our certificate {certificate}",
    "CERTIFICATE_UNKNOWN": "it does not accept our certificate {certificate}",
    "CERTIFICATE_REVOKED": "our certificate {certificate} has been revoked",
    "DECRYPT_ERROR": "it trusts another authority than the one that issued our certificate {certificate}",
}
"""Meaning of TLS alerts from the other side, by the end of OpenSSL's name."""


@dataclass(frozen=True, slots=True)
class Credentials:
    """Three files that fit each other. `name` is the certificate's common name, `hosts` its alternative names.

    It expires at `expires`, in seconds of Unix time, if known.
    """

    authority: Path
    certificate: Path
    key: Path
    name: str
    hosts: tuple[str, ...] = ()
    expires: float | None = None


class _Certificate(TypedDict, total=False):
    """The used parts of a certificate as ssl returns it: names by kind, times as OpenSSL writes them."""

    subject: tuple[tuple[tuple[str, str], ...], ...]
    subjectAltName: tuple[tuple[str, str], ...]
    notBefore: str
    notAfter: str


def credentials_of(options: Mapping[str, object], environ: Mapping[str, str], use: Use) -> Credentials | None:
    """Return the credentials that the options ``tls_ca``, ``tls_cert``, ``tls_key`` or the environment name, if any.

    Raises:
        UsageError: one of the three is missing, or they cannot work.
    """
    files: dict[str, object] = {}
    for option, (variable, _) in TLS_OPTIONS.items():
        files[option] = options.get(option.lstrip("-").replace("-", "_")) or environ.get(variable)
    missing = [f"{option} (or {TLS_OPTIONS[option][0]})" for option, file in files.items() if not file]
    if len(missing) == len(files):
        return None
    if missing:
        raise UsageError(f"TLS needs three files, but {' and '.join(missing)} is not given")
    authority, certificate, key = (Path(str(file)).absolute() for file in files.values())
    return load(authority, certificate, key, use)


def load(authority: Path, certificate: Path, key: Path, use: Use) -> Credentials:
    """Return the credentials in these files, after all checks that are possible before dialling.

    All files are PEM. Intermediate certificates follow in the file `certificate`; `key` is unencrypted; `use` says
    whether the listening side ("serve") or the dialling side uses them.

    Raises:
        UsageError: a file cannot be read or holds something else; key and certificate do not fit; the certificate was
            issued by another authority, has expired, is for the other side, or has no usable name.
    """
    _check_contents(authority, "--tls-ca", "CERTIFICATE-----", "the certificate of an authority")
    _check_contents(certificate, "--tls-cert", "CERTIFICATE-----", "a certificate")
    if "ENCRYPTED" in _check_contents(key, "--tls-key", "PRIVATE KEY-----", "a private key"):
        raise UsageError(f"the key {key} is encrypted; give --tls-key one that is not, readable by its owner only")
    fields = _verified_fields(authority, certificate, key, use)
    now, first, last = time.time(), fields.get("notBefore"), fields.get("notAfter")
    expires = None if last is None else float(ssl.cert_time_to_seconds(last))
    if expires is not None and now > expires:
        raise UsageError(f"the certificate {certificate} has expired ({last}); renew it with deploy/tls/make-authority")
    if first is not None and now < ssl.cert_time_to_seconds(first):
        raise UsageError(f"the certificate {certificate} is not valid before {first}; check this machine's clock")
    hosts = tuple(_usual_form(kind, name) for kind, name in fields.get("subjectAltName", ()))
    names = [value for part in fields.get("subject", ()) for kind, value in part if kind == "commonName"]
    if use == "serve" and not hosts:
        raise UsageError(
            f"the certificate {certificate} has no subject alternative name, so that it cannot be dialled by name or "
            "address; make one with deploy/tls/make-authority DIR --coordinator HOST,..."
        )
    if len(names) != 1 or not is_id(names[0]) or len(names[0]) > MAX_NAME:
        raise UsageError(
            f"the certificate {certificate} has the common name {', '.join(names)[:100]!r}, but one of 1 to {MAX_NAME} "
            "letters, digits, - and _ was expected"
        )
    return Credentials(authority, certificate, key, names[0], hosts, expires)


def check_welcome(host: str, port: int, credentials: Credentials, listen_s: float) -> str | None:
    """Try a TLS connection with these credentials; return any other problem, None when both sides accept.

    Waits up to `listen_s` seconds for the other side to refuse our certificate.

    Raises:
        RefusedError: one side does not accept the other's certificate, so that trying again would not help.
    """
    context = _context(ssl.PROTOCOL_TLS_CLIENT, credentials.certificate, credentials.key)
    context.load_verify_locations(credentials.authority)
    try:
        with _connect_tls(context, host, port) as connection:
            connection.settimeout(listen_s)
            with contextlib.suppress(TimeoutError):  # with TLS 1.3 a server refuses after the handshake
                connection.recv(1)
    except ssl.SSLCertVerificationError as error:
        raise RefusedError(_rejection_reason(error, host, port, credentials)) from error
    except ssl.SSLError as error:
        for ending, sentence in _ALERTS.items():
            if (error.reason or "").endswith(ending):
                raise RefusedError(sentence.format(certificate=credentials.certificate)) from error
        return "the program that listens there does not speak TLS as a coordinator does"
    except OSError as error:
        return (
            "the program that listens there does not speak TLS"
            if isinstance(error, TimeoutError)
            else str(error).lower()
        )
    return None


def speaks_tls(host: str, port: int) -> bool:
    """Tell whether the server there begins a TLS handshake."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        _connect_tls(context, host, port).close()
    except ssl.SSLError as error:
        return "ALERT" in (error.reason or "")
    except OSError:
        return False
    return True


def _connect_tls(context: ssl.SSLContext, host: str, port: int) -> ssl.SSLSocket:
    plain = socket.create_connection((host, port), timeout=_PROBE_LIMIT_S)
    try:
        return context.wrap_socket(plain, server_hostname=host)
    except BaseException:
        plain.close()
        raise


def _rejection_reason(error: ssl.SSLCertVerificationError, host: str, port: int, credentials: Credentials) -> str:
    if error.verify_code in _NAMES:
        names = _names_of_server(host, port, credentials)
        return f"its certificate is not for {host!r} but for {names}; dial it by one of these"
    if error.verify_code in _FOREIGN:
        return f"its certificate was not issued by the authority in {credentials.authority}"
    if error.verify_code in _UNTIMELY:
        return "its certificate has expired or is not valid yet, or this machine's clock is wrong"
    if error.verify_code == _PURPOSE:
        return "its certificate is not one for a coordinator"
    return f"its certificate was not accepted ({error.verify_message})"


def _names_of_server(host: str, port: int, credentials: Credentials) -> str:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.load_verify_locations(credentials.authority)
    try:
        with _connect_tls(context, host, port) as connection:
            fields = cast(_Certificate, connection.getpeercert() or {})
    except OSError:
        return "other names"
    names = fields.get("subjectAltName", ())
    return ", ".join(_usual_form(kind, name) for kind, name in names)[:300] or "no name at all"


def _check_contents(file: Path, option: str, mark: str, expected: str) -> str:
    try:
        text = file.read_text("ascii", "replace")
    except OSError as error:
        raise UsageError(f"{file} cannot be read ({(error.strerror or str(error)).lower()}); check {option}") from error
    if mark not in text:
        raise UsageError(f"{file} does not hold {expected} in PEM form; check {option}")
    return text


def _verified_fields(authority: Path, certificate: Path, key: Path, use: Use) -> _Certificate:
    """Return our certificate as read by a verifier that trusts `authority`; raises UsageError."""
    try:
        try:
            return _handshake(authority, certificate, key, use, 0)
        except ssl.SSLCertVerificationError as error:
            if error.verify_code not in _UNTIMELY:
                raise
            return _handshake(authority, certificate, key, use, _NO_CHECK_TIME)
    except ssl.SSLCertVerificationError as error:
        raise UsageError(_certificate_error(error, authority, certificate, use)) from error
    except ssl.SSLError as error:
        raise UsageError(f"{certificate} cannot be used for TLS ({error.reason or error}); make a new one") from error


def _handshake(authority: Path, certificate: Path, key: Path, use: Use, flags: int) -> _Certificate:
    """Return our certificate as the verifier of a handshake in memory reads it. Raises ssl.SSLError."""
    server = _context(ssl.PROTOCOL_TLS_SERVER, certificate, key)
    client = _context(ssl.PROTOCOL_TLS_CLIENT, certificate, key)
    client.check_hostname, client.verify_mode = False, ssl.CERT_NONE
    verifier = client if use == "serve" else server
    try:
        verifier.load_verify_locations(authority)
    except ssl.SSLError as error:
        raise UsageError(f"{authority} does not hold the certificate of an authority; check --tls-ca") from error
    verifier.verify_mode = ssl.CERT_REQUIRED
    verifier.verify_flags = ssl.VerifyFlags(verifier.verify_flags | flags)
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = (client.wrap_bio(to_client, to_server), server.wrap_bio(to_server, to_client, server_side=True))
    for _ in range(4):  # TLS 1.3 needs two turns of each side
        for end in ends:
            with contextlib.suppress(ssl.SSLWantReadError):
                end.do_handshake()
    return cast(_Certificate, ends[0 if use == "serve" else 1].getpeercert() or {})


def _context(protocol: int, certificate: Path, key: Path) -> ssl.SSLContext:
    context = ssl.SSLContext(protocol)
    try:
        context.load_cert_chain(certificate, key, password=lambda: "")  # so that OpenSSL does not prompt
    except ssl.SSLError as error:
        if error.reason == "KEY_VALUES_MISMATCH":
            raise UsageError(f"the key {key} does not belong to the certificate {certificate}") from error
        raise UsageError(
            f"{certificate} and {key} are damaged or of an unknown kind ({error.reason or error})"
        ) from error
    return context


def _usual_form(kind: str, name: str) -> str:
    """Return a subject alternative name in its usual form: OpenSSL writes IPv6 addresses at full length."""
    with contextlib.suppress(ValueError):
        return str(ipaddress.ip_address(name)) if kind == "IP Address" else name
    return name


def _certificate_error(error: ssl.SSLCertVerificationError, authority: Path, certificate: Path, use: Use) -> str:
    if error.verify_code in _FOREIGN:
        return f"the certificate {certificate} was not issued by the authority in {authority}; take one folder's files"
    if error.verify_code in _UNTIMELY:
        return f"the authority in {authority} has expired or is not valid yet; make a new one, or check the clock"
    if error.verify_code == _PURPOSE:
        users = "a coordinator" if use == "serve" else "workers and clients"
        return f"the certificate {certificate} is not one for {users} (its extended key usage says so); use another"
    return f"the certificate {certificate} was not accepted ({error.verify_message}); make a new one"
