"""One self-contained page of a command's results: tables, figures with values under the pointer, the configuration."""

import html
import io
import json
import math
import platform
from collections.abc import Iterable, Mapping
from importlib import metadata
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

import gearjax
from gearjax.plot.report_parts import SCRIPT, STYLE

MOST_VALUES = 20_000  # largest number of values of one axes that the pointer can show
MOST_DRAWN = 40_000  # largest number of points of one axes that are drawn as vectors, not as an image
LONGEST_ROW = 12  # numbers of a list that are shown
DEEPEST, FEW_ROWS = 2, 3  # tables that are nested deeper than this, and longer, are folded


def report_page(
    title: str, told: Mapping[str, Any], figures: Mapping[str, Figure], config: str, notes: Iterable[str] = ()
) -> str:
    """The page in HTML; it needs no network and no other files.

    Args:
        title: title of the page.
        told: the results, as ``--json`` prints them.
        figures: figures by the names of their files.
        config: text of the configuration.
        notes: notes and warnings of the command.
    """
    says = "".join(f"<li>{html.escape(note)}</li>" for note in notes)
    drawn = "".join(_figure(name, figure) for name, figure in figures.items())
    sections = [
        f"<h1>{html.escape(title)}</h1>",
        f"<h2>Notes and warnings</h2><ul>{says}</ul>" if says else "",
        f"<h2>Figures</h2>{drawn}" if drawn else "",
        f"<h2>Results</h2>{_shown(told)}",
        f"<h2>Configuration</h2><pre>{html.escape(config)}</pre>",
        f"<h2>Made with</h2>{_shown(_versions())}",
    ]
    head = f'<meta charset="utf-8"><title>{html.escape(title)}</title><style>{STYLE}</style>'
    body = f"{''.join(sections)}<script>{SCRIPT}</script>"
    return f'<!doctype html>\n<html lang="en"><head>{head}</head><body>{body}</body></html>\n'


def _versions() -> dict[str, str]:
    """Versions of gearjax, of Python, and of the packages on which the numbers depend."""
    packages = ("jax", "jaxlib", "diffrax", "numpy", "scipy")
    return {
        "gearjax": gearjax.__version__,
        **{name: metadata.version(name) for name in packages},
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
    }


def _figure(name: str, figure: Figure) -> str:
    """A figure as SVG, followed by the values that the pointer shows."""
    for ax in figure.axes:
        many = sum(np.size(line.get_xdata()) for line in ax.get_lines()) > MOST_DRAWN
        for part in (
            *(ax.get_lines() if many else ()),
            *(part for part in ax.collections if isinstance(part, QuadMesh)),
        ):
            part.set_rasterized(True)
    drawn = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        figure.savefig(drawn, format="svg", metadata={"Date": None})
    svg = drawn.getvalue()
    data = json.dumps([_values(ax) for ax in figure.axes if ax.axison]).replace("<", "\\u003c")
    return f'<figure>{svg[svg.index("<svg") :]}<script type="application/json">{data}</script></figure>'


def _values(ax: Axes) -> dict[str, Any]:
    """Position of axes in their figure, their scales, and points of their curves."""
    box = ax.get_position()
    lines = [line for line in ax.get_lines() if line.get_transform() == ax.transData]  # no lines across the axes
    most = MOST_VALUES // max(1, len(lines))
    curves = []
    for line in lines:
        x, y = (np.ravel(np.asarray(values, float)) for values in (line.get_xdata(), line.get_ydata()))
        every = max(1, math.ceil(len(x) / most))
        finite = np.isfinite(x) & np.isfinite(y)
        label = str(line.get_label())
        curves.append(
            {
                "label": "" if label.startswith("_") else label,
                "x": [float(f"{value:.6g}") for value in x[finite][::every]],
                "y": [float(f"{value:.6g}") for value in y[finite][::every]],
            }
        )
    return {
        "box": [box.x0, 1 - box.y1, box.x1, 1 - box.y0],
        "x": [*ax.get_xlim(), ax.get_xscale() == "log", ax.get_xlabel()],
        "y": [*ax.get_ylim(), ax.get_yscale() == "log", ax.get_ylabel()],
        "curves": curves,
    }


def _shown(value: Any, depth: int = 0) -> str:
    """A result as a table, a list or a word; deeply nested tables are folded."""
    if isinstance(value, Mapping):
        rows = (f"<tr><th>{_named(key)}</th><td>{_shown(each, depth + 1)}</td></tr>" for key, each in value.items())
        return f"<table>{''.join(rows)}</table>" if value else "none"
    if isinstance(value, list | tuple):
        return _listed(list(value), depth)
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: ""}[value]
    if isinstance(value, float):
        return f"{value:.6g}"
    return html.escape(str(value))


def _listed(values: list[Any], depth: int) -> str:
    """A list: a list of tables becomes one table with a row for each; another long list is cut."""
    if values and all(isinstance(each, Mapping) for each in values):
        keys = dict.fromkeys(key for each in values for key in each)
        head = "".join(f"<th>{_named(key)}</th>" for key in keys)
        cells = (("".join(f"<td>{_shown(each.get(key), depth + 1)}</td>" for key in keys)) for each in values)
        rows = "".join(f"<tr>{row}</tr>" for row in cells)
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
        folded = f"<details><summary>{len(values)} rows</summary>{table}</details>"
        return folded if depth > DEEPEST and len(values) > FEW_ROWS else table
    shown = [_shown(each, depth + 1) for each in values[:LONGEST_ROW]]
    more = [f"… {len(values)} in all"] if len(values) > LONGEST_ROW else []
    return ", ".join(shown + more) or "none"


def _named(key: Any) -> str:
    return html.escape(str(key).replace("_", " "))
