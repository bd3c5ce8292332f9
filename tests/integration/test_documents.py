"""Every code block of README and documentation does what its page says, or stands in `NOT_RUN` with the reason.

A page is followed from its first block to its last in a folder of its own, which holds the examples, some files of
"your own data" and a saved result `runs/JOB`. All of it happens in this process but for one coordinator with one
worker, started as the page on several machines says: `run` is `submit` to it, and the service that Python starts is
this one. A job that was run before, on the same data with the same options, is not run again.
"""

import contextlib
import io
import json
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
import traceback
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

from atoll.api import discover as session
from atoll.cli.main import main
from atoll.cli.parser import parse
from atoll.cli.request import config_of
from atoll.cli.result_files import REPORT, write_report, write_result
from atoll.terminal.output import say
from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.result.result import Result
from atoll_coordinator.service.scheduling.limits import Limits, read_limits
from atoll_core.config import DataConfig
from tests.integration.test_processes import started
from tests.unit import documents
from tests.unit.documents import ROOT, Block

SPECIES = "examples/lotka_volterra.csv"
SOURCES = ("common", "coordinator", "island_worker")
OWN_DATA = ("measurements.csv", "other.csv", "more.csv")
"""Files that pages name as the reader's own."""

NOT_RUN = {
    # commands
    r"make ": "installs, or runs these tests; tests/unit/test_project.py looks whether the target exists",
    r"docker |ATOLL_PUBLISH=.* docker ": "needs Docker: make deploy-rehearsal STEPS=compose",
    r"kubectl ": "needs Kubernetes: make deploy-rehearsal STEPS=kubernetes",
    r"srun ": "needs Slurm: make deploy-rehearsal STEPS=slurm",
    r"coordinator run position.csv": "of data that the page lacks: tests/unit/coordinator/model/hidden",
    r"coordinator run pendulums.csv": "of data that the page lacks: tests/integration/test_parameters_by_run.py",
    r".* --inputs planned.csv": "of inputs that the page lacks: tests/unit/library/experiments/test_forecast.py",
    r"coordinator compare ": "needs results with candidates: tests/unit/library/cli/verbs/test_results.py",
    r"sbatch ": "needs Slurm: make deploy-rehearsal STEPS=slurm",
    r"python3 -m venv |pip ": "installs from the network: make test-wheel",
    r"make-authority |cd ": "tests/unit/test_make_authority.py runs it",
    r".* tls/": "needs these certificates: tests/integration/test_security.py and test_python_api.py",
    r"coordinator serve |island-worker": "runs while all pages are followed",
    r"coordinator web |curl |ssh |.* https://": "needs a page that is there: tests/integration/test_web.py",
    r"\[ann\]": "users of a page: tests/unit/library/web/test_access.py",
    r"location |export |lab.example": "settings of proxies: tests/integration/test_web_proxies.py",
    r"coordinator adapt ": "needs Slurm: make deploy-rehearsal STEPS=adapt",
    r"coordinator (backup|restore) ": "needs a store: tests/integration/test_standby.py runs them",
    r"coordinator (pause|resume|priority|share|retry) ": "tests/simulation/test_sharing.py",
    r"coordinator (queue|cordon|drain|uncordon)": "tests/unit/library/cli/verbs/test_jobs.py",
    r"coordinator router ": "tests/unit/library/cli/verbs/test_serve.py runs it",
    r".* --paths ": "needs the result of a process: tests/unit/library/cli/verbs/test_results.py",
    r".* --group NAME": "needs a result with groups: tests/unit/library/report/test_page.py",
    # Python
    r"import atoll\nimport atoll\.workers": "needs a cluster of Dask or Ray: tests/integration/test_cluster_workers.py",
    # outputs
    r"limit cycles as c3 varies": "minutes of another system: tests/unit/library/analysis/test_cycle_continuation.py",
    r"identifiability \(95 %": "of data that the page does not have: tests/unit/library/experiments",
    r"candidates, with constants": "of data that the page does not have: tests/unit/library/experiments",
    r"dhare/dyear: ": "of the run that examples/quotes.py makes: tests/integration/test_quotes.py",
    r"dx/dt = 0.534067": "of data that the page lacks: tests/unit/coordinator/model/inference/test_groups.py",
    r"dx/dt = x\*\(1\.5 - y\)": "of data that the page does not have: tests/unit/coordinator/test_units.py",
    r"dv/dt = -9\.81/1\.29957": "of data that the page does not have: tests/integration/test_given_equations.py",
    r"dv/dt = -9\.81/l\*sin": "of data that the page lacks: tests/integration/test_parameters_by_run.py",
    r"dc/dt = -0\.2985": "of another page's job: docs/how-to/known-part-examples.md",
    r"coordinator: trajectory 1: 4": "of data that the page lacks: tests/unit/library/experiments/test_smoothing.py",
    r"coordinator: the forecast is": "of data that the page lacks: tests/unit/library/experiments/test_forecast.py",
    r"warning: Trajectories were simulated in pieces": "a search of chaotic data: benchmarks/RESULTS.md",
    r"1 equation would be searched:": "shown by --dry-run: tests/unit/coordinator/data/test_outline.py",
    r"site A: workers": "a drawing",
}
"""Why a command, Python or a printed text is not tried here, by how it begins."""

