"""Values that are not there are counted apart from those beyond a limit, and shown beside the range."""

import json

import pytest

from hil.cli import main

SCRIPT = '''
"""Every third run has a value; the others have none, each kind for its own reason."""
from hil.procedure import Measurement, procedure


@procedure(name="holes", measurements=[Measurement("two", "mm", high=5.5), Measurement("free", "1")])
def run(ctx):
    """Measure, or not."""
    ctx.measure("free", 1.0)
    if ctx.seed == 7:
        raise ValueError("on its way")
    if ctx.seed % 3 == 0:
        ctx.measure("two", float(ctx.seed))
    elif ctx.seed % 3 == 1:
        ctx.measure("two", float("inf"))
'''


def test_terminal_and_data_say_how_many_runs_a_range_covers_and_why(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "holes.py").write_text(SCRIPT)
    main(["campaign", "holes.py", "--seeds", "0:9", "--workers", "0", "--keep", "results", "--out", "o"])
    folder, said = tmp_path / "o", capsys.readouterr().out
    (two,) = [line for line in said.splitlines() if line.startswith("  two ")]
    assert two.endswith("[0 to 6] in 3 of 9 runs; 1 ended before, 3 never measured, 2 no finite number")
    (free,) = [line for line in said.splitlines() if line.startswith("  free ")]
    assert free.endswith("[1 to 1]")
    found = json.loads((folder / "campaign.json").read_text())["groups"][0]["measurements"][0]
    assert (found["n"], found["of"]) == (3, 9)
    assert found["missing"] == {"ended before": 1, "never measured": 3, "no finite number": 2}
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(folder / "rows").to_pydict()
    whys = dict(zip(zip(table["seed"], table["measurement"], strict=True), table["missing"], strict=True))
    assert [whys[seed, "two"] for seed in (0, 1, 2, 7)] == [
        "",
        "no finite number",
        "never measured",
        "ended before",
    ]
