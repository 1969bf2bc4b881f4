"""Public functions say what they may raise, and the shapes of the arrays that they take and give."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = (
    "vocabulary",
    "robot",
    "config",
    "calibration",
    "recording",
    "replay",
    "report",
    "procedure",
    "bench",
)
"""Rooms whose names others build on. Within the filter and the emulated world arrays are the state's."""
ARRAYS = re.compile(r"\b(Array|ArrayLike|NDArray)\b")
SHAPE = re.compile(r"\(\.*\w*[^()]{0,12},[^()]*\)|\d ?x ?\d|\bshape\b")


def own_nodes(function):
    """Nodes of a function, those of functions and classes within it left out."""
    waiting = list(function.body)
    while waiting:
        node = waiting.pop()
        if not isinstance(node, (ast.FunctionDef, ast.Lambda, ast.ClassDef)):
            yield node
            waiting += ast.iter_child_nodes(node)


def raised(function):
    """Errors that leave a function: not those that it catches itself."""
    nodes = list(own_nodes(function))
    caught = {
        (raising, name)
        for attempt in nodes if isinstance(attempt, ast.Try)
        for name in re.findall(r"\w+", " ".join(ast.unparse(h.type) for h in attempt.handlers if h.type))
        for step in attempt.body for raising in ast.walk(step) if isinstance(raising, ast.Raise)
    }  # fmt: skip
    for node in nodes:
        call = node.exc if isinstance(node, ast.Raise) else None
        name = call.func.id if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) else ""
        if name and (node, name) not in caught:
            yield name


def typed(function):
    """The types of what goes in and out, as text."""
    arguments = function.args.posonlyargs + function.args.args + function.args.kwonlyargs
    found = [ast.unparse(a.annotation) for a in arguments if a.annotation]
    return " ".join([*found, ast.unparse(function.returns) if function.returns else ""])


def public_functions(tree):
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public_functions(node)
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield node


def gaps(text):
    """What the docstrings of a module leave out."""
    for function in public_functions(ast.parse(text)):
        told = ast.get_docstring(function) or ""
        if any(isinstance(d, ast.Name) and "validator" in d.id for d in function.decorator_list):
            continue
        missing = [
            name for name in sorted(set(raised(function))) if name.endswith("Error") and name not in told
        ]
        yield from (f"{function.name} (line {function.lineno}) may raise {name}" for name in missing)
        if told and ARRAYS.search(typed(function)) and not SHAPE.search(told):
            yield f"{function.name} (line {function.lineno}) names no shape"


@pytest.mark.parametrize("room", ROOMS)
def test_a_public_docstring_names_errors_and_shapes(room):
    files = sorted((ROOT / "hil" / room).rglob("*.py"))
    assert files
    found = [f"{p.relative_to(ROOT)}: {gap}" for p in files for gap in gaps(p.read_text(encoding="utf-8"))]
    assert found == []


def test_a_gap_is_noticed():
    source = '''
def read(path: Path) -> Array:
    """Values of a file."""
    raise DataError("no")
'''
    assert list(gaps(source)) == ["read (line 2) may raise DataError", "read (line 2) names no shape"]
    whole = source.replace("Values of a file.", "Values (n, 3) of a file. Raises: DataError.")
    assert list(gaps(whole)) == []
