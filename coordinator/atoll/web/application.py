"""The ASGI application: the page, the API, and the middleware before both."""

import contextlib
from collections.abc import AsyncIterator
from importlib.resources import files

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Mount, Route, Router
from starlette.staticfiles import StaticFiles

from atoll.web.access import Access, AccessMiddleware
from atoll.web.api import Api
from atoll.web.gateway import BusyError
from atoll.web.problems import of_error, of_refusal, of_too_many
from atoll.web.reading import Readers
from atoll.web.temporary import remove_left
from atoll_core.errors import AtollError

_STATIC = files("atoll.web").joinpath("static")


def build_application(access: Access, readers: Readers | None = None) -> Starlette:
    """Return the application, which closes its gateways and what reads files at its end."""
    readers = readers or Readers()
    api = Api(readers)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        remove_left()
        with contextlib.suppress(OSError):  # whoever sends a file is told
            readers.start()
        yield
        await api.close()
        for gateway in {*access.gateways.values(), *([access.viewer] if access.viewer is not None else [])}:
            gateway.close()

    application = Starlette(
        routes=[
            Route("/", _page),
            Mount("/api/v1", Router(api.routes(), redirect_slashes=False)),
            Mount("/static", StaticFiles(directory=str(_STATIC))),
        ],
        middleware=[Middleware(AccessMiddleware, access=access), Middleware(GZipMiddleware, minimum_size=1_000)],
        exception_handlers={AtollError: of_error, HTTPException: of_refusal, BusyError: of_too_many},
        lifespan=lifespan,
    )
    application.router.redirect_slashes = False  # to an address that a proxy may not have
    return application


async def _page(request: Request) -> Response:
    return Response(_STATIC.joinpath("index.html").read_bytes(), media_type="text/html")
