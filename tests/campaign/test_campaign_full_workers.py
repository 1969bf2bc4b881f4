"""Workers of a cluster that have no room: who is left out, who does their runs, and what is left behind."""

import errno
import json
import os
import re
from pathlib import Path

import pytest

from hil.campaign import remote_workers as campaign_cluster
from hil.campaign.worker_files import WorkerFiles, parcel, unpacked
from hil.cli import main
from hil.core.errors import DataError
from hil.procedure import run_result as result_files

distributed = pytest.importorskip("distributed", reason="Dask (the extra campaign) is not installed")

SCRIPT = '''
"""A procedure without a bench."""
from dataclasses import dataclass

from hil.procedure import Measurement, procedure


@dataclass
class Parameters:
    aborts: bool = False


@procedure(name="count", parameters=Parameters, measurements=[Measurement("squared", "1", high=1e3)])
def run(ctx):
    """Square the seed."""
    if ctx.parameters.aborts:
        ctx.prompt("is the robot on the wall?")
    ctx.measure("squared", float(ctx.seed) ** 2)
'''


@pytest.fixture
def workers(tmp_path, monkeypatch):
    """Start so many workers in this process; gives the cluster, and address -> folder of each."""
    monkeypatch.chdir(tmp_path)
    Path("count.py").write_text(SCRIPT)
    found = []

    def start(n):
        cluster = distributed.LocalCluster(
            n_workers=n,
            threads_per_worker=1,
            processes=False,
            dashboard_address=None,
            memory_limit=0,
            local_directory=str(tmp_path / "elsewhere"),
        )
        found.append(cluster)
        return cluster, {w.address: w.local_directory for w in cluster.workers.values()}

    yield start
    for cluster in found:
        cluster.close()


@pytest.fixture
def campaign(capsys):
    """Exit code, JSON and stderr of a campaign on a cluster."""

    def go(cluster, *options):
        common = ("--keep", "results", "--out", "o", "--scheduler", cluster.scheduler_address)
        code = main(["campaign", "count.py", *common, *options, "--json"])
        said = capsys.readouterr()
        return code, json.loads(said.out), said.err

    return go


def full(monkeypatch, *folders):
    """The disks of these folders take no result of a run; gives the seeds that were refused."""
    usual, refused = result_files.put_whole, []

    def put(path, content):
        if str(path).startswith(folders):
            refused.append(path.parent.name)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        usual(path, content)

    monkeypatch.setattr(result_files, "put_whole", put)
    return refused


def too_full_for_files(monkeypatch, *folders):
    """The disks of these folders take not even the files of a campaign."""

    def unpack(content, folder):
        if str(folder).startswith(folders):
            raise DataError(str(folder), "cannot be written (No space left on device)")
        unpacked(content, folder)

    monkeypatch.setattr(campaign_cluster, "unpacked", unpack)


def left_at(cluster, folders):
    """Files of campaigns on the workers, and plugins that the scheduler gives to those to come."""
    files = [path for folder in folders.values() for path in Path(folder).glob("hil-*")]
    return files, [name for name in cluster.scheduler.worker_plugins if name.startswith("hil-")]


def squares(tree):
    return [row["measurements"]["squared"]["value"] for row in tree["rows"]]


def test_the_runs_of_a_full_worker_are_done_by_another_and_it_is_named(
    workers, campaign, monkeypatch, caplog
):
    cluster, folders = workers(2)
    (bad, folder), (good, _) = folders.items()
    refused = full(monkeypatch, folder)
    code, tree, said = campaign(cluster, "--seeds", "0:8")
    assert (code, tree["verdicts"]) == (0, {"PASS": 8}), said
    assert squares(tree) == [float(seed**2) for seed in range(8)]
    assert refused  # how many before it has left is up to the scheduler; each was done again
    assert re.search(f"worker {re.escape(bad)}: .*No space left on device.*it gets no more runs", caplog.text)
    assert list(cluster.scheduler.workers) == [good]


def test_what_no_worker_has_room_for_is_lost_with_the_reason(workers, campaign, monkeypatch):
    cluster, folders = workers(2)
    full(monkeypatch, *folders.values())
    code, tree, _ = campaign(cluster, "--seeds", "0:4")
    assert (code, tree["verdicts"]) == (4, {"LOST": 4})
    assert (tree["groups"][0]["tested"], tree["groups"][0]["pass_share"]) == (0, None)
    (last,) = cluster.scheduler.workers
    for row in tree["rows"]:
        assert row["error"].startswith(f"worker {last}: ")
        assert "result.json: cannot be written (No space left on device)" in row["error"]


def test_a_worker_without_room_for_the_files_is_left_out_and_the_others_go_on(
    workers, campaign, monkeypatch, caplog
):
    cluster, folders = workers(2)
    (bad, folder), (good, _) = folders.items()
    too_full_for_files(monkeypatch, folder)
    code, tree, said = campaign(cluster, "--seeds", "0:4")
    assert (code, tree["verdicts"]) == (0, {"PASS": 4}), said
    assert re.search(f"worker {re.escape(bad)}: .*No space left on device.*it gets no more runs", caplog.text)
    assert list(cluster.scheduler.workers) == [good]


def test_where_no_worker_has_room_for_the_files_each_is_named(workers, campaign, monkeypatch):
    cluster, folders = workers(2)
    too_full_for_files(monkeypatch, *folders.values())
    code, tree, said = campaign(cluster, "--seeds", "0:4")
    assert (code, tree["error"]["exit_code"]) == (4, 4)
    assert "no worker can keep the files of this campaign" in said
    assert all(f"worker {address}: " in said for address in folders)
    assert left_at(cluster, folders) == ([], [])


def test_a_worker_that_comes_later_without_room_for_the_files_is_left_out(workers, monkeypatch, caplog):
    cluster, folders = workers(1)
    sent = WorkerFiles(b"", {})
    known = set(folders.values())

    def unpack(content, folder):
        if str(folder.parent) not in known:
            raise DataError(str(folder), "cannot be written (No space left on device)")

    monkeypatch.setattr(campaign_cluster, "unpacked", unpack)
    with distributed.Client(cluster) as client, campaign_cluster.files_on_workers(client, sent):
        cluster.scale(2)
        client.wait_for_workers(2)
        (late,) = set(cluster.scheduler.workers) - set(folders)
        why = client.run(campaign_cluster.lacking, sent.name)
        assert why[next(iter(folders))] == ""
        assert why[late].startswith(f"worker {late}: ")
        assert campaign_cluster.do_without(client, late, why[late])
        assert not campaign_cluster.do_without(client, next(iter(folders)), "full")
        assert list(cluster.scheduler.workers) == list(folders)
    assert "it gets no more runs" in caplog.text


def test_nothing_of_a_campaign_that_is_aborted_is_left_at_the_workers(workers, campaign):
    cluster, folders = workers(2)
    code, _, said = campaign(cluster, "--seeds", "0:2", "--set", "aborts=true")
    assert code == 4, said
    assert left_at(cluster, folders) == ([], [])


def test_two_campaigns_with_the_same_files_do_not_take_away_each_others(workers):
    cluster, folders = workers(1)
    (folder,) = folders.values()
    one, two = (parcel({"count": Path("count.py").absolute()}) for _ in range(2))
    with distributed.Client(cluster) as client, campaign_cluster.files_on_workers(client, one):
        with campaign_cluster.files_on_workers(client, two):
            assert len(left_at(cluster, folders)[0]) == 2
        assert (Path(folder) / one.name).is_dir()
    assert left_at(cluster, folders) == ([], [])
