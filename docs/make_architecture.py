"""Draws docs/images/architecture.svg from the imports as they are: `python docs/make_architecture.py`.

A box is a room of `hil/`, in the layers of pyproject.toml; an arrow leads to a room that it imports. Imports
that follow from two or more arrows are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import grimp

try:
    import tomllib
except ImportError:  # CPython 3.10
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
LEFT_OUT = ("__main__",)
WIDTH, HEIGHT, BOX, TALL, ROW, COLUMN = 850, 732, 106, 34, 72, 122
PLACES = {
    "cli": (1.0, 0),
    "procedures": (3.0, 0),
    "pytest_plugin": (4.4, 0),
    "campaign": (1.6, 1),
    "fault_matrix": (3.0, 1),
    "commission": (4.4, 1),
    "twin": (5.6, 1),
    "live": (0.2, 2),
    "replay": (1.6, 2),
    "procedure": (3.0, 2),
    "console": (5.4, 2),
    "bench": (3.0, 3),
    "report": (5.2, 3),
    "devkit": (0.6, 3.4),
    "ros2": (5.6, 4.35),
    "monitor": (0.0, 5),
    "drivers": (1.0, 5),
    "fakes": (2.0, 5),
    "fan_daemon": (0.4, 6.2),
    "links": (1.2, 6.9),
    "faults": (1.2, 7.9),
    "recording": (3.0, 5.75),
    "streams": (1.9, 6.2),
    "calibration": (4.15, 3.7),
    "datasets": (3.6, 4.35),
    "estimator": (5.05, 5.4),
    "controller": (6.0, 5.4),
    "loop": (4.2, 6.5),
    "config": (2.6, 7.4),
    "robot": (2.6, 8.4),
    "core": (2.6, 9.4),
    "support": (4.2, 8.4),
    "user_code": (5.6, 7.4),
}
"""Column and row of each room: chosen so that few arrows run behind a box."""
NEW = (5.6, 0)
"""Place of a room that has none yet."""
STYLE = """
svg { color-scheme: light dark; }
rect { fill: #f4f4f5; stroke: #71717a; }
text { fill: #18181b; font: 14px system-ui, sans-serif; text-anchor: middle; }
path { fill: none; stroke: #71717a; stroke-width: 1.2; } marker path { fill: #71717a; stroke: none; }
@media (prefers-color-scheme: dark) {
  rect { fill: #1e1e22; stroke: #9d9da8; } text { fill: #ececf0; }
  path { stroke: #9d9da8; } marker path { fill: #9d9da8; }
}
"""

Edges = set[tuple[str, str]]


def rooms_of() -> list[str]:
    """Rooms from the top down, as the contract in pyproject.toml has them."""
    tree = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contract = next(c for c in tree["tool"]["importlinter"]["contracts"] if "layers" in c)
    found = [name for layer in contract["layers"] for name in re.findall(r"\w+", layer)]
    return [name for name in found if name not in LEFT_OUT]


def imports(rooms: Iterable[str]) -> Edges:
    """Which room imports which, directly."""
    graph, known = grimp.build_graph("hil", cache_dir=None), set(rooms)
    found = set()
    for module in graph.modules:
        for other in graph.find_modules_directly_imported_by(module):
            pair = tuple(f"{name}.".split(".")[1] for name in (module, other))
            if pair[0] != pair[1] and known.issuperset(pair):
                found.add((pair[0], pair[1]))
    return found


def reduced(edges: Edges) -> Edges:
    """The same without what follows from the others; there are no circles."""
    after: dict[str, set[str]] = {}
    for a, b in edges:
        after.setdefault(a, set()).add(b)

    def reached(room: str) -> set[str]:
        return set().union(*({b} | reached(b) for b in after.get(room, ())))

    return {(a, b) for a, b in edges if not any(b in reached(c) for c in after[a] - {b})}


def svg(rooms: Sequence[str], edges: Edges) -> str:
    """The picture; the same imports give the same text."""
    lines = [_arrow(a, b) for a, b in sorted(edges)]
    boxes = []
    for room in rooms:
        x, y = _middle(room)
        boxes.append(
            f'<rect x="{x - BOX / 2:g}" y="{y - TALL / 2:g}" width="{BOX}" height="{TALL}" rx="5"/>'
            f'<text x="{x:g}" y="{y + 5:g}">{room}</text>'
        )
    label = "Rooms of hil, from the command line above to the core below; arrows lead to what is imported"
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="{label}">'
        f"<style>{STYLE}</style>"
        '<marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M 0 0 L 8 4 L 0 8 z"/></marker>'
    )
    return "\n".join([head, *lines, *boxes, "</svg>", ""])


def _arrow(a: str, b: str) -> str:
    (x0, y0), (x1, y1) = _middle(a), _middle(b)
    return (
        f'<path data-from="{a}" data-to="{b}" marker-end="url(#tip)" '
        f'd="M {x0:g} {y0 + TALL / 2:g} L {x1:g} {y1 - TALL / 2:g}"/>'
    )


def _middle(room: str) -> tuple[float, float]:
    column, row = PLACES.get(room, NEW)
    return round(BOX / 2 + 6 + COLUMN * column, 1), 24.0 + ROW * row


def drawn(picture: str) -> Edges:
    """The arrows of a picture."""
    return set(re.findall(r'data-from="(\w+)" data-to="(\w+)"', picture))


def main() -> None:
    """Write the picture."""
    rooms = rooms_of()
    PICTURE.write_text(svg(rooms, reduced(imports(rooms))), encoding="utf-8")
    print(PICTURE.relative_to(ROOT))


if __name__ == "__main__":
    main()
