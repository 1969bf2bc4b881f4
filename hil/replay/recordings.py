"""Recordings played back through the pipeline: the bench they were made on, and the runs they hold."""

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from hil.bench.loop_settings import geometry_of, nominal_of, with_wheel_model
from hil.bench.pipelines import BenchModel
from hil.calibration.calibration_file import coupling_of, read_calibration
from hil.calibration.excitation import OTHER_ROBOT, mismatch
from hil.calibration.usability_check import check_made_for, failed_validation
from hil.config.bench import BenchConfig
from hil.config.loading import load_bench
from hil.config.unchecked import recorded_bench
from hil.core.errors import DataError, HilError, UsageError
from hil.datasets.as_cycles import to_run
from hil.datasets.azimuth_coupling import Coupling, decoupled
from hil.datasets.drive_coverage import covered
from hil.datasets.fit_blocks import reduce_recordings
from hil.datasets.mapped_recordings import read_mapped
from hil.datasets.misplaced_columns import with_misplaced_columns
from hil.datasets.nominal_robot import Nominal
from hil.datasets.read import find_recordings, read_recordings
from hil.datasets.rosbag import is_bag
from hil.datasets.sensor_checks import sensor_contradictions
from hil.datasets.slip_factors import SlipFactors, slip_factors
from hil.datasets.topic_map import TopicMap, read_topic_map
from hil.datasets.truth_correction import corrected
from hil.datasets.truth_files import TruthFile
from hil.datasets.wheel_log import Recording
from hil.datasets.wrong_signs import check_signs, contradictions
from hil.recording.mcap_reader import RecordingReader
from hil.recording.runs import RecordedRun, read_runs
from hil.robot.kinematics import WheelGeometry

_FOREIGN_BENCH = "emulated_floor"
_NAMED = 4
_BLOCK_S = 0.1
_PAIR = 2
"""Number of files of a pair of the public recordings, whose robot and surface are known."""


@dataclass
class OpenedRecording:
    """A recording, and the bench that made it, as far as configuration describes it.

    Attributes:
        foreign: True for one of other origin: wheels and ground truth, nothing estimated.
        problems: parts that could not be read; complete after `runs` was read.
        robot: nominal robot whose wheels a foreign recording is read for.
        tables: recordings read from a foreign one; complete after `runs` was read.
        named: True if the user has named the bench of a foreign recording.
        failed: a sentence where the wheel geometry is of a calibration that failed its own validation run.
        lengths: number of cycles of each run that was read.
    """

    path: Path
    bench: BenchModel
    header: dict[str, Any]
    foreign: bool
    problems: list[str]
    read: Any
    robot: Nominal = field(default_factory=Nominal)
    tables: list[Recording] = field(default_factory=list)
    named: bool = True
    failed: str = ""
    lengths: list[int] = field(default_factory=list)

    @property
    def runs(self) -> Iterator[RecordedRun]:
        """All runs, read one by one; raises `DataError` when there is none."""
        self.lengths.clear()
        for run in self.read():
            self.lengths.append(len(run.records))
            yield run
        self.must_hold(len(self.lengths), None)

    def run(self, number: int | None = None) -> RecordedRun:
        """One run by its number from 0, by default the longest; the others do not stay in memory.

        Raises:
            DataError: there is no run.
            UsageError: there is none of that number.
        """
        runs = self.runs
        if number is None:
            return max(runs, key=lambda one: len(one.records))
        found = next(islice(runs, number, None), None)
        deque(runs, maxlen=0)  # problems are those of the whole recording
        self.must_hold(len(self.lengths), number)
        assert found is not None
        return found

    def warnings(self) -> list[str]:
        """Warnings: a failed calibration; assumptions about a foreign recording; wrong wheels."""
        failed = [self.failed] if self.failed else []
        if not self.tables:
            return failed
        from hil.calibration.warnings import warnings_of

        reported = warnings_of(self.tables)
        assumed = [] if self.named or len(self.tables[0].sources) == _PAIR else [self._assumed()]
        if not self._with_truth:
            return [*failed, *reported, *assumed]
        robot = replace(self.robot, geometry=self.bench.geometry)
        found = mismatch(reduce_recordings(self._with_truth, _BLOCK_S), robot)
        other = [f"{found}; {OTHER_ROBOT}"] if found else []
        return [*failed, *reported, *assumed, *other]

    @property
    def contradicted(self) -> list[str]:
        """Lines where wheels and ground truth, or sensors, of a foreign recording contradict each other.

        Complete after `runs` was read.
        """
        wheels = contradictions(self._with_truth, self.bench.geometry) if self._with_truth else []
        return [*wheels, *self.contradicted_sensors]

    @property
    def contradicted_sensors(self) -> list[str]:
        """The same for IMU and camera alone."""
        geometry, on_wall = self.bench.geometry, self.bench.config.environment.on_wall
        found = (sensor_contradictions(one, geometry, on_wall=on_wall) for one in self.tables)
        return list(chain.from_iterable(found))

    @property
    def slip(self) -> SlipFactors | None:
        """Slip factors of a recorded twist; None for wheels, or where nothing moves beside it."""
        return slip_factors([one for one in self.tables if one.of_twist])

    @property
    def _with_truth(self) -> list[Recording]:
        return [one for one in self.tables if one.has_truth]

    def _assumed(self) -> str:
        surface = "a wall" if self.bench.config.environment.on_wall else "a floor"
        return (
            f"{self.path} does not say on what surface which robot drove: {surface} and the wheels of "
            f"{self.robot.source} are assumed, and the filters rest on that; name its bench file with --bench"
        )

    def must_hold(self, runs: int, number: int | None) -> None:
        """Refuse a recording without a run, and a run number that does not exist.

        Raises:
            DataError: there is no run.
            UsageError: there is none of that number.
        """
        if not runs:
            why = f" that can be read ({'; '.join(self.problems)})" if self.problems else ""
            raise DataError(str(self.path), "holds no cycles" + why, expected="at least one control cycle")
        if number is not None and number >= runs:
            raise UsageError(f"{self.path} has no run {number}", expected=f"0 to {runs - 1}")


