"""The page's server as strangers and slow readers meet it, over real sockets."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import http.client
import json
import socket
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from live import HANG_S, until
from looking import VEHICLE, fix
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from tramstream import keys
from tramstream.clock import VehicleClock
from tramstream.errors import ConfigError
from tramstream.transport.bus import LocalBus
from tramstream.web.access import Access, Address, granted
from tramstream.web.app import ASSETS, HEADERS
from tramstream.web.certificate import make
from tramstream.web.hub import Client, Hub
from tramstream.web.serve import Page, serving


class Served:
    """A page that is served, and the bus that it looks at."""

    def __init__(self, bus: LocalBus, page: Page, address: str) -> None:
        self.bus, self.page, self.address = bus, page, address
        self.port = int(address.split("/")[2].rpartition(":")[2])

    def get(self, path: str, method: str = "GET", **headers: str) -> tuple[int, dict, bytes]:
        link = http.client.HTTPConnection("127.0.0.1", self.port, timeout=HANG_S)
        try:
            link.request(method, path, headers=headers)
            answer = link.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()
        finally:
            link.close()

    def link(self, **options):
        return connect(f"ws://127.0.0.1:{self.port}/live", max_size=None, **options)

    def put_fix(self, number: int) -> None:
        key = keys.GNSS_FIX
        payload = fix(number, self.bus.clock.now_ns()).SerializeToString()
        self.bus.publish(key.on(VEHICLE), payload, key.encoding, number)


@contextmanager
def served(access: Access | None = None) -> Iterator[Served]:
    bus = LocalBus(VehicleClock())
    page = Page(bus, VEHICLE, b'{"tracks":[]}')
    address = Address("127.0.0.1", 0)
    with serving(page, address, access or granted(address, share=False)) as shown:
        yield Served(bus, page, shown)
    bus.close()


def test_page_and_its_files_come_with_headers_that_keep_other_sites_out() -> None:
    with served() as page:
        for path in ("/", "/live.js", "/live.css", "/vendor/leaflet.js", "/vendor/uplot.css"):
            status, headers, body = page.get(path)
            assert status == 200, path
            assert body
            for name, value in HEADERS.items():
                assert headers[name.lower()] == value
        assert page.get("/")[1]["content-security-policy"].startswith("default-src 'self';")
        assert json.loads(page.get("/network.json")[2]) == {"tracks": []}


@pytest.mark.parametrize(
    "path",
    ["/../serve.py", "/..%2fserve.py", "/vendor/../../app.py", "//etc/passwd", "/%00", "/live.js/",
     "/vendor/%2e%2e/%2e%2e/access.py", "/vendor/leaflet.LICENSE", "/" + 3000 * "a"],
)  # fmt: skip
def test_no_path_leads_out_of_the_page(path: str) -> None:
    with served() as page:
        status, _, body = page.get(path)
        assert status == 404
        assert len(body) < 100


def test_page_is_read_only_and_other_hosts_and_sites_get_nothing() -> None:
    with served() as page:
        for method in ("POST", "PUT", "DELETE", "PATCH"):
            assert page.get("/", method)[0] == 405
        assert page.get("/", Host="evil.example")[0] == 403
        with pytest.raises(InvalidStatus) as refused, page.link(origin="http://evil.example"):
            pass
        assert refused.value.response.status_code == 403
        with page.link(origin=f"http://127.0.0.1:{page.port}") as link:
            assert json.loads(link.recv(HANG_S))["type"] == "first"


def test_frames_and_status_follow_each_other_with_what_the_bus_brings() -> None:
    with served() as page, page.link() as link:
        page.put_fix(7)
        seen = set()
        while not ({"frame", "status"} <= seen and "fix" in seen):
            message = json.loads(link.recv(HANG_S))
            seen.add(message["type"])
            if message["type"] == "frame" and message["gnss"]:
                assert message["gnss"]["latitude_deg"] == 50.007
                seen.add("fix")
            elif message["type"] == "frame":
                page.put_fix(7)


def test_page_that_is_opened_later_has_what_was_before() -> None:
    with served() as page:

        def some() -> bool:
            page.put_fix(3)
            return bool(json.loads(page.page.first())["history"]["minute"][0])

        until(some, "a row of history")
        with page.link() as link:
            minute = json.loads(link.recv(HANG_S))["history"]["minute"]
        assert minute[0]


def test_who_has_the_token_comes_in_once_and_for_all_and_nobody_else() -> None:
    access = Access("geheim", frozenset(), secure=False)  # TLS has a test of its own
    with served(access) as page:
        assert page.get("/")[0] == 403
        assert page.get("/?token=falsch")[0] == 403
        status, headers, _ = page.get("/?token=geheim")
        assert (status, headers["location"]) == (303, "/")
        cookie = headers["set-cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=strict" in cookie
        sent = cookie.partition(";")[0]
        assert page.get("/", Cookie=sent)[0] == 200
        with pytest.raises(InvalidStatus), page.link():
            pass
        with page.link(additional_headers={"Cookie": sent}) as link:
            assert json.loads(link.recv(HANG_S))["type"] == "first"


def test_shared_page_speaks_tls_with_its_own_certificate(tmp_path: Path) -> None:
    import ssl

    certificate, key, fingerprint = make(tmp_path, "127.0.0.1")
    bus = LocalBus(VehicleClock())
    address = Address("127.0.0.1", 0)
    access = granted(address, share=True)
    with serving(Page(bus, VEHICLE), address, access, (certificate, key)) as shown:
        assert shown.startswith("https://127.0.0.1:")
        trusted = ssl.create_default_context(cafile=str(certificate))
        port = int(shown.split("/")[2].rpartition(":")[2])
        link = http.client.HTTPSConnection("127.0.0.1", port, timeout=HANG_S, context=trusted)
        link.request("GET", "/" + shown.rpartition("/")[2])
        answer = link.getresponse()
        assert answer.status == 303
        assert "Secure" in answer.headers["set-cookie"]
        link.close()
        with socket.create_connection(("127.0.0.1", port), HANG_S) as plain:
            plain.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
            plain.settimeout(HANG_S)
            assert not plain.recv(100).startswith(b"HTTP/1.1 200")
    der = ssl.PEM_cert_to_DER_cert(certificate.read_text())
    assert hashlib.sha256(der).hexdigest().upper() == fingerprint.replace(":", "")
    assert key.stat().st_mode & 0o077 == 0


def test_whoever_sends_much_is_cut_off_and_the_page_goes_on() -> None:
    with served() as page:
        with page.link() as link, contextlib.suppress(ConnectionClosed, OSError):
            link.send(bytes(10_000_000))
            while True:
                link.recv(HANG_S)
        slow = [socket.create_connection(("127.0.0.1", page.port), HANG_S) for _ in range(50)]
        try:
            for each in slow:
                each.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-A: ")  # and no more
            assert page.get("/")[0] == 200
        finally:
            for each in slow:
                each.close()
        until(lambda: not page.page.hub.clients, "the big sender to be gone")


def test_request_that_never_ends_is_ended() -> None:
    from tramstream.web.serve import REQUEST_S

    assert 0 < REQUEST_S <= 30
    with served() as page, socket.create_connection(("127.0.0.1", page.port), HANG_S) as slow:
        slow.settimeout(HANG_S)
        slow.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-A: ")
        assert slow.recv(1000) == b""


def test_page_that_does_not_read_keeps_only_the_newest_of_each_kind() -> None:
    async def ride() -> tuple[list[bytes], int]:
        sent: list[bytes] = []
        open_ = asyncio.Event()

        async def send(payload: bytes) -> None:
            await open_.wait()
            sent.append(payload)

        hub = Hub()
        client: Client = hub.join()
        task = asyncio.create_task(client.run(send))
        for number in range(1000):
            hub.publish("frame", b"frame %d" % number)
            hub.publish("status", b"status %d" % number)
            await asyncio.sleep(0)
        open_.set()
        for _ in range(10):
            await asyncio.sleep(0)
        task.cancel()
        return sent, client.skipped

    sent, skipped = asyncio.run(ride())
    assert sent[-2:] == [b"frame 999", b"status 999"]
    assert len(sent) <= 4
    assert skipped >= 1990


def test_address_that_is_taken_is_said_with_the_cure() -> None:
    with served() as page:
        taken = Address("127.0.0.1", page.port)
        other = Page(LocalBus(VehicleClock()), VEHICLE)
        with pytest.raises(ConfigError, match="in use"), serving(other, taken, Access()):
            pass


def test_libraries_of_the_page_are_those_that_are_written_down() -> None:
    vendor = ASSETS.joinpath("vendor")
    told = tomllib.loads(vendor.joinpath("vendor.toml").read_text())
    files = {name: library for library in told.values() for name in library["sha256"]}
    there = {each.name for each in vendor.iterdir()} - {"vendor.toml"}
    assert there == set(files)
    for library in told.values():
        assert library["licence"]
        for name, wanted in library["sha256"].items():
            assert hashlib.sha256(vendor.joinpath(name).read_bytes()).hexdigest() == wanted
