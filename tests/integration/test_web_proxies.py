"""The page behind what stands between a browser and it: nginx with a prefix, caddy with TLS, Jupyter, a tunnel by ssh.

Each needs its program and is left out without it. Jupyter is `jupyter-server` with jupyter-server-proxy, which
the variable ATOLL_JUPYTER may name in an environment of its own.
"""

import contextlib
import getpass
import os
import shutil
import subprocess
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from tests.integration.stage import LIMIT_MS, Stage, needs_chromium
from tests.integration.test_web import Page, free_port, web
from tests.programs import started, until

pytestmark = [
    needs_chromium,
    pytest.mark.slow,
]

HOST = "lab.localhost"
"""A name that browsers take for this machine, and that the process does not know by itself."""

SYSTEM = f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/local/sbin"
JUPYTER = os.environ.get("ATOLL_JUPYTER") or shutil.which("jupyter-server")
SEPARATION = Path("/run/sshd")
"""Where Debian's sshd separates privileges; the service makes it."""
JUPYTER_TOKEN = "what-jupyter-asks-for"

NGINX = """
user {user}; daemon off; pid {place}/nginx.pid; error_log stderr; events {{}}
http {{
  access_log off; client_body_temp_path {place}/a; proxy_temp_path {place}/b; fastcgi_temp_path {place}/c;
  uwsgi_temp_path {place}/d; scgi_temp_path {place}/e;
  server {{
    listen 127.0.0.1:{port}; client_max_body_size 256m;
    location /atoll/ {{
      proxy_pass http://127.0.0.1:{inside}/; proxy_http_version 1.1; proxy_set_header Host $http_host;
    }}
  }}
}}
"""
CADDY = """
{{
  admin off
  skip_install_trust
  auto_https disable_redirects
  storage file_system {place}/storage
}}
https://{host}:{port} {{
  tls internal
  reverse_proxy 127.0.0.1:{inside}
}}
"""
SSHD = """
Port {port}
ListenAddress 127.0.0.1
HostKey {place}/host
PidFile {place}/sshd.pid
AuthorizedKeysFile {place}/user.pub
StrictModes no
UsePAM no
PermitRootLogin yes
"""


def program(name: str) -> str:
    found = shutil.which(name, path=SYSTEM)
    if found is None:
        pytest.skip(f"no {name}")
    return found


@contextlib.contextmanager
def running(place: Path, *command: str, **variables: str) -> Iterator[None]:
    """Run a program of somebody else's, what it says in a file."""
    with (place / "proxy.log").open("ab") as log:
        process = subprocess.Popen(
            command, cwd=place, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env={**os.environ, **variables}
        )
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:  # caddy waits for streams that are open, as those of a test that fails are
            process.kill()
            process.wait()


def answers(base: str) -> Callable[[], bool]:
    """Return what tells whether anything answers there, whatever it is."""

    def ask() -> bool:
        with contextlib.suppress(OSError):
            try:
                urllib.request.urlopen(base, timeout=5.0).close()
            except urllib.error.HTTPError as error:
                error.close()
            return True
        return False

    return ask


@contextlib.contextmanager
def nginx(place: Path, inside: int) -> Iterator[str]:
    port = free_port()
    (place / "nginx.conf").write_text(NGINX.format(place=place, port=port, inside=inside, user=getpass.getuser()))
    with running(place, program("nginx"), "-c", str(place / "nginx.conf"), "-e", "stderr"):
        until(answers(f"http://127.0.0.1:{port}/"))
        yield f"http://{HOST}:{port}/atoll"


@contextlib.contextmanager
def caddy(place: Path, inside: int) -> Iterator[str]:
    port = free_port()
    (place / "Caddyfile").write_text(CADDY.format(place=place, host=HOST, port=port, inside=inside))
    command = [program("caddy"), "run", "--config", str(place / "Caddyfile"), "--adapter", "caddyfile"]
    with running(place, *command, HOME=str(place), XDG_DATA_HOME=str(place), XDG_CONFIG_HOME=str(place)):
        until(lambda: _listens(port))
        yield f"https://{HOST}:{port}"


