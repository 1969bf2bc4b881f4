"""A module that is imported when asked is what it would have been, and not before."""

import importlib
import sys

import pytest

from hil.vocabulary.when_asked import import_when_asked

HANDS_OUT = """
__all__ = ["heavy"]

def __getattr__(name):
    if name != "heavy":
        raise AttributeError(name)
    import shop.heavy as heavy
    return heavy
"""


@pytest.fixture
def shop(tmp_path, monkeypatch):
    """A package that hands out a module to whoever asks for all of its names."""
    folder = tmp_path / "shop"
    folder.mkdir()
    (folder / "__init__.py").write_text(HANDS_OUT)
    (folder / "heavy.py").write_text("import sys\nsys.shop_sold = True\nWEIGHT_KG = 3.0\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "shop_sold", False, raising=False)
    yield importlib.import_module("shop")
    for name in ("shop", "shop.heavy"):
        sys.modules.pop(name, None)


def test_all_names_of_the_package_do_not_import_it_and_a_look_does(shop):
    import_when_asked(shop, "heavy")
    names = {}
    exec("from shop import *", names)
    assert not sys.shop_sold
    assert names["heavy"].WEIGHT_KG == 3.0
    assert sys.shop_sold
    assert names["heavy"] is sys.modules["shop.heavy"] is shop.heavy


def test_without_it_all_names_import_it(shop):
    exec("from shop import *", {})
    assert sys.shop_sold


def test_what_is_imported_already_stays_what_it_is(shop):
    heavy = importlib.import_module("shop.heavy")
    import_when_asked(shop, "heavy")
    assert sys.modules["shop.heavy"] is heavy
    assert shop.heavy is heavy


def test_a_module_that_there_is_not_is_left_alone(shop):
    import_when_asked(shop, "light")
    assert "shop.light" not in sys.modules
    assert not hasattr(shop, "light")
