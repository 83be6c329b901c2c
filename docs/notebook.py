"""Runs the cells of docs/notebook.ipynb in this process and keeps in it what they show: no Jupyter is needed, or in the way of the tests.

python docs/notebook.py
"""

from __future__ import annotations

import ast
import base64
import io
import json
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).with_suffix(".ipynb")


def run(cells: list[dict[str, Any]]) -> list[Any]:
    """What the last line of each code cell is, as a notebook would show it; the cell's outputs are replaced by it."""
    names: dict[str, Any] = {}
    shown = []
    for number, cell in enumerate((cell for cell in cells if cell["cell_type"] == "code"), start=1):
        *lines, last = ast.parse("".join(cell["source"])).body
        assert isinstance(last, ast.Expr), f"cell {number} ends without something to show"
        exec(compile(ast.Module(lines, []), f"cell {number}", "exec"), names)
        shown.append(eval(compile(ast.Expression(last.value), f"cell {number}", "eval"), names))
        cell["execution_count"] = number
        cell["outputs"] = [{"output_type": "execute_result", "execution_count": number, "metadata": {}, "data": mime_data(shown[-1])}]
    return shown


def mime_data(value: Any) -> dict[str, str]:
    """As IPython does it, of the kinds that occur."""
    data = {"text/plain": f"<{type(value).__name__}>"}
    if hasattr(value, "savefig"):
        file = io.BytesIO()
        value.savefig(file, format="png", dpi=72)
        data["image/png"] = base64.b64encode(file.getvalue()).decode()
    elif hasattr(value, "_repr_png_"):
        data["image/png"] = base64.b64encode(value._repr_png_()).decode()
    else:
        data["text/html"] = value._repr_html_()
    return data


if __name__ == "__main__":
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    run(notebook["cells"])
    NOTEBOOK.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
