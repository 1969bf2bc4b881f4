"""A file that cannot be written is named, and nothing but our own error leaves."""

import resource

import pytest

from hil.console.json_files import put_private
from hil.core.errors import DataError
from hil.support.atomic_files import put_whole, write_text


def test_a_text_is_written_over_what_was_there(tmp_path):
    path = tmp_path / "new" / "page.html"
    assert write_text(path, "old and long") == path
    write_text(path, "Größe")
    assert path.read_bytes() == "Größe".encode()


@pytest.mark.parametrize("name", ["file/page.html", "."])
def test_what_cannot_be_written_is_named(tmp_path, name):
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match="cannot be written") as caught:
        write_text(tmp_path / name, "text")
    assert caught.value.path == str(tmp_path / name)


def test_on_a_full_disk_the_old_file_stays_and_no_part_of_the_new_one(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text("old")
    (tmp_path / "c.toml.part").symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left"):
        put_whole(path, b"new")
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("c.toml", "old")]


def test_an_object_that_cannot_be_put_into_a_file_leaves_no_part_of_it(tmp_path):
    with pytest.raises(TypeError):
        put_private(tmp_path / "state.json", object())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("old", [None, "the old page"])
def test_a_page_that_the_disk_does_not_take_is_not_left_cut_off(tmp_path, old):
    path, before = tmp_path / "report.html", resource.getrlimit(resource.RLIMIT_FSIZE)
    if old is not None:
        path.write_text(old)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(DataError, match=r"report\.html"):
            write_text(path, "<p>the new page</p>" * 100)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    left = [] if old is None else [(path.name, old)]
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == left


def test_a_text_keeps_the_rights_of_the_file_and_is_written_through_a_link(tmp_path):
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "real.txt").chmod(0o640)
    (tmp_path / "link.txt").symlink_to(tmp_path / "real.txt")
    write_text(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink()
    write_text(tmp_path / "real.txt", "newer")
    assert (tmp_path / "link.txt").read_text() == "newer"
    assert (tmp_path / "real.txt").stat().st_mode & 0o777 == 0o640
