"""The way from cables to the wall is told once, in an order that the procedures themselves allow."""

import re
from pathlib import Path

import pytest

from hil.config.loading import load_bench
from hil.procedure.scripts import load_procedure

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
HARDWARE = (ROOT / "docs" / "hardware.md").read_text(encoding="utf-8")
SECTION = re.search(r"^## 7\. Procedures, in this order\n(.*?)^## ", HARDWARE, re.DOTALL | re.MULTILINE)[1]
BLOCKS = re.findall(r"^```sh\n(.*?)^```", SECTION, re.DOTALL | re.MULTILINE)
FLOOR, WALL = filter(None, (re.findall(r"^hil run (\w+)", block, re.MULTILINE) for block in BLOCKS))


def test_the_order_names_every_procedure_that_finds_something_out_once():
    shipped = {path.stem for path in (ROOT / "procedures").glob("[a-z]*.py")}
    assert sorted(FLOOR + WALL) == sorted(shipped - {"grid_scan"})


def test_no_other_page_has_an_order_of_its_own():
    """An enumeration with a "then" in it, or a heading that promises one."""
    name = "`({})`".format("|".join(FLOOR + WALL))
    signs = (rf"{name}[^.]*\bthen\b[^.]*{name}", r"(?m)^#+ .*\b[Oo]rder\b")
    texts = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
    told = {page for page, text in texts.items() if any(re.search(sign, text) for sign in signs)}
    assert told == {"hardware.md"}


@pytest.mark.parametrize("name", FLOOR)
def test_what_is_to_be_done_on_the_floor_is_made_for_it(name):
    """All but bring_up, which runs wherever the robot stands, ask for the floor by themselves."""
    assert load_bench(load_procedure(name).bench).environment.kind == "floor" or name == "bring_up"


@pytest.mark.parametrize("name", WALL)
def test_what_is_to_be_done_on_the_wall_is_made_for_it(name):
    assert load_bench(load_procedure(name).bench).environment.kind == "wall"


def test_what_others_build_on_comes_first():
    order = FLOOR + WALL
    for first, then in (
        ("bring_up", "steering_zero"),
        ("steering_zero", "odometry_calibration"),
        ("odometry_calibration", "surface_identification"),
        ("tracker_extrinsics", "wall_tracking"),
        ("imu_calibration", "wall_tracking"),
    ):
        assert order.index(first) < order.index(then)


def test_nobody_is_told_to_lift_the_wheels():
    assert not [page.name for page in PAGES if "wheels off the ground" in page.read_text(encoding="utf-8")]
