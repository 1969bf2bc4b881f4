"""The repository for CI in `examples/ros2/ci`, run as it stands with the program on Fast DDS."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

EXAMPLE = Path(__file__).parents[2] / "examples" / "ros2" / "ci"


@pytest.mark.long
@pytest.mark.real_time
@pytest.mark.timeout(1200)
def test_the_repository_for_ci_runs_as_it_stands(wall_line_dds, domain, tmp_path):
    project = tmp_path / "my_controller"
    shutil.copytree(EXAMPLE, project, ignore=shutil.ignore_patterns("__pycache__", ".pytest_cache"))
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "--junitxml=tests.xml"],
        cwd=project,
        env={**os.environ, "WALL_LINE": f"{wall_line_dds} --up 0.2", "ROS_DOMAIN_ID": str(domain)},
        capture_output=True,
        text=True,
        timeout=1000,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    cases = list(ElementTree.parse(project / "tests.xml").iter("testcase"))
    assert len(cases) == 3
    held = {p.get("value") for case in cases for p in case.iter("property") if p.get("name") == "held"}
    assert held == {"HELD"}
