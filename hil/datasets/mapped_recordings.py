"""Recordings of other robots, read by a `--topics` file: bags by their topics, CSV by its columns."""

import logging
from pathlib import Path

from hil.core.errors import UsageError
from hil.datasets import plain_csv, public_csv, rosbag
from hil.datasets.nominal_robot import Nominal
from hil.datasets.topic_map import TopicMap
from hil.datasets.truth_files import TruthFile
from hil.datasets.wheel_log import Recording

LOG = logging.getLogger(__name__)
PUBLIC = "is of the public recordings, whose columns are known; leave --topics out"


def read_mapped(
    path: Path, mapping: TopicMap, nominal: Nominal | None = None, truth: TruthFile | None = None
) -> Recording:
    """Read a recording of another robot: a bag by its topics, or a CSV file by its columns.

    Args:
        path: the recording.
        mapping: content of the `--topics` file.
        nominal: robot that it is read for.
        truth: ground truth of a CSV file in a file of its own.

    Raises:
        DataError: it cannot be read.
        UsageError: the mapping is for the other kind of file.
    """
    table = path.name.removesuffix(".gz").endswith(".csv")
    if table and public_csv.is_pair_file(path):
        raise UsageError(f"{path}: {PUBLIC}")
    if table and mapping.columns is None and plain_csv.has_own_columns(path):
        LOG.warning("%s: --topics is not applied to it: its columns are those of the bench", path)
        return plain_csv.read_plain(path, nominal, truth)
    if table != (mapping.columns is not None):
        lacks = "has no [columns] for it" if table else "has [columns], which are for CSV"
        raise UsageError(
            f"{path}: --topics {lacks}", remedy="give the mapping of this kind of file, or leave --topics out"
        )
    if mapping.columns is not None:
        return plain_csv.read_plain(path, nominal, truth, mapping.columns)
    if truth is not None:
        raise UsageError(
            f"{path} names its ground truth in --topics", expected="wheel logs as CSV beside --truth"
        )
    return rosbag.read_bag(path, mapping, nominal)
