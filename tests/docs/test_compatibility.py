"""docs/compatibility.md: its numbers are those of the code, its modules those that users are shown."""

import importlib
import re
from pathlib import Path
from typing import get_args

import pytest

from hil.calibration.calibration_file import CalibrationFile
from hil.campaign import plan as plan_file
from hil.config.bench import BenchConfig
from hil.config.robot_record.parts import RecordFile
from hil.core import errors
from hil.core.result_names import RESULT_SCHEMA
from hil.datasets.topic_map import TopicMap
from hil.recording import cycle_codec

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "compatibility.md").read_text(encoding="utf-8")
MODULES = {name for name in re.findall(r"`(hil(?:\.[a-z_0-9]+)*)`", PAGE) if name.islower()}


def schema_of(model):
    (number,) = get_args(model.model_fields["schema_version"].annotation)
    return number


def test_the_formats_have_the_numbers_of_the_page():
    shown = dict(re.findall(r"^\| ([^|(]+?)(?: \([^|]+\))? \| [^|]+ \| (\d+) \|$", PAGE, re.M))
    assert {name: int(number) for name, number in shown.items()} == {
        "bench file": schema_of(BenchConfig),
        "`calibration.toml`": schema_of(CalibrationFile),
        "record of a robot": schema_of(RecordFile),
        "topic mapping of a bag": schema_of(TopicMap),
        "`result.json` of a run": RESULT_SCHEMA,
        "`plan.json` of a campaign": plan_file.SCHEMA,
        "recording": cycle_codec.FORMAT,
    }


def test_every_exit_code_is_on_the_page():
    codes = {value for name, value in vars(errors).items() if name.startswith("EXIT_")}
    assert {int(code) for code in re.findall(r"^\| (\d) \|", PAGE, re.M)} == codes


@pytest.mark.parametrize("name", sorted(MODULES))
def test_every_module_is_there_and_documented(name):
    assert importlib.import_module(name).__doc__


def test_every_module_that_users_are_shown_is_promised():
    folders = [ROOT / "docs" / "ci-template", ROOT / "docs" / "notebooks", ROOT / "examples"]
    texts = [ROOT / "README.md", ROOT / "PACKAGE.md", *(ROOT / "docs").glob("*.md")]
    texts += [p for f in folders for p in f.rglob("*") if p.suffix in (".py", ".md", ".ipynb")]
    imported = re.compile(r"^\W*(?:from (hil(?:\.\w+)*) import|import (hil(?:\.\w+)*))", re.M)
    shown = {
        match[1] or match[2]
        for path in texts
        for match in imported.finditer(path.read_text(encoding="utf-8"))
    }
    assert len(shown) > 10
    assert sorted(shown - MODULES) == []
