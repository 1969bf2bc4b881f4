"""The doctor's findings on a MAVLink odometry source: identity, rate, quality, clock."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hil.config.mavlink import MavlinkTrackerConfig
from hil.core.clock import NS_PER_S
from hil.core.finding import Finding, Level
from hil.core.signals import TrackerSample
from hil.drivers.tracker.mavlink.session import Session
from hil.links.mavlink import messages as odometry_messages

_LEAST_HZ = 25.0
_LOSS_WARNING = 0.02
_LONG_TRIP_S = 0.01


def diagnose(
    session: Session,
    config: MavlinkTrackerConfig,
    device: str,
    samples: Sequence[TrackerSample],
    watched_s: float,
) -> Iterator[Finding]:
    """Findings on a sender with an open session.

    Args:
        session: the session with the sender.
        config: configuration of the tracker.
        device: name in the findings.
        samples: samples read during `watched_s`.
        watched_s: duration of the watch; no finding on the rate when 0.
    """
    yield _sender(session, device)
    yield _time(session, config, device)
    message = session.last
    if message is not None:
        yield _frames(message, config, device)
        yield _quality(message, config, device)
        yield _covariance(message, config, device)
    if watched_s > 0.0:
        yield _rate(session, device, samples, watched_s)


def _sender(session: Session, device: str) -> Finding:
    names = "no system" if session.source is None else "system {} component {}".format(*session.source)
    level: Level = "ok" if session.heartbeat is not None else "warning"
    beat = "sends heartbeats" if session.heartbeat is not None else "sends no heartbeat"
    others = sorted(source for source in session.heard if source != session.source)
    also = "; also heard: " + ", ".join(f"{s}/{c}" for s, c in others) if others else ""
    return Finding(
        device,
        "sender",
        level,
        f"{names}, {beat}{also}",
        "one sender with heartbeats",
        "switch its heartbeats on, so that routers and this bench can identify it",
    )


def _time(session: Session, config: MavlinkTrackerConfig, device: str) -> Finding:
    trip = session.trip()
    if trip is None:
        return Finding(
            device,
            "time",
            "warning",
            f"answers no TIMESYNC: a pose is taken to be {config.latency_s * 1e3:g} ms older than the "
            "quickest arrivals",
            "answers to TIMESYNC (111)",
            "switch them on at the sender, or measure tracker.latency_s",
        )
    if session.other_clock:
        return Finding(
            device,
            "time",
            "warning",
            f"{session.other_clock} poses bear stamps of another clock than the one that answers TIMESYNC: "
            f"taken to be {config.latency_s * 1e3:g} ms older than the quickest arrivals",
            "one clock for both",
            "have the sender stamp time_usec by the clock that answers TIMESYNC",
        )
    trip_s = trip.duration_ns / NS_PER_S
    level: Level = "ok" if trip_s < _LONG_TRIP_S else "warning"
    steps = f"; its clock has stepped {session.sync.steps} times" if session.sync.steps else ""
    return Finding(
        device,
        "time",
        level,
        f"round trip {trip_s * 1e3:.2f} ms, so known to {trip_s * 500:.2f} ms{steps}",
        f"a round trip below {_LONG_TRIP_S * 1e3:g} ms",
        "use a wired network or a faster serial port",
    )


def _frames(message: Any, config: MavlinkTrackerConfig, device: str) -> Finding:
    frame, child = (
        odometry_messages.frame_name(message.frame_id),
        odometry_messages.frame_name(message.child_frame_id),
    )
    axes = odometry_messages.axes_of(message.frame_id, message.child_frame_id, config.body_axes)
    if axes is None:
        return Finding(
            device,
            "frames",
            "failure",
            f"{frame}, {child}",
            "LOCAL_FRD, BODY_FRD",
            "set the frames of the sender's odometry",
        )
    doubtful = config.body_axes is None and not axes.turn_world
    body = "front-right-down" if axes.turn_body else "front-left-up"
    return Finding(
        device,
        "frames",
        "warning" if doubtful else "ok",
        f"pose in {frame}, twist in {child}; the quaternion is taken to turn {body} axes",
        "LOCAL_FRD, BODY_FRD",
        "set tracker.body_axes to the axes (FRD or FLU) that the sender's quaternion turns",
    )


def _quality(message: Any, config: MavlinkTrackerConfig, device: str) -> Finding:
    quality = message.quality
    if quality == odometry_messages.UNKNOWN_QUALITY:
        found, level = "not given: every pose counts as usable", "warning"
    elif quality < odometry_messages.UNKNOWN_QUALITY:
        found, level = "the odometry has failed", "failure"
    else:
        found, level = f"{quality} %", "ok" if quality >= config.good_quality else "warning"
    return Finding(
        device,
        "quality",
        level,  # type: ignore[arg-type]
        found,
        f"at least {config.good_quality} %",
        "move the camera a little; the scene needs light and texture",
    )


def _covariance(message: Any, config: MavlinkTrackerConfig, device: str) -> Finding:
    axes = odometry_messages.axes_of(message.frame_id, message.child_frame_id, config.body_axes)
    covariance = None if axes is None else odometry_messages.pose_covariance(message, axes)
    if covariance is None:
        return Finding(device, "covariance", "ok", "not given; estimator.tracker says how far a pose is off")
    sigma = np.sqrt(np.diag(covariance))
    position_mm, angle_deg = 1e3 * max(sigma[:3].tolist()), math.degrees(max(sigma[3:].tolist()))
    return Finding(device, "covariance", "ok", f"up to {position_mm:.2g} mm and {angle_deg:.2g} deg")


def _rate(session: Session, device: str, samples: Sequence[TrackerSample], watched_s: float) -> Finding:
    rate_hz = len(samples) / watched_s
    share = session.lost / max(session.lost + len(samples), 1)
    level: Level = "ok" if rate_hz >= _LEAST_HZ and share < _LOSS_WARNING else "warning"
    message = f"{rate_hz:.0f} poses per second, {session.lost} packets lost, {session.malformed} damaged"
    return Finding(
        device,
        "rate",
        level,
        message,
        f"at least {_LEAST_HZ:g} Hz and nothing lost",
        "raise the rate of the sender's odometry; use a wired network, or a faster serial port",
    )
