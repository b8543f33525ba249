"""One picture to many pages: encoded once, only the newest; who does not read waits alone."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

Send = Callable[[bytes], Awaitable[None]]


class Client:
    """One open page. What it has not got yet is replaced by what is newer: nothing piles up."""

    def __init__(self) -> None:
        self._waiting: dict[str, bytes] = {}
        self._something = asyncio.Event()
        self.skipped = 0
        """Messages that were replaced before they went out."""

    def put(self, kind: str, payload: bytes) -> None:
        """Leave the newest message of a kind to be sent."""
        if kind in self._waiting:
            self.skipped += 1
        self._waiting[kind] = payload
        self._something.set()

    async def run(self, send: Send) -> None:
        """Send what comes until `send` fails or the task is cancelled."""
        while True:
            await self._something.wait()
            self._something.clear()
            waiting, self._waiting = self._waiting, {}
            for payload in waiting.values():
                await send(payload)


class Hub:
    """All open pages."""

    def __init__(self) -> None:
        self.clients: set[Client] = set()

    def join(self) -> Client:
        """A new page."""
        client = Client()
        self.clients.add(client)
        return client

    def leave(self, client: Client) -> None:
        self.clients.discard(client)

    def publish(self, kind: str, payload: bytes) -> None:
        """Leave a message for every page."""
        for client in self.clients:
            client.put(kind, payload)
