"""Files: only regular ones, whole, within a limit; any other is a FileError that names the path, and at once."""

import os
import socket

import pytest

from loewner import FileError
from loewner._files import CHUNK, read_regular


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
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as server:
        here = os.getcwd()
        os.chdir(tmp_path)  # a socket's path is limited to about a hundred letters
        try:
            server.bind("socket")
        finally:
            os.chdir(here)
        for path, found in (("pipe", "a pipe"), ("/dev/zero", "a device"), ("socket", "a socket"), (".", "directory")):
            with pytest.raises(FileError, match=f"expected a text, found .*{found}"):
                read_regular(tmp_path / path, "a text", 1 << 40)


@pytest.mark.parametrize("name", ["a\0b", "a\ud800b", "x" * 300, "none", "x/../y", "\udcff"])
def test_impossible_names(name, tmp_path):
    """A name with NUL, with a surrogate, too long or of no file is a FileError whose message can be printed."""
    with pytest.raises(FileError, match="expected a text") as caught:
        read_regular(tmp_path / name, "a text", 10)
    str(caught.value).encode()


@pytest.mark.skipif(not os.path.exists("/proc/self/mem"), reason="needs Linux's /proc")
def test_failing_read():
    """An input/output error while reading is a FileError."""
    with pytest.raises(FileError, match="/proc/self/mem: expected a text, found input/output error"):
        read_regular("/proc/self/mem", "a text", 10)


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may read all")
def test_permission(tmp_path):
    """A file that may not be read is a FileError."""
    (tmp_path / "file").write_bytes(b"x")
    (tmp_path / "file").chmod(0)
    with pytest.raises(FileError, match="permission denied"):
        read_regular(tmp_path / "file", "a text", 10)
