"""The procedures printed in docs/procedures.md run as printed."""

import importlib
import re
from pathlib import Path

import pytest

from hil.procedure.bench_source import BenchSource
from hil.procedure.scripts import load_procedure

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "procedures.md").read_text(encoding="utf-8")


BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
PUBLIC = ("devices", "fragment", "samples", "scripted", "tracking")


@pytest.mark.parametrize("block", BLOCKS, ids=lambda b: re.search(r'name="(\w+)"', b)[1])
def test_the_printed_procedure_passes(block, tmp_path, run_small):
    assert len([line for line in block.splitlines() if line.strip()]) <= 15
    path = tmp_path / "printed.py"
    path.write_text(block)
    result = run_small(load_procedure(str(path)), source=BenchSource("emulated"))
    assert result.exit_code == 0, (result.error, result.measurements)
    assert (result.folder / "recording.mcap").stat().st_size > 10_000


@pytest.mark.parametrize("name", PUBLIC)
def test_the_page_names_what_a_procedure_can_use_and_it_is_there(name):
    """A name printed beside a module is one of its public names."""
    row = re.search(rf"^\| `(hil\.procedure\.{name})` \| (.*) \|$", PAGE, re.MULTILINE)
    assert row is not None
    module = importlib.import_module(row[1])
    named = [name for name in re.findall(r"`(\w+)`", row[2]) if name != "wall_tracking"]
    assert named
    assert [name for name in named if not hasattr(module, name)] == []


def test_every_shipped_calibration_procedure_has_its_section():
    titles = re.findall(r"^## (\S+)", PAGE, re.MULTILINE)
    assert {"bring_up", "steering_zero", "odometry_calibration", "surface_identification"} <= set(titles)
