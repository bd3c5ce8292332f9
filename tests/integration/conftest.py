"""Fixtures that several files of tests share."""

from tests.integration.stage import browser, stage

__all__ = ["browser", "stage"]
