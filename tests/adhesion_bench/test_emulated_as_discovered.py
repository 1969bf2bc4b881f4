"""A bench file as `hil discover` writes it runs on emulated devices, too."""

import hil


def test_a_fan_without_a_word_about_its_emulation_reports_what_it_does(tmp_path):
    (tmp_path / "my.toml").write_text(
        'schema = 1\nname = "mine"\n[environment]\ntilt_rad = 1.5708\n[adhesion]\nbackend = "real"\n'
        'interface = "socketcan"\nchannel = "can0"\ncontroller_id = 1\n[servos]\nport = "/dev/ttyUSB0"\n'
        '[tracker]\nbackend = "real"\n'
    )
    with hil.open_bench(str(tmp_path / "my.toml"), emulate="all", seed=1) as bench:
        assert "by the fan's speed" in bench.pressed
        assert bench.look(1.0).state == "HELD"
