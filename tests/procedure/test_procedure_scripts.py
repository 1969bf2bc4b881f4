"""Shipped procedures are found by name, whatever else is called `procedures` on the import path."""

import subprocess
import sys

from hil.procedure import Procedure
from hil.procedure.scripts import load_procedure, shipped_names

FIND = """
from hil.procedure.scripts import load_procedure, shipped_names
assert "mine" not in shipped_names()
print(load_procedure("wall_tracking").name, load_procedure("procedures/mine.py").name)
"""
MINE = """
from hil.procedure import Context, procedure

@procedure(name="mine")
def run(ctx: Context) -> None:
    pass
"""


def test_every_shipped_name_is_a_procedure_and_what_they_share_is_none():
    assert len(shipped_names()) == 11
    assert "parts" not in shipped_names()
    assert all(isinstance(load_procedure(name), Procedure) for name in shipped_names())


def test_a_users_folder_of_the_same_name_hides_nothing(tmp_path):
    folder = tmp_path / "procedures"
    folder.mkdir()
    (folder / "mine.py").write_text(MINE)
    command = [sys.executable, "-c", FIND]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.stderr == ""
    assert done.stdout.split() == ["wall_tracking", "mine"]
