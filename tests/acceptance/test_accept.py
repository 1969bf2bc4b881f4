"""`hil accept`: what passes, what fails with device and remedy, and that no wheel turns without a word."""

import errno
import hashlib
import json
import signal
from pathlib import Path

import pytest

from hil.cli import main
from hil.commission import acceptance
from hil.commission.acceptance import QUESTION, Acceptance, accept
from hil.config.encoders import SHIPPED_DBC
from hil.core.errors import Aborted, DeviceError
from hil.drivers.servos.dynamixel.driver import DynamixelServos
from hil.faults.files import read_faults
from hil.procedure.bench_source import BenchSource
from hil.procedure.interrupts import Interrupts
from hil.procedure.operator import Operator
from hil.report import acceptance_page
from hil.report.acceptance_page import write_acceptance

SERVOS = '[servos]\nbackend = "emulated"\n'
ENCODERS = '[encoders]\nbackend = "emulated"\ninterface = "hil"\n'
HEAD = 'schema = 1\nname = "lab"\n[robot]\nname = "climber 2"\n'


@pytest.fixture
def bench(tmp_path):
    """A bench file of some tables."""

    def write(*tables):
        path = tmp_path / "my.toml"
        path.write_text("\n".join((HEAD, *tables)))
        return path

    return write


@pytest.fixture
def hil(tmp_path, capsys):
    """`hil accept` with `--json`: exit code and what it reported."""

    def run(*arguments):
        code = main(["accept", "--json", "--out", str(tmp_path / "out"), *map(str, arguments)])
        return code, json.loads(capsys.readouterr().out)

    return run


def stages(reported):
    return {stage["name"]: stage for stage in reported["stages"]}


def failures(reported):
    return [f for s in reported["stages"] for f in s["findings"] if f["level"] == "failure"]


class Asked(Operator):
    """Answers in a fixed way, and remembers the questions."""

    def __init__(self, answer):
        self.answer, self.questions = answer, []

    def ask(self, question):
        self.questions.append(question)
        if self.answer is None:
            raise Aborted("there is no operator")
        return self.answer


def now():
    return "2030-01-01T12:00:00+00:00"


@pytest.fixture(scope="module")
def healthy(tmp_path_factory):
    """Folder, exit code and result of the acceptance of a bench on which nothing is wrong."""
    folder = tmp_path_factory.mktemp("healthy")
    path = folder / "my.toml"
    path.write_text("\n".join((HEAD, SERVOS, ENCODERS)))
    steps = []
    reported, code = accept(Acceptance(BenchSource(path), now, report=lambda *step: steps.append(step)))
    return folder, code, write_acceptance(folder, reported), steps


def test_a_healthy_bench_passes_and_its_page_names_what_was_accepted(healthy):
    folder, code, reported, _ = healthy
    assert (code, reported["verdict"], failures(reported)) == (0, "PASS", [])
    in_virtual_time = {f["device"] for f in stages(reported)["latency"]["findings"]}
    assert in_virtual_time == {"servos", "encoders"}, "this computer is not judged"
    motion = {(f["device"], f["check"]): f["found"] for f in stages(reported)["motion"]["findings"]}
    for axis in (
        ("servos", "command to steering"),
        ("encoders", "command to steering"),
        ("servos", "command to wheels"),
    ):
        assert 20.0 < float(motion[axis].split()[0]) < 150.0, axis  # 40 to 100 ms on the robot
    promises = {f["check"] for f in stages(reported)["contract"]["findings"] if f["device"] == "encoders"}
    assert promises == set(acceptance.AT_REST)
    page, data = Path(reported["page"]).read_text(), Path(reported["data"]).read_bytes()
    for text in (
        hashlib.sha256((folder / "my.toml").read_bytes()).hexdigest(),
        hashlib.sha256(data).hexdigest(),
        "climber 2",
        "XH430-W210 (1010); firmware 46",
        "firmware 1",
        "signature",
        "accepted by",
    ):
        assert text in page, text
    assert json.loads(data)["verdict"] == "PASS"


