"""Who may open the live page."""

from __future__ import annotations

import pytest

from tramstream.errors import ConfigError
from tramstream.web.access import Access, Address, address_of, granted

TOKEN = "geheim"


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("", "127.0.0.1", 8470),
        ("8000", "127.0.0.1", 8000),
        (":0", "127.0.0.1", 0),
        ("localhost", "localhost", 8470),
        ("0.0.0.0:80", "0.0.0.0", 80),
        ("[::1]:9", "::1", 9),
    ],
)
def test_address_is_read(text: str, host: str, port: int) -> None:
    assert address_of(text) == Address(host, port)


@pytest.mark.parametrize("text", ["a:b", "1.2.3.4:99999", "host/path", "user@host:1", "[::1:2"])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="HOST:PORT"):
        address_of(text)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.3.2.1", "::1", "localhost"])
def test_loopback_needs_nothing(host: str) -> None:
    access = granted(Address(host, 1), share=False)
    assert not access.token
    assert not access.secure


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.4", "tram-17"])
def test_beyond_loopback_only_with_a_token_and_tls(host: str) -> None:
    with pytest.raises(ConfigError, match="--share"):
        granted(Address(host, 1), share=False)
    access = granted(Address(host, 1), share=True)
    assert access.secure
    assert len(access.token) >= 32
    assert access.token != granted(Address(host, 1), share=True).token


LOCAL = Access()
SHARED = Access(TOKEN, frozenset(), secure=True)


@pytest.mark.parametrize(
    ("access", "host", "origin", "cookie", "socket", "refused"),
    [
        (LOCAL, "127.0.0.1:8470", None, None, False, ""),
        (LOCAL, "LOCALHOST:8470", None, None, False, ""),
        (LOCAL, "[::1]:8470", None, None, False, ""),
        (LOCAL, "evil.example", None, None, False, "Host"),
        (LOCAL, "127.0.0.1.evil.example:8470", None, None, False, "Host"),
        (LOCAL, "", None, None, False, "Host"),
        (LOCAL, "127.0.0.1:8470", "http://127.0.0.1:8470", None, True, ""),
        (LOCAL, "127.0.0.1:8470", "http://evil.example", None, True, "Origin"),
        (LOCAL, "127.0.0.1:8470", "http://127.0.0.1:9999", None, True, "Origin"),
        (LOCAL, "127.0.0.1:8470", "null", None, True, "Origin"),
        (LOCAL, "127.0.0.1:8470", None, None, True, ""),  # no browser: it has no other sites open
        (SHARED, "tram-17:8470", None, TOKEN, False, ""),
        (SHARED, "tram-17:8470", None, None, False, "token"),
        (SHARED, "tram-17:8470", None, TOKEN[:-1], False, "token"),
        (SHARED, "tram-17:8470", None, "é", False, "token"),
        (SHARED, "tram-17:8470", "https://tram-17:8470", TOKEN, True, ""),
        (SHARED, "tram-17:8470", "http://tram-17:8470", TOKEN, True, "Origin"),
        (SHARED, "tram-17:8470", "https://evil.example", TOKEN, True, "Origin"),
    ],
)
def test_request_is_admitted_or_refused_by_name(
    access: Access, host: str, origin: str | None, cookie: str | None, socket: bool, refused: str
) -> None:
    found = access.refusal(host, origin, cookie, socket)
    assert (refused in found) if refused else found == ""


def test_token_in_an_address_is_right_or_not_and_none_is_never_right() -> None:
    assert SHARED.admits(TOKEN)
    assert not SHARED.admits("")
    assert not SHARED.admits(TOKEN + "x")
    assert not LOCAL.admits("")
