"""Reads the paths of a command line as recordings, choosing the reader by the kind of file."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from hil.core.errors import ConfigError, DataError, UsageError
from hil.core.path_hints import meant
from hil.datasets import export, plain_csv, public_csv, rosbag
from hil.datasets.angle_faults import with_angle_faults
from hil.datasets.azimuth_coupling import Coupling, decoupled
from hil.datasets.changed_wheels import with_changed_wheels
from hil.datasets.drive_coverage import covered
from hil.datasets.duplicates import without_copies
from hil.datasets.integrated_angles import with_integrated_angles
from hil.datasets.late_parts import with_late_parts
from hil.datasets.mapped_recordings import PUBLIC, read_mapped
from hil.datasets.misplaced_columns import with_misplaced_columns
from hil.datasets.near_copies import without_near_copies
from hil.datasets.nominal_robot import Nominal
from hil.datasets.recording_names import named_apart
from hil.datasets.smooth_rows import with_smooth_rows
from hil.datasets.topic_map import TopicMap, read_topic_map
from hil.datasets.truth_at_rest import with_truth_at_rest
from hil.datasets.truth_correction import corrected
from hil.datasets.truth_files import TruthFile
from hil.datasets.truth_in_turns import with_truth_in_turns
from hil.datasets.truth_of_wheels import with_odometry_in_truth
from hil.datasets.truth_scales import with_truth_scales
from hil.datasets.truth_seams import with_truth_seams
from hil.datasets.truth_sessions import with_other_sessions
from hil.datasets.uneven_wheels import with_uneven_wheels
from hil.datasets.unlike_repetitions import with_unlike_repetitions
from hil.datasets.unpacking import PACKED
from hil.datasets.wheel_log import Recording
from hil.datasets.wrong_signs import check_signs
from hil.recording.mcap_reader import NEEDS_TOPICS
from hil.recording.mcap_scan import COPY_AGAIN
from hil.support.atomic_files import check_name

_READERS = 2
_WITH_TRUTH = (".mcap", ".db3")
_OTHERS = (".py", ".toml", ".json", ".html")
"""Suffixes of files in this project that contain no recording."""


@dataclass(frozen=True)
class Job:
    """A run to read.

    Attributes:
        files: files of the run.
        read: function that reads it.
        given: files that the caller named, directly or by their folder.
    """

    files: tuple[Path, ...]
    read: Callable[[], Recording]
    given: tuple[Path, ...]

    @property
    def identity(self) -> tuple[Path, ...]:
        """Key of the run, independent of the path by which it was given."""
        return tuple(file.resolve() for file in self.files)


def find_recordings(
    paths: Sequence[str | Path],
    topics: str | Path | None = None,
    nominal: Nominal | None = None,
    truth: TruthFile | None = None,
) -> list[Job]:
    """Find every run under the given files and folders, with its reader, in a fixed order.

    Args:
        paths: files and folders.
        topics: topic mapping of another robot; every `.mcap` and `.db3` file and rosbag2 folder is then one
            of its bags.
        nominal: robot that they are read for, see `build_recording`.
        truth: file of ground truth of the wheel logs, which are then plain CSV.

    Raises:
        DataError: a path does not exist or contains no recording.
        ConfigError: the topic mapping is wrong.
        UsageError: a path is not a possible file name.
    """
    mapping = None if topics is None else read_topic_map(topics)
    if mapping is not None and truth is None and not mapping.has_truth:
        raise ConfigError(
            f"{topics}: has no [truth], and without ground truth nothing can be compared",
            expected="the topic of the robot's true poses, or x, y and theta in [columns]",
            remedy="add it, or use `hil replay`, which does without",
        )
    jobs: list[Job] = []
    for given in paths:
        path = Path(given)
        check_name(path)
        look = _folder if path.is_dir() else _one_file
        found = look(path, mapping, nominal, truth)
        if not found:
            raise DataError(
                str(path),
                "holds no recording",
                expected="odom_N.csv + abs_N.csv pairs, plain .csv files, .mcap recordings or rosbag2 bags",
                remedy=_below(path),
            )
        jobs += found
    if not jobs:
        raise DataError("", "no data given", expected="at least one file or folder")
    return jobs


def read_recordings(
    paths: Sequence[str | Path],
    progress: Callable[[int, int], None] | None = None,
    *,
    topics: str | Path | None = None,
    nominal: Nominal | None = None,
    truth: TruthFile | None = None,
    coupling: Coupling | None = None,
    unusable: dict[str, str] | None = None,
) -> list[Recording]:
    """Read every run under the given files and folders.

    A run that occurs more than once is used once, and a repair mentions it: a file named directly and by its
    folder, or a copy at another place with other line ends or compression, also where its rows were cut,
    resampled or changed a little. Otherwise it would count twice,
    and in a cross-validation its copy would stay in the fit when it is left out. The readable part of a
    damaged recording is used; its `problems` name the damage.

    Args:
        paths: files and folders.
        progress: called with (done, total) after each run.
        topics: topic mapping, see `find_recordings`.
        nominal: robot that they are read for, see `build_recording`.
        truth: ground truth in files of its own, see `find_recordings`.
        coupling: coupling to take out, see `decoupled`.
        unusable: mapping to fill with file and reason of each recording that cannot be used, while more than
            half can. The others are then refused only for signs that are wrong in most of them. If None, the
            first unusable recording raises.

    Returns:
        The recordings, in a fixed order, with unique names and corrected ground truth
        (`hil.datasets.truth_correction`).

    Raises:
        DataError: see `find_recordings`, `build_recording`, `covered`, `decoupled` and `check_signs`.
    """
    robot = nominal if nominal is not None else Nominal()
    found = find_recordings(paths, topics, nominal, truth)
    jobs = dict[tuple[Path, ...], list[Job]]()
    for job in found:
        jobs.setdefault(job.identity, []).append(job)
    out, refused = [], list[DataError]()
    for number, (job, read) in enumerate(_at_once([same[0] for same in jobs.values()], robot), start=1):
        if progress is not None:
            progress(number, len(jobs))
        if isinstance(read, DataError):
            refused.append(read)
            if unusable is None or 2 * len(refused) >= len(jobs):
                raise refused[0]
            unusable[str(job.files[0])] = str(read).removeprefix(f"{job.files[0]}: ")
            continue
        times = _times_given(jobs[job.identity])
        more = {f"mentions of {job.files[0]} beyond the first left out": times - 1} if times > 1 else {}
        out += [replace(read[0], repairs={**read[0].repairs, **more}), *read[1:]]
    out = decoupled(without_near_copies(named_apart(without_copies(out))), robot.geometry, coupling)
    out = with_smooth_rows(with_integrated_angles(out))
    out = with_truth_in_turns(with_truth_at_rest(out))
    out = with_angle_faults(with_late_parts(with_misplaced_columns(out, robot)))
    out = corrected(with_uneven_wheels(with_unlike_repetitions(out)))
    out = with_truth_scales(with_truth_seams(out))
    out = with_odometry_in_truth(with_other_sessions(out))
    check_signs(out, robot, of_all=unusable is not None)
    return with_changed_wheels(out, robot.geometry)


Parts = tuple[Recording, ...]


def _at_once(jobs: Iterable[Job], robot: Nominal) -> Iterator[tuple[Job, Parts | DataError]]:
    """Read some recordings at a time, in order.

    Threads help because unpacking and number parsing release the interpreter lock.
    """
    readers = ThreadPoolExecutor(_READERS)
    try:
        read = [(job, readers.submit(_read, job, robot)) for job in jobs]
        for job, recording in read:
            yield job, recording.result()
    finally:
        readers.shutdown(cancel_futures=True)


def _read(job: Job, robot: Nominal) -> Parts | DataError:
    """Read a recording with all its parts, or return the reason why it cannot be used."""
    try:
        first = job.read()
        return tuple(covered(replace(part, later=()), robot) for part in (first, *first.later))
    except DataError as error:
        return error


def _times_given(same: Sequence[Job]) -> int:
    """Number of times that a run was named; naming both halves of a pair counts as one."""
    return max(Counter(file.resolve() for job in same for file in job.given).values())


def _one_job(path: Path, read: Callable[[], Recording]) -> Job:
    """Job for a run of one file, or of a folder that is one recording."""
    return Job((path,), read, (path,))


def _below(folder: Path) -> str:
    """Remedy that names subfolders with recordings; empty where there are none."""
    kinds = ("*.csv", "*.csv.gz", "*.mcap", "*.db3")
    holders = sorted({found.parent for kind in kinds for found in folder.glob(f"*/{kind}")})
    return "name the folder that does: " + ", ".join(map(str, holders[:3])) if holders else ""


def _folder(
    folder: Path, mapping: TopicMap | None, nominal: Nominal | None, truth: TruthFile | None
) -> list[Job]:
    if rosbag.is_bag(folder):
        return [_bag(folder, mapping, nominal)]
    pairs = public_csv.find_pairs(folder)
    paired = {file for pair in pairs for file in pair}
    bags = rosbag.bags_in(folder)
    tables = {f for kind in ("*.csv", "*.csv.gz") for f in folder.glob(kind)} - paired
    if truth is not None:
        tables = {f for f in tables if f.resolve() != truth.path.resolve()}
    own = folder.glob("*.mcap") if mapping is None else ()
    foreign = bags if mapping is not None else [b for b in bags if b.suffix != ".mcap"]
    if mapping is not None and pairs:
        raise UsageError(f"{pairs[0][0]}: {PUBLIC}")
    jobs = [_pair(odom, absolute, nominal, (odom, absolute)) for odom, absolute in pairs]
    jobs += [_file(f, mapping, nominal, truth) for f in sorted([*tables, *own])]
    if foreign and mapping is None:
        names = ", ".join(b.name for b in foreign)
        raise DataError(
            str(folder), f"holds rosbag2 recordings of another robot ({names})", remedy=NEEDS_TOPICS
        )
    return jobs + [_bag(b, mapping, nominal) for b in foreign]


def _bag(path: Path, mapping: TopicMap | None, nominal: Nominal | None) -> Job:
    if mapping is None:
        raise DataError(str(path), "is a rosbag2 recording of another robot", remedy=NEEDS_TOPICS)
    return _one_job(path, lambda: read_mapped(path, mapping, nominal))


def _whole_or_not(path: Path, nominal: Nominal | None) -> Recording:
    """Read as much of one of our recordings as is readable."""
    problems: list[str] = []
    try:
        return replace(export.to_recording(path, problems, nominal), problems=tuple(problems))
    except DataError as error:
        if not problems:
            raise
        why = error.message.removeprefix(f"{path}: ")
        raise DataError(
            str(path),
            f"{'; '.join(problems)}; what could be read does not do: {why}",
            expected=error.expected,
            remedy=COPY_AGAIN,
        ) from None


def _pair(odom: Path, absolute: Path, nominal: Nominal | None, given: tuple[Path, ...]) -> Job:
    return Job((odom, absolute), lambda: public_csv.read_pair(odom, absolute, nominal), given)


def _one_file(
    path: Path, mapping: TopicMap | None, nominal: Nominal | None, truth: TruthFile | None
) -> list[Job]:
    return [_file(path, mapping, nominal, truth)]


def _file(path: Path, mapping: TopicMap | None, nominal: Nominal | None, truth: TruthFile | None) -> Job:
    if not path.exists():
        raise DataError(str(path), "does not exist", expected="a recording, or a folder of them")
    if truth is not None and (path.suffix in _WITH_TRUTH or public_csv.is_pair_file(path)):
        raise UsageError(
            f"{path} holds its ground truth itself, or names it in --topics",
            expected="wheel logs as plain CSV beside --truth",
        )
    if path.suffix in _OTHERS:
        raise DataError(str(path), "is no recording", remedy=meant(path))
    if path.suffix in PACKED and mapping is None:
        raise DataError(
            str(path),
            "is packed as a whole",
            expected="a recording as it was written",
            remedy=f"unpack it with `zstd -d {path}`; bags of other robots are read packed, with --topics",
        )
    if path.suffix != ".mcap" and rosbag.is_bag(path):
        return _bag(path, mapping, nominal)
    if path.suffix == ".mcap" and mapping is not None:
        return _bag(path, mapping, nominal)
    if mapping is not None:
        return _one_job(path, lambda: read_mapped(path, mapping, nominal, truth))
    if path.suffix == ".mcap":
        return _one_job(path, lambda: _whole_or_not(path, nominal))
    if public_csv.is_pair_file(path):
        odom = path.with_name(path.name.replace("abs_", "odom_", 1))
        if not odom.exists():
            raise DataError(str(path), "has no odometry file", expected=f"{odom.name} beside it")
        return _pair(odom, public_csv.partner(odom), nominal, (path,))
    return _one_job(path, lambda: plain_csv.read_plain(path, nominal, truth))
