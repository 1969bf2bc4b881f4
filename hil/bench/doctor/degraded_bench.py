"""Opens a bench for the doctor without devices whose drivers cannot be made; each becomes a finding."""

from pathlib import Path
from typing import Any

from hil.bench.bench import Bench
from hil.bench.opening import open_bench
from hil.config.bench import BenchConfig
from hil.config.loading import load_bench
from hil.core.finding import Finding
from hil.core.third_party_errors import PackageError


def open_degraded(
    config: str | Path | BenchConfig, *, emulate: str | None = None, **given: Any
) -> tuple[Bench, list[Finding]]:
    """Make a bench as `open_bench` does, and a failure for every device that had to be left out.

    Args:
        config: bench, as for `open_bench`.
        emulate: names of devices to emulate, as for `open_bench`.
        given: further arguments of `open_bench`.
    """
    left_out: list[Finding] = []
    rest = load_bench(config, emulate=emulate)
    while True:
        try:
            return open_bench(rest, **given), left_out
        except PackageError as error:
            if error.kind not in rest.devices():
                raise
            left_out.append(Finding.of_error(error.kind, "open", error))
            emulation = rest.emulation.model_copy(update={error.kind: {}})
            rest = rest.model_copy(update={error.kind: None, "emulation": emulation})
