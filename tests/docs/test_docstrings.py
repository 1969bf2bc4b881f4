"""Public functions say what they may raise, and the shapes of the arrays that they take and give."""

import ast
import builtins
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
    "controller",
    "estimator",
    "ring",
    "drivers",
    "devices",
    "fakes",
    "live",
    "console",
    "monitor",
    "pytest_plugin",
    "cli",
)
NOTATION = {"estimator": "hil/estimator/sensors/sensor.py"}
"""Where a room says once what the vectors are that its kernels pass to each other."""
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
        for attempt in nodes
        if isinstance(attempt, ast.Try)
        for name in re.findall(r"\w+", " ".join(ast.unparse(h.type) for h in attempt.handlers if h.type))
        for step in attempt.body
        for raising in ast.walk(step)
        if isinstance(raising, ast.Raise)
    }
    for node in nodes:
        call = node.exc if isinstance(node, ast.Raise) else None
        name = call.func.id if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) else ""
        if name and not any(node is raising and covers(by, name) for raising, by in caught):
            yield name


def covers(handler, error):
    """Whether a handler takes an error, by their names: the same, or a base of a built-in one."""
    known, base = getattr(builtins, error, None), getattr(builtins, handler, None)
    return handler == error or (
        isinstance(known, type) and isinstance(base, type) and issubclass(known, base)
    )


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


def is_not_called(function):
    """Validators, and commands: what those raise is told by exit codes, and their docstring is their help."""
    said = " ".join(ast.unparse(decorator) for decorator in function.decorator_list)
    return re.search(r"validator|\.(command|group)\(", said) is not None


def without_shape(function, told, module):
    """Whether arrays go in or out whose shape neither the docstring nor the head of the module gives.

    Kernels pass the same few vectors from one to the next: the head of their module says what each holds.
    """
    if not ARRAYS.search(typed(function)) or SHAPE.search(told):
        return False
    arguments = function.args.posonlyargs + function.args.args + function.args.kwonlyargs
    names = [a.arg for a in arguments if a.annotation and ARRAYS.search(ast.unparse(a.annotation))]
    gives = function.returns is not None and ARRAYS.search(ast.unparse(function.returns))
    return bool(gives) or not all(re.search(rf"`{name}`\s+\([^()]*,[^()]*\)", module) for name in names)


def gaps(text, notation=""):
    """What the docstrings of a module leave out; `notation` holds beside what its head says."""
    tree = ast.parse(text)
    module = (ast.get_docstring(tree) or "") + notation
    for function in public_functions(tree):
        told = ast.get_docstring(function) or ""
        if is_not_called(function):
            continue
        missing = [
            name for name in sorted(set(raised(function))) if name.endswith("Error") and name not in told
        ]
        yield from (f"{function.name} (line {function.lineno}) may raise {name}" for name in missing)
        if told and without_shape(function, told, module):
            yield f"{function.name} (line {function.lineno}) names no shape"


@pytest.mark.parametrize("room", ROOMS)
def test_a_public_docstring_names_errors_and_shapes(room):
    files = sorted((ROOT / "hil" / room).rglob("*.py"))
    assert files
    notation = ""
    if room in NOTATION:
        notation = ast.get_docstring(ast.parse((ROOT / NOTATION[room]).read_text(encoding="utf-8")))
    told = ((p.relative_to(ROOT), gaps(p.read_text(encoding="utf-8"), notation)) for p in files)
    found = [f"{path}: {gap}" for path, own in told for gap in own]
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
    kernel = '''
"""A step of the state `s` (138,)."""
def advance(s: Array) -> None:
    """Advance it."""
def press(s: Array, c: Array) -> None:
    """Press it."""
'''
    assert list(gaps(kernel)) == ["press (line 5) names no shape"]
    command = source.replace("def read", "@click.command()\ndef read")
    assert list(gaps(command)) == []
