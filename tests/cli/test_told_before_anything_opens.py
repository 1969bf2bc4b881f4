"""What an operator has mistyped, or may not write, is said before a device opens, with the way out."""

import pytest
import tomli_w

from hil.cli import main
from hil.config.loading import load_bench


@pytest.mark.parametrize("words", [("live", "--duration", "1"), ("jog", "--body")])
def test_a_folder_that_cannot_be_written_is_refused_before_the_bench_opens(
    tmp_path, words, monkeypatch, capsys
):
    (tmp_path / "out").write_text("a file where the sessions would go")
    monkeypatch.chdir(tmp_path)
    assert main([*words, "--bench", "emulated_floor"]) == 2
    said = capsys.readouterr().err
    assert "name another folder with --out" in said
    assert "loading" not in said


def test_a_key_of_the_bench_that_is_given_as_a_parameter_is_told_its_whole_name(tmp_path, capsys):
    for key, hinted in (("control.gains", True), ("tracker.scale", True), ("gain", False)):
        assert main(["run", "bring_up", "--set", f"{key}=1", "--out", str(tmp_path / key)]) == 2
        assert (f"is given as bench.{key}" in capsys.readouterr().err) == hinted


@pytest.fixture
def injecting(tmp_path):
    """A bench on a wall with one real device, whose port does not exist, and consent to faults of it."""
    overrides = {"imu.backend": "real", "imu.port": "/dev/no-such-port", "faults.real": "wall"}
    config = load_bench("emulated", overrides={**overrides, "faults.devices": ["imu"]})
    path = tmp_path / "bench.toml"
    path.write_bytes(tomli_w.dumps(config.model_dump(mode="json", by_alias=True, exclude_none=True)).encode())
    return path


@pytest.mark.parametrize("by", ["a file of waypoints", "the plan of a procedure"])
def test_a_path_that_leads_too_far_with_faults_at_links_is_refused_before_a_port_is_opened(
    by, tmp_path, injecting, capsys
):
    (tmp_path / "way.csv").write_text("x,y,theta\n0,0,0\n0.31,0,0\n")
    words = {
        "a file of waypoints": ("live", "--trajectory", str(tmp_path / "way.csv")),
        "the plan of a procedure": ("run", "wall_tracking", "--set", "length_m=0.31"),
    }[by]
    faulty = ("--bench", str(injecting), "--fault", "imu:silent@3+1", "--out", str(tmp_path / "out"))
    assert main([*words, *faulty, "--inject-real"]) == 2
    said = capsys.readouterr().err
    assert "leads 0.31 m away from its first place" in said
    assert "loading" not in said
    assert not (tmp_path / "out").exists()
