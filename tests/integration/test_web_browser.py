"""The browser's side in real headless Chromium, with real programs: what a newcomer does, and what must never happen.

These need Chromium and what `make browser` installs.
"""

import signal
from pathlib import Path

from tests.integration.stage import Stage, check, needs_chromium, shoot
from tests.integration.test_web import web
from tests.programs import started, until

pytestmark = needs_chromium

HOSTILE = "<img src=x onerror=alert(1)>"
NOISY = b"t,x,v,note\n" + b"".join(
    b"%.17g,%.17g,%.17g,%.17g\n" % (0.1 * row, 1 + 0.9**row + 0.01 * (-1) ** row, 0.5 + 0.8**row, 3 - 0.97**row)
    for row in range(200)
)
CLEAN = b"t,x\n" + b"".join(b"%.17g,%.17g\n" % (0.1 * row, 1 + 2 * 0.95**row) for row in range(100))


def test_a_file_is_dropped_corrected_watched_and_reported(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port), started(stage.place, "island_worker", "--connect", stage.address):
        until(stage.page.is_up)
        tab = stage.open()
        tab.get_by_text("island-worker").first.wait_for()  # an empty service says what to do next
        check(tab)
        tab.get_by_role("link", name="New job").click()
        data = stage.place / "my data.csv"
        data.write_bytes(NOISY)
        tab.locator("input[type=file]").set_input_files(data)
        tab.get_by_text("200 rows").wait_for()
        tab.get_by_label("note", exact=False).first.select_option("unused")
        tab.get_by_text("--states x,v").first.wait_for()  # the command says so as well
        tab.locator("canvas").first.wait_for()
        check(tab)
        shoot(tab, "web-new-job")
        tab.get_by_label("Name").fill(HOSTILE)
        tab.get_by_role("button", name="Submit the job").click()
        tab.get_by_role("heading", name=HOSTILE).wait_for()
        job = tab.url.rpartition("/")[2]
        tab.get_by_text("candidates compared so far").or_(
            tab.get_by_role("button", name="Open the report")
        ).first.wait_for()
        tab.get_by_role("button", name="Open the report").wait_for()
        tab.locator("math").first.wait_for()
        check(tab)
        with tab.context.expect_page() as opened:
            tab.get_by_role("button", name="Open the report").click()
        opened.value.get_by_role("heading", level=1).wait_for()
        assert stage.page.ask("GET", f"jobs/{job}/result")[1]["state"] == "done"
        tab.get_by_role("link", name="Workers").click()
        tab.get_by_role("button", name="Cordon").first.wait_for()
        check(tab)
        tab.get_by_role("button", name="Cordon").first.click()
        tab.get_by_text("cordoned").first.wait_for()
        tab.get_by_role("link", name="Coordinator").click()
        tab.get_by_role("button", name="Pause the queue").click()
        tab.get_by_role("button", name="Resume the queue").wait_for()
        check(tab, "light")


def test_two_files_are_one_job_of_which_a_chosen_equation_is_simulated(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port), started(stage.place, "island_worker", "--connect", stage.address):
        until(stage.page.is_up)
        tab = stage.open("#/new")
        paths = [stage.place / name for name in ("one.csv", "two.csv")]
        for path in paths:
            path.write_bytes(CLEAN)
        tab.locator("input[type=file]").set_input_files(paths)
        tab.get_by_text("coordinator submit one.csv two.csv").wait_for()
        tab.get_by_role("combobox", name="Trajectory", exact=True).select_option(label="2")
        tab.get_by_label("Whether x is an angle").select_option("degrees")
        tab.get_by_text("--angle x:deg").wait_for()
        check(tab, "light")
        tab.get_by_label("Whether x is an angle").select_option("no")
        tab.get_by_text("--angle x:deg").wait_for(state="detached")
        tab.get_by_role("button", name="Submit the job").click()
        tab.get_by_role("button", name="Open the report").wait_for()
        tab.get_by_text("Candidates, front and convergence").first.click()
        tab.get_by_text("The front as a table").first.click()
        with tab.expect_request(lambda request: "simulation?pick=x%3D0" in request.url):
            tab.locator("details details table button").first.click()
        tab.get_by_text("Download, with the chosen equations").wait_for()
        tab.get_by_text("chosen: complexity").wait_for()
        with tab.expect_download() as saved:
            tab.get_by_role("button", name="python").click()
        assert "def " in Path(saved.value.path()).read_text("utf-8")
        check(tab, "dark")


