"""Shipped procedures are found by name, whatever else is called `procedures` on the import path."""

import sys

import pytest

from hil.core.errors import ConfigError
from hil.procedure import Procedure
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.shipped import shipped_names

MINE = """
from hil.procedure import Context, procedure

@procedure(name="mine")
def run(ctx: Context) -> None:
    pass
"""


def test_every_shipped_name_is_a_procedure_and_what_they_share_is_none():
    assert len(shipped_names()) == 12
    assert "parts" not in shipped_names()
    assert all(isinstance(load_procedure(name), Procedure) for name in shipped_names())


def test_a_users_folder_of_the_same_name_hides_nothing(tmp_path, monkeypatch):
    folder = tmp_path / "procedures"
    folder.mkdir()
    (folder / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    assert "mine" not in shipped_names()
    assert [load_procedure(name).name for name in ("wall_tracking", "procedures/mine.py")] == [
        "wall_tracking",
        "mine",
    ]


def test_a_procedure_that_a_script_does_not_declare_is_reported_with_those_that_it_does(tmp_path):
    text = "from hil.procedure import procedure\n"
    for name in ("short_line", "long_line"):
        text += f"@procedure(name={name!r})\ndef {name}(ctx):\n    pass\n"
    (tmp_path / "mine.py").write_text(text)
    with pytest.raises(ConfigError) as refused:
        load_procedure(f"{tmp_path}/mine.py:short_lin")
    assert refused.value.message == f"{tmp_path}/mine.py:short_lin: declares no procedure 'short_lin'"
    assert refused.value.expected == "one of short_line, long_line"
    assert refused.value.remedy == "did you mean short_line?"
    assert load_procedure(f"{tmp_path}/mine.py:long_line").name == "long_line"