def test_all_that_the_bench_was_made_from_is_named_with_its_hash(looked, bench, tmp_path):
    record, found = tmp_path / "robot", tmp_path / "found.toml"
    found.write_text("[alignment]\nsteer_zero_rad = [0.01, 0.0, 0.0, 0.0]\n")
    path = bench(ENCODERS, f'[record]\nfolder = "{record}"\n')
    used = []
    for known in (False, True):
        if known:
            assert (
                main(
                    [
                        "robot",
                        "apply",
                        str(record),
                        "--from",
                        str(found),
                        "--bench",
                        str(path),
                        "--of-this-robot",
                    ]
                )
                == 0
            )
        reported, _ = accept(Acceptance(BenchSource(path), now))
        files = {file["what"]: file for file in reported["files"]}
        assert list(files) == ["bench file", "configuration as used", *["record of the robot"] * known]
        used.append(files["configuration as used"]["sha256"])
    assert used[0] != used[1], "the record changes what is used"
    digest = hashlib.sha256((record / "record.toml").read_bytes()).hexdigest()
    assert files["record of the robot"]["sha256"] == digest


def test_its_progress_counts_up_to_the_whole_of_each_part(healthy):
    *_, steps = healthy
    for part in ("doctor", "contract", "motion"):
        counted = [(done, total) for what, done, total in steps if what == part]
        assert [done for done, _ in counted] == list(range(len(counted))), part
        assert {total for _, total in counted} == {counted[-1][0]}, part


def test_a_bench_without_servos_passes_and_says_that_nothing_could_turn(bench):
    reported, code = accept(Acceptance(BenchSource(bench(ENCODERS)), now))
    assert (code, reported["verdict"], stages(reported)["motion"]["verdict"]) == (0, "PASS", "PASS")
    assert "no servos" in stages(reported)["motion"]["why"]
    assert reported["devices"]["encoders"]["identity"]["firmware"]


def test_who_asks_it_to_end_has_the_check_finished_that_is_under_way_and_no_other_begun(bench, monkeypatch):
    interrupts, begun = Interrupts(), []
    check = acceptance.judged

    def asked_to_end(device, promise, body):
        begun.append(promise)
        if len(begun) == 2:
            interrupts.handle(signal.SIGINT)
        return check(device, promise, body)

    monkeypatch.setattr(acceptance, "judged", asked_to_end)
    with interrupts.deferred():
        reported, code = accept(Acceptance(BenchSource(bench(ENCODERS)), now, interrupts=interrupts))
    assert (code, reported["verdict"], len(begun)) == (4, "ABORTED", 2)
    assert len(stages(reported)["contract"]["findings"]) == 2


@pytest.mark.parametrize(
    ("tables", "options", "device", "found", "remedy"),
    [
        (
            ['[tracker]\nbackend = "emulated"', '[emulation.tracker]\nfirmware = "0.2.0.926"'],
            (),
            "tracker",
            "0.2.0.926",
            "pyrealsense2 2.53.1",
        ),
        ([f'{ENCODERS}dbc = "other.dbc"'], (), "encoders", "0x1A0", "encoders.dbc"),
        ([SERVOS], ("--fault", "servo.drive_BL:off"), "servos", "drive_BL", "power"),
    ],
    ids=["camera firmware", "node of another DBC", "silent servo"],
)
def test_a_sick_device_fails_with_its_name_and_what_to_do(
    hil, bench, tmp_path, tables, options, device, found, remedy
):
    text = SHIPPED_DBC.read_text().replace("BO_ 416 ", "BO_ 432 ").replace("BO_ 417 ", "BO_ 433 ")
    (tmp_path / "other.dbc").write_text(text)
    code, reported = hil("--bench", bench(*tables), *options)
    assert (code, reported["verdict"]) == (3, "FAIL")
    first = failures(reported)[0]
    assert first["device"] == device
    assert found in first["found"] + first["expected"]
    assert remedy in first["remedy"]
    assert remedy in (tmp_path / "out" / "accept.html").read_text()
    assert not stages(reported)["motion"]["findings"]


