"""The live page of a vehicle as a context: listens, samples the bus ten times a second, serves."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import uvicorn
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from tramstream.clock import S
from tramstream.errors import ConfigError
from tramstream.monitor.watch import Watch
from tramstream.transport.bus import Bus
from tramstream.web.access import Access, Address
from tramstream.web.app import application, encoded
from tramstream.web.hub import Hub
from tramstream.web.picture import LISTENED, Picture

FRAME_S = 0.1
STATUS_EVERY = 10
"""Frames between two of status."""
FIRST_NS = S // 2
"""So long the first message of a page is kept for others: it holds an hour."""
LARGEST_REQUEST_BYTES = 1024
"""A page sends nothing on its WebSocket."""
REQUEST_S = 5.0
"""Who has not asked for anything by then is cut off; a page asks at once."""
START_S = 10.0
STOP_S = 5


class Page:
    """The picture of one vehicle, fed from the bus and sent to every open page."""

    def __init__(self, bus: Bus, vehicle: str, network: bytes = b"null") -> None:
        self.hub = Hub()
        self.network = network
        self._watch = Watch(bus, vehicle, LISTENED, lambda envelope: self.picture.add(envelope))
        self.picture = Picture(self._watch.stats, self._watch.decode, vehicle)
        self._first: tuple[int, bytes] = (0, b"")

    def first(self) -> bytes:
        """What a page needs when it opens; the same for all that open at once."""
        now_ns = self._watch.update()
        made_ns, payload = self._first
        if not 0 <= now_ns - made_ns < FIRST_NS or not payload:
            message = {
                "type": "first",
                "history": self.picture.history.as_dict(),
                "status": self.picture.status(now_ns, all_events=True),
            }
            payload = encoded(message)
            self._first = (now_ns, payload)
        return payload

    def sample(self, count: int) -> None:
        """Take what has come, and send it; `count` numbers the frames."""
        now_ns = self._watch.update()
        self.hub.publish("frame", encoded(self.picture.frame(now_ns)))
        if count % STATUS_EVERY == 0:
            self.hub.publish("status", encoded(self.picture.status(now_ns)))

    @asynccontextmanager
    async def sampling(self) -> AsyncIterator[None]:
        """Sample for as long as the context is open."""
        task = asyncio.create_task(self._run())
        try:
            yield
        finally:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task
            self._watch.close()

    async def _run(self) -> None:
        loop = asyncio.get_running_loop()
        due_s, count = loop.time(), 0
        while True:
            self.sample(count)
            count += 1
            due_s = max(due_s + FRAME_S, loop.time())
            await asyncio.sleep(due_s - loop.time())


class Prompt(HttpToolsProtocol):
    """Cuts off who opens a connection and does not ask: a few hundred of those would fill it."""

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._deadline = self.loop.call_later(REQUEST_S, transport.close)

    def on_headers_complete(self) -> None:
        self._deadline.cancel()
        super().on_headers_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        self._deadline.cancel()
        super().connection_lost(exc)


@contextmanager
def serving(
    page: Page, address: Address, access: Access, tls: tuple[Path, Path] | None = None
) -> Iterator[str]:
    """Serve `page` from a thread while the context is open; gives the address to open.

    Raises
    ------
    ConfigError
        If nobody can listen there.
    """
    listening = listen(address)
    port = listening.getsockname()[1]
    settings: dict[str, Any] = {}
    if tls is not None:
        settings = {"ssl_certfile": str(tls[0]), "ssl_keyfile": str(tls[1])}
    config = uvicorn.Config(
        application(page.hub, access, page.first, lambda: page.network, page.sampling),
        log_config=None,
        access_log=False,
        lifespan="on",
        http=Prompt,
        ws="websockets-sansio",
        ws_max_size=LARGEST_REQUEST_BYTES,
        ws_per_message_deflate=False,
        server_header=False,
        timeout_graceful_shutdown=STOP_S,
        **settings,
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(
        target=server.run, kwargs={"sockets": [listening]}, name="live-page", daemon=True
    )
    thread.start()
    try:
        _wait_until(lambda: server.started or not thread.is_alive())
        if not server.started:
            raise ConfigError(f"the live page at {address.shown} did not start")
        yield url(Address(address.host, port), access)
    finally:
        server.should_exit = True
        thread.join(2 * STOP_S)


def listen(address: Address) -> socket.socket:
    """A socket that listens.

    Raises
    ------
    ConfigError
        If the address is taken, or not of this machine.
    """
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    found = socket.socket(family, socket.SOCK_STREAM)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        found.bind((address.host, address.port))
    except OSError as error:
        found.close()
        raise ConfigError(
            f"--listen {address.shown}: {error.strerror or error}",
            cure="choose another port with --listen, :0 takes any",
        ) from error
    return found


def url(address: Address, access: Access) -> str:
    """What to open in a browser; holds the token where there is one."""
    scheme = "https" if access.secure else "http"
    token = f"?token={access.token}" if access.token else ""
    return f"{scheme}://{address.shown}/{token}"


def _wait_until(done: Callable[[], bool]) -> None:
    waiting = threading.Event()
    for _ in range(int(START_S / 0.02)):
        if done():
            return
        waiting.wait(0.02)
