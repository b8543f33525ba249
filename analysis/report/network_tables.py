"""What is said of a network, and of a path over it, as rows of tables."""

from __future__ import annotations

from typing import Any


def network_facts(figures: dict[str, Any]) -> list[tuple[str, str]]:
    """Name and value of each figure, for people."""
    height = figures["height_share"]
    return [
        ("built from", figures["source"]),
        ("size", f"{figures['size_bytes'] / 1e6:.2f} MB, loaded in {figures['loading_s']:.2f} s"),
        ("tracks", f"{figures['tracks']}, {figures['track_m'] / 1000:.1f} km"),
        ("edges", f"{figures['edges']} directed, {figures['edge_m'] / 1000:.1f} km"),
        ("nodes", f"{figures['nodes']}, {figures['switches']} of them switches"),
        ("parallel", f"{figures['parallel_share']:.1%} of the track has another one beside it"),
        ("node error", f"σ {figures['node_std_m']:.2f} m from the rail, per axis"),
        ("heights", f"known for {height:.1%} of the track" if height else "none"),
        ("stops", str(figures["stops"])),
        ("lines", str(len(figures["lines"]))),
    ]


LINE_HEAD = ("line", "direction", "from", "to", "km", "stops")


def line_rows(figures: dict[str, Any]) -> list[tuple[str, str, str, str, float, int]]:
    """A row of the table of lines for each; see `LINE_HEAD`."""
    return [
        (
            line["line"],
            line["direction"],
            line["origin"],
            line["destination"],
            line["length_m"] / 1000,
            line["stops"],
        )
        for line in figures["lines"]
    ]


LEG_HEAD = ("entered", "run", "from, m", "to, m", "probability", "on the line")


def leg_rows(figures: dict[str, Any]) -> list[tuple[str, str, str, str, str, str]]:
    """A row for each run of the path; see `LEG_HEAD`."""
    rows = []
    for leg in figures["path"]:
        if leg["edge"] is None:
            rows.append((leg["entered"], "off the map", "", "", "", ""))
            continue
        ends = f"{leg['from_m']:.1f}", f"{leg['to_m']:.1f}"
        lines = "; ".join(
            f"{each['line']}/{each['direction']} {round(each['from_m'])}–{round(each['to_m'])} m"
            for each in leg["lines"][:2]
        )
        rows.append((leg["entered"], leg["edge"], *ends, f"{leg['probability']:.3f}", lines))
    return rows


def match_facts(figures: dict[str, Any]) -> list[tuple[str, str]]:
    """Name and value of each figure, for people."""
    across = figures["across_rms_m"]
    told = [
        ("matched", figures["matched"]),
        ("duration", f"{figures['duration_s']:.1f} s"),
        ("on track", f"{figures['on_track_share']:.1%} of the time, {figures['length_m']:.0f} m"),
    ]
    if across is not None:
        text = f"RMS {across:.2f} m, 95 % within {figures['across_p95_m']:.2f} m"
        told.append(("across", f"{text} of the track"))
    return told + [("note", each) for each in figures["notes"]]