DOCUMENTS = documents.texts()
BLOCKS = {name: documents.blocks(name, text) for name, text in DOCUMENTS.items()}
PAGES = [name for name, blocks in BLOCKS.items() if blocks]

_FUNCTIONS = """\
set -eu
said() { printf '%s\\0' "${ATOLL_CONNECT:-}" "$@" $'\\x01'; }
for program in coordinator island-worker make docker kubectl sbatch srun python python3 pip make-authority cd; do
  eval "$program() { said $program \\"\\$@\\"; }"
done
"""
"""In which the programs write down what they are called with."""


class Command(NamedTuple):
    """A command as the shell understands it, and the coordinator that the environment names."""

    connect: str
    words: list[str]

    @property
    def text(self) -> str:
        return " ".join(self.words)


def test_every_block_names_its_language() -> None:
    assert [
        block[:3] for blocks in BLOCKS.values() for block in blocks if block.language not in documents.LANGUAGES
    ] == []


def test_every_reason_is_needed_and_names_what_is_there() -> None:
    texts = [command.text for blocks in BLOCKS.values() for block in blocks for command in commands(block)]
    texts += [block.output[0] for blocks in BLOCKS.values() for block in blocks if block.language == "text"]
    texts += [block.text for blocks in BLOCKS.values() for block in blocks if block.language in ("python", "toml")]
    assert [pattern for pattern in NOT_RUN if not any(re.match(pattern, text) for text in texts)] == []
    named = [name for reason in NOT_RUN.values() for name in re.findall(r"tests/[\w/.]+|benchmarks/[\w/.]+", reason)]
    assert [name for name in named if not (ROOT / name).exists()] == []


