"""Setting a sensor up: what is sent to it, what is refused by name, and what it was doing before."""

import dataclasses
import math

import numpy as np
import pytest

from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import Status
from hil.fakes.imu.microstrain.commands import Settings
from hil.links.mip import fields as f
from hil.links.mip.packets import PacketParser

OTHER = {f.FILTER_DATA: ((f.REFERENCE_TIME, 2), (f.STATUS, 2), (f.GRAVITY, 2))}


def test_an_open_sensor_says_who_it_is(bench):
    b = bench()
    assert b.driver.identity() == {}
    assert math.isnan(b.driver.rate_hz)
    b.driver.open()
    identity = dict(b.driver.identity())
    assert identity.pop("serial").startswith("6286.")
    assert identity == {
        "model": "3DM-CV7-AHRS",
        "model_number": "6286-9960",
        "firmware": "1.0.07",
        "rate": "111.1 Hz",
        "port": "hil://imu",
    }
    b.driver.close()
    b.driver.close()
    assert b.driver.identity() == {}


def test_it_can_be_opened_again_while_it_goes_on_sending(bench):
    b = bench()
    b.driver.open()
    b.run(0.1)
    b.driver.open()
    assert b.run(0.2)[-1].status is Status.OK
    b.driver.close()
    b.clock.sleep_until_ns(b.clock.now_ns() + 3_000_000_000)
    b.driver.open()
    samples = b.run(0.3)
    assert {s.status for s in samples} == {Status.OK}
    assert samples[0].stamp.t_ns > b.clock.now_ns() - 400_000_000
    b.driver.close()
    with pytest.raises(DeviceError, match=r"imu.*used while closed"):
        b.driver.read()


@pytest.mark.parametrize("wanted", [False, True])
def test_the_magnetometer_is_used_only_when_asked_for(bench, wanted):
    b = bench(config={"magnetometer": wanted})
    b.driver.open()
    b.run(0.1)
    assert b.chip.commands.settings.magnetometer is wanted
    assert f.FILTER_STATES[b.driver.latest.state] == ("AHRS" if wanted else "vertical gyro")


def test_a_sensor_that_turns_its_data_is_brought_back_to_its_own_axes(bench, turning_plant, ideal):
    b = bench(
        plant=turning_plant(tilt_rad=0.0), options=ideal, saved=Settings(transform_rad=(0.3, -0.2, 1.0))
    )
    b.driver.open()
    samples = b.run(1.0)
    assert samples[0].status is Status.STARTING
    np.testing.assert_allclose(samples[-1].gravity_m_s2, [0.0, 0.0, -9.80665], atol=1e-5)


def test_a_sensor_in_its_own_axes_keeps_its_filter_running(bench):
    b = bench()
    b.driver.open()
    assert b.run(0.1)[0].status is Status.OK
    assert b.chip.commands.filter_resets == 0


def test_what_a_transformation_does_to_the_data(bench, turning_plant, ideal):
    """Else the test above would show nothing."""
    turned = Settings(
        transform_rad=(0.0, 0.5, 0.0),
        formats={f.FILTER_DATA: tuple((descriptor, 10) for descriptor in f.LAYOUTS)},
    )
    b = bench(plant=turning_plant(tilt_rad=0.0), options=ideal, saved=turned)
    b.world.advance_to(10_000_000)
    b.world.sync_plant()
    (reply,) = b.chip.poll(b.chip.next_poll_ns())
    data = f.FilterData.of(PacketParser(1).feed(reply.data, 0)[0])
    # the vehicle pitches its nose down by 0.5 with respect to the sensor, so down leans forward in it
    np.testing.assert_allclose(
        data.gravity_m_s2, [-9.80665 * math.sin(0.5), 0.0, 9.80665 * math.cos(0.5)], atol=1e-5
    )


def test_another_sensor_of_the_maker_is_refused_by_name(bench):
    b = bench(model="6284")
    with pytest.raises(DeviceError, match=r"another device answers: other \(6284-9960\)") as caught:
        b.driver.open()
    assert "3DM-CV7-AHRS (6286)" in str(caught.value)
    assert b.driver.identity() == {}
    assert not b.line.in_use


@pytest.mark.parametrize("model", ["6287", "6289"])
def test_its_siblings_serve_as_well(bench, model):
    b = bench(model=model)
    b.driver.open()
    assert b.driver.identity()["model"] == f.MODELS[model]
    assert b.run(0.1)[-1].status is Status.OK


