"""The page of a report: sections of text, tables and figures in one file that asks no network.

The browser is told so as well: the page's own policy refuses every connection.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from typing import Any

from tramstream import __version__

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:"
)
"""Bokeh compiles the callbacks of a figure from text, which browsers call eval."""


class Page:
    """Collects sections; `render` makes the file.

    Parameters
    ----------
    title : str
        Of page and browser tab.
    facts : sequence of str
        Lines below the title.
    """

    def __init__(self, title: str, facts: Sequence[str]) -> None:
        self._title, self._facts = title, facts
        self._body: list[str | int] = []
        # Text, or which figure stands here.
        self._names: list[str] = []
        self._figures: list[Any] = []
        self._overview: Any = None

    @property
    def placed(self) -> list[Any]:
        """In the order of the page."""
        return list(self._figures)

    def section(self, name: str, note: str = "") -> None:
        """Begin a section."""
        self._names.append(name)
        self._body.append(f'<h2 id="{_id(name)}">{escape(name)}</h2>')
        if note:
            self.note(note)

    def note(self, text: str) -> None:
        self._body.append(f'<p class="note">{escape(text)}</p>')

    def absent(self, text: str) -> None:
        """Say what is not in the record, and so not here."""
        self._body.append(f'<p class="absent">{escape(text)}</p>')

    def fold(self, name: str, texts: Sequence[str]) -> None:
        """Paragraphs to unfold."""
        body = "".join(f'<p class="note">{escape(text)}</p>' for text in texts)
        self._body.append(f"<details><summary>{escape(name)}</summary>{body}</details>")

    def heading(self, text: str) -> None:
        self._body.append(f"<h3>{escape(text)}</h3>")

    def figures(self, figures: Sequence[Any], beside: str = "") -> None:
        """Place figures below each other, or beside each other: as `many` as fit, or `two`.

        None leaves its place empty.
        """
        self._body.append(f'<div class="figures {beside}">')
        for figure in figures:
            self._body.append("<div>")
            if figure is not None:
                self._body.append(len(self._figures))
                self._figures.append(figure)
            self._body.append("</div>")
        self._body.append("</div>")

    def overview(self, figure: Any) -> None:
        """Keep `figure` in sight above all sections."""
        self._overview = figure

    def tiles(self, tiles: Sequence[tuple[str, str]]) -> None:
        """Few figures, large: value and what it is."""
        cells = [
            f"<div><b>{escape(value)}</b><span>{escape(of)}</span></div>" for value, of in tiles
        ]
        self._body.append(f'<div class="tiles">{"".join(cells)}</div>')

    def table(self, head: Sequence[str], rows: Sequence[Sequence[object]], fold: str = "") -> None:
        """Rows of text and numbers; numbers are aligned right. `fold` names a table to unfold."""
        if not rows:
            return
        body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
        names = "".join(
            f'<th class="number">{escape(name)}</th>' if _counts(rows, k) else _head(name)
            for k, name in enumerate(head)
        )
        table = (
            f'<div class="scroll"><table><thead><tr>{names}</tr></thead>'
            f"<tbody>{body}</tbody></table></div>"
        )
        if fold:
            table = f"<details><summary>{escape(fold)}</summary>{table}</details>"
        self._body.append(table)

    def render(self, document: Any) -> str:
        """The whole file; `document` is the bokeh document that all figures belong to."""
        from bokeh.embed import components
        from bokeh.resources import Resources

        models = [*self._figures, *([self._overview] if self._overview else [])]
        with document.models.freeze():  # or each root would have all models looked through again
            for model in models:
                document.add_root(model)
        script, places = components(models) if models else ("", [])
        body = "".join(part if isinstance(part, str) else places[part] for part in self._body)
        ride = ""
        if self._overview:
            ride = (
                f'<div id="ride"><p><span id="shown"></span>'
                f'<button id="whole" type="button">whole ride</button></p>{places[-1]}</div>'
            )
        library = Resources(mode="inline", components=["bokeh"]).render_js() if models else ""
        style = files("tramstream.analysis.report").joinpath("report.css").read_text()
        links = " ".join(f'<a href="#{_id(name)}">{escape(name)}</a>' for name in self._names)
        facts = "".join(f"<p>{escape(fact)}</p>" for fact in self._facts)
        return (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{escape(self._title)}</title><style>\n{style}</style>{library}</head>\n"
            f"<body><header><h1>{escape(self._title)}</h1>{facts}<nav>{links}</nav></header>\n"
            f"{ride}<main>{body}</main>\n"
            f"<footer>tramstream {__version__}</footer>{script}</body></html>\n"
        )


def _id(name: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in name.lower())


def _head(name: str) -> str:
    return f"<th>{escape(name)}</th>"


def figure(value: float) -> str:
    """A number as people read it: three digits that count, no exponent, none below 0.001."""
    size = abs(value)
    if not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    if size >= 100:
        return f"{value:,.0f}".replace(",", "\u202f")
    return f"{value:.1f}" if size >= 10 else f"{value:.2f}" if size >= 1 else f"{value:.3f}"


def _cell(value: object) -> str:
    if value is None:
        return "<td></td>"
    if isinstance(value, int):
        return f'<td class="number">{value:,}</td>'.replace(",", "\u202f")
    if isinstance(value, float):
        return f'<td class="number">{figure(value)}</td>'
    return f"<td>{escape(str(value))}</td>"


def _counts(rows: Sequence[Sequence[object]], column: int) -> bool:
    """Whether a column is of numbers, so that its name stands on the right as they do."""
    return all(isinstance(row[column], int | float | None) for row in rows)