@cache
def commands(block: Block) -> tuple[Command, ...]:
    """Return the commands of a block, as bash understands it."""
    script = block.text
    if block.language == "console":
        script = "\n".join(line[2:] for line in script.splitlines() if line.startswith("$ "))
    elif block.language != "sh":
        return ()
    script = re.sub(
        r"(?<![\w/.-])(?:[\w.-]+/)+(?=(?:coordinator|island-worker|python|pip|make-authority) )", "", script
    )
    shell = shutil.which("bash")
    if shell is None:
        pytest.skip("no bash to read the commands of pages")
    done = subprocess.run([shell, "-c", _FUNCTIONS + "id=one\n" + script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, (block, done.stderr)
    said = (words.removesuffix("\0").split("\0") for words in done.stdout.split("\x01\0")[:-1])
    return tuple(Command(connect, words) for connect, *words in said)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator["Service"]:
    """A coordinator and a worker, as the page on several machines starts them."""
    serve, work, _ = (command.words[1:] for command in commands(BLOCKS["docs/how-to/several-machines.md"][0]))
    place = tmp_path_factory.mktemp("pages")
    serve = [word.replace("0.0.0.0:7447", "127.0.0.1:0") for word in serve]
    with started(place, "coordinator", *serve) as coordinator:
        assert coordinator.stdout is not None
        line = next(line for line in coordinator.stdout if "island-worker --connect" in line)
        address = line.split("--connect ")[1].split()[0]
        work = [word.replace("tcp/192.168.1.5:7447", address) for word in work]
        with started(place, "island_worker", *work, "--processes", "1"):
            yield Service(address, place)


class Service:
    """The coordinator of these tests, and what its jobs have found."""

    def __init__(self, address: str, place: Path) -> None:
        self.address = address
        self._place = place
        self._found: dict[tuple[object, ...], tuple[dict[str, Any], str]] = {}

    def run(self, words: list[str]) -> int:
        """Do what ``run`` does with these words, by a job that is run once."""
        options = parse(["run", *words])
        kept = _without(words, {"--out": 2, "--workers": 2, "--report": 1})
        key = (*(Path(word).read_bytes() if word in options.data else word for word in kept),)
        if key not in self._found:
            made = self._place / f"job-{len(self._found)}"
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                assert main(["submit", *kept, "--out", str(made), "--connect", self.address]) == 0
            self._found[key] = json.loads((made / "result.json").read_text("utf-8")), printed.getvalue()
        result, text = self._found[key]
        folder = Path(options.out or f"runs/{len(list(Path().glob('runs/*')))}")
        write_result(folder, Result.of(result))
        if options.report:
            write_report(folder / REPORT, Result.of(result))
        say(text)
        return 0


def _without(words: list[str], options: dict[str, int]) -> list[str]:
    """Return words without these options, each of so many words."""
    if not words:
        return []
    length = options.get(words[0], 0)
    return _without(words[length:], options) if length else [words[0], *_without(words[1:], options)]


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_a_page_does_what_it_says(page: str, service: Service, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    local = SimpleNamespace(workers=1, is_alive=True, endpoint=service.address, close=lambda: None)
    monkeypatch.setattr(session, "_services", {1: local})
    reader = Reader(service, monkeypatch)
    for block in BLOCKS[page]:
        reader.follow(block)


class Reader:
    """Somebody who follows a page in the current folder: names of Python, what was printed, the job of the page."""

    def __init__(self, service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
        self._service = service
        self._monkeypatch = monkeypatch
        self._names: dict[str, Any] = {"__name__": "page"}
        self._printed: list[str] = []
        self._job = ""
        Path("examples").symlink_to(ROOT / "examples")
        head, *rows = (ROOT / SPECIES).read_text("utf-8").splitlines(keepends=True)
        for name in OWN_DATA:  # a tenth of the rows: what costs most grows with them
            Path(name).write_text(head + "".join(rows[::10]), "utf-8")

    def follow(self, block: Block) -> None:
        """Do what a block says."""
        for command in commands(block):
            if not is_excused(command.text):
                self._run(block, command)
        if block.language in ("text", "console") and not is_excused(block.output[0]):
            assert [line for line in block.output if line not in self._printed] == [], (block, self._printed)
        if block.language in ("csv", "mermaid", "python", "toml") and not is_excused(block.text):
            getattr(self, f"_{block.language}")(block)

    def _run(self, block: Block, command: Command) -> None:
        """Run a command of ours in this process."""
        words = [self._meant(word) for word in command.words]
        if command.connect:
            self._monkeypatch.setenv("ATOLL_CONNECT", self._service.address)
        self._monkeypatch.setattr(sys, "argv", words)
        if any(word.startswith(("runs/JOB", "runs/ID", "result.json")) for word in words):
            self._save_results()
        code, printed = output_of(lambda: self._call(words))
        self._printed += printed
        assert code == 0, (block.page, block.line, words, printed[-5:])
        if "--no-wait" in words:
            self._job = printed[-1]

    def _call(self, words: list[str]) -> int:
        if words[:2] == ["python", "-m"]:
            self._monkeypatch.setattr(sys, "argv", words[2:])
            for name in (words[2], f"{words[2]}.__main__"):  # another test may have imported it
                self._monkeypatch.delitem(sys.modules, name, raising=False)
            runpy.run_module(words[2], run_name="__main__")
            return 0
        assert words[0] == "coordinator", words
        return self._service.run(words[2:]) if words[1] == "run" else main(words[1:])

    def _meant(self, word: str) -> str:
        """Return a word with what the page leaves open: the address, the job, a folder."""
        word = re.sub(r"^tcp/[\w.]+:\d+$|^tcp/[abc]:\d+$", self._service.address, word)
        return {"ID": self._job, "DIR": "made"}.get(word, word)

    def _save_results(self) -> None:
        """Save the result of two competing species where pages have that of their reader."""
        for name in ("runs/JOB", "runs/ID"):
            if not Path(name).exists():
                output_of(lambda name=name: self._service.run([OWN_DATA[0], "--out", name]))  # type: ignore[misc]
        Path("result.json").unlink(missing_ok=True)
        Path("result.json").symlink_to("runs/JOB/result.json")

    def _python(self, block: Block) -> None:
        if "runs/JOB" in block.text:
            self._save_results()
        code = compile("\n" * block.line + block.text, str(ROOT / block.page), "exec")
        outcome, printed = output_of(lambda: exec(code, self._names))
        self._printed += printed
        assert outcome is None, (block.page, block.line, printed)

    def _csv(self, block: Block) -> None:
        Path("block.csv").write_text(block.text, "utf-8")
        header, *rows = (line.split(",") for line in block.text.splitlines())
        is_long = header[0] in ("variable", "observableId")  # a row a measurement, which becomes a column of each name
        expected = {row[0] for row in rows} | {"time"} if is_long else set(header)
        assert expected <= set(read_table([Path("block.csv")], DataConfig()).names)

    def _toml(self, block: Block) -> None:
        if tomllib.loads(block.text).keys() <= Limits.model_fields.keys():
            Path("limits.toml").write_text(block.text, "utf-8")
            assert (
                read_limits(Path("limits.toml")).model_dump(exclude_unset=True).keys()
                == tomllib.loads(block.text).keys()
            )
            return
        Path("job.toml").write_text(block.text, "utf-8")
        config = config_of(parse(["run", "x.csv", "--config", "job.toml"]))
        assert config.model_dump(mode="json", exclude_defaults=True) == tomllib.loads(block.text)

    def _mermaid(self, block: Block) -> None:
        sources = [str(path) for root in SOURCES for path in (ROOT / root).rglob("*.py")]
        named = re.findall(r"[\w/]*\w\.py", block.text)
        assert [name for name in named if not any(source.endswith(f"/{name}") for source in sources)] == []


def is_excused(text: str) -> bool:
    """Tell whether something has a reason not to be tried."""
    return any(re.match(pattern, text) for pattern in NOT_RUN)


def output_of(work: Any) -> tuple[Any, list[str]]:
    """Do `work`; return what it returns, and the lines that it prints on stderr and stdout."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            outcome = work()
        except SystemExit as end:  # after --help
            outcome = end.code or 0
        except Exception:
            traceback.print_exc()
            outcome = "failed"
    return outcome, [line.strip() for line in (err.getvalue() + out.getvalue()).splitlines()]
