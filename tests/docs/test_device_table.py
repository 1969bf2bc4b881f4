"""The table of devices on docs/hardware.md: every model that the bench knows, and what was tried of it."""

import re
from collections import Counter
from pathlib import Path

import yaml

from hil.core.registry import kinds
from hil.core.result_names import ACCEPTANCE_PAGE, ACCEPTANCE_TABLE

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "hardware.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| [^|`]+, `(\w+)` \| [^|]+ \| ([^|]+) \| ([^|]+) \|$", PAGE, re.M)


def test_every_model_of_the_bench_has_its_row():
    shipped = [model.name for kind in kinds().values() for model in kind.models if model.package == "hil"]
    assert len(shipped) > 10
    assert Counter(name for name, _, _ in ROWS) == Counter(shipped)


def test_what_was_tried_on_hardware_names_who_said_so():
    assert all(tried == "no" or re.search(r"\]\(.+\)", tried) for _, _, tried in ROWS)


def test_the_form_asks_for_the_files_of_an_acceptance():
    (name,) = re.findall(r"\.github/ISSUE_TEMPLATE/\w+\.yml", PAGE)
    form = yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))
    needed = [part for part in form["body"] if part.get("validations", {}).get("required")]
    asked = " ".join(part["attributes"].get("description", "") for part in needed)
    assert ACCEPTANCE_PAGE in asked
    assert ACCEPTANCE_TABLE in asked
