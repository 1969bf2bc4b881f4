"""Who goes on with a campaign gets the runs that it would have had undisturbed, or is refused."""

import json
import os
import sys
from pathlib import Path

import pytest

from hil.campaign.plan import locked_folder
from hil.cli import main
from hil.core.errors import UsageError
from hil.procedure.procedure_lookup import modules_beside
from hil.support import versions

DRIVES = '''
"""Two checkpoints on one bench; the second one dies once."""
import os
from pathlib import Path

from hil.procedure import Measurement, procedure
from hil.robot.trajectories import line


@procedure(name="twice", measurements=[Measurement("first", "m"), Measurement("second", "m")])
def run(ctx):
    """Drive on from where the first drive ended."""

    def drive(name, begin_m):
        way = line((begin_m, 0, 0), (begin_m + 0.005, 0, 0), duration_s=0.5)
        ctx.bench.drive(way, feedback="odometry")
        ctx.measure(name, ctx.bench.truth().pose_body_in_wall[0])

    def fall_over():
        if Path("die").exists():
            Path("die").unlink()
            os.kill(os.getpid(), 9)
        drive("second", 0.005)

    ctx.checkpoint("one", lambda: drive("first", 0.0))
    ctx.checkpoint("two", fall_over)
'''
PLAIN = '''
"""A procedure that asks no device."""
from hil.procedure import Measurement, procedure

print("a script that prints")


@procedure(name="plain", measurements=[Measurement("seed", "1")])
def run(ctx):
    """Tell the seed."""
    ctx.measure("seed", ctx.seed)
'''
WITH_HELPER = '''
"""A procedure with a module of its own."""
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import own_helper

from hil.procedure import Measurement, procedure


@procedure(name="helped", measurements=[Measurement("gain", "1")])
def run(ctx):
    """Ask the helper."""
    ctx.measure("gain", own_helper.GAIN)
'''


