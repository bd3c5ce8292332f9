"""The service in a browser, and over HTTP: a client of a coordinator, in a process of its own that can end at any time.

- `server`: the application, addresses, users, TLS, uvicorn; `access`: hosts, origins and tokens
- `api`: the operations; `operations`: how they are declared; `description`: OpenAPI made of the declarations
- `problems`: errors as RFC 9457 has them; `connections`: limits of time and number that uvicorn lacks
- `gateway`: questions to the coordinator from threads; `feed`: events and changes for all pages
- `reading`: files that are sent, read by `reading_process` in forks with limits; there `submission`
- `options`: options of a job as pages send them; `pictures`: what pages draw; ``static``: the page
"""