def test_a_death_and_its_recovery_are_seen_and_another_job_is_cancelled(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port), started(
        stage.place, "island_worker", "--connect", stage.address
    ) as first:  # fmt: skip
        until(stage.page.is_up)
        stage.page.submit("long", seed="1", target_error="1e-300", max_epochs="100000")
        stage.page.submit("other", seed="2", target_error="1e-300", max_epochs="100000")
        tab = stage.open("#/jobs/long")
        tab.get_by_text("running").first.wait_for()
        first.send_signal(signal.SIGKILL)
        tab.get_by_text("lost", exact=False).first.wait_for()
        with started(stage.place, "island_worker", "--connect", stage.address, "--name", "second"):
            tab.get_by_text("second", exact=False).first.wait_for()
            shoot(tab, "web-recovery")
            tab.get_by_role("button", name="Pause").click()
            tab.get_by_role("button", name="Resume").wait_for()
            tab.get_by_role("link", name="Submit again with changes").click()
            tab.get_by_role("heading", name="Smoothed").wait_for()  # its data are there already
            tab.get_by_text("search", exact=False).filter(has_text="options").first.click()
            tab.get_by_label("--operators").fill("+,-,*,exp")
            tab.get_by_text("--operators +,-,*,exp", exact=False).or_(tab.get_by_text("'+,-,*,exp'")).first.wait_for()
            tab.get_by_role("button", name="Submit the job").click()
            tab.get_by_role("button", name="Cancel").wait_for()
            again = tab.url.rpartition("/")[2]
            assert again not in ("long", "other")
            stage.page.ask("POST", f"jobs/{again}/cancel")
            tab.goto(f"{stage.page.base}/#/jobs/other")
            tab.get_by_role("button", name="Cancel").click()
            tab.get_by_role("button", name="Yes, cancel it").click()
            tab.get_by_text("cancelled").first.wait_for()
            stage.page.ask("POST", "jobs/long/cancel")
            tab.goto(f"{stage.page.base}/#/compare?a=long&b=other")
            tab.get_by_role("heading", name="Compare", exact=False).wait_for()
            check(tab, "light")


def test_pages_heal_when_their_process_was_killed_and_the_seventh_tab_is_live(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port) as process:
        until(stage.page.is_up)
        context = stage.browser.new_context()
        tabs = [stage.open("#/jobs", context) for _ in range(7)]
        stage.page.submit("j1")
        for tab in tabs:
            tab.bring_to_front()
            tab.get_by_text("j1").first.wait_for()
        process.kill()
        process.wait()
        tabs[-1].get_by_text("connection", exact=False).first.wait_for()
    with web(stage.place, stage.address, stage.port):
        until(stage.page.is_up)
        stage.page.submit("j2")
        tabs[-1].get_by_text("j2").first.wait_for()
        stage.page.ask("POST", "jobs/j1/cancel")
        tabs[-1].get_by_role("row").get_by_text("cancelled").wait_for()


def test_without_a_token_the_page_only_looks(stage: Stage) -> None:
    with web(stage.place, stage.address, stage.port, "--look-without-token"):
        until(stage.page.is_up)
        stage.page.submit("j1")
        tab = stage.browser.new_context().new_page()
        stage.tabs.append(tab)
        tab.goto(f"{stage.page.base}/#/jobs/j1")
        tab.get_by_text("read only", exact=False).first.wait_for()
        assert tab.get_by_role("button", name="Cancel").count() == 0
