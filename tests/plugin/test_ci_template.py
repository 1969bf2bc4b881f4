"""The template repository in `docs/`, copied and run as a user's CI would run it.

From the wheel alone it is run by `tests/install/test_wheel.py`.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

TEMPLATE = Path(__file__).parents[2] / "docs" / "ci-template"


def test_the_template_runs_as_it_stands(tmp_path):
    project = tmp_path / "my_robot"
    shutil.copytree(
        TEMPLATE, project, ignore=shutil.ignore_patterns("__pycache__", ".pytest_cache", "results")
    )
    with (project / "tests" / "test_bench.py").open("a") as file:
        file.write("\nWATCH_S = 3.0\n")
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    environment = {**os.environ, "PATH": path}
    done = subprocess.run(
        ["sh", "ci.sh"],
        cwd=project,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout
    assert done.stdout.splitlines()[-1].startswith("report: "), "nothing follows the verdict"
    cases = list(ElementTree.parse(project / "results" / "tests.xml").iter("testcase"))
    skipped = [case.get("name") for case in cases if case.find("skipped") is not None]
    assert len(cases) > 20
    lacking = ("[adhesion]", "[thrust]", "[load_cells]")
    assert [name for name in skipped if not name.endswith(lacking)] == [
        "test_the_firmware_is_the_one_we_released"
    ]
    for case in cases:
        names = [p.get("name") for p in case.iter("property") if p.get("name") not in ("fault", "event")]
        assert len(names) == len(set(names))
        assert "bench_2" not in names
    benches = {p.get("value") for case in cases for p in case.iter("property") if p.get("name") == "bench"}
    assert benches == {"my_bench"}
    result = json.loads((project / "results" / "short_line" / "result.json").read_text())
    assert (result["verdict"], result["bench"]) == ("PASS", "my_bench")
    assert (project / "results" / "short_line" / "report.html").stat().st_size > 10_000
    assert not (project / "results" / "failed").exists() or not list(
        (project / "results" / "failed").iterdir()
    )


HIL = """#!/bin/sh
[ "$2" != procedures/failing.py ] || { mkdir "$8"; touch "$8/report.html"; exit 1; }
exec "%s" -m hil "$@"
"""


def test_what_is_said_of_a_procedure_that_has_not_passed_is_there(tmp_path):
    (tmp_path / "procedures").mkdir()
    for name, text in (("broken", "def run(:"), ("failing", "")):
        (tmp_path / "procedures" / f"{name}.py").write_text(f"{text}\n")
    shutil.copy(TEMPLATE / "bench.toml", tmp_path)
    for name, text in (("python", "#!/bin/sh\n"), ("hil", HIL % sys.executable)):
        (tmp_path / "bin" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "bin" / name).write_text(text)
        (tmp_path / "bin" / name).chmod(0o755)
    done = subprocess.run(
        ["sh", TEMPLATE / "ci.sh"],
        cwd=tmp_path,
        env={**os.environ, "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}", "GITHUB_ACTIONS": "true"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 1
    said = dict(line.removeprefix("::error file=").split("::") for line in done.stdout.splitlines())
    assert "results/failing/report.html" in said["procedures/failing.py"]
    broken = said["procedures/broken.py"]
    assert "report.html" not in broken
    assert broken in done.stderr
    assert "procedures/broken.py" in broken


@pytest.mark.parametrize("jobs", [".github/workflows/bench.yml", ".gitlab-ci.yml"])
def test_a_job_keeps_what_it_has_made_and_the_machine_code(jobs):
    job = yaml.safe_load((TEMPLATE / jobs).read_text(encoding="utf-8"))
    steps = job["jobs"]["bench"]["steps"] if "jobs" in job else [job["bench"]]
    text = str(steps)
    assert "sh ci.sh" in text
    assert "site-packages/hil/__pycache__" in text
    kept = [s for s in steps if "artifact" in s.get("uses", "") or "artifacts" in s]
    assert len(kept) == 1
    assert "always" in (kept[0].get("if") or kept[0]["artifacts"]["when"])
