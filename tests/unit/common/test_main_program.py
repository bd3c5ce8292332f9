"""How both programs end: by Ctrl-C at any moment with exit code 130 and without a traceback."""

import signal
import subprocess
import sys
import time

import pytest

PROGRAM = """
import os, sys
package, *words = sys.argv[1:]
sys.argv[1:] = words
main = __import__(package + ".__main__", fromlist=["main"]).main
try:
    os.write(1, b"begun\\n")
    main()
except KeyboardInterrupt:  # before there is a handler of ours
    os._exit(130)
"""
"""Runs a program from its entry on; what Python does before that cannot be guarded, and is not looked at."""


@pytest.mark.parametrize("words", [["atoll", "jobs"], ["atoll", "run", "--help"], ["atoll_island_worker", "--help"]])
def test_an_interrupt_at_any_moment_is_exit_code_130_without_a_traceback(words: list[str]) -> None:
    codes = set()
    for delay_ms in (0, 1, 2, 3, 5, 7, 10, 14, 20, 28, 40, 56, 80, 113, 160):
        command = [sys.executable, "-c", PROGRAM, *words]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"begun\n"
            time.sleep(delay_ms / 1000.0)  # not to synchronise: any moment will do
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=60.0)
        assert b"Traceback" not in said
        assert b"Exception ignored" not in said
        codes.add(process.returncode)
    assert 130 in codes
    assert codes <= {0, 2, 130}


def test_how_children_end_is_known_although_a_parent_ignores_it() -> None:
    """An ignored SIGCHLD is inherited; the system then forgets how children ended, and that they were there."""
    program = (
        "import signal, subprocess, sys\n"
        "signal.signal(signal.SIGCHLD, signal.SIG_IGN)\n"
        "code = 'import subprocess, sys; from atoll_core.signals import reap_children; reap_children(); '\n"
        'code += \'print(subprocess.run([sys.executable, "-c", "raise SystemExit(7)"]).returncode)\'\n'
        "sys.stdout.write(subprocess.run([sys.executable, '-c', code], stdout=subprocess.PIPE, text=True).stdout)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "7", done.stderr


@pytest.mark.slow
def test_a_worker_goes_on_when_a_child_dies_although_a_parent_ignores_that() -> None:
    """The supervisor of two workers waits for a coordinator, and for a child whose death nobody told the system of."""
    program = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGCHLD, signal.SIG_IGN)\n"
        "words = ['--connect', 'tcp/127.0.0.1:1', '--processes', '2', '--wait', '0.1']\n"
        "os.execv(sys.executable, [sys.executable, '-m', 'atoll_island_worker', *words])\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 3, done.stderr
    assert "Traceback" not in done.stderr
