"""The notebooks run from top to bottom, and are kept without output."""

import ast
import json
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).resolve().parents[2] / "docs" / "notebooks"
NAMES = sorted(p.name for p in NOTEBOOKS.glob("*.ipynb"))


def cells(name, kind):
    tree = json.loads((NOTEBOOKS / name).read_text(encoding="utf-8"))
    return [cell for cell in tree["cells"] if cell["cell_type"] == kind]


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_is_kept_without_output_and_judges_its_own_result(name):
    code = cells(name, "code")
    assert [c for c in code if c["outputs"] or c["execution_count"]] == []
    trees = [ast.parse("".join(c["source"])) for c in code]
    assert any(isinstance(node, ast.Assert) for tree in trees for node in ast.walk(tree))
    assert name in (NOTEBOOKS / "README.md").read_text(encoding="utf-8")


def executed(name, folder):
    nbclient = pytest.importorskip("nbclient", reason="the extra docs is not installed")
    pytest.importorskip("ipykernel", reason="the extra docs is not installed")
    import nbformat

    notebook = nbformat.read(NOTEBOOKS / name, as_version=4)
    nbclient.NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(folder)}}).execute()
    return notebook


def pictures(notebook):
    outputs = [out for cell in notebook.cells if cell.cell_type == "code" for out in cell.outputs]
    return sum("image/png" in out.get("data", {}) for out in outputs)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")  # of the notebook server's packages
def test_the_run_on_the_wall_is_executed(tmp_path):
    assert pictures(executed("wall_run.ipynb", tmp_path)) == 1


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_the_calibration_is_executed_on_the_public_recordings(tmp_path, public_data, monkeypatch):
    monkeypatch.setenv("HIL_RECORDINGS", str(public_data))
    assert pictures(executed("calibration.ipynb", tmp_path)) == 1
