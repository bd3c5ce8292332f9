"""What a search hands on, kept in a file and refined again."""

import pickle
from dataclasses import replace
from types import SimpleNamespace

import pytest

from atoll_coordinator.model.result.result import VariableOutcome
from atoll_coordinator.service.tasks.background import RefiningFailed
from atoll_coordinator.tasks.preparing import prepare_job
from atoll_coordinator.tasks.refining import Searched
from atoll_core.errors import UsageError
from atoll_core.wire.values import encode_value
from benchmarks.corpus import pools
from benchmarks.corpus.campaign import configuration
from benchmarks.corpus.cases import Key, make_case
from tests.unit.coordinator.model.shooting import made

KEY = Key("logistic", 1, 1, "even", "exact", 1000)


def test_what_is_kept_is_refined_and_judged(tmp_path, monkeypatch):
    case = make_case(KEY, has_fresh=False)
    config = configuration(KEY, case, None, {})
    prepared, _ = prepare_job(case.table.to_bytes(), config)
    monkeypatch.setenv(pools.FILE, str(tmp_path / "last"))
    found = made.pools(prepared.preparation, x=("x", "x*(2.0 - x)"))
    outcomes = tuple(VariableOutcome(name, pool.front, 1, runners_up=pool.runners_up) for name, pool in found.items())
    posted: list[object] = []
    controller = SimpleNamespace(encoded=lambda job: encode_value(prepared), post=posted.append)
    pools.keep(controller, Searched("j", outcomes), prepared.config, None, 0.0)
    assert [type(item) for item in posted] == [RefiningFailed]
    kept = replace(pickle.loads((tmp_path / "last").read_bytes()), key=KEY)
    pools.file_of(tmp_path, KEY).write_bytes(pickle.dumps(kept))
    (equation,) = pools.refine_kept(KEY, tmp_path).equations
    assert equation.is_right, equation.expression
    assert equation.grade == "exact"


def test_a_pool_that_is_not_kept_is_named(tmp_path):
    with pytest.raises(UsageError, match="--keep-pools"):
        pools.refine_kept(KEY, tmp_path)
