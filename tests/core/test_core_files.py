"""A file that cannot be written is named, and nothing but our own error leaves."""

import pytest

from hil.vocabulary.errors import DataError
from hil.vocabulary.files import write_text


def test_a_text_is_written_over_what_was_there(tmp_path):
    path = tmp_path / "page.html"
    assert write_text(path, "old and long") == path
    write_text(path, "Größe")
    assert path.read_bytes() == "Größe".encode()


@pytest.mark.parametrize("name", ["no/page.html", "."])
def test_what_cannot_be_written_is_named(tmp_path, name):
    with pytest.raises(DataError, match="cannot be written") as caught:
        write_text(tmp_path / name, "text")
    assert caught.value.path == str(tmp_path / name)
