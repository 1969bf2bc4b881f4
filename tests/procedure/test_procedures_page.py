"""The procedures printed in docs/procedures.md run as printed."""

import re
from pathlib import Path

import pytest

from hil.procedure.bench_source import BenchSource
from hil.procedure.procedure_lookup import load_procedure

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "procedures.md").read_text(encoding="utf-8")


BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda b: re.search(r'name="(\w+)"', b)[1])
def test_the_printed_procedure_passes(block, tmp_path, run_small):
    assert len([line for line in block.splitlines() if line.strip()]) <= 15
    path = tmp_path / "printed.py"
    path.write_text(block)
    result = run_small(load_procedure(str(path)), source=BenchSource("emulated"))
    assert result.exit_code == 0, (result.error, result.measurements)
    assert (result.folder / "recording.mcap").stat().st_size > 10_000
