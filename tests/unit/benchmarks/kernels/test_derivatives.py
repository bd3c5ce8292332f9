"""The report on derivatives: a line per equation, and the largest ratio at the end."""

import pytest

from benchmarks.kernels.derivatives import main


@pytest.mark.slow
def test_a_line_per_equation_and_the_largest_ratio_are_printed(capsys):
    main(["--system", "bar_magnets", "--system", "pendulum", "--step", "0.1", "--seeds", "1"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[2] for line in lines[1:-1]] == ["dtheta1/dt", "dtheta2/dt", "d2theta/dt2"]
    assert lines[-1].endswith("0 of 3 above 1")


def test_noise_is_passed_on(capsys):
    main(["--system", "bar_magnets", "--step", "0.1", "--seeds", "0-1", "--noise", "0.05"])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 6
    assert float(lines[1].split()[8]) == pytest.approx(0.05, rel=0.3)
