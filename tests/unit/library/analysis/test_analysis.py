"""All parts of an analysis together, where numbers are at their limits."""

import warnings

from atoll.analysis.analysis import analyse
from tests.unit.library.analysis.systems import COMPETITION, box


def test_a_box_beyond_all_numbers_gives_no_warnings_of_arithmetic() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        analysis = analyse(COMPETITION.field, box((-1e300, 1e300), (-1e300, 1e300)))
    assert [0.0, 0.0] in [point.point.tolist() for point in analysis.fixed_points.points]
