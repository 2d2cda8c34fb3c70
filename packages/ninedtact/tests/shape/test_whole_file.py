"""Nothing half-written: not when the disk is full, not when the program is stopped."""

import errno
import os
import stat
from pathlib import Path

import pytest

from ninedtact.atomic_write import FileNotWritten, create_folder_atomically, open_atomic_file, write_file_atomically


def test_content_appears_whole_and_replaces_what_was_there(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"before")
    write_file_atomically(path, b"first ", memoryview(b"second"))
    assert path.read_bytes() == b"first second"
    assert [found.name for found in tmp_path.iterdir()] == ["file"]


def test_others_may_read_it_as_any_new_file(tmp_path):
    (tmp_path / "plain").touch()
    write_file_atomically(tmp_path / "whole", b"")
    assert stat.S_IMODE((tmp_path / "whole").stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)


def test_until_the_end_only_the_old_file_is_seen(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"before")
    with open_atomic_file(path) as file:
        file.write(b"after")
        assert path.read_bytes() == b"before"
    assert path.read_bytes() == b"after"


@pytest.mark.parametrize("trouble", [KeyboardInterrupt(), ValueError("no"), OSError(errno.ENOSPC, "No space left")])
def test_a_stopped_write_leaves_what_was_there_and_nothing_else(tmp_path, trouble):
    path = tmp_path / "file"
    path.write_bytes(b"before")
    expected = FileNotWritten if isinstance(trouble, OSError) else type(trouble)
    with pytest.raises(expected), open_atomic_file(path) as file:
        file.write(b"half")
        raise trouble
    assert path.read_bytes() == b"before"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_full_disk_is_told_in_one_sentence(tmp_path):
    with pytest.raises(FileNotWritten, match=r"expected to write .*file, got: No space left; free the disk"):  # noqa: SIM117
        with open_atomic_file(tmp_path / "file"):
            raise OSError(errno.ENOSPC, "No space left")
    with pytest.raises(FileNotWritten, match="No such file or directory; choose another folder"):  # noqa: SIM117
        with open_atomic_file(tmp_path / "file"):  # as in /proc
            raise OSError(errno.ENOENT, "No such file or directory")


def test_a_folder_in_its_place_is_refused_and_left_alone(tmp_path):
    (tmp_path / "file").mkdir()
    with pytest.raises(FileNotWritten):
        write_file_atomically(tmp_path / "file", b"content")
    assert [found.name for found in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("is_there", [True, False])
def test_through_a_link_is_written_what_it_names(tmp_path, is_there):
    """A link is kept, and what it names has the new content; /dev/stdout is such a link, too."""
    disk = tmp_path / "disk"
    disk.mkdir()
    (tmp_path / "file").symlink_to(disk / "file")
    (tmp_path / "folder").symlink_to("disk/folder")
    if is_there:
        (disk / "file").write_bytes(b"before")
        (disk / "folder").mkdir()
        (disk / "folder" / "before").touch()
    write_file_atomically(tmp_path / "file", b"after")
    with create_folder_atomically(tmp_path / "folder") as folder:
        (folder / "after").touch()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["disk", "file", "folder"]
    assert (tmp_path / "file").is_symlink() and (disk / "file").read_bytes() == b"after"
    assert (tmp_path / "folder").is_symlink() and [path.name for path in (disk / "folder").iterdir()] == ["after"]
    assert len(list(disk.iterdir())) == 2


def test_a_device_or_a_pipe_is_not_replaced(tmp_path):
    """As root, a file would otherwise take the place of /dev/null."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    for name in ("pipe", "link"):
        with pytest.raises(FileNotWritten, match="which is a device or a pipe; name a file"):
            write_file_atomically(tmp_path / name, b"content")
    assert (tmp_path / "pipe").is_fifo()


def test_a_folder_that_cannot_be_made_is_named_as_it_was_given(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(FileNotWritten, match=r"expected to write .*file/folder, got: .*file is no folder"):  # noqa: SIM117
        with create_folder_atomically(tmp_path / "file" / "folder"):
            pytest.fail("nothing is worked for in vain")


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(FileNotWritten, match=f"make the folder {tmp_path / 'missing'}"):
        write_file_atomically(tmp_path / "missing" / "file", b"content")


@pytest.mark.parametrize("name", [".", "..", "../here", "sub/..", "/"])
def test_the_current_folder_is_not_replaced_under_the_program(tmp_path, monkeypatch, name):
    here = tmp_path / "here"
    (here / "sub").mkdir(parents=True)
    monkeypatch.chdir(here)
    with pytest.raises(FileNotWritten, match=r"expected .*, got .*, in which this program runs; "):  # noqa: SIM117
        with create_folder_atomically(Path(name)):
            pytest.fail("nothing is worked for in vain")
    with create_folder_atomically(Path("sub")) as folder:
        (folder / "file").touch()
    assert [found.relative_to(tmp_path).as_posix() for found in tmp_path.rglob("*")] == [
        "here",
        "here/sub",
        "here/sub/file",
    ]
