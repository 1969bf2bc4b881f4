"""`hil replay` of recordings of other origin: what it says of them, and what it refuses."""

import csv

import numpy as np
import pytest

from hil.cli import main

RADIUS_M, LEVER_M = 0.0254, 0.1414
HEAD = ["t", *(f"phi{i}" for i in range(1, 5)), *(f"delta{i}" for i in range(1, 5)), "x", "y", "theta"]


def written(path, *, scale=1.0, seconds=6.0):
    """Wheels and truth of a straight line with a quick start; `scale`: how far it really went."""
    rng = np.random.default_rng(3)
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(HEAD)
        for k in range(int(40 * seconds)):
            t = k / 40
            way = 0.1 * max(0.0, t - 1.0)
            turned = (way / RADIUS_M + 1e-3 * rng.normal(size=4)).tolist()
            table.writerow([t, *turned, 0, 0, 0, 0, scale * way, 0.0, 0.0])
    return path


@pytest.fixture
def recording(tmp_path):
    return written(tmp_path / "line_x_1.csv")


def test_a_folder_is_refused_with_what_lies_in_it(recording, tmp_path, capsys):
    """It had replayed the first file and said nothing of the others."""
    written(tmp_path / "line_x_2.csv")
    assert main(["replay", str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert "is a folder, with line_x_1.csv, line_x_2.csv" in said.err
    assert f"name one, as {recording}" in said.err
    assert said.out == ""


def test_a_foreign_recording_is_nothing_to_verify(recording, capsys):
    """It had been told to differ in its first cycle."""
    assert main(["replay", str(recording), "--verify"]) == 2
    assert "not a recording of this bench: there is nothing to verify" in capsys.readouterr().err
