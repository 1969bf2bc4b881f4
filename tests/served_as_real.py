"""Devices that `hil emulate` serves, and a bench file that declares them as real."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import tomli_w
from pydantic import BaseModel

from hil.bench.device_set_from_config import model_of
from hil.config.loading import load_bench
from hil.core.device import Connection
from hil.core.registry import kinds
from hil.faults.permission import situation

END_S = 20.0


@contextmanager
def served_as_real(
    folder: Path,
    names: Sequence[str] = (),
    *,
    profile: str = "emulated_floor",
    faulty: Sequence[str] = (),
    tables: Mapping[str, object] | None = None,
) -> Iterator[Path]:
    """Serve devices of a profile; yield the path of a bench file in which they are real.

    Args:
        folder: folder of the file.
        names: devices of the bench; all of the profile by default.
        profile: name of the profile.
        faulty: devices whose messages may be damaged; all by default.
        tables: other keys of that file, by their dotted names.
    """
    config = load_bench(profile, overrides=dict(tables or {}))
    names = tuple(names) or tuple(config.devices())
    command = [sys.executable, "-m", "hil.cli", "emulate", "--bench", profile, "--only", ",".join(names)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        try:
            ends = json.loads(child.stdout.readline())
            tree = config.model_dump(mode="json", by_alias=True, exclude_none=True)
            for name in config.devices():
                if name not in names:
                    del tree[name]
                    continue
                reached = model_of(config, name).connection(ends[kinds()[name].shown_as])
                values = reached.values if isinstance(reached, Connection) else reached
                tree[name] |= {
                    key: value.model_dump() if isinstance(value, BaseModel) else value
                    for key, value in values.items()
                    if value is not None
                }
                tree[name]["backend"] = "real"
            del tree["emulation"]
            where = situation(on_wall=config.environment.on_wall, tethered=config.safety.tethered)
            tree["faults"] = {"real": where, "devices": list(faulty or names)}
            path = folder / "served.toml"
            path.write_text(tomli_w.dumps(tree))
            yield path
        finally:
            child.terminate()
            child.wait(END_S)
