"""Packs files for transfer between a campaign and its workers: input files of the runs, and their results."""

import hashlib
import io
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from uuid import uuid4

from hil.core.errors import ConfigError, reason_of
from hil.support.atomic_files import staged

MOST_BYTES = 256 << 20


@dataclass(frozen=True)
class WorkerFiles:
    """Files for all runs of a campaign.

    Attributes:
        content: packed files.
        places: text by which the campaign names a file -> name of the packed file.
    """

    content: bytes
    places: Mapping[str, str]

    @cached_property
    def name(self) -> str:
        """Name of the folder in which a worker keeps the files; each campaign removes only its own folder."""
        return f"hil-{uuid4().hex[:16]}"


def names(named: Mapping[str, Path]) -> dict[str, str]:
    """Return the same texts -> name of each file or folder in a parcel."""
    return {text: f"{number}/{path.name}" for number, (text, path) in enumerate(named.items())}


def parcel(
    named: Mapping[str, Path],
    written: Mapping[str, str] | None = None,
    beside: Mapping[str, Sequence[Path]] | None = None,
) -> WorkerFiles:
    """Pack the files of a campaign.

    Args:
        named: text by which the campaign names a file or folder -> its local path.
        written: text that names a bench file -> content that the workers read instead of the file.
        beside: text of `named` -> files to pack beside it.

    Raises:
        ConfigError: a file cannot be read, or the files exceed the size limit.
    """
    places = names(named)
    files = {k: v for text, path in named.items() for k, v in _contents(path, places[text])}
    for text, others in (beside or {}).items():
        near = Path(places[text]).parent
        files |= {k: v for path in others for k, v in _contents(path, f"{near}/{path.name}")}
    for number, (text, content) in enumerate((written or {}).items()):
        places[text] = f"bench_{number}.toml"
        files[places[text]] = content.encode()
    if sum(map(len, files.values())) > MOST_BYTES:
        raise ConfigError(
            f"the files of this campaign take more than {MOST_BYTES >> 20} MiB",
            remedy="use smaller meshes or recordings, or --workers on one computer",
        )
    return WorkerFiles(_packed(files), places)


def _contents(path: Path, name: str) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of a file and of the files that a model names, or of all files in a folder."""
    try:
        if path.is_dir():
            for inner in sorted(p for p in path.rglob("*") if p.is_file()):
                yield f"{name}/{inner.relative_to(path).as_posix()}", inner.read_bytes()
            return
        yield name, path.read_bytes()
        for inner in _of_model(path):
            yield f"{Path(name).parent}/{inner.relative_to(path.parent).as_posix()}", inner.read_bytes()
    except OSError as error:
        raise ConfigError(f"{error.filename or path}: cannot be read ({reason_of(error)})") from None
    except ValueError:
        raise ConfigError(f"{path}: names files outside its folder, which workers cannot be sent") from None


def _of_model(path: Path) -> list[Path]:
    """Return meshes and further files of a MuJoCo model; none for any other file."""
    if path.suffix != ".xml":
        return []
    import mujoco

    found = (Path(name).absolute() for name in mujoco.mju_getXMLDependencies(str(path)))
    return [file for file in found if file != path]


def digest(path: Path) -> str:
    """Return the digest of a file and of the files that a model names, or of all files in a folder.

    Raises:
        ConfigError: a file cannot be read.
    """
    reported = hashlib.sha256()
    for name, content in _contents(path, path.name):
        reported.update(f"{name} {len(content)} ".encode() + content)
    return reported.hexdigest()


def packed(folder: Path) -> bytes:
    """Pack all files of a folder; raises `OSError` if a file cannot be read."""
    files = (p for p in sorted(folder.rglob("*")) if p.is_file())
    return _packed({p.relative_to(folder).as_posix(): p.read_bytes() for p in files})


def _packed(files: Mapping[str, bytes]) -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return held.getvalue()


def unpacked(content: bytes, folder: Path) -> None:
    """Unpack files into a folder, all or none; raises `DataError` if this fails."""
    with staged(folder) as parts, zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(parts)
