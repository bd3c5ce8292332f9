"""Queries that the coordinator answers.

`dispatch` answers greetings and workers, and passes requests of clients to `clients`. In `waiting`, requests wait for
their turn or for a result. `authorization` checks permissions, `admission` applies limits, `uploads` has uploaded
tables that no job uses yet, and `deletion` deletes ended jobs.

Service (bus) -> `RequestDispatcher.answer` -> `ClientRequests.answer` -> controller.
"""
