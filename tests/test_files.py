"""Files: only regular ones are read, within a limit, and written over; any other is a FileError that names the path."""

import os
import socket
from contextlib import contextmanager

import pytest

from loewner import Body, FileError, Scene, save_scene
from loewner._base._files import CHUNK, read_regular, replacing


@contextmanager
def no_regular_files(folder):
    """A pipe, a socket and a directory, and what each is called."""
    os.mkfifo(folder / "pipe")
    (folder / "folder").mkdir()
    with socket.socket(socket.AF_UNIX) as server:
        here = os.getcwd()
        os.chdir(folder)  # a socket's path is limited to about a hundred letters
        try:
            server.bind("socket")
        finally:
            os.chdir(here)
        yield {folder / "pipe": "a pipe", folder / "socket": "a socket", folder / "folder": "a directory"}


def test_read_whole(tmp_path):
    """All bytes of a file come back, of an empty one and of one longer than a chunk too."""
    for data in (b"", b"abc", bytes(range(256)) * (CHUNK // 256) + b"end"):
        (tmp_path / "file").write_bytes(data)
        assert read_regular(tmp_path / "file", "a file", len(data)) == data


def test_limit(tmp_path):
    """One byte more than the limit is refused, and the message gives both numbers."""
    (tmp_path / "file").write_bytes(b"x" * 11)
    with pytest.raises(FileError, match="file: expected a text of at most 10 bytes, found 11"):
        read_regular(tmp_path / "file", "a text", 10)


def test_endless_device_and_pipe_are_refused_at_once(tmp_path):
    """What could block or never end is not read: a pipe without a writer, a device, a socket, a directory."""
    with no_regular_files(tmp_path) as paths:
        for path, found in {**paths, "/dev/zero": "a device"}.items():
            with pytest.raises(FileError, match=f"expected a text, found .*{found}"):
                read_regular(path, "a text", 1 << 40)


def test_what_is_no_regular_file_is_not_written_over(tmp_path):
    """Renaming a file would take the name away from a pipe, a socket, a device (as root), or what links lead to."""
    with no_regular_files(tmp_path) as paths:
        for path, found in paths.items():
            link = tmp_path / f"link to {found}"
            link.symlink_to(path)
            for name in (path, link):
                before = os.lstat(name)
                refused = pytest.raises(FileError, match=f"expected the name of a file to write, found .*{found}")
                with refused, replacing(name):
                    pytest.fail("there is nothing to write to")
                assert os.lstat(name) == before
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(FileError, match="loop: could not be written"), replacing(tmp_path / "loop"):
        pytest.fail("there is nothing to write to")


@pytest.mark.parametrize("name", ["a\0b", "a\ud800b"])
def test_impossible_names_are_not_written(name, tmp_path):
    """A name with NUL or a surrogate is a FileError, too."""
    with pytest.raises(FileError, match="found one that no file can have"), replacing(tmp_path / name):
        pytest.fail("there is nothing to write to")


def test_no_name_is_the_folder(tmp_path, monkeypatch):
    """An empty name writes nothing, least of all beside the folder."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileError, match="found a directory"), replacing(""):
        pytest.fail("there is nothing to write to")


@pytest.mark.skipif(os.name == "nt", reason="a folder in use cannot be removed there")
def test_in_a_folder_that_is_gone_nothing_is_written(tmp_path, monkeypatch):
    """Where the process stands in a folder that was removed, a relative name leads nowhere."""
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    with pytest.raises(FileError, match="file.txt: could not be written"), replacing("file.txt") as temporary:
        temporary.write_text("")


def test_links_stay_links(tmp_path):
    """What a link leads to is written, whether it is there or not; nothing else is left in either folder."""
    (tmp_path / "there").mkdir()
    (tmp_path / "here").mkdir()
    link, file = tmp_path / "here" / "link.txt", tmp_path / "there" / "file.txt"
    link.symlink_to("../there/file.txt")
    for text in ("first", "second"):
        with replacing(link) as temporary:
            temporary.write_text(text)
        assert link.is_symlink()
        assert file.read_text() == text
    assert [*link.parent.iterdir(), *file.parent.iterdir()] == [link, file]


def test_a_scene_that_cannot_be_written_leaves_nothing(tmp_path):
    """Bodies are saved beside a scene's file only where there can be one."""
    scene = Scene()
    scene.add("hull", Body.from_points([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]))
    (tmp_path / "scene.yaml").mkdir()
    with pytest.raises(FileError, match=r"scene.yaml: expected the name of a file to write, found a directory"):
        save_scene(scene, tmp_path / "scene.yaml")
    assert [path.name for path in tmp_path.iterdir()] == ["scene.yaml"]


@pytest.mark.parametrize("name", ["a\0b", "a\ud800b", "x" * 300, "none", "x/../y", "\udcff"])
def test_impossible_names(name, tmp_path):
    """A name with NUL, with a surrogate, too long or of no file is a FileError whose message can be printed."""
    with pytest.raises(FileError, match="expected a text") as caught:
        read_regular(tmp_path / name, "a text", 10)
    str(caught.value).encode()


@pytest.mark.skipif(not os.path.exists("/proc/self/mem"), reason="needs Linux's /proc")
def test_failing_read():
    """An input/output error while reading is a FileError."""
    with pytest.raises(
        FileError, match=r"/proc/self/mem: expected a text, but it could not be read \(Input/output error\)"
    ):
        read_regular("/proc/self/mem", "a text", 10)


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may read all")
def test_permission(tmp_path):
    """A file that may not be read is a FileError."""
    (tmp_path / "file").write_bytes(b"x")
    (tmp_path / "file").chmod(0)
    with pytest.raises(FileError, match="permission denied"):
        read_regular(tmp_path / "file", "a text", 10)