@pytest.fixture
def campaign(tmp_path, monkeypatch, capsys):
    """Runs `hil campaign` in `tmp_path`, here, results alone; gives exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*options):
        code = main(["campaign", *options, "--workers", "0", "--keep", "results"])
        said = capsys.readouterr()
        return code, said.out, said.err

    return run


def measured(folder):
    rows = json.loads((folder / "campaign.json").read_text())["rows"]
    return [[m["value"] for m in row["measurements"].values()] for row in rows]


def test_a_run_that_died_on_its_way_ends_as_it_would_have_ended(campaign, tmp_path):
    (tmp_path / "twice.py").write_text(DRIVES)
    assert campaign("twice.py", "--seeds", "0", "--out", "whole")[0] == 0
    (tmp_path / "die").touch()
    child = os.fork()
    if not child:
        main(["campaign", "twice.py", "--seeds", "0", "--workers", "0", "--keep", "results", "--out", "cut"])
        os._exit(0)
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == 9
    assert campaign("twice.py", "--seeds", "0", "--out", "cut", "--resume")[0] == 0
    assert measured(tmp_path / "cut") == measured(tmp_path / "whole")


def test_a_run_is_not_resumed_where_the_emulated_robot_is_no_longer(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "twice.py").write_text(DRIVES)
    (tmp_path / "die").touch()
    child = os.fork()
    if not child:
        main(["run", "twice.py", "--out", "cut"])
        os._exit(0)
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == 9
    assert main(["run", "twice.py", "--out", "cut", "--resume"]) == 2
    assert "no longer where the run that was cut off had left it" in capsys.readouterr().out


def test_what_a_script_prints_is_no_part_of_the_json_object(campaign, tmp_path):
    (tmp_path / "plain.py").write_text(PLAIN)
    code, out, said = campaign("plain.py", "--seeds", "0:2", "--out", "o", "--json")
    assert (code, json.loads(out)["cases"]) == (0, 2)
    assert "a script that prints" in said


def test_other_versions_do_not_go_on_with_it(campaign, tmp_path, monkeypatch):
    (tmp_path / "plain.py").write_text(PLAIN)
    assert campaign("plain.py", "--seeds", "0", "--out", "o")[0] == 0
    here = versions.make()
    monkeypatch.setattr("hil.campaign.plan.make", lambda: {**here, "numba": "another"})
    code, _, said = campaign("plain.py", "--seeds", "0:2", "--out", "o", "--resume")
    assert (code, "was begun with numba" in said) == (2, True), said


def test_the_digest_of_the_package_holds_the_shipped_procedures(tmp_path, monkeypatch):
    (tmp_path / "hil").mkdir()
    (tmp_path / "procedures").mkdir()
    (tmp_path / "hil" / "__init__.py").touch()
    (tmp_path / "hil" / "procedures").symlink_to("../procedures")
    (tmp_path / "procedures" / "bring_up.py").write_text("x = 1\n")
    monkeypatch.setattr(versions.hil, "__file__", str(tmp_path / "hil" / "__init__.py"))
    before = versions._sources()
    (tmp_path / "procedures" / "bring_up.py").write_text("x = 2\n")
    assert versions._sources() != before


def test_modules_beside_the_script_are_files_of_the_campaign(campaign, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "helped.py").write_text(WITH_HELPER)
    (tmp_path / "own_helper.py").write_text("GAIN = 1.0\n")
    assert campaign("helped.py", "--seeds", "0", "--out", "o")[0] == 0
    assert modules_beside(tmp_path / "helped.py") == (tmp_path / "own_helper.py",)
    (tmp_path / "own_helper.py").write_text("GAIN = 2.0\n")
    code, _, said = campaign("helped.py", "--seeds", "0:2", "--out", "o", "--resume")
    assert (code, "own_helper.py changed since the campaign began" in said) == (2, True), said
    del sys.modules["own_helper"]


def test_a_campaign_that_is_at_work_is_left_alone(campaign, tmp_path):
    (tmp_path / "plain.py").write_text(PLAIN)
    assert campaign("plain.py", "--seeds", "0", "--out", "o")[0] == 0
    with locked_folder(tmp_path / "o", resume=True):
        for options in ((), ("--resume",)):
            code, _, said = campaign("plain.py", "--seeds", "0:2", "--out", "o", *options)
            assert (code, "a campaign is at work there" in said) == (2, True), said
    with (
        locked_folder(tmp_path / "o", resume=True),
        pytest.raises(UsageError),
        locked_folder(Path("o"), resume=True),
    ):
        pass


def test_cases_are_not_left_out_and_files_are_those_of_the_same_folder(campaign, tmp_path, monkeypatch):
    (tmp_path / "plain.py").write_text(PLAIN)
    late = '[[fault]]\ndevice = "tracker"\nkind = "slow"\nat_s = 0.1\n'
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "late.toml").write_text(late)
    out, options = str(tmp_path / "o"), (str(tmp_path / "plain.py"), "--fault", "late.toml")
    monkeypatch.chdir(tmp_path / "a")
    assert campaign(*options, "--seeds", "0:2", "--out", out)[0] == 1  # no device, so no fault
    code, _, said = campaign(*options, "--seeds", "1", "--out", out, "--resume")
    assert (code, "has 1 more cases, seed=0 among them" in said) == (2, True), said
    monkeypatch.chdir(tmp_path / "b")
    code, _, said = campaign(*options, "--seeds", "0:3", "--out", out, "--resume")
    assert (code, "differs in faults" in said) == (2, True), said


def test_a_plan_of_another_version_and_an_empty_scheduler_are_named(campaign, tmp_path):
    (tmp_path / "plain.py").write_text(PLAIN)
    assert campaign("plain.py", "--seeds", "0", "--out", "o")[0] == 0
    plan = tmp_path / "o" / "plan.json"
    plan.write_text(json.dumps({**json.loads(plan.read_text()), "schema": 2}))
    code, _, said = campaign("plain.py", "--seeds", "0", "--out", "o", "--resume")
    assert (code, "another version of the package made it" in said) == (2, True), said
    code, _, said = campaign("plain.py", "--seeds", "0", "--scheduler", "", "--out", "p")
    assert (code, "--scheduler is empty" in said) == (2, True), said