def open_recording(
    path: Path,
    *,
    bench: str | None = None,
    calibration: Path | None = None,
    topics: Path | None = None,
    truth: TruthFile | None = None,
    coupling: Coupling | None = None,
) -> OpenedRecording:
    """Detect the kind of a recording, and rebuild the bench that made it.

    Args:
        path: path of one of ours (`.mcap`), a bag of another robot (with `topics`), or CSV.
        bench: bench file or profile instead of the recording's own.
        calibration: wheel geometry instead of the recording's own.
        topics: topic mapping of a bag.
        truth: file of ground truth of a wheel log.
        coupling: coupling of a foreign recording to take out; that of the calibration by default.

    Raises:
        DataError: it cannot be read, or is a folder of recordings: they are opened one by one.
        ConfigError: bench or calibration is refused, also where the calibration is another robot's.
    """
    problems: list[str] = []
    if topics is None and path.is_dir() and not is_bag(path):
        _refuse_folder(path)
    if topics is not None or truth is not None or path.suffix != ".mcap":
        config = load_bench(bench or _FOREIGN_BENCH)
        robot, tables = nominal_of(config), list[Recording]()
        if coupling is None and calibration is not None:
            coupling = coupling_of(read_calibration(calibration))
        mapping = None if topics is None else read_topic_map(topics)
        if mapping is not None and mapping.odometry is not None and calibration is not None:
            raise UsageError("--calibration is of wheels, and [odometry] of --topics gives a twist")
        found = _read_foreign(path, mapping, truth, coupling, robot, tables, config.environment.on_wall)
        made, failed = _bench(config, None, calibration, {}, known=bench is not None)
        if mapping is not None and mapping.odometry is not None:
            made = made.with_estimator(made.config.estimator.of_a_twist())
        if calibration is not None:
            robot = replace(robot, source=str(calibration))
        named = bench is not None
        return OpenedRecording(path, made, {}, True, [], found, robot, tables, named, failed)
    reader = RecordingReader(path)
    header = reader.header
    if bench is not None:
        config = load_bench(bench)
    elif isinstance(header.get("config"), dict):
        config = recorded_bench(header["config"], f"configuration in {path}", reader.packages)
    else:
        raise DataError(
            str(path), "does not carry the configuration of its bench", remedy="give it with --bench"
        )
    try:
        made, failed = _bench(config, _geometry(header, path), calibration, header, recorded=bench is None)
        dict(header.get("versions", {}))
    except HilError:
        raise
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError(str(path), f"has a header that cannot be used ({error})") from None
    arithmetic = header.get("arithmetic", {})
    if not isinstance(arithmetic, dict) or not all(isinstance(text, str) for text in arithmetic.values()):
        raise DataError(
            str(path), "has a header whose `arithmetic` cannot be used", expected="names, each with a text"
        )
    return OpenedRecording(
        path, made, header, False, problems, lambda: read_runs(path, problems), failed=failed
    )


