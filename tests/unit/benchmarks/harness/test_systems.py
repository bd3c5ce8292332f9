"""The generator of the paper's systems."""

import numpy as np
import pytest
import sympy

from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig
from benchmarks.harness.systems import SYSTEMS, TRUTH, main, trajectories


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_text_of_the_truth_is_the_field_that_is_solved(name):
    states = sympy.symbols(list(TRUTH[name]))
    for point in ((0.7, 1.3), (2.1, -0.4)):
        slopes = SYSTEMS[name].field(*point)
        for text, slope in zip(TRUTH[name].values(), slopes, strict=True):
            value = sympy.sympify(text).subs(dict(zip(states, point, strict=True)))
            assert float(value) == pytest.approx(float(slope), rel=1e-12)


def test_the_command_writes_files_that_are_read_back_exactly(tmp_path, capsys):
    main(["--system", "pendulum", "--step", "0.5", "--out", str(tmp_path)])
    assert capsys.readouterr().out == f"{tmp_path / 'pendulum.csv'}\n"
    table = read_table([tmp_path / "pendulum.csv"], DataConfig())
    assert table.names == ("trajectory", "t", "theta")
    values = np.concatenate(trajectories("pendulum", 0.5).values)
    assert table.column("theta").tolist() == values[:, 0].tolist()
