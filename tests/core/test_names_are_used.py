"""Every name at the top of a module is used: a private one in its module, a public one somewhere."""

import ast
import functools
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
CODE = [path for room in ("hil", "procedures") for path in sorted((ROOT / room).rglob("*.py"))]
BESIDE = [
    path
    for room in ("tests", "benchmarks", "docs", "examples", "pyproject.toml")
    for path in ([ROOT / room] if (ROOT / room).is_file() else (ROOT / room).rglob("*"))
    if path.suffix in (".py", ".md", ".toml", ".ipynb")
]
CALLED_BY_OTHERS = re.compile(r"__\w+__|pytest_\w+|test_\w+")
"""Names that Python and pytest look for."""


def defined(tree):
    """Names that a module binds at its top; what is decorated is in use by its decorator."""
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.decorator_list:
            yield node.name
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in targets:
            yield from (part.id for part in ast.walk(target) if isinstance(part, ast.Name)) if target else ()


def used(tree):
    """Names that a module reads itself, and those that it takes from others."""
    own, others = set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            own.add(node.id)
        elif isinstance(node, ast.Attribute):
            others.add(node.attr)
        elif isinstance(node, ast.ImportFrom):
            others |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and " " not in node.value:
            others |= set(re.findall(r"\w+", node.value))
    return own, others


@functools.cache
def unused():
    """Of every module, the names that nothing in `hil` and `procedures` uses."""
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in CODE}
    uses = {path: used(tree) for path, tree in trees.items()}
    elsewhere = set().union(*(others for _, others in uses.values()))
    found = []
    for path, tree in trees.items():
        own, by_text = uses[path]
        for name in dict.fromkeys(defined(tree)):
            near = own | by_text
            if name not in (near if name.startswith("_") else own | elsewhere):
                found.append((path.relative_to(ROOT).as_posix(), name))
    return [(path, name) for path, name in found if not CALLED_BY_OTHERS.fullmatch(name)]


def test_private_names_are_used_in_their_module():
    assert [(path, name) for path, name in unused() if name.startswith("_")] == []


def test_public_names_are_used_somewhere():
    words = set()
    for path in BESIDE:
        words |= set(re.findall(r"\w+", path.read_text(encoding="utf-8")))
    assert [(path, name) for path, name in unused() if not name.startswith("_") and name not in words] == []
