"""Run examples/tour.ipynb as Jupyter would, keep what it shows in it, and write docs/tour.md, the page of the same for the site.

    .venv/bin/python scripts/run_tour.py
    .venv/bin/python scripts/run_tour.py run.ipynb    # writes the run notebook there, and nothing else

Jupyter is not needed: cells run one after the other in a temporary folder; text and figures become their outputs.
"""

import ast
import base64
import io
import json
import os
import re
import sys
import tempfile
from contextlib import chdir, redirect_stdout
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOK, PAGE = ROOT / "examples" / "tour.ipynb", ROOT / "docs" / "tour.md"
IMAGES = PAGE.parent / "images"
FIGURE_DPI = 80

Notebook = dict[str, Any]


def run_notebook(notebook: Notebook, folder: Path) -> Notebook:
    """Return the notebook with the outputs of its cells, which run in a folder; raises what a cell raises."""
    os.environ["MPLBACKEND"] = "Agg"
    names: dict[str, Any] = {"__name__": "__main__"}
    cells, count = [], 0
    with chdir(folder):
        for cell in notebook["cells"]:
            if cell["cell_type"] == "code":
                count += 1
                cell = {**cell, "execution_count": count, "outputs": run_cell("".join(cell["source"]), names, count)}
            cells.append(cell)
    return {**notebook, "cells": cells}


def run_cell(source: str, names: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """Run the source of a cell; return what it prints, the value of its last line and its figures."""
    import matplotlib.pyplot as plt

    *statements, last = ast.parse(source).body
    shows_value = isinstance(last, ast.Expr)
    printed, value = io.StringIO(), None
    with redirect_stdout(printed):
        exec(compile(ast.Module([*statements, *([] if shows_value else [last])], []), "tour", "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "tour", "eval"), names)
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        outputs.append(
            {"output_type": "stream", "name": "stdout", "text": printed.getvalue().splitlines(keepends=True)}
        )
    if value is not None:
        data = {"text/plain": repr(value).splitlines(keepends=True)}
        outputs.append({"output_type": "execute_result", "execution_count": count, "metadata": {}, "data": data})
    for number in plt.get_fignums():
        png = io.BytesIO()
        plt.figure(number).savefig(png, dpi=FIGURE_DPI, metadata={"Software": None})
        data = {"image/png": base64.b64encode(png.getvalue()).decode()}
        outputs.append({"output_type": "display_data", "metadata": {}, "data": data})
    plt.close("all")
    return outputs


def to_page(notebook: Notebook) -> tuple[str, dict[str, bytes]]:
    """Return the page of a notebook in Markdown, and its figures by their file names."""
    parts, figures = [], {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(re.sub(r"\]\(\.\./docs/", "](", source))
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                name = f"tour_{len(figures) + 1}.png"
                figures[name] = base64.b64decode(data["image/png"])
                parts.append(f"![What this code shows](images/{name})")
            else:
                text = "".join(output.get("text") or data["text/plain"]).rstrip()
                parts.append(f"```text\n{text}\n```")
    return "\n\n".join(parts) + "\n", figures


def main() -> None:
    """Run the notebook and write it, the page and its figures."""
    with tempfile.TemporaryDirectory() as folder:
        notebook = run_notebook(json.loads(NOTEBOOK.read_text(encoding="utf-8")), Path(folder))
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(json.dumps(notebook), encoding="utf-8")
        return
    NOTEBOOK.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    page, figures = to_page(notebook)
    PAGE.write_text(page, encoding="utf-8")
    for name, png in figures.items():
        (IMAGES / name).write_bytes(png)
    print(f"wrote {NOTEBOOK.relative_to(ROOT)}, {PAGE.relative_to(ROOT)} and {len(figures)} figures")


if __name__ == "__main__":
    main()
