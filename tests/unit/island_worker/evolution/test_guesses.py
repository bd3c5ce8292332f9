"""How a first population takes in the guesses, and how an equation keeps to its variables and operators."""

import numpy as np

from atoll_core.config import EvolutionConfig, PredictorConfig, PriorConfig, SpaceConfig
from atoll_core.expression.operators import BY_NAME, CONSTANT, VARIABLE
from atoll_core.expression.program import Program
from atoll_core.search.seeding import Stream, stream_key
from atoll_core.wire.codec import decode_arrays
from atoll_island_worker.evolution.island import Island, parse_guesses, place
from atoll_island_worker.evolution.kernels.generation import random_population
from atoll_island_worker.evolution.setup import IslandSetup
from atoll_island_worker.evolution.structures import empty_lists
from tests.archipelago import search
from tests.unit.island_worker.evolution.test_island import config_of, problem_of

FORM = "2*x/(3 + y) - 1"


def truth(x, y):
    return 5.0 * x / (0.5 + y) - 3.0


def with_prior(*guesses, **changes):
    space = SpaceConfig(terminals=7, **changes.pop("space", {}))
    return config_of(prior=PriorConfig(guesses={"x": guesses} if guesses else {}), space=space, **changes)


def drawn(setup, population=16):
    """Return the first population before any guess."""
    lists = empty_lists(population, setup.space.nodes)
    key = stream_key(setup.config.seed, setup.variable, setup.island, 0, "generations")
    random_population(lists, setup.space, np.array([key], np.uint64))
    return lists


def constants_of(lists, p):
    live = lists.code[p] == CONSTANT
    return lists.constants[p][live].tolist()


def test_a_guess_becomes_one_individual_and_leaves_the_others_alone():
    setup = IslandSetup(problem_of(), with_prior(FORM), 0)
    lists, before = drawn(setup), drawn(setup)
    place(lists, 0, parse_guesses(setup)[0], None)
    for column, old in zip(lists, before, strict=True):
        assert (column[1:] == old[1:]).all()
    assert constants_of(lists, 0)[:3] == [2.0, 3.0, 1.0]


def test_constants_vary_within_three_octaves_and_keep_their_sign():
    setup = IslandSetup(problem_of(), with_prior("-2*x + 3*y"), 1)
    guess = parse_guesses(setup)[0]
    constants = {node.index: node.constant for node in guess if node.code == CONSTANT}
    factors = []
    for number in range(200):
        lists = drawn(setup)
        place(lists, 0, guess, Stream(number))
        factors += [lists.constants[0, index] / value for index, value in constants.items()]
    assert 1 / 8 <= min(factors) < 1 / 6
    assert 6 < max(factors) < 8


def test_a_guess_of_the_right_form_is_found_at_once_from_far_off_constants():
    problem = problem_of(truth=truth)
    config = with_prior(FORM, budget=config_of().budget.model_copy(update={"target_error": 1e-9}))
    result = search(problem, config, epochs=1)
    assert result.has_hit
    assert {report.hit.generation for report in result.reports if report.hit} == {10}


def test_the_same_guess_gives_the_same_answer_in_any_strides_and_from_a_checkpoint():
    problem, config = problem_of(), with_prior(FORM, "x + y")
    whole = search(problem, config, epochs=2)
    assert search(problem, config, epochs=2, stride=7) == whole
    assert whole != search(problem, with_prior(), epochs=2)
    fresh = Island(problem, config, 1)
    again = Island.from_bytes(fresh.to_bytes(), problem, config, 1)
    for island in (fresh, again):
        while not island.advance(10):
            pass
    assert fresh.report() == again.report() == whole.reports[1]


def test_a_guess_without_a_finite_value_does_no_harm():
    config = with_prior("x/(y - y)", "sin(1e9*x)")
    result = search(problem_of(), config, epochs=1)
    assert all(np.isfinite(entry.error) for entry in result.front)
    assert result.front


NARROW = {"variables_of": {"x": ("y",)}}


def test_an_equation_keeps_to_its_variables_in_all_that_leaves_the_island():
    problem = problem_of()
    config = with_prior(
        space=NARROW,
        predictors=PredictorConfig(rows=8, effort=0.2, renewal=5),
        evolution=EvolutionConfig(islands=2, population=16, runners_up=3),
    )
    result = search(problem, config, epochs=2)
    assert any(report.runners_up for report in result.reports)
    assert len(result.front) > 3
    used = set()
    for report in result.reports:
        for entry in (*report.additions, *report.runners_up):
            program = Program.from_bytes(entry.program, 2)
            used |= set(program.left[program.operators == VARIABLE].tolist())
    assert used == {1}


def test_a_narrowed_search_is_the_search_of_the_narrowed_problem():
    problem = problem_of()
    alone = type(problem)(("y",), np.ascontiguousarray(problem.inputs[1:]), problem.target)
    narrow = search(problem, with_prior(space=NARROW), epochs=2)
    plain = search(alone, with_prior(), epochs=2)
    assert narrow.digests == plain.digests
    assert [entry.error for entry in narrow.front] == [entry.error for entry in plain.front]


def test_a_target_over_some_variables_is_met_pruned_and_told_over_all():
    problem = problem_of(truth=lambda x, y: 3.0 * y - y * y)
    config = with_prior(space=NARROW, budget=config_of().budget.model_copy(update={"target_error": 1e-9}))
    result = search(problem, config, epochs=5)
    assert result.has_hit
    program = Program.from_bytes(result.front[-1].program, 2)
    assert set(program.left[program.operators == VARIABLE].tolist()) == {1}


def test_an_equation_keeps_to_its_operators():
    config = with_prior(space={"operators_of": {"x": ("*", "/")}})
    island = Island(problem_of(), config, 0)
    while not island.advance(10):
        pass
    allowed = {BY_NAME["*"].code, BY_NAME["/"].code}
    for block in island.emigrants().values():
        _, arrays = decode_arrays(block)
        assert set(np.unique(arrays["code"][:, 7:])) <= allowed
