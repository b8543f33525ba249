"""The page's web application: a few files, the network, the history, and a WebSocket."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from importlib.resources import files
from typing import Any

import msgspec
from starlette.applications import Starlette
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from tramstream.web.access import COOKIE, Access
from tramstream.web.hub import Hub

ASSETS = files("tramstream.web").joinpath("assets")
TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; "
    "form-action 'none'; object-src 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-cache",
}
LEAST_GZIP_BYTES = 1024
REFUSED_CODE = 4403
"""Of a WebSocket that is closed because it may not look."""
CLIENTS = 500
"""More pages are told to come back."""
GONE = (WebSocketDisconnect, RuntimeError, OSError)


def application(
    hub: Hub,
    access: Access,
    first: Callable[[], bytes],
    network: Callable[[], bytes],
    sampling: Callable[[], Any],
) -> ASGIApp:
    """Make the application.

    Parameters
    ----------
    hub : Hub
        What it publishes goes to every open page.
    access : Access
    first : callable
        The first message of a page: history and status, as JSON.
    network : callable
        The track network, as JSON.
    sampling : callable
        Makes the context manager that keeps `hub` fed while the server runs.
    """

    async def asset(request: Request) -> Response:
        name = request.path_params.get("name") or "index.html"
        return _asset(name)

    async def rails(request: Request) -> Response:
        return Response(network(), media_type="application/json")

    async def socket(websocket: WebSocket) -> None:
        if len(hub.clients) >= CLIENTS:
            await websocket.close(1013, "too many pages are open")
            return
        await websocket.accept()
        client = hub.join()
        sender = asyncio.create_task(client.run(websocket.send_bytes))
        try:
            await websocket.send_bytes(first())
            while True:  # a page says nothing; this is how its end is noticed
                await websocket.receive()
                if websocket.client_state.name == "DISCONNECTED":
                    break
        except GONE:
            pass  # the page was closed: nothing is left to be said to it
        finally:
            hub.leave(client)
            sender.cancel()
            with suppress(asyncio.CancelledError, *GONE):
                await sender

    routes = [
        Route("/", asset),
        Route("/network.json", rails),
        WebSocketRoute("/live", socket),
        Route("/{name:path}", asset),
    ]
    app = Starlette(routes=routes, lifespan=lambda _: sampling())
    app.add_middleware(GZipMiddleware, minimum_size=LEAST_GZIP_BYTES)
    return Gate(app, access)


def _asset(name: str) -> Response:
    """A file of the page; only names that it knows, so that no path leads anywhere else."""
    if name not in _known():
        return PlainTextResponse("there is no such page\n", 404)
    kind = TYPES[name.rpartition(".")[2]]
    return Response(_known()[name], media_type=kind)


_KNOWN: dict[str, bytes] = {}


def _known() -> dict[str, bytes]:
    """All files of the page by name, read once."""
    if not _KNOWN:
        for folder, prefix in ((ASSETS, ""), (ASSETS.joinpath("vendor"), "vendor/")):
            for each in folder.iterdir():
                if each.is_file() and each.name.rpartition(".")[2] in TYPES:
                    _KNOWN[prefix + each.name] = each.read_bytes()
    return _KNOWN


class Gate:
    """Refuses who may not look, and puts the headers on what is answered."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        request = HTTPConnection(scope)
        if scope["type"] == "http":
            await self._http(request, scope, receive, send)
            return
        if self._refusal(request, socket=True):
            await WebSocket(scope, receive, send).close(REFUSED_CODE)
            return
        await self._app(scope, receive, send)

    async def _http(
        self, request: HTTPConnection, scope: Scope, receive: Receive, send: Send
    ) -> None:
        response: ASGIApp = self._app
        token = request.query_params.get("token", "")
        if scope["method"] not in ("GET", "HEAD"):
            response = PlainTextResponse("this page is read only\n", 405)
        elif token and self._access.admits(token):
            response = self._welcome()
        elif refusal := self._refusal(request, socket=False):
            response = PlainTextResponse(f"{refusal}\n", 403)

        async def with_headers(message: Any) -> None:
            if message["type"] == "http.response.start":
                extra = [(name.lower().encode(), value.encode()) for name, value in HEADERS.items()]
                message = {**message, "headers": [*message.get("headers", []), *extra]}
            await send(message)

        await response(scope, receive, with_headers)

    def _welcome(self) -> Response:
        """The token becomes a cookie and leaves the address, where others would read it."""
        answer = RedirectResponse("/", 303)
        answer.set_cookie(
            COOKIE, self._access.token, httponly=True, samesite="strict", secure=self._access.secure
        )
        return answer

    def _refusal(self, request: HTTPConnection, socket: bool) -> str:
        headers = request.headers
        return self._access.refusal(
            headers.get("host", ""), headers.get("origin"), request.cookies.get(COOKIE), socket
        )


def encoded(message: dict[str, Any]) -> bytes:
    """A message as JSON."""
    return msgspec.json.encode(message)
