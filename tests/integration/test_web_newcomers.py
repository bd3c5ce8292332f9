"""New users in real headless Chromium, each with data as people have them, and no stumbling block on the way.

These need Chromium and what `make browser` installs.
"""

import math
import ssl
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browsers import NARROWEST
from tests.certificates import HAS_OPENSSL, Lab
from tests.integration.stage import LIMIT_MS, Stage, check, needs_chromium, shoot
from tests.integration.test_web import TOKEN, Page, _address, _entry, free_port, web
from tests.programs import started, until

pytestmark = needs_chromium

Rates = Callable[[float, tuple[float, ...]], tuple[float, ...]]


def course(rates: Rates, x: tuple[float, ...], rows: int, step: float) -> Iterator[tuple[float, tuple[float, ...]]]:
    """Yield times and states of a system by the Runge-Kutta method, 20 steps for each row."""
    h = step / 20.0

    def moved(by: float, k: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(a + by * b for a, b in zip(x, k, strict=True))

    for row in range(rows):
        yield row * step, x
        for part in range(20):
            t = row * step + part * h
            k1 = rates(t, x)
            k2 = rates(t + h / 2, moved(h / 2, k1))
            k3 = rates(t + h / 2, moved(h / 2, k2))
            k4 = rates(t + h, moved(h, k3))
            x = moved(h / 6, tuple(a + 2 * b + 2 * c + d for a, b, c, d in zip(k1, k2, k3, k4, strict=True)))


def field_notes() -> str:
    """Return counts at two sites with decimal commas, some weeks without a visit and one count that is missing."""
    lines = ["site;week;hares;foxes"]
    for site, start in (("Nordmoor", (3.0, 1.0)), ("Südwald", (1.0, 2.0))):
        for row, (t, (x, y)) in enumerate(
            course(lambda _, z: (z[0] * (1.2 - 0.5 * z[1]), z[1] * (0.4 * z[0] - 0.8)), start, 80, 0.1)
        ):
            if not 40 <= row < 43:
                cells = [f"{value:.6f}".replace(".", ",") for value in (t, x, y)]
                lines.append(";".join([site, cells[0], "" if row == 12 else cells[1], cells[2]]))
    return "\n".join(lines) + "\n"


def motor_log() -> str:
    """Return a log of a motor: time, voltage, current, speed, and a counter that is no state."""

    def rates(t: float, z: tuple[float, ...]) -> tuple[float, ...]:
        return (4.0 * math.sin(1.3 * t) + 5.0 - 2.0 * z[0] - 0.5 * z[1], 3.0 * z[0] - 0.4 * z[1])

    rows = course(rates, (0.0, 0.0), 300, 0.02)
    lines = ["seconds,voltage [V],current [A],speed [rad/s],packet"]
    lines += [
        f"{t:.6g},{4 * math.sin(1.3 * t) + 5:.9g},{i:.9g},{w:.9g},{7 + n % 5}" for n, (t, (i, w)) in enumerate(rows)
    ]
    return "\n".join(lines) + "\n"


def expected(stage: Stage, *statuses: int) -> None:
    """Take answers of these statuses, which the page is to show as sentences, for no complaint."""
    stage.complaints[:] = [text for text in stage.complaints if not text.startswith(tuple(map(str, statuses)))]


def put(stage: Stage, tab: Any, name: str, text: str, encoding: str = "utf-8") -> None:
    (stage.place / name).write_text(text, encoding)
    tab.locator("input[type=file]").first.set_input_files(stage.place / name)


def test_a_role_is_sent_only_where_somebody_chose_it(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port):
        until(stage.page.is_up)
        tab = stage.open("#/new")
        put(stage, tab, "motor.csv", motor_log())
        tab.get_by_role("button", name="Time column: seconds").or_(
            tab.get_by_label("Time column", exact=False)
        ).first.wait_for()
        time = tab.get_by_role("group", name="Corrections")
        assert time.get_by_role("button", name="Time between rows", exact=False).count() == 0, "0.1 is an example"
        proposed = time.get_by_role("button", name="Time column: seconds")
        proposed.click() if proposed.count() else time.get_by_label("Time column").select_option("seconds")
        tab.get_by_text("coordinator submit motor.csv --time seconds", exact=True).wait_for()
        tab.get_by_label("Role of voltage").select_option("input")
        tab.get_by_text("coordinator submit motor.csv --time seconds --inputs voltage", exact=True).wait_for()
        tab.get_by_label("Role of packet").select_option("unused")
        tab.get_by_text("--states current,speed", exact=False).first.wait_for()
        tab.get_by_label("Role of packet").select_option("")
        tab.get_by_text("coordinator submit motor.csv --time seconds --inputs voltage", exact=True).wait_for()
        check(tab, "light")
        expected(stage, 422)


def test_errors_have_buttons_that_mend_them_and_sites_their_names(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port):
        until(stage.page.is_up)
        tab = stage.open("#/new")
        put(stage, tab, "counts.csv", field_notes())
        mending = tab.get_by_role("group", name="Corrections")
        mending.get_by_label("Time column").select_option("week")
        mending.get_by_role("button", name="Missing values: drop").click()
        mending.get_by_label("A new trajectory begins where this column changes").select_option("site")
        tab.get_by_text("Nordmoor, Nordmoor").wait_for()
        assert tab.get_by_role("combobox", name="Role of hares").input_value() == ""
        assert tab.get_by_text("No file chosen").count() == 0
        tab.get_by_text("data", exact=False).filter(has_text="options").first.click()
        tab.get_by_text("Constants may differ between runs").wait_for()
        tab.get_by_label("Held-out trajectories, to test the model").fill("2")
        mending.get_by_role("button", name="Remove “Held-out trajectories, to test the model”").click()
        tab.get_by_text("Nordmoor, Nordmoor").wait_for()
        mending.wait_for(state="hidden")
        expected(stage, 422)


def test_given_equations_are_typeset_as_one_types(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port):
        until(stage.page.is_up)
        tab = stage.open("#/new")
        rows = course(lambda _, z: (z[1], -math.sin(z[0]) - 0.2 * z[1]), (1.0, 0.0), 100, 0.1)
        put(stage, tab, "p.csv", "t,theta,v\n" + "".join(f"{t!r},{x!r},{v!r}\n" for t, (x, v) in rows))
        tab.get_by_text("search", exact=False).filter(has_text="options").first.click()
        field = tab.locator(".field", has_text="Given equations, with parameters and unknown parts")
        field.get_by_role("textbox").fill("dv/dt = -g/l*sin(theta) + ?1(v)\ndtheta/dt = v")
        field.locator("math .unknown").wait_for()
        assert field.locator("math").count() == 2
        field.get_by_role("textbox").fill("dv/dt = -g/l*sin(theta) +")
        field.get_by_text("--equation for 'dv/dt'").wait_for()
        parameters = tab.locator(".field", has_text="Parameters of given equations")
        field.get_by_role("textbox").fill("dv/dt = -g/l*sin(theta) + ?1(v)")
        parameters.get_by_role("textbox").fill("l=2 in 1..\ng=9.81")
        tab.get_by_text("l: at least 1, beginning at 2").wait_for()
        assert field.locator(".fault").is_hidden()
        parameters.get_by_role("textbox").fill("l=2 in 3..")
        parameters.get_by_text("parameter l: the start value 2 is outside").wait_for()
        check(tab, "light")
        expected(stage, 422)


def test_given_equations_of_a_job_are_given_again(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port), started(stage.place, "island_worker", "--connect", stage.address):
        until(stage.page.is_up)
        tab = stage.open("#/new")
        rows = course(lambda _, z: (z[1], -2.0 * z[0] - 0.2 * z[1]), (1.0, 0.0), 100, 0.1)
        put(stage, tab, "p.csv", "t,q,v\n" + "".join(f"{t!r},{x!r},{v!r}\n" for t, (x, v) in rows))
        tab.get_by_text("search", exact=False).filter(has_text="options").first.click()
        tab.get_by_label("Given equations, with parameters").fill("dv/dt = -k*q + ?(v)\ndq/dt = v")
        tab.get_by_label("Parameters of given equations").fill("k=1 in 0.5..9")
        tab.get_by_label("Initial values of states").fill("q=0.5..2")
        tab.get_by_text("k: 0.5 to 9, beginning at 1").wait_for()
        tab.get_by_role("button", name="Submit the job").click()
        tab.get_by_role("button", name="Open the report").wait_for()
        tab.get_by_role("link", name="Submit again with changes").click()
        tab.get_by_text("k: 0.5 to 9, beginning at 1").wait_for()
        tab.get_by_text("search", exact=False).filter(has_text="options").first.click()
        assert tab.get_by_label("Given equations, with parameters").input_value() == "q=v\nv=-k*q + ?(v)"
        assert tab.get_by_label("Parameters of given equations").input_value() == "k=1 in 0.5..9"
        assert tab.get_by_label("Initial values of states").input_value() == "q=0.5..2"
        assert tab.get_by_label("Initial guesses of equations").input_value() == ""


def test_warnings_have_buttons_that_do_what_they_advise(stage: Stage) -> None:
    """A voltage that is switched is made an input that is held, by two buttons; units can be given on a telephone."""
    lines = ["t [ms],voltage [V],current,sample no."]
    current = 0.0
    for row in range(200):
        voltage = 12 if row // 50 % 2 == 0 else 6
        lines.append(f"{10 * row},{voltage},{current:.3f},{row}")
        current += 0.05 * (voltage - 2.0 * current) + 0.01 * math.sin(1e3 * row)
    with web(stage.place, stage.address, stage.port):
        until(stage.page.is_up)
        tab = stage.open("#/new")
        put(stage, tab, "motor.csv", "\n".join(lines) + "\n")
        mending = tab.get_by_role("group", name="Corrections")
        mending.get_by_role("button", name="Inputs: columns without an equation: voltage").click()
        tab.get_by_text("'sample no.' counts the rows", exact=False).wait_for()
        tab.get_by_text("--inputs voltage", exact=False).first.wait_for()
        tab.locator("canvas").first.wait_for()
        shoot(tab, "web-warnings")
        mending.get_by_role("button", name="Inputs that keep their value until the next row: voltage").click()
        tab.get_by_text("--inputs voltage --hold voltage", exact=False).or_(
            tab.get_by_text("--hold voltage --inputs voltage", exact=False)
        ).first.wait_for()
        tab.set_viewport_size({"width": NARROWEST, "height": 900})
        tab.get_by_label("Unit of current").fill("A")
        tab.get_by_label("Unit of current").press("Enter")  # which does not submit the job
        tab.get_by_text("--unit current=A", exact=False).first.wait_for()
        check(tab, "light")
        expected(stage, 422)  # a state that is switched has no derivative


def test_columns_can_be_chosen_whatever_stands_above_them(stage: Stage) -> None:
    """A log with lines of remarks above its header, in the letters of Windows."""
    with web(stage.place, stage.address, stage.port):
        until(stage.page.is_up)
        tab = stage.open("#/new")
        remarks = "Prüfstand 3; Bediener: Müller\nAbtastrate: 50 Hz\n\n"
        put(stage, tab, "zählung.csv", remarks + field_notes().replace("hares", "Füchse"), "cp1252")
        mending = tab.get_by_role("group", name="Corrections")
        mending.get_by_label("Time column").select_option("week")
        mending.get_by_role("button", name="Missing values: drop").click()
        mending.get_by_label("A new trajectory begins where this column changes").select_option("site")
        tab.get_by_text("Nordmoor, Nordmoor").wait_for()
        assert tab.get_by_role("combobox", name="Role of Füchse").is_visible()
        check(tab, "dark")
        expected(stage, 422)


def test_who_has_no_token_gives_it_in_a_field(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port):
        until(stage.page.is_up)
        tab = stage.open("")
        tab.goto(f"{stage.page.base}/?token=the-token-of-yesterday")
        tab.get_by_role("heading", name="Enter the token").wait_for()
        tab.get_by_text("does not accept the token", exact=False).first.wait_for()
        assert tab.get_by_text("Loading…").count() == 0
        check(tab)
        tab.get_by_label("Token").fill("another-wrong-token")
        tab.get_by_role("button", name="Continue").click()
        tab.get_by_text("This token is unknown", exact=False).wait_for()
        tab.get_by_label("Token").fill(f"{stage.page.base}/?token={TOKEN}")
        tab.get_by_role("button", name="Continue").click()
        tab.get_by_text("signed in").wait_for()
        tab.get_by_role("heading", name="No jobs yet").wait_for()
        expected(stage, 401)


def test_a_view_that_could_not_be_loaded_comes_by_itself(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port):
        until(stage.page.is_up)
        tab = stage.open()
        tab.get_by_role("heading", name="No jobs yet").wait_for()
        tab.route("**/*", lambda route: route.abort())
        tab.get_by_role("link", name="Coordinator").click()
        tab.get_by_text("The service does not answer", exact=False).first.wait_for()
        assert tab.get_by_text("Loading…").count() == 0
        tab.unroute_all()
        tab.get_by_text("starts jobs").wait_for()
        tab.get_by_text("The page shows the last known state", exact=False).wait_for(state="detached")


@pytest.mark.slow
def test_an_ecologist_with_two_sites_decimal_commas_and_a_gap(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port), started(stage.place, "island_worker", "--connect", stage.address):
        until(stage.page.is_up)
        tab = stage.open()
        tab.get_by_role("link", name="New job").click()
        put(stage, tab, "counts.csv", field_notes())
        mending = tab.get_by_role("group", name="Corrections")
        mending.get_by_label("Time column").select_option("week")
        mending.get_by_role("button", name="Missing values: drop").click()
        mending.get_by_label("A new trajectory begins where this column changes").select_option("site")
        tab.locator("canvas").first.wait_for()
        tab.get_by_label("Name").fill("hares and foxes")
        tab.get_by_role("button", name="Submit the job").click()
        tab.get_by_role("button", name="Open the report").wait_for(timeout=4 * LIMIT_MS)
        tab.get_by_text("equations that describe how fast hares and foxes change", exact=False).wait_for()
        tab.get_by_text("Dots are measured, lines simulated by the model", exact=False).wait_for()
        tab.get_by_role("region", name="Measured and simulated").locator("canvas").first.wait_for()
        assert tab.get_by_text("Nordmoor", exact=False).first.is_visible()
        check(tab)
        shoot(tab, "web-job")
        with tab.context.expect_page() as opened:
            tab.get_by_role("button", name="Open the report").click()
        opened.value.get_by_text("Atoll looked in", exact=False).wait_for(timeout=4 * LIMIT_MS)
        tab.get_by_role("link", name="Jobs").first.click()
        tab.get_by_text("dhares/dweek = ", exact=False).wait_for()
        expected(stage, 422)


@pytest.mark.slow
def test_an_engineer_with_the_log_of_a_motor(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port), started(stage.place, "island_worker", "--connect", stage.address):
        until(stage.page.is_up)
        tab = stage.open("#/new")
        put(stage, tab, "motor.csv", motor_log().replace("seconds", "t [s]"))
        tab.get_by_label("Role of voltage").select_option("input")
        tab.get_by_label("Role of packet").select_option("unused")
        tab.get_by_text("--inputs voltage", exact=False).first.wait_for()
        tab.locator("canvas").first.wait_for()
        tab.get_by_role("button", name="Submit the job").click()
        tab.get_by_role("button", name="Open the report").wait_for(timeout=4 * LIMIT_MS)
        tab.get_by_text("equations that describe how fast current and speed change", exact=False).wait_for()
        tab.get_by_role("region", name="Measured and simulated").locator("canvas").first.wait_for()
        with tab.expect_download() as saved:
            tab.get_by_role("button", name="matlab").click()
        assert "function" in Path(saved.value.path()).read_text("utf-8")
        check(tab, "light")
        shoot(tab, "web-motor")


@pytest.mark.slow
@pytest.mark.skipif(not HAS_OPENSSL, reason="no openssl")
def test_the_manager_of_a_lab_with_certificates_a_page_and_a_killed_coordinator(
    tmp_path: Path, lab: Lab, browser: Any
) -> None:
    token = "token-of-ann-0123456789"
    roster = str(lab.folder / "roster.toml")
    (tmp_path / "users.toml").write_text(_entry(lab, "ann", token))
    (tmp_path / "users.toml").chmod(0o600)
    port, (authority, certificate, key) = free_port(), lab.files("coordinator")
    context = ssl.create_default_context(cafile=str(authority))
    context.check_hostname = False
    page = Page(f"https://127.0.0.1:{port}", token, context)
    serve = ["serve", "--state", "state", *lab.options("coordinator"), "--roster", roster, "--listen"]
    with started(tmp_path, "coordinator", *serve, "tls/127.0.0.1:0") as first:
        address = _address(first)
        with (
            web(tmp_path, address, port, *lab.options("eve"), "--users", "users.toml", "--cert", str(certificate),
                "--key", str(key)),
            started(tmp_path, "island_worker", "--connect", address, *lab.options("lab1"), "--wait", "600"),
        ):  # fmt: skip
            until(page.is_up)
            tab = browser.new_context(ignore_https_errors=True).new_page()
            tab.set_default_timeout(LIMIT_MS)
            tab.goto(page.base)
            tab.get_by_role("heading", name="Enter the token").wait_for()  # no jobs, and no eternal "Loading…"
            tab.get_by_label("Token").fill(token)
            tab.get_by_role("button", name="Continue").click()
            tab.get_by_text("ann").first.wait_for()
            page.submit("overnight", target_error="1e-300", max_epochs="100000")
            tab.get_by_text("overnight").first.wait_for()
            tab.goto(f"{page.base}/#/jobs/overnight")
            tab.get_by_text("running").first.wait_for()
            first.kill()
            first.wait()
            tab.get_by_text("The page shows the last known state", exact=False).wait_for()
            with started(tmp_path, "coordinator", *serve, address):
                tab.get_by_text("The page shows the last known state", exact=False).wait_for(
                    state="detached", timeout=2 * LIMIT_MS
                )
                tab.get_by_text("running").first.wait_for()
                tab.get_by_role("button", name="Cancel").click()
                tab.get_by_role("button", name="Yes, cancel it").click()
                tab.get_by_text("cancelled").first.wait_for(timeout=2 * LIMIT_MS)
                tab.get_by_role("link", name="Workers").click()
                tab.get_by_text("worker-joined").first.wait_for()
                shoot(tab, "web-workers")
            tab.context.close()
