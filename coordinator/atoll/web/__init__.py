"""The service in a browser and over HTTP: a client of a coordinator, in a separate process without state of its own.

- `server`: the application, addresses, users, TLS, uvicorn; `access`: hosts, origins and tokens
- `api`: the operations; `operations`: how they are declared; `description`: OpenAPI from the declarations
- `problems`: errors in the format of RFC 9457; `connections`: limits on time and number, which uvicorn lacks
- `gateway`: requests to the coordinator from threads; `feed`: events and changes for all pages
- `reading`: uploaded files; `reading_process` reads them in forks with limits, by functions of `submission`;
  `reading_task` describes one such task
- `page_options`: options of a job as pages send them; `pictures`: data for charts of pages; ``static``: the page
"""
