"""Queries that the coordinator answers.

`dispatch` answers greetings and workers, and passes the requests of clients to `clients`; in `waiting` requests wait
for their turn, or for a result. `authorization` checks permissions, `admission` applies limits, `uploads` has tables of
jobs to come, `deletion` deletes ended jobs.

Service (bus) -> `RequestDispatcher.answer` -> `ClientRequests.answer` -> controller.
"""
