"""A report as one HTML file that needs no other: its pictures are inside."""

from __future__ import annotations

import base64
import html
import io
from typing import Any

Row = dict[str, Any]

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 66rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2.5rem; border-top: 1px solid #ccc; padding-top: 1rem }
img { max-width: 100% } table { border-collapse: collapse; margin: 1rem 0 } caption { text-align: left; color: #555 }
td, th { padding: .2rem .8rem; border-bottom: 1px solid #ddd; text-align: right } th { font-weight: 600 }
td:first-child, th:first-child { text-align: left } code { background: #f4f4f4; padding: 0 .2rem }
"""

CAPTIONS = {
    "settings": "Every setting tried, on a sample of pixels against float64; the line joins those that no other beats. "
    "The star is the picture that was planned (or, refused, that of the usual settings), whose pixels get as many "
    "points as they need.",
    "factors": "Each factor's own approximations, the others left fine: what a point's radiance errs for it. Light on "
    "few directions takes f_v's finer levels with it, which have nothing to meet.",
    "stages": "Where the planned picture's time went, and what a point takes of the device's memory.",
    "error": "The planned picture, and what each of its pixels is expected to err.",
}


def page(result: Row, drawn: list[dict[str, Any]]) -> str:
    """The whole file.

    Parameters
    ----------
    result : what `command` writes as JSON
    drawn : of each material, figures by name
    """
    title = f"{result['mesh']} under {result['environment']}"
    parts = [
        f"<!doctype html><html lang=en><meta charset=utf-8><title>prtcl report: {_text(title)}</title>",
        f"<style>{STYLE}</style><h1>Error against run time: {_text(title)}</h1>",
        f"<p>{_text(result['device'])}, {result['size'][0]} × {result['size'][1]} pixels, {_text(result['date'])}. "
        "Errors are relative RMSE over the pixels that see the mesh. "
        f"<code>{_text(result['command'])}</code></p>",
        _summary(result["materials"]),
    ]
    for told, figures in zip(result["materials"], drawn, strict=True):
        parts.append(f"<h2>{_text(told['material'])}</h2>")
        why = told["plan"].get("why") or [
            told["plan"]["refused"],
            "the picture below is that of the usual settings",
        ]
        parts.append("<ul>" + "".join(f"<li>{_text(line)}</li>" for line in why) + "</ul>")
        for name, figure in figures.items():
            parts.append(f"<p><img alt='{_text(name)}' src='{_embedded(figure)}'><br>{CAPTIONS[name]}</p>")
        parts.append(_frontier(told["frontier"]))
    return "\n".join(parts) + "\n"


def _summary(materials: list[Row]) -> str:
    rows = "".join(
        f"<tr><td>{_text(told['material'])}<td>{_percent(told['plan']['asked'])}"
        + (
            "<td colspan=2>refused"
            if "refused" in told["plan"]
            else f"<td>{_percent(told['plan']['predicted'])}<td>{100 * told['plan']['confidence']:.0f} %"
        )
        + f"<td>{_percent(told['plan']['found'])}<td>{told['plan']['seconds']:.1f} s"
        for told in materials
    )
    return (
        "<table><caption>Found is against float64 at a sample of pixels; the time has the pilot in it. Where an error "
        "is refused, found is that of the usual settings.</caption>"
        "<tr><th>material<th>asked<th>predicted<th>confidence<th>found<th>time" + rows + "</table>"
    )


def _frontier(rows: list[Row]) -> str:
    body = "".join(
        f"<tr><td>{row['samples']} × {row['samples']}<td>4^{row['rays']}<td>4^{row['levels']}"
        f"<td>{_percent(row['error'])}<td>{row['seconds']:.2f} s<td>{row['bytes_per_point']}"
        for row in rows
    )
    return (
        "<table><caption>The frontier of fixed settings</caption><tr><th>points a pixel<th>rays<th>directions<th>error"
        "<th>time<th>bytes a point" + body + "</table>"
    )


def _embedded(figure: Any) -> str:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode("ascii")


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def _text(value: object) -> str:
    return html.escape(str(value), quote=True)
