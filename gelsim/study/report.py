"""What people read of a study: study.csv (a row a case), study.png (a panel a metric), index.html (one page with all in it, which needs no
other file and no network) and study.md (the same in short, for a documentation)."""

from __future__ import annotations

import base64
import hashlib
import html
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gelsim.files import digest
from gelsim.scene.definition import Scene
from gelsim.study.definition import Study, shown
from gelsim.study.metrics import METRICS
from gelsim.tables import write_csv
from gelsim.work.ledger import Row

TABLE, PICTURE, PAGE, SHORT = "study.csv", "study.png", "index.html", "study.md"
INK = "#22272e"
DASHES = ("-", "--", ":", "-.")
_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #22272e; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } img { max-width: 100%; } .answer { font-size: 1.15rem; }
table { border-collapse: collapse; font-size: .85rem; } td, th { padding: .15rem .6rem; border-bottom: 1px solid #ddd; text-align: right; }
pre, code { background: #f4f5f7; } pre { padding: .8rem; overflow-x: auto; } .failed { color: #a40000; }
"""


def fingerprint(scene: Scene, metrics: Sequence[str]) -> str:
    """Eight characters that change with anything that decides a row."""
    decides: tuple[object, ...] = (scene, tuple(metrics))
    if scene.object.mesh is not None:  # the scene has its path alone
        decides = *decides, digest(Path(scene.object.mesh))
    return hashlib.sha256(repr(decides).encode()).hexdigest()[:8]


def write(
    out: Path,
    study: Study,
    rows: Sequence[Row],
    facts: Mapping[str, Any],
    paint: Callable[[Path, Study, Sequence[Row]], None] | None = None,
) -> None:
    """Writes all four files; `facts` are what `runner.run` returns; `paint`, or `draw`, makes the picture of the rows that gave numbers."""
    write_csv(out / TABLE, rows, without=("key",))
    (paint or draw)(out / PICTURE, study, [row for row in rows if row["status"] == "CONVERGED"])
    (out / PAGE).write_text(_page(out, study, rows, facts), encoding="utf-8")
    (out / SHORT).write_text(_short(study, rows, facts), encoding="utf-8")


def draw(path: Path, study: Study, rows: Sequence[Row]) -> None:
    """A panel for each metric against study.x: curves over a grid, points of a Latin hypercube."""
    import matplotlib
    from matplotlib.figure import Figure

    columns = min(2, len(study.metrics))
    lines = -(-len(study.metrics) // columns)
    figure = Figure(figsize=(4.6 * columns, 3.3 * lines + 0.2), dpi=90, facecolor="white", layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    curves = _curves(study, rows)
    sampled = any(isinstance(values, Mapping) for values in study.axes.values())
    hues = list(dict.fromkeys(row[study.colour] for row in rows)) if study.colour else [None]
    others = list(dict.fromkeys(rest for _, rest in curves))
    palette = matplotlib.colormaps["viridis"]
    for panel, name in zip(panels, study.metrics, strict=False):
        for (hue, rest), curve in curves.items():
            known = [row for row in curve if row.get(name) is not None]
            colour = palette(0.9 * hues.index(hue) / max(len(hues) - 1, 1))
            style = "" if sampled else DASHES[others.index(rest) % len(DASHES)]
            label = ", ".join([*([f"{study.colour} {shown(hue)}"] if study.colour else []), *(f"{axis} {value}" for axis, value in rest)])
            x, y = [row[study.x] for row in known], [row[name] for row in known]
            panel.plot(x, y, marker="o", markersize=3.5, linestyle=style or "none", linewidth=1.4, color=colour, label=label or None)
        panel.set_xlabel(study.x)
        panel.set_ylabel(METRICS[name].label, fontsize=8.5)
        panel.tick_params(labelsize=8)
        panel.grid(alpha=0.25)
        panel.set_ylim(bottom=min(0.0, panel.get_ylim()[0]))
    for panel in panels[len(study.metrics) :]:
        panel.set_axis_off()
    if any(label for label in panels[0].get_legend_handles_labels()[1]):
        panels[0].legend(fontsize=7)
    figure.suptitle(study.name, fontsize=11, color=INK)
    figure.savefig(path, format="png")


def _curves(study: Study, rows: Sequence[Row]) -> dict[tuple[Any, tuple[tuple[str, str], ...]], list[Row]]:
    """(value of the colour axis, other axes' values) -> rows. Axes that are ranges tell no curves apart."""
    rest = [axis for axis, values in study.axes.items() if axis not in (study.x, study.colour) and not isinstance(values, Mapping)]
    curves: dict[tuple[Any, tuple[tuple[str, str], ...]], list[Row]] = {}
    for row in rows:
        key = (row[study.colour] if study.colour else None, tuple((axis, shown(row[axis])) for axis in rest))
        curves.setdefault(key, []).append(row)
    return curves


def cost(rows: Sequence[Row], facts: Mapping[str, Any]) -> str:
    """What the cases cost, and how busy the machine was."""
    loads = [row["load"] for row in rows if row.get("load") is not None]
    cores = os.cpu_count() or 1
    busy = f", load {min(loads):g} to {max(loads):g}" if loads else ""
    said = " (busy: on an idle machine it is less)" if loads and max(loads) > 1.5 * cores else ""
    return f"{facts['cases']} cases, {facts['case_seconds']:.0f} s in all, {cores} cores ({platform.machine()}){busy}{said}"


def _short(study: Study, rows: Sequence[Row], facts: Mapping[str, Any]) -> str:
    failed = "".join(f"\n- failed: {item['case']}: {item['message']}" for item in facts["failed"])
    return (
        f"## {study.name}\n\n**{study.question}**\n\n{facts['answer']}\n\n![{study.name}]({PICTURE})\n\n"
        f"    {facts['command']}\n\n{cost(rows, facts)}.\n\n{study.method}\n{failed}"
    )


def _page(out: Path, study: Study, rows: Sequence[Row], facts: Mapping[str, Any]) -> str:
    import tomli_w

    picture = base64.b64encode((out / PICTURE).read_bytes()).decode()
    columns = [*study.axes, *study.metrics, "status", "seconds"]
    head = "".join(f"<th>{html.escape(name)}</th>" for name in columns)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(_cell(row.get(name)))}</td>" for name in columns) + "</tr>\n" for row in rows)
    failed = "".join(f"<li>{html.escape(item['case'])}: {html.escape(item['message'])}</li>" for item in facts["failed"])
    meanings = "".join(f"<li><code>{name}</code>: {html.escape(METRICS[name].label)}</li>" for name in study.metrics)
    axes = tomli_w.dumps({"fields": dict(study.axes)})
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{html.escape(study.name)}</title><style>{_STYLE}</style></head><body>
<h1>{html.escape(study.question)}</h1>
<p class="answer">{html.escape(facts["answer"])}</p>
<img alt="{html.escape(study.name)}" src="data:image/png;base64,{picture}">
<p>{html.escape(study.method)}</p>
{f'<h2 class="failed">{len(facts["failed"])} of {facts["cases"]} cases failed</h2><ul>{failed}</ul>' if failed else ""}
<h2>What was measured</h2><ul>{meanings}</ul>
<h2>Scenes</h2><p>Shared by all cases; what is not named is the default:</p><pre>{html.escape(tomli_w.dumps(study.base))}</pre>
<p>Varied:</p><pre>{html.escape(axes)}</pre>
<h2>Command</h2><pre>{html.escape(facts["command"])}</pre><p>{html.escape(cost(rows, facts))}.</p>
<details><summary>All cases ({TABLE})</summary><table><tr>{head}</tr>
{body}</table></details>
</body></html>
"""


def _cell(value: Any) -> str:
    return "–" if value is None else shown(value)
