"""`hil accept`: acceptance test of a bench, from doctor to turning wheels, with a page to sign."""

import json
from pathlib import Path
from typing import Any

import click

from hil.cli.bench_options import BenchRequest, bench_options
from hil.cli.options import JSON, OUT, results_folder
from hil.cli.progress import reporting
from hil.cli.question_answers import answers_option, asked_to_end, operator
from hil.core.clock import local_time
from hil.core.errors import shown_path
from hil.core.result_names import ACCEPTANCE_TABLE


@click.command()
@bench_options("bench")
@click.option("--on-stand", is_flag=True, help="The wheels are free and may turn: do not ask.")
@bench_options("emulate", "realtime", "seed", "faults")
@answers_option
@click.option("--out", type=OUT, help="Results folder [default: out/accept/TIME].")
@JSON
def command(
    request: BenchRequest, on_stand: bool, answers: Path | None, out: Path | None, as_json: bool
) -> int:
    """Acceptance test of a bench on its first day, on one page that supplier or lab sign.

    Without motion: doctor, the contract of every device and the age of its samples. If all of this passes and
    the operator confirms that the robot is on a stand: the contract of the servos with turning wheels, and
    their delay. Ends with 0 if all passed, 3 if the doctor found a faulty device, 1 if a contract was
    violated, 4 if wheels were not allowed to turn, something ended it, or no page could be written.

    Example: hil accept --bench my.toml
    """
    from hil.commission.acceptance import Acceptance, accept
    from hil.core.errors import EXIT_ABORTED, ConfigError, HilError
    from hil.report.acceptance_page import write_acceptance
    from hil.support.atomic_files import check_folder

    folder = results_folder("accept", out, None)
    check_folder(folder)
    if (folder / ACCEPTANCE_TABLE).exists():
        raise ConfigError(f"{folder}: holds an acceptance", remedy="choose another --out")
    interrupts = asked_to_end()
    with interrupts.installed(), interrupts.deferred():
        with reporting() as report:
            reported, code = accept(
                Acceptance(
                    request.source({}),
                    local_time,
                    on_stand=on_stand,
                    operator=operator(answers),
                    report=report,
                    interrupts=interrupts,
                )
            )
        try:
            reported = write_acceptance(folder, reported)
        except HilError as error:
            click.echo(f"hil: {error}", err=True)
            reported, code = (
                {**reported, "folder": str(folder), "page": None, "data": None},
                code or EXIT_ABORTED,
            )
        click.echo(json.dumps(reported, allow_nan=False) if as_json else _text(reported))
    return code


def _text(summary: dict[str, Any]) -> str:
    lines = []
    for stage in summary["stages"]:
        lines.append(f"{stage['verdict']:8}{stage['name']:10}{stage['why']}".rstrip())
        for finding in stage["findings"]:
            if finding["level"] == "ok":
                continue
            mark = {"warning": "warn", "failure": "FAIL"}[finding["level"]]
            lines.append(f"  {mark} {finding['device']} {finding['check']}: {finding['found']}")
            expected = f"expected {finding['expected']}" if finding["expected"] else ""
            if hints := "; ".join(filter(None, (expected, finding["remedy"]))):
                lines.append(f"       {hints}")
    written = "the page to sign could not be written"
    if summary["page"]:
        page, data = (shown_path(Path(summary[key])) for key in ("page", "data"))
        written = f"the page to sign is {page}, its data {data}"
    lines.append(f"{summary['verdict']}: {written}")
    return "\n".join(lines)
