"""The procedure printed in docs/procedures.md runs as printed."""

import re
from pathlib import Path

import pytest

from hil.procedure.bench_source import BenchSource
from hil.procedure.scripts import load_procedure

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "procedures.md").read_text(encoding="utf-8")


@pytest.fixture
def printed(tmp_path):
    block = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)[0]
    path = tmp_path / "straight.py"
    path.write_text(block)
    assert len([line for line in block.splitlines() if line.strip()]) <= 12
    return path


def test_the_printed_procedure_passes(printed, run_small):
    result = run_small(load_procedure(str(printed)), source=BenchSource("emulated"))
    assert result.exit_code == 0, (result.error, result.measurements)
    assert (result.folder / "recording.mcap").stat().st_size > 10_000


def test_every_shipped_calibration_procedure_has_its_section():
    titles = re.findall(r"^## (\S+)", PAGE, re.MULTILINE)
    assert {"bring_up", "steering_zero", "odometry_calibration", "surface_identification"} <= set(titles)