def test_its_result_is_listed_and_opened_as_any_other(hil, bench, tmp_path, capsys):
    _, reported = hil("--bench", bench('[imu]\nbackend = "emulated"'), "--fault", "imu:off")
    assert stages(reported)["contract"]["findings"] == [], "nothing else is tried of a silent device"
    assert main(["results", "list", "--in", str(tmp_path), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["results"]
    assert (row["kind"], row["bench"], row["where"], row["verdict"]) == (
        "acceptance",
        "lab",
        "emulated",
        "FAIL",
    )
    assert main(["results", "open", "--in", str(tmp_path), "--no-browser", "out"]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "out" / "accept.html")
    signed = (tmp_path / "out" / "accept.html").read_bytes()
    assert main(["accept", "--out", str(tmp_path / "out")]) == 2
    assert "holds an acceptance; choose another --out" in capsys.readouterr().err
    assert (tmp_path / "out" / "accept.html").read_bytes() == signed


@pytest.fixture
def looked(monkeypatch):
    """Acceptances of which only the question and what follows it is of interest."""
    monkeypatch.setattr(acceptance._Running, "_look", lambda self: self.stages["doctor"].end())

    def nothing_wrong(self):
        for name in ("contract", "latency"):
            self.stages[name].end()

    monkeypatch.setattr(acceptance._Running, "_contracts", nothing_wrong)


REAL = SERVOS.replace("emulated", "real") + 'port = "/dev/serial/by-id/none"\n'


@pytest.mark.parametrize("answer", ["y", None])
def test_without_consent_no_servo_is_even_opened(looked, bench, tmp_path, answer):
    person = Asked(answer)
    reported, code = accept(Acceptance(BenchSource(bench(REAL)), now, operator=person))
    assert (code, reported["verdict"], person.questions) == (4, "ABORTED", [QUESTION])
    assert stages(reported)["motion"]["findings"] == []
    page = write_acceptance(tmp_path / "out", reported)["page"]
    assert "ABORTED" in Path(page).read_text()


@pytest.mark.parametrize(("answer", "on_stand", "asked"), [(" YES ", False, 1), (None, True, 0)])
def test_with_consent_the_servos_are_opened(looked, bench, answer, on_stand, asked):
    person = Asked(answer)
    reported, code = accept(Acceptance(BenchSource(bench(REAL)), now, on_stand=on_stand, operator=person))
    assert len(person.questions) == asked
    assert (code, reported["verdict"]) == (1, "FAIL")
    assert "port cannot be opened" in failures(reported)[0]["found"]


def test_the_first_promise_that_is_broken_is_the_last_that_moves(looked, bench):
    source = BenchSource(bench(SERVOS), faults=read_faults(("servo.drive_FL:stuck@1",)))
    reported, code = accept(Acceptance(source, now))
    motion = stages(reported)["motion"]
    assert code == 1
    assert [f["level"] for f in motion["findings"]].count("failure") == 1
    assert motion["findings"][-1]["level"] == "failure"
    assert "drive_FL" in motion["findings"][-1]["found"]


@pytest.mark.parametrize(
    ("stage", "promises", "struck", "swallowed"),
    [("contract", "AT_REST", "identity", False), ("motion", "IN_MOTION", "goals are reached", True)],
    ids=["at rest, heard", "in motion, swallowed by a driver"],
)
def test_a_signal_within_a_check_is_no_devices_fault(bench, monkeypatch, stage, promises, struck, swallowed):
    interrupts = Interrupts()

    def check(_):
        try:
            interrupts.handle(signal.SIGTERM)
        except Aborted:
            if not swallowed:
                raise
            raise DeviceError("servos", "does not answer") from None
        raise AssertionError("the signal was not heeded")

    monkeypatch.setattr(acceptance, promises, {**getattr(acceptance, promises), struck: check})
    with interrupts.deferred():
        reported, code = accept(Acceptance(BenchSource(bench(SERVOS)), now, interrupts=interrupts))
    assert (code, reported["verdict"], stages(reported)[stage]["verdict"]) == (4, "ABORTED", "ABORTED")
    assert "SIGTERM" in reported["stopped"]
    assert failures(reported) == []


def test_a_signal_that_a_driver_swallows_while_the_doctor_looks_is_no_devices_fault(bench, monkeypatch):
    interrupts = Interrupts()

    def read(self):
        try:
            interrupts.handle(signal.SIGTERM)
        except Aborted:
            raise DeviceError("servos", "does not answer") from None

    monkeypatch.setattr(DynamixelServos, "read", read)
    with interrupts.deferred():
        reported, code = accept(Acceptance(BenchSource(bench(SERVOS)), now, interrupts=interrupts))
    assert (code, reported["verdict"], failures(reported)) == (4, "ABORTED", [])


CAMERA = '[tracker]\nbackend = "emulated"\n'
SICK = {
    "a servo that restarts": (SERVOS, "servo.drive_FL:reset@6", "servos", "drive_FL restarted"),
    "old answers": (SERVOS + ENCODERS, "servos:delayed", "servos", "encoders 2"),
    "a servo that loses answers": (SERVOS, "servo.drive_FL:drop", "servos", "due are good"),
    "encoders that lose frames": (ENCODERS, "encoders:drop", "encoders", "due are good"),
    "a camera that drifts": (CAMERA, "tracker:wrong,drift_x_m_s=0.05", "tracker", "50 mm/s"),
}


FEW = ("a servo that restarts", "encoders that lose frames", "a camera that drifts")


@pytest.mark.parametrize(
    ("tables", "fault", "device", "found"),
    [
        pytest.param(*case, id=name, marks=() if name in FEW else pytest.mark.long)
        for name, case in SICK.items()
    ],
)
def test_a_device_that_is_a_little_sick_does_not_pass(bench, tables, fault, device, found):
    reported, code = accept(Acceptance(BenchSource(bench(tables), seed=3, faults=read_faults((fault,))), now))
    assert (code, reported["verdict"]) == (1, "FAIL")
    (failure,) = failures(reported)
    assert failure["device"] == device
    assert found in failure["found"]
    assert failure["remedy"]
    (failed,) = (stage for stage in reported["stages"] if stage["verdict"] == "FAIL")
    assert failed["why"] == f"1 of {len(failed['findings'])} checks failed"


def test_a_device_that_restarts_while_the_doctor_looks_is_named(bench):
    source = BenchSource(bench('[imu]\nbackend = "emulated"'), faults=read_faults(("imu:reset@1.5",)))
    reported, code = accept(Acceptance(source, now))
    assert code == 3
    assert "has restarted" in failures(reported)[0]["found"]


@pytest.mark.parametrize("named_by", ["bench file", pytest.param("--fault", marks=pytest.mark.long)])
def test_faults_of_devices_that_are_not_there_in_motion_do_not_end_it(bench, named_by):
    tables = [
        SERVOS,
        '[load_cells]\nbackend = "emulated"\n[environment]\ntilt_rad = 1.5708\n'
        "x_range_m = [-5.0, 5.0]\ny_range_m = [-5.0, 5.0]\n",
    ]
    given = ("load_cells:wrong,factor=0.9",)
    if named_by == "bench file":
        tables.append(f"[emulation]\nfaults = {list(given)}")
    reported, _ = accept(
        Acceptance(BenchSource(bench(*tables), faults=read_faults(given * (named_by == "--fault"))), now)
    )
    assert stages(reported)["motion"]["verdict"] == "PASS", reported


def test_a_part_that_a_device_was_left_out_of_does_not_read_pass(hil, bench):
    code, reported = hil("--bench", bench(SERVOS, ENCODERS), "--fault", "servos:off")
    assert code == 3
    for name in ("contract", "latency"):
        assert stages(reported)[name]["verdict"] == "ABORTED"
        assert "servos" in stages(reported)[name]["why"]


def test_a_disk_that_takes_no_page_leaves_the_verdict_and_no_half_of_it(
    bench, tmp_path, monkeypatch, capsys, looked
):
    def full(self, *_, **__):
        self.touch()
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    monkeypatch.setattr(acceptance_page.Path, "write_bytes", full)
    path = tmp_path / "my.toml"
    with path.open("w") as file:
        file.write(HEAD + SERVOS)
    for json_too in ([], ["--json"]):
        assert main(["accept", "--bench", str(path), "--out", str(tmp_path / "out"), *json_too]) == 4
        out, err = capsys.readouterr()
        assert "No space left on device" in err
        assert (json.loads(out)["verdict"] if json_too else out.splitlines()[-1].split(":")[0]) == "PASS"
        assert not (tmp_path / "out").exists()
