"""Who may open the page: on loopback whoever is on the machine, from elsewhere who has the token.

A page of another site that the same browser has open must get nothing either: the Host has to be
one that the server answers to (else a name that was pointed at 127.0.0.1 would do), and a
WebSocket's Origin has to be the page itself.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from dataclasses import dataclass
from typing import NamedTuple
from urllib.parse import urlsplit

from tramstream.errors import ConfigError

COOKIE = "tramstream_live"
TOKEN_BYTES = 24
LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]"})
DEFAULT_PORT = 8470


class Address(NamedTuple):
    """Where the server listens."""

    host: str
    port: int

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach it."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def shown(self) -> str:
        """Host and port as they stand in a URL."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"


def address_of(text: str) -> Address:
    """Read `HOST`, `:PORT`, `HOST:PORT` or `[IPv6]:PORT`.

    Raises
    ------
    ConfigError
        If it is none of them.
    """
    wanted = text.strip()
    if not wanted:
        return Address("127.0.0.1", DEFAULT_PORT)
    if wanted.isdigit():
        wanted = f":{wanted}"
    try:
        parts = urlsplit(f"//{wanted}")
        host, port = parts.hostname or "127.0.0.1", parts.port
    except ValueError:
        host, port = "", None
    if not host or (parts.path or parts.query or parts.username):
        raise ConfigError(
            f"--listen {text}: is no address; write HOST:PORT, for example 127.0.0.1:{DEFAULT_PORT}"
        )
    return Address(host, DEFAULT_PORT if port is None else port)


@dataclass(frozen=True)
class Access:
    """What a request must bring.

    Parameters
    ----------
    token : str
        Empty where none is asked for: on loopback.
    hosts : frozenset of str
        Names that the server answers to, without port; empty: any (the token decides).
    secure : bool
        Whether the server speaks TLS.
    """

    token: str = ""
    hosts: frozenset[str] = LOOPBACK_NAMES
    secure: bool = False

    def refusal(self, host: str, origin: str | None, cookie: str | None, socket: bool) -> str:
        """Why a request is refused; empty if it is not.

        Parameters
        ----------
        host, origin : str
            Headers of the request.
        cookie : str or None
            The token that it brings.
        socket : bool
            A WebSocket: browsers send its Origin, and nothing else keeps other sites away.
        """
        name = _name_of(host)
        if self.hosts and name not in self.hosts:
            return f"Host {host!r} is not this server"
        scheme = "https" if self.secure else "http"
        if socket and origin is not None and origin.lower() != f"{scheme}://{host.lower()}":
            return f"Origin {origin!r} is another site"
        if self.token and not hmac.compare_digest(
            (cookie or "").encode("utf-8", "replace"), self.token.encode()
        ):
            return "the token is missing or no longer valid; ask for the address with the token"
        return ""

    def admits(self, token: str) -> bool:
        """Whether `token`, out of an address, is the right one."""
        offered = token.encode("utf-8", "replace")
        return bool(self.token) and hmac.compare_digest(offered, self.token.encode())


def granted(address: Address, share: bool) -> Access:
    """Who may come in at an address: with `share` whoever has a new token, by TLS.

    Raises
    ------
    ConfigError
        If others could come in without one.
    """
    if share:
        return Access(secrets.token_urlsafe(TOKEN_BYTES), frozenset(), secure=True)
    if address.loopback:
        return Access()
    raise ConfigError(
        f"--listen {address.shown}: others on the network could open the page",
        cure="--share asks them for a token and encrypts; without it, listen at 127.0.0.1",
    )


def _name_of(host: str) -> str:
    """The Host header without its port, lower case."""
    if host.startswith("["):
        return host.partition("]")[0].lower() + "]"
    return host.partition(":")[0].lower()
