"""The service in a browser, and over HTTP: a client of a coordinator like any other, in a process of its own.

- `server`: addresses, tokens, TLS, uvicorn; `application`: what is answered where, and the middleware
- `access`: who may look and who may change something; `problems`: errors as RFC 9457 has them
- `gateway`: questions to the coordinator from threads; `feed`: what happens, told to all pages from one subscription
- `connections`: limits of time and number that uvicorn lacks
- `api`: the resources; `options`: those of a job
- `temporary`: folders of what was sent, also those that a killed process has left
- `reading`: files, read by `reading_process` in forks with limits; there `submission`: what is made of a file
- `description`: the API as OpenAPI describes it, in ``openapi.json``
- `progress`: equations, fronts and convergence as pages draw them; `simulation`: curves beside what was measured
- ``static``: the page

Nothing here is needed by a search: this process can end at any time.
"""
