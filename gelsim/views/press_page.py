"""A press to look at and to take elsewhere: one HTML page that works offline, and surfaces by state for ParaView.

The page (plotly, its script inside) shows gel and object in 3D with a slider over the recorded states, the tactile picture of the state
where there is one, and force against approach (or time). The series is one .vtu a body and state of six-node faces, with
displacement and pressure, and a press.pvd that holds them by the same.

Left out: what happens inside the bodies; press.npz holds their surfaces only.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gelsim.files import whole_file
from gelsim.results import Deformation
from gelsim.units import KPA, MM

MOST_STATES = 40
"""On a page; of more states every second, third … is shown."""
GEL_COLOURS = "Viridis"


def write_page(path: Path, press: Deformation, frames: Sequence[Path] = (), title: str = "press") -> None:
    """Writes the page.

    Args:
        frames: PNG files of the states, as many as there are states; none, and the page has no picture.
    Raises:
        OSError: The file cannot be written; an older one is left as it was.
    """
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    count, (name, along) = len(press.approach), press.along
    states = list(range(0, count, -(-count // MOST_STATES)))
    if states[-1] != count - 1:
        states.append(count - 1)
    pictures = [_data_uri(frame) for frame in frames] if len(frames) == count else []
    figure = make_subplots(
        rows=2, cols=2, column_widths=[0.6, 0.4], horizontal_spacing=0.06, vertical_spacing=0.12,
        specs=[[{"type": "scene", "rowspan": 2}, {"type": "xy"}], [None, {"type": "xy"}]],
        subplot_titles=("gel (coloured by height) and object", "tactile picture" if pictures else "", f"force against {name.split()[0]}"),
    )  # fmt: skip
    force = -press.force[:, 2]
    # The colours' scale, of all states.
    lowest = float((press.gel.rest[:, 2] + press.gel.displacement[..., 2]).min() / MM)
    span = lowest, float(press.gel.rest[:, 2].max() / MM)
    frames_of = {i: _moving(press, i, pictures, along, force, span) for i in states}
    moving = frames_of[states[-1]]
    figure.add_trace(moving[0], row=1, col=1)
    figure.add_trace(moving[1], row=1, col=1)
    figure.add_trace(go.Scatter(x=along, y=force, mode="lines+markers", showlegend=False, marker={"size": 5}), row=2, col=2)
    figure.add_trace(moving[2], row=2, col=2)
    if pictures:
        figure.add_trace(moving[3], row=1, col=2)
    # The moving traces in the order in which they were added, without the curve.
    places = [0, 1, 3, *([4] if pictures else [])]
    figure.frames = [go.Frame(data=data, traces=places, name=str(i)) for i, data in frames_of.items()]
    steps = [
        {
            "label": f"{along[i]:.2f}",
            "method": "animate",
            "args": [[str(i)], {"mode": "immediate", "frame": {"duration": 0, "redraw": True}, "transition": {"duration": 0}}],
        }
        for i in states
    ]
    figure.update_layout(
        title=title,
        sliders=[{"active": len(steps) - 1, "steps": steps, "currentvalue": {"prefix": f"{name}: "}}],
        scene={"aspectmode": "data", "xaxis_title": "x [mm]", "yaxis_title": "y [mm]", "zaxis_title": "z [mm]"},
        margin={"l": 20, "r": 20, "t": 70, "b": 20},
    )
    figure.update_xaxes(title_text=name, row=2, col=2)
    figure.update_yaxes(title_text="force [N]", row=2, col=2)
    figure.update_xaxes(visible=False, row=1, col=2)
    figure.update_yaxes(visible=False, row=1, col=2)
    page = figure.to_html(include_plotlyjs=True, full_html=True, auto_play=False, default_height="100vh")
    with whole_file(path) as partial:
        partial.write_text(page.replace("<body>", '<body style="margin: 0">', 1), encoding="utf-8")


def write_series(folder: Path, press: Deformation) -> list[Path]:
    """Writes gel_NNNN.vtu, object_NNNN.vtu and press.pvd; returns them. Lengths in metres, pressure in pascals."""
    import meshio

    folder.mkdir(parents=True, exist_ok=True)
    written, lines = [], []
    for state, at in enumerate(press.along[1]):
        for part, (name, motion) in enumerate((("gel", press.gel), ("object", press.object))):
            moved = motion.displacement[state]
            data = {"displacement": moved} | ({"contact_pressure": press.contact_pressure[state]} if name == "gel" else {})
            path = folder / f"{name}_{state:04d}.vtu"
            meshio.Mesh(motion.rest + moved, [("triangle6", motion.faces6)], point_data=data).write(path)
            written.append(path)
            lines.append(f'<DataSet timestep="{at:.9g}" part="{part}" name="{name}" file="{path.name}"/>')
    body = "\n".join(lines)
    with whole_file(folder / "press.pvd") as partial:
        partial.write_text(f'<VTKFile type="Collection" version="0.1"><Collection>\n{body}\n</Collection></VTKFile>\n', encoding="utf-8")
    return [*written, folder / "press.pvd"]


def _moving(press: Deformation, state: int, pictures: Sequence[str], along: Any, force: Any, span: tuple[float, float]) -> list[Any]:
    """What changes from state to state: both surfaces, the point on the curve, the picture."""
    import plotly.graph_objects as go

    gel = ((press.gel.rest + press.gel.displacement[state]) / MM).astype(np.float32)
    body = ((press.object.rest + press.object.displacement[state]) / MM).astype(np.float32)
    pressure = (press.contact_pressure[state] / KPA).astype(np.float32)
    traces: list[Any] = [
        go.Mesh3d(
            **_corners(gel, press.gel.faces), intensity=gel[:, 2], colorscale=GEL_COLOURS, cmin=span[0], cmax=span[1],
            customdata=pressure, hovertemplate="z %{z:.3f} mm, %{customdata:.2f} kPa<extra>gel</extra>", showscale=False,
        ),
        go.Mesh3d(**_corners(body, press.object.faces), color="#b0a090", opacity=0.45, hoverinfo="skip"),
        go.Scatter(x=[along[state]], y=[force[state]], mode="markers", marker={"size": 12, "color": "crimson"}, showlegend=False),
    ]  # fmt: skip
    if pictures:
        traces.append(go.Image(source=pictures[state], hoverinfo="skip"))
    return traces


def _corners(points: Any, faces: Any) -> dict[str, Any]:
    return dict(zip("xyzijk", (*points.T, *faces.T), strict=True))


def _data_uri(frame: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(frame.read_bytes()).decode()
