"""What zenoh is told: how router and clients find each other, and how patient they are.

Measured with five nodes' traffic (700 messages a second) and a router halted for 2 and 4 s: with
zenoh's own queues 683 and 1417 messages were lost, with these none (tests/transport/test_bus.py).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

CONNECT_TIMEOUT_MS = 2000
LEAVE_S = 3.0
"""A recorder that stands still does not hold up those who end for longer."""
QUEUE_BATCHES = 16
"""Of 64 KiB, on each link; zenoh allows no more. With its default of two, a reader that is not
scheduled for some milliseconds loses messages."""
WAIT_FOR_ROUTER_US = 200_000
"""How long a node waits for room on its link before it drops: the router always reads on."""
WAIT_FOR_READER_US = 1000
"""The router waits no longer, so that a reader that stands still stalls nobody."""


def _settings(mode: str, wait_us: int) -> dict[str, Any]:
    """What router and clients have in common; `wait_us` is the patience with a full link."""
    queue = {
        "size": {"data": QUEUE_BATCHES},
        "congestion_control": {"drop": {"wait_before_drop": wait_us}},
    }
    return {
        "mode": mode,
        # Found by name only: opening takes 3 ms instead of 503, and nothing listens that need not.
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"shared_memory": {"enabled": False}, "link": {"tx": {"queue": queue}}},
    }


def router_settings(path: Path) -> dict[str, Any]:
    """Of the router that listens on the socket at `path`."""
    return {
        **_settings("router", WAIT_FOR_READER_US),
        "listen": {"endpoints": [f"unixsock-stream/{path}"]},
    }


def client_settings(path: Path) -> dict[str, Any]:
    """Of a client of that router; it connects again by itself."""
    retry = {"period_init_ms": 100, "period_max_ms": 200, "period_increase_factor": 2}
    return {
        **_settings("client", WAIT_FOR_ROUTER_US),
        "listen": {"endpoints": []},
        "connect": {
            "endpoints": [f"unixsock-stream/{path}"],
            "timeout_ms": CONNECT_TIMEOUT_MS,
            "retry": retry,
        },
    }