def _refuse_folder(folder: Path) -> NoReturn:
    """Raise an error that lists the recordings of a folder: only one can be opened."""
    names = [job.files[0].name for job in find_recordings([folder])]
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    count = f"{len(names)} recordings" if len(names) > 1 else "1 recording"
    raise DataError(
        str(folder),
        f"is a folder of {count} ({', '.join(names[:_NAMED])}{more})",
        remedy=f"name one, as {folder / names[0]}",
    )


def _geometry(header: Mapping[str, Any], path: Path) -> WheelGeometry | None:
    """The wheel geometry that was in use, None where the recording does not say."""
    given = header.get("geometry")
    if given is None:
        return None
    try:
        geometry = WheelGeometry.from_vector(np.array(given, dtype=np.float64))
    except HilError as error:
        raise DataError(
            str(path),
            f"has a header whose `geometry` cannot be used ({error.message})",
            expected="16 numbers",
        ) from None
    return geometry.with_tyres(**header["tyres"]) if "tyres" in header else geometry


def _read_foreign(
    path: Path,
    topics: TopicMap | None,
    truth: TruthFile | None,
    coupling: Coupling | None,
    robot: Nominal,
    tables: list[Recording],
    on_wall: bool,
) -> Any:
    """Reads the runs of a bag, which is opened at once, or of a CSV file; `tables` receives what was read."""
    if topics is not None:
        found = read_mapped(path, topics, robot, truth)
        parts = [replace(part, later=()) for part in (found, *found.later)]
        if not found.has_truth:
            tables.extend(decoupled(parts, robot.geometry, coupling))
            return lambda: (to_run(one, on_wall=on_wall) for one in tables)
        parts = [covered(part, robot) for part in parts]
        parts = decoupled(parts, robot.geometry, coupling)
        parts = with_misplaced_columns(parts, robot)
        tables.extend(parts if on_wall else corrected(parts))  # sag on a wall looks like a turned body
        check_signs(tables, robot)
        return lambda: (to_run(one, on_wall=on_wall) for one in tables)

    def read() -> Iterator[RecordedRun]:
        tables[:] = read_recordings([path], nominal=robot, truth=truth, coupling=coupling)
        return (to_run(one, on_wall=on_wall) for one in tables)

    return read


def _bench(
    config: BenchConfig,
    geometry: WheelGeometry | None,
    calibration: Path | None,
    header: Mapping[str, Any],
    *,
    recorded: bool = False,
    known: bool = True,
) -> tuple[BenchModel, str]:
    """The bench of a configuration, and a sentence where the calibration failed its own validation run.

    A recorded configuration contains every value, chosen or default. Where the bench is not `known` its
    robot is assumed, and the calibration may be another robot's.
    """
    failed = ""
    if calibration is not None:
        found = read_calibration(calibration)
        if known:
            check_made_for(found, config, str(calibration))
        failed, geometry = failed_validation(found, str(calibration)), found.geometry
        config = with_wheel_model(config, found.model, given=False if recorded else None)
    geometry = geometry_of(config) if geometry is None else geometry
    return BenchModel(config, geometry=geometry, seed=int(header.get("seed", 0))), failed
