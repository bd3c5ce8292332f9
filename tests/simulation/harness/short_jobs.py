"""Configurations of jobs that their epochs end, of a few islands."""

from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig, MigrationConfig


def short_job(seed: int = 1, *, islands: int, generations: int = 20, **budget: object) -> JobConfig:
    """Return the configuration of a job of so many islands, in epochs of so many generations."""
    return JobConfig(
        seed=seed,
        evolution=EvolutionConfig(islands=islands),
        migration=MigrationConfig(generations=generations),
        budget=BudgetConfig.model_validate(budget),
    )
