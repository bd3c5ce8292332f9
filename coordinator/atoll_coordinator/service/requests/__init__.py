"""Queries that the coordinator answers.

``dispatch`` takes every query, tells by its key what it asks for, and answers workers that ask for a job, a placement,
states or a dataset. In ``question_queue`` clients wait for their turn, in ``deferred`` for a result that is composed.
``handshake`` answers greetings, ``clients`` what the command line asks, ``authorization`` decides who may take part as
what and who may cancel or delete which job, ``uploads`` keeps the tables of jobs to come, ``deletion`` deletes ended
jobs, also by itself.

Service (bus) -> `dispatch.RequestDispatcher.answer` -> `clients.ClientRequests` or `handshake.Handshake` -> controller.
"""