@contextlib.contextmanager
def jupyter(place: Path, inside: int) -> Iterator[str]:
    if JUPYTER is None:
        pytest.skip("no jupyter-server")
    port = free_port()
    options = [
        f"--ServerApp.port={port}", "--ServerApp.port_retries=0", "--ServerApp.ip=127.0.0.1", "--no-browser",
        "--allow-root", f"--IdentityProvider.token={JUPYTER_TOKEN}", f"--ServerApp.root_dir={place}",
    ]  # fmt: skip
    folders = {name: str(place) for name in ("HOME", "JUPYTER_RUNTIME_DIR", "JUPYTER_DATA_DIR", "JUPYTER_CONFIG_DIR")}
    with running(place, JUPYTER, *options, **folders):
        until(answers(f"http://127.0.0.1:{port}/api"))
        base = f"http://127.0.0.1:{port}/proxy/{inside}"
        try:
            urllib.request.urlopen(f"{base}/?token={JUPYTER_TOKEN}").close()
        except urllib.error.HTTPError as error:
            pytest.skip(f"no jupyter-server-proxy: {error}")
        yield base


@contextlib.contextmanager
def ssh(place: Path, inside: int) -> Iterator[str]:
    server, client, keys, port, outside = (
        program("sshd"),
        program("ssh"),
        program("ssh-keygen"),
        free_port(),
        free_port(),
    )
    if os.geteuid() == 0 and not SEPARATION.is_dir():
        pytest.skip(f"no {SEPARATION}, without which sshd does not start as root")
    for name in ("host", "user"):
        subprocess.run([keys, "-q", "-t", "ed25519", "-N", "", "-f", str(place / name)], check=True)
    (place / "sshd_config").write_text(SSHD.format(place=place, port=port))
    tunnel = [
        client, "-N", "-L", f"127.0.0.1:{outside}:127.0.0.1:{inside}", "-p", str(port), "-i", str(place / "user"),
        "-o", "StrictHostKeyChecking=no", "-o", f"UserKnownHostsFile={place}/known", "-o", "BatchMode=yes",
        "-o", "ExitOnForwardFailure=yes", "-F", "none", f"{getpass.getuser()}@127.0.0.1",
    ]  # fmt: skip
    with running(place, server, "-D", "-e", "-f", str(place / "sshd_config")):
        until(lambda: _listens(port))
        with running(place, *tunnel):
            until(answers(f"http://127.0.0.1:{outside}/"))
            yield f"http://127.0.0.1:{outside}"


def _listens(port: int) -> bool:
    import socket

    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 5.0):
        return True
    return False


@pytest.mark.parametrize("proxy", [nginx, caddy, jupyter, ssh])
def test_from_the_demo_data_to_a_result_behind(
    proxy: Callable[[Path, int], AbstractContextManager[str]],
    stage: Stage,
) -> None:
    direct, folder = stage.page, stage.place / "proxy"
    folder.mkdir()
    with (
        web(stage.place, stage.address, stage.port, "--allow-host", HOST),
        started(stage.place, "island_worker", "--connect", stage.address),
    ):
        until(direct.is_up)
        with proxy(folder, stage.port) as base:
            stage.page = Page(base)
            context = stage.browser.new_context(ignore_https_errors=True)
            if proxy is jupyter:  # whose cookie lets requests through; the token of the page is the page's
                login = context.new_page()
                login.goto(f"{base.partition('/proxy/')[0]}/api/status?token={JUPYTER_TOKEN}")
            _use(stage.open(context=context), direct)
            context.close()
            stage.tabs.clear()


def _use(tab: Any, direct: Page) -> None:
    """Submit the demo data, watch, take along, and see that what happens is told at once, not when a buffer is full."""
    tab.get_by_role("link", name="Try the demo data").click()
    tab.get_by_role("heading", name="Smoothed").wait_for()
    tab.get_by_label("Name").fill("from outside")
    tab.get_by_role("button", name="Submit the job").click()
    tab.get_by_role("heading", name="from outside").wait_for()
    job = tab.url.rpartition("/")[2]
    tab.get_by_role("button", name="Open the report").wait_for()
    tab.locator("math").first.wait_for()
    with tab.expect_download(timeout=LIMIT_MS) as taken:
        tab.get_by_role("button", name="result.json").click()
    assert '"equations"' in Path(taken.value.path()).read_text("utf-8")
    tab.get_by_text("Event log").click()  # which is folded away once there is a result
    for shared in ("true", "false"):
        change = b'{"shared": %s}' % shared.encode()
        status, _ = direct.ask("PUT", f"jobs/{job}/sharing", change, **{"Content-Type": "application/json"})
        assert status == 200
        tab.get_by_text(
            "all users may see it" if shared == "true" else "only its submitter and admins may see it"
        ).first.wait_for()
    tab.get_by_role("button", name="Share", exact=True).click()
    tab.get_by_role("button", name="Make private").wait_for()
