"""What an operator has mistyped, or may not write, is said before a device opens, with the way out."""

import pytest

from hil.cli import main


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
