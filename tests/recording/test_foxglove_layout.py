"""docs/foxglove/layout.json: every panel that it places is there, and shows what a recording holds."""

import json
import re
from pathlib import Path

from mcap_cases import driving_record
from recorded import HEADER, STORE

from hil.core.registry import kinds
from hil.recording.ros_messages import CycleMessages
from hil.recording.topics import topics_with
from hil.recording.transform_tree import BODY, WALL, FrameTree

LAYOUT = json.loads((Path(__file__).parents[2] / "docs" / "foxglove" / "layout.json").read_text())
KINDS = tuple(kinds().values())
TOPICS = topics_with(KINDS)


def panels_of(tree):
    return [tree] if isinstance(tree, str) else panels_of(tree["first"]) + panels_of(tree["second"])


def test_every_panel_is_placed_once():
    assert sorted(panels_of(LAYOUT["layout"])) == sorted(LAYOUT["configById"])


def test_every_plotted_path_leads_to_a_number_of_a_recording():
    recorded, messages = {}, CycleMessages(KINDS, FrameTree({}))
    for k in range(10):
        recorded |= {
            topic: STORE.deserialize_cdr(data, TOPICS[topic])
            for topic, _, data in messages.of(driving_record(k))
        }
    paths = [
        p["value"]
        for name, config in LAYOUT["configById"].items()
        if name.startswith("Plot!")
        for p in config["paths"]
    ]
    assert len(paths) > 20
    for path in paths:
        topic, *fields = path.split(".")
        value = recorded[topic]
        for field in fields:
            name, place = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", field).groups()
            value = getattr(value, name)
            value = value if place is None else value[int(place)]
        assert float(value) == value or value != value


def test_scene_and_log_show_topics_and_frames_that_there_are():
    scene = LAYOUT["configById"]["3D!robot"]
    layers = scene["layers"]
    shown = {*scene["topics"], layers["robot"]["topic"], layers["robot"]["jointStatesTopic"]}
    assert shown | {LAYOUT["configById"]["RosOut!events"]["topicToRender"]} <= set(TOPICS)
    tree = FrameTree(HEADER)
    assert tree.follow(driving_record(0))
    known = {WALL, BODY} | {name for f in (*tree.fixed, tree.camera_start) for name in (f.parent, f.child)}
    assert {scene["followTf"], scene["fixedFrame"], layers["grid"]["frameId"]} <= known
