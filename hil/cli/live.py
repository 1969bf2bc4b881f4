"""`hil live`: the loop in real time, commanded from outside, watched in Rerun and recorded."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli import start_question
from hil.cli.bench_options import BenchRequest, bench_options
from hil.cli.closed_output import Answered, print_end, unreadable
from hil.cli.options import (
    FILE,
    JSON,
    FiniteRange,
    on_recording_failure_option,
    rerun_option,
    say_rerun_files,
)
from hil.cli.question_answers import watching
from hil.cli.ros2_options import published
from hil.cli.session_folder import SessionFolder, out_option
from hil.core.errors import EXIT_PASS, Aborted, DataError, DeviceError, HilError, UsageError, reason_of
from hil.core.known_names import ESTIMATORS
from hil.support.atomic_files import check_new_file

if TYPE_CHECKING:
    from hil.bench import Bench
    from hil.core.geometry import Array
    from hil.live import CommandLines, LiveSession
    from hil.live.reference_files import MakeTrajectory
    from hil.live.ros2_program import Ros2Program
    from hil.monitor import RerunMonitor
    from hil.procedure.bench_source import BenchSource
    from hil.recording.mcap_writer import McapRecorder, OnFailure
    from hil.robot.trajectories import Trajectory
    from hil.ros2.publisher import Ros2Publisher
    from hil.support.interrupt_signals import StopRequest


@click.command()
@bench_options("bench", "emulate")
@click.option(
    "--trajectory",
    "source",
    type=FILE,
    help="Waypoints (.csv: x,y,theta) or a script (.py) with trajectory(start_pose).",
)
@click.option(
    "--command",
    "commands",
    default="none",
    show_default=True,
    help="Velocity commands from: stdin, udp:PORT (this host, with the token; 0: any) or none.",
)
@click.option(
    "--dead-man",
    "dead_man_s",
    default=0.5,
    show_default=True,
    type=FiniteRange(0.02, 10.0),
    help="Age in s at which a command means stop.",
)
@click.option(
    "--duration",
    "duration_s",
    type=FiniteRange(0.0, min_open=True),
    help="Seconds; a longer trajectory is ended there, at the end of a shorter one the robot waits. Then the "
    "robot is watched until it is held [default: until the trajectory or a signal ends it].",
)
@click.option(
    "--feedback",
    type=click.Choice(ESTIMATORS),
    default="ekf",
    show_default=True,
    help="Estimator in the loop.",
)
@click.option(
    "--observe",
    "observers",
    type=click.Choice(ESTIMATORS),
    multiple=True,
    help="Estimators beside it (repeatable).",
)
@bench_options("controller")
@rerun_option("spawn, connect, serve, a rerun+http:// URL or a .rrd file; several with commas.")
@out_option
@click.option(
    "--record", type=FILE, help="Recording to write, a new file [default: recording.mcap in that folder]."
)
@click.option("--no-record", "unrecorded", is_flag=True, help="Write no recording.")
@on_recording_failure_option("the recording")
@bench_options("calibration", "start_pose", "seed")
@click.option(
    "--replay", "repeated", type=FILE, help="Recording whose motion the emulated robot repeats, at the wire."
)
@bench_options("faults", "inject_real", "ros2", "ros2_domain", "ros2_wait", "ros2_interface")
@JSON
def command(
    request: BenchRequest,
    source: Path | None,
    commands: str,
    dead_man_s: float,
    duration_s: float | None,
    feedback: str,
    observers: tuple[str, ...],
    view: str | None,
    out: Path | None,
    record: Path | None,
    unrecorded: bool,
    on_failure: OnFailure,
    repeated: Path | None,
    as_json: bool,
) -> int:
    """Run the control-estimate loop at its rate in real time.

    Every session is recorded, in a new folder, and listed by `hil results`: see --out and --no-record.
    Without --trajectory, --command and a program on ROS 2 it only watches: no wheel moves. On a wall torque
    is switched on, so that the robot is held; on the floor the servos are left as they are.
    SIGINT, SIGTERM and SIGHUP stop the robot, watch it until it is held, print the summary and end with
    exit code 4; further signals do not shorten that. A signal while the bench opens acts once it is open.
    A session that ends well but leaves the robot NOT HELD ends with exit code 3.

    Example: hil live --bench emulated --duration 20 --rerun spawn
    """
    from hil.bench import check_travel, make_bench_model
    from hil.live import LivePlan, LiveSession, load_trajectory
    from hil.support.interrupt_signals import StopRequest

    if request.ros2_topic and commands != "none":
        raise UsageError(f"--command and --controller {request.controller} would both move the robot")
    _must_agree(source, commands, repeated, record, out, unrecorded=unrecorded)
    folder = None if unrecorded else SessionFolder(out, "live")
    if folder is not None and record is None:
        folder.check()
    if repeated is not None and request.ros2_topic:
        raise UsageError("--replay: a repeated recording takes no commands", remedy="only watch it")
    bench = real_time_source(request, repeated)
    reference, known = None, None
    if source is not None:
        model = make_bench_model(bench.config, calibration=bench.calibration)
        reference, known = load_trajectory(source, model.check)
        check_travel(bench.config, bench.planned_faults(), () if known is None else (known,))
    stop = StopRequest()
    with stop.noted():
        with published(request, bench.config, patient=True) as publisher, _commands(commands) as lines:
            opened = open_aloud(replace(bench, publish=None if publisher is None else publisher.sink))
            with closing(opened):
                plan = LivePlan(
                    None if reference is None else _announced(reference, duration_s),
                    lines,
                    _program(request, publisher),
                    duration_s,
                    feedback,
                    observers,
                    dead_man_s,
                    known,
                )
                recorder = None
                if folder is not None:
                    recorder = open_recorder(opened, record or folder.recording, on_failure)
                monitor = _monitor(opened, view)
                session = LiveSession(opened, plan, recorder=recorder, monitor=monitor, stop=stop)
                drive(session, folder, view, as_json=as_json)
        must_be_held(opened, recorder, stop)
    return EXIT_PASS


def must_be_held(bench: Bench, recorder: McapRecorder | None, stop: StopRequest) -> None:
    """Raise what a closed session has to report: a lost recording, a signal, or a robot NOT HELD."""
    if recorder is not None and (lost := recorder.objection()) is not None:
        raise lost
    if stop.name:
        raise Aborted(unreadable() or f"{stop.name} came while the bench was being closed")
    if bench.held.lost:
        emulated = "servos" in bench.config.emulated()
        raise DeviceError(
            f"{'emulated' if emulated else 'real'} robot of bench {bench.config.name}",
            f"NOT HELD: {bench.held.why}",
            remedy="" if emulated else "secure it before anything else",
        )


def _announced(make: MakeTrajectory, duration_s: float | None) -> MakeTrajectory:
    """The same trajectory; printed on standard error: how long it takes, and what the session does then."""
    from hil.live.session import HOLD_S

    def made(pose: Array) -> Trajectory:
        trajectory = make(pose)
        takes_s = trajectory.duration_s
        then = f"the session ends {HOLD_S:g} s after it"
        if duration_s is not None:
            then = f"the session ends after {duration_s:g} s, " + (
                "before its end" if duration_s < takes_s else "and until then the robot waits at its end"
            )
        click.echo(f"the trajectory takes {takes_s:.1f} s; {then}", err=True)
        return trajectory

    return made


def _program(request: BenchRequest, publisher: Ros2Publisher | None) -> Ros2Program | None:
    """The program on ROS 2 that drives the open bench, None without one; prints the topic that is used."""
    if publisher is None or not request.ros2_topic:
        return None
    from hil.live.ros2_program import Ros2Program

    found = Ros2Program(publisher, request.controller)
    click.echo(f"commands: {found.where}", err=True)
    return found


@contextmanager
def _commands(commands: str) -> Iterator[CommandLines | None]:
    """Open the source of velocity commands and print where it listens; None without one."""
    from hil.live import open_commands

    lines = open_commands(commands)
    if lines is None:
        yield None
        return
    click.echo(f"velocity commands: {lines.where}", err=True)
    with closing(lines):
        yield lines


def _must_agree(
    source: Path | None,
    commands: str,
    repeated: Path | None,
    record: Path | None,
    out: Path | None,
    *,
    unrecorded: bool,
) -> None:
    """Refuse options that contradict each other, and a recording that cannot be written."""
    if source is not None and commands != "none":
        raise UsageError(
            f"--trajectory and commands from {commands} would both move the robot", remedy="give one of them"
        )
    if unrecorded and (record is not None or out is not None):
        given = "--out" if record is None else "--record"
        raise UsageError(f"{given} and --no-record contradict each other", remedy="give one of them")
    if repeated is not None and (source is not None or commands != "none"):
        raise UsageError("--replay: a repeated recording takes no commands", remedy="only watch it")
    if record is not None:
        check_new_file(record, "--record")


def real_time_source(request: BenchRequest, repeated: Path | None = None) -> BenchSource:
    """The bench in real time, with the start pose and the recording that it repeats."""
    from hil.config.loading import must_have_a_device

    overrides = {} if repeated is None else {"emulation.replay": str(repeated.resolve())}
    source = replace(request, realtime=True).source(overrides)
    must_have_a_device(source.config, request.bench, "there is nothing to watch or to move")
    source = replace(source, watch=watching(table=True))
    return source.changed(overrides=start_question.asked_start(source.config))


def open_aloud(source: BenchSource) -> Bench:
    """The bench, with its emulated devices started; says first what the start waits for."""
    emulated = ", ".join(source.config.emulated())
    served = f"; emulated, by a process of their own: {emulated}" if emulated else ""
    click.echo(f"loading bench {source.config.name}{served}", err=True)
    bench = source.open()
    bench.warns_not_held = False
    click.echo("loading the loop's machine code; it is compiled at the first use", err=True)
    return bench


def drive(session: LiveSession, folder: SessionFolder | None, view: str | None, *, as_json: bool) -> None:
    """Run the session on the open bench; always prints the summary, even if the session never began.

    Args:
        session: session to run.
        folder: folder in which the summary is kept, too; None for nowhere.
        view: place where Rerun shows the session; None for nowhere.
        as_json: True to print one JSON object.
    """
    from hil.bench.hold.held_state import seen_in_words

    bench = session.bench
    if folder is not None:
        folder.begin(bench)
    try:
        session.end_if_asked()
        click.echo(f"opening {', '.join(bench.config.devices())}", err=True)
        with bench:
            click.echo(f"at the start {seen_in_words(bench.look())}", err=True)
            try:
                session.run()
            finally:
                click.echo(
                    "the session is over: the robot is stopped, and watched until it is held", err=True
                )
    except HilError as error:
        session.ended = session.ended or str(error)
        raise
    finally:
        bench.close()
        _report(session, folder, as_json=as_json)
        if view is not None:
            say_rerun_files(view)


def open_recorder(bench: Bench, path: Path, on_failure: OnFailure) -> McapRecorder:
    """Add a recorder to the bench, and print where it writes; creates the folder."""
    from hil.recording.mcap_writer import McapRecorder

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(
            str(path.parent),
            f"cannot be created ({reason_of(error)})",
            remedy="give --record FILE or --no-record",
        ) from None
    recorder = McapRecorder(path, bench.header(), lossless=False, on_failure=on_failure)
    bench.add_sink(recorder)
    click.echo(f"recording to {path}", err=True)
    return recorder


def _monitor(bench: Bench, view: str | None) -> RerunMonitor | None:
    if view is None:
        return None
    from hil.monitor import RerunMonitor, Scene

    monitor = RerunMonitor(view, lossless=False, scene=Scene.of(bench.config, bench.geometry))
    bench.add_sink(monitor)
    return monitor


def _report(session: LiveSession, folder: SessionFolder | None, *, as_json: bool) -> None:
    summary, monitor = session.summary(), session.monitor
    if monitor is not None:
        summary["monitor"] = {"dropped": monitor.dropped, "failure": monitor.failure}
    if folder is not None:
        folder.end(summary)
    held: Any = summary["held"]
    print_end(json.dumps(summary) if as_json else text_of(summary), held)
    answered = click.get_current_context().find_object(Answered)
    if answered is not None:
        answered.already = True


def text_of(summary: dict[str, Any]) -> str:
    """A summary as text: times of the sections only where a cycle was late, and HELD at the end."""
    from hil.bench.hold.held_state import held_in_words
    from hil.core.event_rows import event_lines

    timing = summary["timing"]
    lines = [
        f"{summary['bench']} at {summary['rate_hz']:g} Hz, ended by: {summary['ended']}",
        f"{timing['cycles']:.0f} cycles, {timing['late']:.0f} late "
        f"({100.0 * timing['late'] / max(timing['cycles'], 1.0):.1f} %), {timing['overruns']:.0f} overruns, "
        f"{timing['skipped']:.0f} skipped",
    ]
    if "advice" in summary:
        lines.append(summary["advice"])
    told = timing["late"] or timing["overruns"]  # what took the time: where none was short, --json tells it
    if told:
        lines.append(f"{'section':10} {'mean ms':>9} {'p99 ms':>9} {'worst ms':>9}")
    for name in ("read", "estimate", "control", "write", "sinks", "work", "lateness"):
        if told and f"{name}_mean_ms" in timing:
            values = (timing[f"{name}_{kind}_ms"] for kind in ("mean", "p99", "worst"))
            lines.append(f"{name:10} " + " ".join(f"{v:9.3f}" for v in values))
    for name, count in summary["samples"].items():
        bad = ", ".join(f"{n} {kind}" for kind, n in count["bad"].items()) or "none bad"
        lines.append(f"{name:10} {count['received']} samples, {count['missing']} missing, {bad}")
    if summary["pose"] is not None:
        x, y, theta = summary["pose"]
        lines.append(f"pose       x {x:.4f} m, y {y:.4f} m, theta {theta:.4f} rad")
    for name in ("recording", "monitor", "commands"):
        if name in summary:
            lines.append(f"{name:10} " + ", ".join(f"{k} {v}" for k, v in summary[name].items() if v != ""))
    if "note" in summary:
        lines.append(summary["note"])
    lines += [f"seen: {line}" for line in event_lines(summary["events"])]
    lines.append(held_in_words(summary["held"]))
    return "\n".join(lines)