def test_a_refused_command_is_named(bench):
    b = bench()
    b.chip.commands._known[f.THREE_DM, f.MESSAGE_FORMAT] = lambda data: (f.INVALID_PARAMETER, ())
    with pytest.raises(DeviceError, match=r"refuses 'message format' \(invalid parameter\)"):
        b.driver.open()


def test_a_sensor_without_system_data_is_none_the_worse(bench):
    b = bench()
    obey = b.chip.commands._known[f.THREE_DM, f.STREAM]
    b.chip.commands._known[f.THREE_DM, f.STREAM] = lambda data: (
        obey(data) if data[1] == f.FILTER_DATA else (f.INVALID_PARAMETER, ())
    )
    b.driver.open()
    assert b.run(0.1)[-1].status is Status.OK


def test_axes_that_cannot_be_changed_are_refused(bench):
    b = bench(saved=Settings(transform_rad=(0.3, 0.0, 0.0)))
    obey = b.chip.commands._known[f.THREE_DM, f.TRANSFORM]
    b.chip.commands._known[f.THREE_DM, f.TRANSFORM] = lambda data: (
        obey(data) if data[0] == f.READ else (f.DONE, ())
    )
    with pytest.raises(DeviceError, match="other axes"):
        b.driver.open()


def test_a_rate_that_the_sensor_cannot_is_reported_with_what_it_can(bench, ideal):
    b = bench(config={"baud": 921_600, "rate_hz": 700.0}, baud=921_600)
    with pytest.raises(DeviceError, match=r"cannot measure at 700 Hz.*500\.0 or 1000\.0"):
        b.driver.open()
    b = bench(options=dataclasses.replace(ideal, base_rate_hz=50))
    with pytest.raises(DeviceError, match="cannot measure at 110 Hz"):
        b.driver.open()


def test_a_silent_port_is_a_time_out_that_says_what_to_look_at(bench):
    b = bench("imu:off")
    with pytest.raises(DeviceTimeoutError, match=r"no MicroStrain sensor answers.*baud") as caught:
        b.driver.open()
    assert 5.0 <= b.clock.now_ns() * 1e-9 < 5.2
    assert "hil://imu" in str(caught.value)
    assert not b.line.in_use


def test_noise_is_distinguished_from_silence(bench):
    formats = {f.FILTER_DATA: tuple((descriptor, 10) for descriptor in f.LAYOUTS)}
    b = bench("imu:garbage", saved=Settings(formats=formats))
    with pytest.raises(DeviceTimeoutError, match="what comes is no MIP packet"):
        b.driver.open()


def test_a_sensor_that_is_still_starting_is_waited_for(bench):
    b = bench("imu:off@0+2")
    b.driver.open()
    assert 3.0 < b.clock.now_ns() * 1e-9 < 3.5
    samples = b.run(1.0)
    assert samples[0].status is Status.STARTING
    assert samples[-1].status is Status.OK


def test_losses_on_the_wire_do_not_stop_the_set_up(bench):
    b = bench("imu:drop@0+1.5,probability=0.5", "imu:corrupt@0+1.5,probability=0.3")
    b.driver.open()
    settings = b.chip.commands.settings
    assert not settings.magnetometer
    assert settings.streams == {f.FILTER_DATA}
    b.run(2.0)
    assert b.run(0.2)[-1].status is Status.OK


@pytest.mark.parametrize("after_s", [0.015, 0.05])
def test_a_sensor_that_restarts_in_the_middle_is_begun_anew(bench, after_s):
    b = bench(f"imu:reset@{after_s}", config={"open_timeout_s": 10.0})
    b.driver.open()
    assert b.clock.now_ns() > 1_000_000_000
    assert b.run(1.0)[-1].status is Status.OK
    assert not b.chip.commands.settings.magnetometer
    assert b.chip.commands.settings.streams == {f.FILTER_DATA}


@pytest.mark.parametrize(("fault", "reported"), [("off", "stopped answering"), ("unplug", "port has failed")])
def test_a_sensor_that_goes_in_the_middle_is_distinguished_from_one_that_never_answered(
    bench, fault, reported
):
    b = bench(f"imu:{fault}@0.015")
    with pytest.raises(DeviceTimeoutError, match=reported):
        b.driver.open()
    assert not b.line.in_use
