"""A calibration as one self-contained page of HTML: a verdict with its reasons, facts, tables and drawn figures.

Figures are drawn by matplotlib, which is an extra: without it a page has all its words and numbers, and says how to
get the figures. What draws is handed in as a function of a figure, so that this module knows no calibration.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

from camrig.messages import Verdict

WITHOUT_FIGURES = "No figures without matplotlib: pip install 'camrig[pictures]', and calibrate again."


@dataclass(frozen=True, slots=True)
class Table:
    """A titled table; all cells are text, written as it is."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Drawing:
    """A titled figure; ``draw`` fills an empty matplotlib figure of ``size_in`` inches."""

    title: str
    draw: Callable[[Any], None]
    size_in: tuple[float, float] = (6.4, 4.2)
    caption: str = ""


@dataclass(frozen=True, slots=True)
class CalibrationReport:
    """A page. ``reasons`` say why the verdict is what it is, ``facts`` are shown beside it, ``made`` says when, of what
    and by which command.
    """

    title: str
    verdict: Verdict
    reasons: Sequence[str]
    facts: Mapping[str, str]
    sections: Sequence[Table | Drawing] = field(default_factory=tuple)
    made: str = ""


def report_html(report: CalibrationReport) -> str:
    """Return the page; it needs no other file and no network."""
    sections = "\n".join(_sections(report.sections))
    reasons = "".join(f"<li>{escape(reason)}</li>" for reason in report.reasons)
    facts = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in report.facts.items())
    made = f'<p class="made">{escape(report.made)}</p>' if report.made else ""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(report.title)}</title>
<style>{_STYLE}</style>
</head>
<body>
<h1>{escape(report.title)}</h1>
{made}
<div class="verdict {report.verdict}"><strong>{report.verdict}</strong><ul>{reasons}</ul></div>
<table class="facts">{facts}</table>
{sections}
</body>
</html>
"""


def _sections(sections: Sequence[Table | Drawing]) -> Iterator[str]:
    missing = False
    for section in sections:
        if isinstance(section, Table):
            yield _table(section)
        elif (svg := _svg(section)) is not None:
            yield (
                f"<h2>{escape(section.title)}</h2>\n"
                f'<figure role="img" aria-label="{escape(section.title)}">{svg}'
                f"<figcaption>{escape(section.caption)}</figcaption></figure>"
            )
        else:
            missing = True
    if missing:
        yield f"<p>{escape(WITHOUT_FIGURES)}</p>"


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(column)}</th>" for column in table.columns)
    body = "\n".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in table.rows)
    note = f"<p>{escape(table.note)}</p>" if table.note else ""
    return (
        f'<h2>{escape(table.title)}</h2>\n{note}<div class="wide"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _svg(drawing: Drawing) -> str | None:
    """Return the drawn figure, None without matplotlib."""
    try:
        from camrig.report.canvas import figure_of, style  # noqa: PLC0415 - matplotlib is an extra
    except ImportError:
        return None
    text = io.StringIO()
    with style():
        figure = figure_of(*drawing.size_in)
        drawing.draw(figure)
        figure.savefig(text, format="svg", metadata={"Date": None})
    svg = re.search(r"<svg.*</svg>", text.getvalue(), re.DOTALL)
    return svg.group(0) if svg else None


_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #222; }
h1 { font-size: 1.5em; margin-bottom: 0; } h2 { font-size: 1.15em; margin: 1.8em 0 .4em; }
.made { color: #666; margin-top: .3em; }
.verdict { border-left: .5em solid; padding: .6em 1em; margin: 1em 0; background: #f6f6f6; }
.verdict strong { text-transform: uppercase; letter-spacing: .05em; } .verdict ul { margin: .3em 0 0; }
.green { border-color: #2a8a3a; } .amber { border-color: #d98a00; } .red { border-color: #c03028; }
table { border-collapse: collapse; } th, td { text-align: left; padding: .2em .9em .2em 0; vertical-align: top; }
thead th { border-bottom: 1px solid #999; } tbody tr:nth-child(even) { background: #f6f6f6; }
.wide { overflow-x: auto; } td { font-variant-numeric: tabular-nums; }
figure { margin: 0; } figure svg { max-width: 100%; height: auto; } figcaption { color: #555; }
"""
