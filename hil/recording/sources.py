"""Which reader reads what: turns the paths of a command line into recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from hil.calibration.datasets import Recording
from hil.calibration.nominal import Nominal
from hil.recording import export, plain_csv, public_csv, rosbag
from hil.recording.mcap_reader import NEEDS_TOPICS
from hil.vocabulary.errors import DataError
from hil.vocabulary.mistaken import meant

_OTHERS = (".py", ".toml", ".json", ".html")
"""Files of this project that hold no recording."""

Job = Callable[[], Recording]


def find_recordings(
    paths: Sequence[str | Path], topics: str | Path | None = None, nominal: Nominal | None = None
) -> list[Job]:
    """Readers for every run under the given files and folders, in a fixed order.

    Args:
        paths: files and folders.
        topics: topic mapping of another robot; every `.mcap` and `.db3` file and rosbag2 folder is then one
            of its bags.
        nominal: robot that they are read for, see `build_recording`.

    Raises:
        DataError: a path that does not exist or holds no recording.
        ConfigError: the topic mapping is wrong.
    """
    mapping = None if topics is None else rosbag.read_topic_map(topics)
    jobs: list[Job] = []
    for given in paths:
        path = Path(given)
        found = _folder(path, mapping, nominal) if path.is_dir() else [_file(path, mapping, nominal)]
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
) -> list[Recording]:
    """Read every run under the given files and folders; `progress(done, total)` after each."""
    jobs = find_recordings(paths, topics, nominal)
    out = []
    for number, job in enumerate(jobs, start=1):
        out.append(job())
        if progress is not None:
            progress(number, len(jobs))
    return out


def _below(folder: Path) -> str:
    """Which folders in this one hold recordings."""
    kinds = ("*.csv", "*.csv.gz", "*.mcap", "*.db3")
    holders = sorted({found.parent for kind in kinds for found in folder.glob(f"*/{kind}")})
    return "name the folder that does: " + ", ".join(map(str, holders[:3])) if holders else ""


def _folder(folder: Path, mapping: rosbag.TopicMap | None, nominal: Nominal | None) -> list[Job]:
    if rosbag.is_bag(folder):
        return [_bag(folder, mapping, nominal)]
    pairs = public_csv.find_pairs(folder)
    if pairs:
        return [lambda o=o, a=a: public_csv.read_pair(o, a, nominal) for o, a in pairs]  # type: ignore[misc]
    bags = rosbag.bags_in(folder)
    tables = sorted(f for kind in ("*.csv", "*.csv.gz") for f in folder.glob(kind))
    if mapping is not None:
        return [_file(t, mapping, nominal) for t in tables] + [_bag(b, mapping, nominal) for b in bags]
    files = sorted([*tables, *folder.glob("*.mcap")])
    if bags and not files:
        names = ", ".join(b.name for b in bags)
        raise DataError(
            str(folder), f"holds rosbag2 recordings of another robot ({names})", remedy=NEEDS_TOPICS
        )
    return [_file(f, None, nominal) for f in files]


def _bag(path: Path, mapping: rosbag.TopicMap | None, nominal: Nominal | None) -> Job:
    if mapping is None:
        raise DataError(str(path), "is a rosbag2 recording of another robot", remedy=NEEDS_TOPICS)
    return lambda: rosbag.read_bag(path, mapping, nominal)


def _file(path: Path, mapping: rosbag.TopicMap | None, nominal: Nominal | None) -> Job:
    if not path.exists():
        raise DataError(str(path), "does not exist", expected="a recording, or a folder of them")
    if path.suffix in _OTHERS:
        raise DataError(str(path), "is no recording", remedy=meant(path))
    if path.suffix == ".db3" or (path.suffix == ".mcap" and mapping is not None):
        return _bag(path, mapping, nominal)
    if path.suffix == ".mcap":
        return lambda: export.to_recording(path, nominal=nominal)
    if public_csv.is_pair_file(path):
        odom = path.with_name(path.name.replace("abs_", "odom_", 1))
        if not odom.exists():
            raise DataError(str(path), "has no odometry file", expected=f"{odom.name} beside it")
        return lambda: public_csv.read_pair(odom, public_csv.partner(odom), nominal)
    return lambda: plain_csv.read_plain(path, nominal)
