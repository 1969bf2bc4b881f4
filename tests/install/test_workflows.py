"""The workflows of `.github/`: they take the steps of `.ci/run`, and hand over what they have made."""

import re
import subprocess
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / ".github" / "workflows"
WORKFLOWS = {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in FOLDER.glob("*.yml")}
MADE = re.compile(r"^(?:make|\.ci/run) (.+)$", re.M)


def jobs(workflow):
    return WORKFLOWS[workflow]["jobs"]


def rows(job):
    """What `${{ matrix... }}` stands for in each run of a job."""
    matrix = dict(job.get("strategy", {}).get("matrix", {}))
    included = matrix.pop("include", [])
    found = [{}]
    for key, values in matrix.items():
        found = [{**row, key: value} for row in found for value in values]
    return (found if matrix or not included else []) + included


def filled(text, row):
    return re.sub(r"\$\{\{ matrix\.([\w-]+) \}\}", lambda match: row[match[1]], text)


def steps_of(workflow):
    """(job's name, row of its matrix, step) of everything that a workflow does."""
    return [
        (name, row, step)
        for name, job in jobs(workflow).items()
        for row in rows(job)
        for step in job.get("steps", ())
    ]


def made_by(workflow):
    runs = (filled(step.get("run", ""), row) for _, row, step in steps_of(workflow))
    return {made for run in runs for made in MADE.findall(run)}


def test_they_take_every_step_of_the_ci_script():
    script = set(MADE.findall((ROOT / ".ci" / "run").read_text(encoding="utf-8")))
    assert len(script) > 4
    assert script <= made_by("test") | made_by("site")


@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_every_step_is_a_target_that_make_knows(workflow):
    for made in made_by(workflow):
        done = subprocess.run(
            ["make", "--dry-run", *made.split()], cwd=ROOT, capture_output=True, text=True, timeout=60
        )
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_a_job_takes_what_an_earlier_one_has_left_and_local_parts_are_there(workflow):
    local = {step["uses"] for _, _, step in steps_of(workflow) if step.get("uses", "").startswith("./")}
    local |= {job["uses"] for job in jobs(workflow).values() if "uses" in job}
    for used in local:
        assert (ROOT / used).is_file() or (ROOT / used / "action.yml").is_file(), used
    named = {"upload": set(), "download": set()}
    for _, row, step in steps_of(workflow):
        way = re.match(r"actions/(upload|download)-artifact@", step.get("uses", ""))
        if way and "with" in step:
            named[way[1]].add(filled(step["with"]["name"], row))
    assert named["download"] <= named["upload"]


def test_the_release_checks_the_tag_and_publishes_only_what_was_tried(tmp_path):
    release = jobs("release")
    assert set(release["publish"]["needs"]) == {"test", "site", "wheel"}
    assert release["wheel"]["needs"] == "dist"
    (check,) = [step["run"] for _, _, step in steps_of("release") if "tag is" in step.get("name", "")]
    (tmp_path / "dist").mkdir()
    (tmp_path / "dist" / "hil_4wis4wid-9.8.7-py3-none-any.whl").touch()
    for tag, right in (("v9.8.7", True), ("v9.8.8", False)):
        done = subprocess.run(["sh", "-c", check], cwd=tmp_path, env={"GITHUB_REF_NAME": tag}, timeout=10)
        assert (done.returncode == 0) == right
