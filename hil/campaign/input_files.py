"""Input files of a campaign's runs: packed for workers elsewhere, identified by content."""

from collections.abc import Sequence
from pathlib import Path

import tomli_w

from hil.campaign.cases import Case
from hil.campaign.run_case import Setup
from hil.campaign.worker_files import WorkerFiles, digest, names, parcel
from hil.config.loading import bench_files, find_bench, path_keys
from hil.procedure.declaration import Procedure
from hil.procedure.procedure_lookup import file_and_name, modules_beside
from hil.support.file_reading import put_dotted


def files_of(setup: Setup, proc: Procedure, cases: Sequence[Case]) -> WorkerFiles:
    """Pack all local files that the cases read, for workers without access to them.

    Raises:
        ConfigError: a file cannot be read, or the files exceed the size limit.
    """
    named = _named(setup, cases)
    beside = {text: modules_beside(path) for text, path in _script(setup).items()}
    bench = setup.bench or proc.bench
    if not Path(bench).is_file():
        return parcel(named, beside=beside)
    tree, _ = find_bench(bench)
    inner = bench_files(tree, Path(bench).parent)
    named |= {str(path.absolute()): path.absolute() for path in inner.values()}
    packed = names(named)
    for key, path in inner.items():
        put_dotted(tree, key, packed[str(path.absolute())], "path")
    return parcel(named, {bench: tomli_w.dumps(tree)}, beside)


def contents_of(setup: Setup, proc: Procedure, cases: Sequence[Case]) -> dict[str, str]:
    """Return absolute path -> digest of the content, for every file or folder that the cases read.

    Raises:
        ConfigError: a file cannot be read.
    """
    read, bench = list(_named(setup, cases).values()), Path(setup.bench or proc.bench)
    read += [path for script in _script(setup).values() for path in modules_beside(script)]
    if bench.is_file():
        tree, _ = find_bench(bench)
        read += [bench, *bench_files(tree, bench.parent).values()]
    return {str(path.absolute()): digest(path.absolute()) for path in read}


def _named(setup: Setup, cases: Sequence[Case]) -> dict[str, Path]:
    """Return command line text that names a file or folder -> its path; without the bench file."""
    texts = [setup.calibration, setup.answers, *_script(setup)]
    for case in {case.settings: case for case in cases}.values():
        _, overrides = setup.split(case)
        keys = path_keys(key.partition(".")[0] for key in overrides)
        texts += [str(overrides[key]) for key in keys if key in overrides]
        texts += [fault for fault in setup.all_faults(case) if fault.endswith(".toml")]
    return {text: Path(text).absolute() for text in texts if text}


def _script(setup: Setup) -> dict[str, Path]:
    """Return command line text -> path of the procedure's own file; empty for a shipped procedure."""
    script = file_and_name(setup.script)[0]
    return {script: Path(script).absolute()} if Path(script).is_file() else {}
