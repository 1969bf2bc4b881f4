"""Foxglove's own packages read our recordings: its schemas, its reader and writer of messages, its layout."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from mcap_cases import driving_record
from recorded import HEADER, recorded

from hil.core.clock import NS_PER_S, WallOffset
from hil.recording.transform_tree import describe_clock

PACKAGES = (
    "@foxglove/rosmsg@5.0.5",
    "@foxglove/rosmsg-msgs-common@3.2.3",
    "@foxglove/rosmsg2-serialization@3.1.0",
    "@mcap/core@2.2.2",
    "@mcap/nodejs@1.0.2",
    "@mcap/support@1.1.0",
)
"""`@foxglove/schemas` is not among them: it has the schemas `foxglove.*`, of which a recording uses none."""
LAYOUT = Path(__file__).parents[2] / "docs" / "foxglove" / "layout.json"
CYCLES = 120
pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    """What Foxglove's packages make of a recording."""
    if shutil.which("npm") is None or shutil.which("node") is None:
        pytest.skip("Foxglove's packages need node and npm, which are not installed")
    folder = tmp_path_factory.mktemp("foxglove")
    fetched = subprocess.run(
        ["npm", "install", "--no-audit", "--no-fund", "--prefix", folder, *PACKAGES],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    if fetched.returncode != 0:
        pytest.skip(f"npm does not get Foxglove's packages: {fetched.stderr.strip()[-200:]}")
    script = shutil.copy(Path(__file__).with_name("foxglove_reads.mjs"), folder)
    said = subprocess.run(
        ["node", script, recording(folder / "run.mcap"), LAYOUT],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert said.returncode == 0, said.stderr
    return json.loads(said.stdout)


def recording(path):
    clock = describe_clock(WallOffset(1_790_000_000 * NS_PER_S, 300, 5))
    return recorded(path, map(driving_record, range(CYCLES)), {**HEADER, "clock": clock})


def test_every_schema_is_the_one_that_foxglove_knows(reported):
    assert len(reported["topics"]) > 15
    assert [one["schema"] for one in reported["topics"] if not one["known"]] == []
    assert [one for one in reported["topics"] if one["unlike"]] == []
    assert {one["encoding"] for one in reported["topics"]} == {"ros2msg, cdr"}


def test_every_message_is_read_and_written_back_byte_by_byte(reported):
    read = {one["topic"]: one["read"] for one in reported["topics"]}
    assert all(read[topic] == CYCLES for topic in ("/tf", "/clock", "/joint_states", "/odom", "/imu/data"))
    assert read["/tf_static"] == read["/robot_description"] == 1
    assert {one["topic"]: one["differ"] for one in reported["topics"] if one["differ"]} == {}


def test_every_plotted_path_of_the_layout_leads_to_a_number(reported):
    assert len(reported["paths"]) > 20
    assert {path: kind for path, kind in reported["paths"].items() if kind != "number"} == {}
