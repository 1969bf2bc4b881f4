"""A device package that cannot be used is named before anything is opened: exit 2, and what to do."""

import json

import pytest

from hil.core.errors import ConfigError
from hil.core.registry import added
from hil.recording.cycle_codec import CycleCodec

MODEL = """
from dataclasses import dataclass
from typing import Literal

from hil.config.device import DeviceConfig
from hil.core.device import DeviceKind, DeviceModel
from hil.core.signals import Stamp, Status


@dataclass(frozen=True)
class Sample:
    stamp: Stamp
    value: float
    status: Status = Status.OK


class Config(DeviceConfig):
    model: Literal["one"] = "one"
    port: str = "/dev/ttyUSB0"


def driver(config, clock):
    open("opened", "w").close()
    raise AssertionError("nothing may be opened")


class One(DeviceModel):
    kind, name, title, config = "thing", "one", "a thing", Config
    driver = f"{__name__}:driver"


ONE = One()


class Thing(DeviceKind):
    name, noun, sample, models = "thing", "thing", Sample, (ONE,)


THING = Thing()



def replace(item, **values):
    return type(type(item).__name__, (type(item),), values)()
"""

BENCH = """
schema = 1
name = "lab"

[imu]
backend = "emulated"

[{section}]
{rest}
"""

COMMANDS = (("doctor", "--bench", "bench.toml"), ("run", "bring_up", "--bench", "bench.toml", "--dry-run"))


@pytest.fixture
def bench(tmp_path):
    def write(section="thing", rest=""):
        (tmp_path / "bench.toml").write_text(BENCH.format(section=section, rest=rest))
        return tmp_path / "bench.toml"

    return write


def changed(text):
    return f"{MODEL}\nfrom hil.drivers.imu.bno055.model import Bno055\nBNO055 = Bno055()\nITEM = {text}\n"


