"""Draw docs/images/architecture.svg: the packages of ninedtact, layer by layer, with the imports between them.

The layers are those that tests/test_layers.py enforces; the arrows are the imports that the source contains. An import that a
chain of other arrows implies is left out.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "packages" / "ninedtact" / "src" / "ninedtact"
DRAWING = ROOT / "docs" / "images" / "architecture.svg"
HIDDEN = {"_version", "__main__", "errors", "atomic_write", "required_libraries"}
"""Modules that nearly every package imports, or that have nothing to draw yet."""
WIDTH, ROW, BOX_HEIGHT, MARGIN = 960, 92, 44, 24

sys.path.insert(0, str(ROOT / "tests"))
from test_layers import LAYERS  # noqa: E402


def package_of(path: Path) -> str:
    """Return the top-level package or module that a file belongs to."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports() -> set[tuple[str, str]]:
    """Return the pairs (importing package, imported package)."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for name in _imported_modules(ast.parse(path.read_text(encoding="utf-8"))):
            parts = name.split(".")
            if parts[0] == "ninedtact" and len(parts) > 1:
                found.add((package_of(path), parts[1]))
    return {(a, b) for a, b in found if a != b and not {a, b} & HIDDEN}


def direct_imports(pairs: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Return the pairs that no path through other packages implies (the transitive reduction)."""
    below: dict[str, set[str]] = {}
    for a, b in pairs:
        below.setdefault(a, set()).add(b)

    def reachable(start: str) -> set[str]:
        return set().union(*({b} | reachable(b) for b in below.get(start, ())))

    return {(a, b) for a, b in pairs if not any(b in reachable(other) for other in below[a] - {b})}


def _imported_modules(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield f"{node.module}.{node.names[0].name}"


def box_positions() -> dict[str, tuple[float, float, float]]:
    """Return left edge, top edge and width of every package's box, the highest layer on top."""
    layers = [
        sorted(name for name in layer if name not in HIDDEN and _exists(name))
        for layer in reversed(LAYERS["ninedtact"])
    ]
    boxes = {}
    for row, names in enumerate(layer for layer in layers if layer):
        space = WIDTH / len(names)
        width = min(190.0, space - 20)
        for column, name in enumerate(names):
            boxes[name] = ((column + 0.5) * space - width / 2, MARGIN + row * ROW, width)
    return boxes


def _exists(name: str) -> bool:
    return (PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").is_file()


def architecture_svg() -> str:
    """Return the drawing as SVG."""
    boxes = box_positions()
    height = max(top for _, top, _ in boxes.values()) + BOX_HEIGHT + MARGIN
    arrows = [_arrow_svg(boxes[a], boxes[b]) for a, b in sorted(direct_imports(imports())) if a in boxes and b in boxes]
    drawn_boxes = [_box_svg(name, *box) for name, box in boxes.items()]
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:.0f}" font-family="sans-serif" font-size="15">'
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0 8 4 0 8z" fill="#8aa"/></marker></defs>'
        f'<rect width="{WIDTH}" height="{height:.0f}" fill="#fff"/>'
    )
    return "\n".join([head, *arrows, *drawn_boxes, "</svg>", ""])


def _arrow_svg(start: tuple[float, float, float], end: tuple[float, float, float]) -> str:
    x1, y1 = start[0] + start[2] / 2, start[1] + BOX_HEIGHT
    x2, y2 = end[0] + end[2] / 2, end[1]
    bend = (y1 + y2) / 2
    path = f"M{x1:.0f} {y1:.0f} C{x1:.0f} {bend:.0f} {x2:.0f} {bend:.0f} {x2:.0f} {y2:.0f}"
    return f'<path d="{path}" fill="none" stroke="#8aa" stroke-opacity=".55" marker-end="url(#tip)"/>'


def _box_svg(name: str, left: float, top: float, width: float) -> str:
    files = len(list((PACKAGE / name).rglob("*.py"))) if (PACKAGE / name).is_dir() else 1
    label = name if (PACKAGE / name).is_dir() else f"{name}.py"
    count = f"{files} files" if files > 1 else "1 file"
    middle = left + width / 2
    return (
        f'<rect x="{left:.0f}" y="{top:.0f}" width="{width:.0f}" height="{BOX_HEIGHT}" rx="6" fill="#eef5f5" stroke="#356"/>'
        f'<text x="{middle:.0f}" y="{top + 19:.0f}" text-anchor="middle" fill="#123">{label}</text>'
        f'<text x="{middle:.0f}" y="{top + 36:.0f}" text-anchor="middle" fill="#578" font-size="12">{count}</text>'
    )


if __name__ == "__main__":
    DRAWING.write_text(architecture_svg(), encoding="utf-8")
    print(f"wrote {DRAWING.relative_to(ROOT)}")
