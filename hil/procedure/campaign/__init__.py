"""One piece of work run many times: over seeds and parameters, in parallel on Dask, into one table.

`plan` makes the cases, `running` runs one of them, `spread` takes any function to processes or machines. The
others check, keep and send what the runs need, and say what came out as statistics, CSV and a page.
"""

from hil.procedure.campaign.cases import Axis, Case, expand, parse_axis, parse_seeds
from hil.procedure.campaign.dask_run import check_dask, spread
from hil.procedure.campaign.ineffective_settings import alike
from hil.procedure.campaign.page import write_campaign_page
from hil.procedure.campaign.parquet_rows import write_rows
from hil.procedure.campaign.table import Row, summarise, write_csv
from hil.procedure.campaign.worker_files import WorkerFiles, names, parcel

__all__ = [
    "Axis",
    "Case",
    "Row",
    "WorkerFiles",
    "alike",
    "check_dask",
    "expand",
    "names",
    "parcel",
    "parse_axis",
    "parse_seeds",
    "spread",
    "summarise",
    "write_campaign_page",
    "write_csv",
    "write_rows",
]
