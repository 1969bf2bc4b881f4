"""What the encoder node says of itself, and what the doctor makes of it."""

import can
import cantools
import pytest

from hil.config.encoders import SHIPPED_DBC, EncodersConfig
from hil.core.errors import DeviceTimeoutError
from hil.drivers.doctor_watch import Watched
from hil.drivers.encoders.as5045.node_status import NodeStatus
from hil.drivers.encoders.kind import KIND, look

DATABASE = cantools.database.load_file(SHIPPED_DBC)
USUAL = {
    "Layout": 1,
    "Firmware": 1,
    "Rate": 200,
    "ResetCause": 0,
    "ParityErrors": 0,
    "LateSets": 0,
    "UnsentFrames": 0,
    "TimesOffBus": 0,
}


@pytest.fixture
def watched(encoder_bench, drain):
    """The doctor's finding about the node after some status frames were on the bus."""

    def run(*reported, config=None):
        bench = encoder_bench(config=config)
        bench.driver.open()
        for values in reported:
            data = DATABASE.encode_message(418, {**USUAL, **values}, scaling=False)
            bench.channel.transmit(418, data, bench.clock.now_ns())
            samples = drain(bench, 20)
        settings = EncodersConfig(interface="hil", channel="test0", **(config or {}))
        seen = Watched(KIND, settings, bench.driver, samples, 0.2, bench.clock, 100.0)
        return bench.driver, next(f for f in look(seen) if f.check == "node")

    return run


def test_a_node_says_what_it_is(watched):
    driver, finding = watched({"ResetCause": 1})
    assert (finding.level, finding.found) == ("ok", "firmware 1, started by watchdog")
    assert driver.passed_over == 0


@pytest.mark.parametrize(
    ("reported", "level", "found", "remedy"),
    [
        ([{"Layout": 7}], "failure", "frames of layout 7, the DBC describes 1", "firmware/as5045_node"),
        ([{"Rate": 100}], "warning", "100 Hz", "set encoders.rate_hz to 100"),
        (
            [{"UnsentFrames": 3, "ParityErrors": 2}],
            "warning",
            "2 words with wrong parity, 3 frames that the bus did not take",
            "termination",
        ),
    ],
)
def test_what_is_wrong_with_a_node_is_named(watched, reported, level, found, remedy):
    _, finding = watched(*reported)
    assert finding.level == level
    assert found in finding.found
    assert remedy in finding.remedy


@pytest.mark.parametrize(
    ("reported", "counted"), [((9, 9), ""), ((250, 3), "9 times off the bus"), ((7,), "")]
)
def test_what_was_counted_before_is_history(reported, counted):
    status = NodeStatus(EncodersConfig(node_id=4))
    for times in reported:
        data = DATABASE.encode_message(418, {**USUAL, "TimesOffBus": times}, scaling=False)
        assert status.take(can.Message(arbitration_id=422, data=data, is_extended_id=False))
    assert status.counted == counted


def test_a_dbc_of_a_lab_need_not_describe_a_status(watched, tmp_path):
    own = tmp_path / "own.dbc"
    own.write_text(SHIPPED_DBC.read_text().replace("NodeStatus", "Housekeeping"))
    _, finding = watched({"Layout": 7}, config={"dbc": str(own)})
    assert (finding.level, finding.found) == ("ok", "the node does not say")


def of_another_node(bench, k):
    """Both frames of a node that began counting elsewhere."""
    for frame, left, right in ((416, "AngleFL", "AngleBL"), (417, "AngleBR", "AngleFR")):
        values = {left: 0, right: 0, "Sequence": (k + 77) % 256, "NodeTime": (5.0 + 0.01 * k) % 10.48}
        bench.channel.transmit(frame, DATABASE.encode_message(frame, values), bench.clock.now_ns())


def found(bench, samples):
    settings = EncodersConfig(interface="hil", channel="test0")
    seen = Watched(KIND, settings, bench.driver, samples, 0.2, bench.clock, 100.0)
    return {f.check: f for f in look(seen)}


def test_two_nodes_with_one_identifier_are_named_and_reported_once_a_second(encoder_bench, drain, caplog):
    bench = encoder_bench()
    bench.driver.open()
    samples = []
    for k in range(200):
        of_another_node(bench, k)
        samples += drain(bench, 1)
    said = [r.getMessage() for r in caplog.records]
    assert 1 <= len(said) <= 4
    assert "two nodes with one identifier" in said[-1]
    finding = found(bench, samples)["identifiers"]
    assert finding.level == "failure"
    assert "0x1A0, 0x1A1" in finding.found


def with_unit_of_time(folder, unit):
    """A DBC that is the shipped one but for the factor of the node's clock."""
    dbc = folder / "other.dbc"
    text = SHIPPED_DBC.read_text()
    dbc.write_text(text.replace("NodeTime : 44|20@1+ (1e-05,", f"NodeTime : 44|20@1+ ({unit},"))
    return {"dbc": str(dbc)}


@pytest.mark.parametrize("unit", ["1e-06", "0.0001"])
def test_another_unit_of_the_nodes_clock_is_named_and_is_no_second_node(encoder_bench, drain, tmp_path, unit):
    bench = encoder_bench(config=with_unit_of_time(tmp_path, unit))
    bench.driver.open()
    findings = found(bench, drain(bench, 200))
    assert findings["node time"].level == "failure"
    assert "a factor of 1e-05 s fits" in findings["node time"].found
    assert "identifiers" not in findings


@pytest.mark.parametrize("unit", ["0.001", "1"])
def test_a_unit_by_which_no_set_can_be_placed_in_time_is_named_as_well(encoder_bench, drain, tmp_path, unit):
    bench = encoder_bench(config=with_unit_of_time(tmp_path, unit))
    bench.driver.open()
    with pytest.raises(DeviceTimeoutError, match=r"a factor of 1e-05 s fits.*correct the factor of NodeTime"):
        drain(bench, 200)


def test_a_node_that_restarts_once_is_no_second_one(encoder_bench, drain):
    bench = encoder_bench("encoders:reset@0.5")
    bench.driver.open()
    samples = drain(bench, 200)
    assert len(bench.driver.restarted) <= 1
    assert not {"identifiers", "node time"} & set(found(bench, samples))


def test_frames_of_a_wrong_length_are_reported_by_the_doctor_and_once_a_second(encoder_bench, drain, caplog):
    bench = encoder_bench()
    bench.driver.open()
    samples = []
    for _ in range(200):
        bench.channel.transmit(416, b"abc", bench.clock.now_ns())
        samples += drain(bench, 1)
    assert found(bench, samples)["frame length"].found.startswith(("199 ", "200 "))
    said = [r.getMessage() for r in caplog.records]
    assert 1 <= len(said) <= 3
    assert "times more" in said[-1]
