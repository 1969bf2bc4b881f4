"""Campaigns: one procedure run over many seeds and parameters, in parallel on Dask, into one table.

`cases` expands the cases, `run_case` runs one of them, `dask_run.spread` runs any function on processes or
machines. The other modules check, store and send input files, and write statistics, CSV and a page.
"""

from hil.campaign.cases import Axis, Case, expand, parse_axis, parse_seeds
from hil.campaign.dask_run import check_dask, spread
from hil.campaign.ineffective_settings import alike
from hil.campaign.page import write_campaign_page
from hil.campaign.parquet_rows import write_rows
from hil.campaign.table import Row, summarise, write_csv
from hil.campaign.worker_files import WorkerFiles, names, parcel

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
