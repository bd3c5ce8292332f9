"""All parts of an analysis together, where numbers are at their limits."""

import warnings

from atoll.analysis.analyse import analyse
from tests.unit.library.analysis.systems import COMPETITION, box


def test_a_box_beyond_all_numbers_gives_no_warnings_of_arithmetic() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        analysis = analyse(COMPETITION.field, box((-1e300, 1e300), (-1e300, 1e300)))
    assert [0.0, 0.0] in [point.point.tolist() for point in analysis.fixed_points.points]


def test_the_data_of_an_analysis_name_constants_by_three_fields() -> None:
    analysis = analyse(COMPETITION.field, box((-1.0, 4.0), (-1.0, 4.0)))
    parameters = analysis.as_dict()["parameters"]
    assert parameters
    assert all([*parameter] == ["name", "variable", "value"] for parameter in parameters)