REFUSED = {
    "an import that fails": (
        "import no_such_library\n",
        ("hil-new 1.0", "no_such_library", "install what it needs", "uninstall hil-new"),
    ),
    "something else": ("ITEM = 3\n", ("hil-new 1.0", "is a int", "DeviceKind", "DeviceModel")),
    "a kind that the bench has": (
        changed('replace(THING, name="imu", models=(replace(ONE, kind="imu"),))'),
        ("hil-new 1.0", "the kind imu exists already (hil)", "give the kind another name"),
    ),
    "a model without a driver": (
        changed("replace(THING, models=(replace(ONE, driver=None),))"),
        ("hil-new 1.0", "model one of thing has no driver"),
    ),
    "a kind that there is not": (
        changed('replace(ONE, kind="imuu")'),
        ("hil-new 1.0", "is of the kind imuu, which does not exist", "did you mean imu?"),
    ),
    "a model that there is": (
        changed("BNO055"),
        ("hil-new 1.0", "a model bno055 of imu already (hil)", "give the model another"),
    ),
    "a kind without models": (changed("replace(THING, models=())"), ("'thing' with 0 models",)),
    "a name that is none": (changed('replace(THING, name="a thing")'), ("'a thing' with 1 models",)),
    **{
        f"the name {name!r}": (changed(f"replace(THING, name={name!r})"), (f"kind {name!r} with 1 models",))
        for name in ("all", "health", "Thing", "class", None)
    },
    "an end of the process": (
        "import sys\nsys.exit(7)\n",
        ("hil-new 1.0", "cannot be loaded (SystemExit: 7)", "uninstall hil-new"),
    ),
    "a table without its name": (
        changed("replace(ONE, config=DeviceConfig, kind='imu')"),
        ("no key for its own name", "Literal"),
    ),
    "a table that is none": (
        MODEL.replace("(DeviceConfig)", "(__import__('pydantic').BaseModel)") + "ITEM = THING\n",
        ("the table of model one of thing is a Config", "DeviceConfig"),
    ),
    "a default that its own key refuses": (
        MODEL.replace('port: str = "/dev/ttyUSB0"', 'gain: float = "high"') + "ITEM = THING\n",
        ("hil-new 1.0", "wrong defaults in the table Config of model one of thing: gain = 'high': "),
    ),
    "a part of the bench file": (
        changed('replace(THING, name="safety", models=(replace(ONE, kind="safety"),))'),
        ("safety is the name of another part of the bench file", "another name"),
    ),
    "something that moves the robot": (
        changed("replace(THING, moves_robot=True)"),
        ("thing says that it moves the robot", "moves_robot = False"),
    ),
    "samples without a stamp": (
        changed("replace(THING, sample=int)"),
        ("samples of the kind thing", "stamp and status"),
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_package_that_cannot_be_used_is_named(case, package, bench, hil, tmp_path):
    source, reported = REFUSED[case]
    bench("servos")
    done = hil("doctor", "--bench", "bench.toml", packages=[package("hil-new", source, "ITEM")])
    assert done.code == 2, done.said
    assert all(words in done.said for words in reported), done.said
    assert not (tmp_path / "opened").exists()


def test_two_packages_with_one_kind_are_both_named(package, bench, hil):
    bench()
    folders = [package("hil-one", MODEL, "THING"), package("hil-two", MODEL, "THING")]
    for command in COMMANDS:
        done = hil(*command, packages=folders)
        assert done.code == 2
        assert "device package hil-two 1.0: the kind thing exists already (hil-one 1.0)" in done.said
        assert "uninstall one of the two packages, or give the kind another name" in done.said


def test_a_broken_package_is_not_blamed_on_the_procedure(package, bench, hil, tmp_path):
    bench("servos")
    (tmp_path / "mine.py").write_text(
        "from hil.procedure import procedure\n\n\n"
        "@procedure(name='mine', needs=('servos',))\ndef run(ctx):\n    pass\n"
    )
    folder = package("hil-new", "import no_such_library\n", "ITEM")
    done = hil("run", "mine.py", "--bench", "bench.toml", "--out", "out", packages=[folder])
    assert done.code == 2
    assert "\nhil: device package hil-new 1.0: " in done.said
    assert "packages/hil-new/hil_new.py" in done.said
    assert "mine.py" not in done.said


def test_two_packages_with_one_model_are_both_named(package, bench, hil):
    """Which of them adds the kind does not count: kinds come before models."""
    bench()
    folders = [package("hil-one", MODEL, "THING"), package("hil-aaa", MODEL, "ONE")]
    done = hil("doctor", "--bench", "bench.toml", packages=folders)
    assert done.code == 2
    assert "hil-aaa 1.0: there is a model one of thing already (hil-one 1.0)" in done.said


def test_info_names_what_is_wrong_beside_the_versions(package, hil):
    folder = package("hil-new", "import no_such_library\n", "ITEM")
    done = hil("info", packages=[folder])
    assert done.code == 2
    assert "numpy" in done.out
    assert "no_such_library" in done.out
    reported = json.loads(hil("info", "--json", packages=[folder]).out)
    assert reported["devices"] == {}
    assert "hil-new 1.0" in reported["problem"]


def test_info_lists_kinds_models_and_their_packages(package, hil):
    reported = json.loads(hil("info", "--json", packages=[package("hil-new", MODEL, "THING")]).out)
    assert reported["devices"]["thing"] == [{"model": "one", "title": "a thing", "package": "hil-new 1.0"}]
    assert reported["devices"]["imu"][0]["package"] == "hil"
    assert "problem" not in reported
    done = hil("info", packages=[package("hil-more", MODEL, "THING")])
    assert done.code == 0
    assert "thing            one          a thing (hil-more 1.0)" in done.out


def test_a_table_for_an_unknown_device_says_that_a_package_may_be_missing(bench, hil):
    bench("thing", 'port = "/dev/ttyUSB7"\n\n[emulation.thing]\nx = 1.0')
    for command in COMMANDS:
        done = hil(*command)
        assert done.code == 2
        for key in ("thing", "emulation.thing"):
            assert f"  {key}: unknown key; no device or table of that name" in done.said
        assert done.said.count("install the package that adds it") == 2


@pytest.mark.parametrize(("models", "reported"), [("(ONE,)", "'one'"), ("(ONE, TWO)", "expected one or two")])
def test_an_unknown_model_is_named_with_those_that_there_are(models, reported, package, bench, hil):
    two = (
        'class Second(Config):\n    model: Literal["two"] = "two"\n\n\n'
        'TWO = replace(ONE, name="two", config=Second)\n'
    )
    folder = package("hil-new", f"{MODEL}\n{two}\nITEM = replace(THING, models={models})\n", "ITEM")
    bench(rest='model = "three"')
    done = hil("doctor", "--bench", "bench.toml", packages=[folder])
    assert done.code == 2
    assert "thing" in done.said
    assert "three" in done.said
    assert reported in done.said


def test_a_model_that_cannot_be_emulated_is_named(package, bench, hil):
    bench(rest='backend = "emulated"')
    done = hil("doctor", "--bench", "bench.toml", packages=[package("hil-new", MODEL, "THING")])
    assert done.code == 2
    assert "thing.model = 'one' cannot be emulated" in done.said


def test_samples_that_cannot_be_recorded_are_named(package, monkeypatch, forget):
    source = MODEL.replace("value: float", "value: complex")
    monkeypatch.syspath_prepend(package("hil-new", source, "THING"))
    forget()
    with pytest.raises(ConfigError, match=r"samples of the kind thing \(hil-new 1\.0\) cannot be recorded"):
        CycleCodec(added())
