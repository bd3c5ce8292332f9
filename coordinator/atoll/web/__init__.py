"""The service in a browser, and over HTTP: a client of a coordinator, in a separate process that can end at any time.

- `server`: the application, addresses, users, TLS, uvicorn; `access`: hosts, origins and tokens
- `api`: the operations; `operations`: how they are declared; `description`: OpenAPI from the declarations
- `problems`: errors in the format of RFC 9457; `connections`: limits on time and number that uvicorn lacks
- `gateway`: questions to the coordinator from threads; `feed`: events and changes for all pages
- `reading`: uploaded files, read by `reading_process` in forks with limits, by functions of `submission`
- `options`: options of a job as pages send them; `pictures`: data for charts of pages; ``static``: the page
"""
