"""No kernel runs with an old version of what it is made of, however that is imported."""

import importlib
import os
import subprocess
import sys

import pytest

from hil.estimator.compiled import fingerprint, sources

INNER = (
    "from hil.estimator.compiled import (\n    compiled,\n)\n\n\n@compiled\ndef step(x):\n    return x + {}\n"
)
OUTER = """
from hil.estimator.compiled import compiled as machine_code
{how}


@machine_code
def outer(x):
    return {call}
"""
FORMS = {
    "parenthesised": ("from kernels.inner import (\n    step,\n)", "step(x)"),
    "alias": ("from kernels.inner import step as stride", "stride(x)"),
    "module": ("from kernels import inner", "inner.step(x)"),
    "module_alias": ("import kernels.inner as i", "i.step(x)"),
    "relative": ("from .inner import step", "step(x)"),
    "relative_module": ("from . import inner as i", "i.step(x)"),
    "in_a_branch": ("try:\n    from kernels.inner import step\nexcept ImportError:\n    raise", "step(x)"),
    "with_a_comment": ("from kernels.inner import step  # quick", "step(x)"),
    "by_a_third": ("from kernels.third import step", "step(x)"),
}


@pytest.fixture
def package(tmp_path):
    """Writes a package `kernels` whose outer kernel calls an inner one that adds a number."""
    folder = tmp_path / "kernels"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "third.py").write_text("from kernels.inner import (\n    step,\n)\n")

    def write(form, added):
        how, call = FORMS[form]
        (folder / "inner.py").write_text(INNER.format(added))
        (folder / "outer.py").write_text(OUTER.format(how=how, call=call))
        return tmp_path

    return write


@pytest.mark.parametrize("form", FORMS)
def test_a_fingerprint_covers_every_file_that_is_used(package, form, monkeypatch):
    monkeypatch.syspath_prepend(package(form, 1.0))
    for name in [n for n in sys.modules if n.partition(".")[0] == "kernels"]:
        monkeypatch.delitem(sys.modules, name)
    importlib.import_module("kernels")
    used = set(sources("kernels.outer"))
    assert used >= {"kernels.outer", "kernels.inner", "hil.estimator.compiled"}
    assert ("kernels.third" in used) is (form == "by_a_third")


@pytest.mark.parametrize("form", ["parenthesised", "module_alias"])
def test_an_edited_inner_kernel_changes_what_the_outer_one_says(package, form, tmp_path):
    pytest.importorskip("numba")
    environment = {
        **os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path]),
    }  # fmt: skip

    def says(added):
        package(form, added)
        code = "from kernels.outer import outer; print(outer(1.0), sum(outer.stats.cache_hits.values()))"
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout.split()

    assert says(1.0) == ["2.0", "0"]
    assert says(1.0) == ["2.0", "1"]
    assert says(7.0) == ["8.0", "0"]


def test_what_only_an_annotation_names_is_no_part_of_a_kernel():
    used = set(sources("hil.estimator.process"))
    assert {"hil.estimator.layout", "hil.estimator.compiled"} <= used
    assert not used & {"hil.vocabulary.geometry", "hil.config.estimator", "hil.estimator.fusion"}
    assert "hil.robot.contact_laws" in sources("hil.estimator.friction")
    assert len({fingerprint(f"hil.estimator.{name}") for name in ("process", "friction", "replay")}) == 3


def test_the_physics_of_the_plant_is_one_file():
    """Compiled apart, by numba's own stamp of that file (`hil.fakes.plant.compiled`)."""
    importlib.import_module("hil.fakes.plant.kernel")
    assert set(sources("hil.fakes.plant.kernel")) == {"hil.fakes.plant.kernel"}
