"""A page to look at in a browser: one file that needs no other, nor the network."""

import html
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fibercontact.files import replace_file
from fibercontact.simulation.pictures.camera import TILT, TURN, view_axes
from fibercontact.simulation.pictures.shown import REGIMES

if TYPE_CHECKING:
    from plotly.basedatatypes import BaseTraceType
    from plotly.graph_objects import Figure

__all__ = ["Rows", "contact_rows", "contact_trace", "lay_out", "write_page"]

Array = NDArray[np.float64]
Rows = list[list[object]]

METRES = ("x (m)", "y (m)", "z (m)")
HOVER = (
    "%{customdata[0]}<br>mu = %{customdata[1]:.3g}<br>"
    "r (N, T1, T2) = (%{customdata[2]:.3g}, %{customdata[3]:.3g}, %{customdata[4]:.3g}) N·s<br>"
    "u (N, T1, T2) = (%{customdata[5]:.3g}, %{customdata[6]:.3g}, %{customdata[7]:.3g}) m/s"
)
"""What is said of a contact: who touches, friction, impulse and velocity."""
CONFIG = {"displaylogo": False, "responsive": True, "showSendToCloud": False}
POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
html, body {{ height: 100%; margin: 0; }}
body {{ display: flex; flex-direction: column; font: 15px sans-serif; }}
h1 {{ font-size: 18px; margin: 12px 16px 2px; }}
p {{ margin: 2px 16px; color: #444; }}
main {{ flex: 1; min-height: 300px; }}
</style>
</head>
<body>
<h1>{title}</h1>
<p>{words}</p>
<main>{figure}</main>
</body>
</html>
"""


def write_page(figure: "Figure", title: str, words: str, file: Path) -> None:
    """Write a figure as a page with everything in it; `title` and `words` are plain text."""
    drawing = figure.to_html(
        full_html=False,
        include_plotlyjs=True,
        default_height="100%",
        div_id="figure",
        config=CONFIG,
    )
    text = PAGE.format(policy=POLICY, title=html.escape(title), words=html.escape(words), figure=drawing)
    replace_file(file, text.encode())


def lay_out(figure: "Figure", turn: float = TURN, tilt: float = TILT, titles: Sequence[str] = METRES) -> None:
    """Equal scales, an orthographic camera, a legend to switch things off."""
    eye = 0.6 * view_axes(turn, tilt)[2]
    axis = {"showbackground": False, "color": "#777777"}
    figure.update_layout(
        template="none",
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        legend={"x": 0.01, "y": 0.99, "itemsizing": "constant"},
        scene={
            "aspectmode": "data",
            "camera": {"eye": dict(zip("xyz", eye, strict=True)), "projection": {"type": "orthographic"}},
            **{f"{x}axis": axis | {"title": {"text": title}} for x, title in zip("xyz", titles, strict=True)},
        },
    )


def contact_rows(names: Sequence[str], mu: Array, r: Array, u: Array) -> Rows:
    """What is said of n contacts: their names, `mu` (n,), `r` and `u` (3n,)."""
    numbers = np.column_stack([mu, r.reshape(-1, 3), u.reshape(-1, 3)]).tolist()
    return [[name, *(float(f"{x:.3g}") for x in row)] for name, row in zip(names, numbers, strict=True)]


def contact_trace(kind: int, points: Array, rows: Rows) -> "BaseTraceType":
    """Dots of the contacts in a regime, at points (m, 3), with what is said of them."""
    from plotly.graph_objects import Scatter3d

    regime = REGIMES[kind]
    x, y, z = points.T.astype(np.float32)
    return Scatter3d(
        x=x,
        y=y,
        z=z,
        mode="markers",
        name=f"{len(points)} {regime.name}",
        showlegend=True,
        marker={"size": 3, "color": regime.colour, "line": {"color": regime.edge, "width": 1}},
        customdata=rows,
        hovertemplate=f"{HOVER}<extra>{regime.name}</extra>",
    )
